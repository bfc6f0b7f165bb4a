"""The times at which triggers fire, by hand; test_triggers_any.py has any sequence of states."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState, Size
from ssp_core.run_file.participants import TriggerSpec
from ssp_core.vocabulary import Phase
from ssp_scenario_manager.triggers.conditions import Sample, Snapshot
from ssp_scenario_manager.triggers.evaluator import Firing, TriggerWatch, truth
from tests.support.states import object_state

MS = 1_000_000
S = 1_000_000_000
PATH = Polyline([(0.0, 0.0), (256.0, 0.0)])
SIZE = Size(3.5, 1.0, 2.0, 1.5)
GAP = {"type": "relative_distance", "object_id": "ot1", "below_m": 12.0}
FAST = {"type": "speed", "object_id": "vut", "relation": "above", "value_mps": 8.0}
OT_SLOW = {"type": "speed", "object_id": "ot1", "relation": "below", "value_mps": 4.0}
BEGUN = {"type": "phase_reached", "phase": "trigger"}


def both(*of: dict[str, Any]) -> dict[str, Any]:
    return {"type": "all", "of": list(of)}


def either(*of: dict[str, Any]) -> dict[str, Any]:
    return {"type": "any", "of": list(of)}


def spec(condition: dict[str, Any] = GAP, **given: Any) -> TriggerSpec:
    return TriggerSpec.model_validate(
        {
            "id": "t",
            "condition": condition,
            "object_id": "ot1",
            "manoeuvre": {
                "kind": "lane_change",
                "lateral_shift_m": 1.0,
                "duration_s": 1.0,
                "cruise_mps": 5.0,
            },
            **given,
        }
    )


def car(object_id: str, stamp_ns: int, x_m: float, y_m: float, speed_mps: float) -> ObjectState:
    moving = {"speed_mps": speed_mps, "stamp_ns": stamp_ns, "size": SIZE}
    return object_state(object_id, x_m=x_m, y_m=y_m, **moving)


def snapshot(
    stamp_ns: int,
    gap_m: float = 50.0,
    vut_mps: float = 0.0,
    ot_mps: float = 10.0,
    trigger_ns: int | None = None,
) -> Snapshot:
    """VUT and ot1 in a lane, so far apart; NaN as the gap: ot1 isn't heard."""
    vut = car("vut", stamp_ns, 10.0, 0.0, vut_mps)
    targets = {}
    if not math.isnan(gap_m):
        targets["ot1"] = car("ot1", stamp_ns, 14.5 + gap_m, 0.0, ot_mps)
    phases = {} if trigger_ns is None else {Phase.TRIGGER: trigger_ns}
    return Snapshot(vut, targets, PATH, 300 * MS, phases)


def fire(asked: TriggerSpec, snapshots: list[Snapshot], start_ns: int = 0) -> list[Firing]:
    watch = TriggerWatch(asked, PATH, start_ns)
    firings = [watch.observe(snapshot) for snapshot in snapshots]
    return [firing for firing in firings if firing is not None]


def gaps(*samples: tuple[int, float]) -> list[Snapshot]:
    return [snapshot(stamp_ns, gap_m) for stamp_ns, gap_m in samples]


def at(firings: list[Firing]) -> list[tuple[int, int]]:
    return [(f.crossing_ns, f.fired_ns) for f in firings]


# -- one condition --------------------------------------------------------------------------------


def test_the_crossing_is_interpolated_and_its_samples_kept() -> None:
    (firing,) = fire(spec(), gaps((0, 16.0), (100 * MS, 13.0), (200 * MS, 9.0)))
    assert (firing.crossing_ns, firing.fired_ns) == (125 * MS, 200 * MS)
    assert firing.samples == (Sample(100 * MS, 13.0), Sample(200 * MS, 9.0))
    assert (firing.threshold, firing.condition) == (12.0, "gap vut - ot1 < 12 m")


def test_a_crossing_between_two_nanoseconds_is_at_the_even_one() -> None:
    # 14 648 437.5 ns after the first sample: 1 000 976 562.5 ns.
    first, second = 986_328_125, 1_005_859_375
    (firing,) = fire(spec(), gaps((first, 18.0), (second, 10.0)))
    assert firing.crossing_ns == 1_000_976_562


def test_without_an_edge_it_fires_also_where_it_holds_from_the_first() -> None:
    samples = gaps((7, 3.0), (8, 2.0))
    (firing,) = fire(spec(), samples)
    assert (firing.crossing_ns, firing.fired_ns) == (7, 7)
    assert firing.samples == (Sample(7, 3.0),)
    assert fire(spec(edge="rising"), samples) == []


def test_a_rising_edge_needs_it_to_have_failed_before() -> None:
    samples = gaps((0, 3.0), (100, 13.0), (200, 11.0))
    (firing,) = fire(spec(edge="rising"), samples)
    assert (firing.crossing_ns, firing.fired_ns) == (150, 200)
    assert firing.condition == "gap vut - ot1 < 12 m, rising"


def test_a_falling_edge_needs_it_to_have_held_before() -> None:
    (firing,) = fire(spec(edge="falling"), gaps((0, 13.0), (100, 11.0), (200, 13.0)))
    assert (firing.crossing_ns, firing.fired_ns) == (150, 200)
    assert firing.samples == (Sample(100, 11.0), Sample(200, 13.0))
    assert fire(spec(edge="falling"), gaps((0, 13.0), (100, 14.0), (200, 13.0))) == []
    # Failing is what must be held then.
    held = spec(edge="falling", held_for_s=1e-7)
    assert at(fire(held, gaps((0, 11.0), (100, 13.0), (200, 13.0)))) == [(50, 200)]


def test_held_counts_from_the_crossing_and_an_interruption_resets_it() -> None:
    held = spec(held_for_s=0.2)
    falling = [(0, 13.0), (100 * MS, 11.0)]  # crosses at 50 ms
    assert fire(held, gaps(*falling, (249 * MS, 11.0))) == []
    (firing,) = fire(held, gaps(*falling, (249 * MS, 11.0), (250 * MS, 11.0)))
    assert (firing.crossing_ns, firing.fired_ns) == (50 * MS, 250 * MS)
    assert firing.samples == (Sample(0, 13.0), Sample(100 * MS, 11.0))
    assert firing.condition == "gap vut - ot1 < 12 m, held for 0.2 s"
    # One sample at the threshold and it starts again.
    again = [*falling, (200 * MS, 12.0), (300 * MS, 10.0), (399 * MS, 10.0)]
    assert fire(held, gaps(*again)) == []
    assert at(fire(held, gaps(*again, (400 * MS, 10.0)))) == [(200 * MS, 400 * MS)]


def test_not_before_counts_from_the_start_of_the_run() -> None:
    later = spec(not_before_s=1.0)
    early = [(5 * S, 20.0), (5 * S + 500 * MS, 3.0), (6 * S - 1, 3.0)]
    assert fire(later, gaps(*early), 5 * S) == []
    (firing,) = fire(later, gaps(*early, (6 * S, 3.0)), 5 * S)
    # What happened before doesn't count: it is true from the first sample on.
    assert (firing.crossing_ns, firing.fired_ns) == (6 * S, 6 * S)
    assert firing.samples == (Sample(6 * S, 3.0),)
    assert fire(spec(not_before_s=1.0, edge="rising"), gaps(*early, (6 * S, 3.0)), 5 * S) == []


def test_of_two_states_of_one_instant_the_first_counts() -> None:
    assert fire(spec(), gaps((100, 13.0), (100, 11.0), (200, 13.0))) == []


# -- several conditions ---------------------------------------------------------------------------


def test_all_cross_with_the_latest_and_any_with_the_earliest() -> None:
    snapshots = [snapshot(0, 13.0, 7.0), snapshot(100, 11.0, 7.5), snapshot(200, 9.0, 8.5)]
    (firing,) = fire(spec(both(GAP, FAST)), snapshots)
    assert (firing.crossing_ns, firing.fired_ns) == (150, 200)
    assert firing.threshold == 8.0
    assert firing.samples == (Sample(100, 7.5), Sample(200, 8.5))
    (firing,) = fire(spec(either(GAP, FAST)), snapshots)
    assert (firing.crossing_ns, firing.fired_ns) == (50, 100)
    assert firing.threshold == 12.0


def test_a_whole_may_become_unknown_by_a_part_that_becomes_true() -> None:
    unheard = [snapshot(0, math.nan, 7.0), snapshot(100, math.nan, 9.0)]
    (firing,) = fire(spec(both(GAP, FAST)), [*unheard, snapshot(200, 11.0, 9.0)])
    assert (firing.crossing_ns, firing.fired_ns, firing.threshold) == (200, 200, 12.0)


def test_every_condition_of_a_nested_one_is_explained() -> None:
    snapshots = [snapshot(S, 13.0, 7.0), snapshot(2 * S, 11.0, 7.5), snapshot(3 * S, 9.0, 8.5)]
    (firing,) = fire(spec(both(GAP, either(FAST, OT_SLOW)), held_for_s=0.1), snapshots)
    assert firing.condition == (
        "all of (gap vut - ot1 < 12 m (9.000 m, holds since 1.500 s); any of ("
        "speed of vut > 8 m/s (8.500 m/s, holds since 2.500 s); "
        "speed of ot1 < 4 m/s (10.000 m/s, fails since 1.000 s))), held for 0.1 s"
    )


def test_times_in_the_explanation_count_from_the_start_of_the_run() -> None:
    late = {"type": "elapsed_time", "after_s": 1.5}
    heard = [snapshot(6 * S, 13.0), snapshot(7 * S, math.nan), snapshot(8 * S, math.nan)]
    (firing,) = fire(spec(either(BEGUN, GAP, late)), heard, 5 * S)
    assert (firing.crossing_ns, firing.fired_ns) == (6 * S + 500 * MS, 7 * S)
    assert firing.condition == (
        "any of (time since phase trigger >= 0 s (-inf s, fails since 1.000 s); "
        "gap vut - ot1 < 12 m (nan m, unknown since 2.000 s); "
        "time since the start >= 1.5 s (2.000 s, holds since 1.500 s))"
    )


A, B, C = GAP, FAST, OT_SLOW
SHAPES = [
    both(A, either(B, C)),
    both(either(A, B), C),
    either(A, both(B, C)),
    either(both(A, B), C),
    both(either(A), both(B), C),
    either(both(A, either(B)), C),
    both(both(either(both(A), B)), C),
]


def grade(condition: dict[str, Any], grades: Iterator[float]) -> float:
    """The truth of a condition as a number: 0 false, 1/2 unknown, 1 true."""
    if "of" not in condition:
        return next(grades)
    parts = [grade(part, grades) for part in condition["of"]]
    return min(parts) if condition["type"] == "all" else max(parts)


@pytest.mark.parametrize("condition", SHAPES)
def test_unknown_lies_between_false_and_true_at_every_depth(condition: dict[str, Any]) -> None:
    number = {False: 0.0, None: 0.5, True: 1.0}
    asked = spec(condition).condition
    for holds in itertools.product(number, repeat=3):
        expected = grade(condition, iter([number[one] for one in holds]))
        assert number[truth(asked, holds)] == expected, holds


# -- phases and time ------------------------------------------------------------------------------


def test_what_held_since_a_phases_start_is_seen_afterwards() -> None:
    """The gap holds from 200 to 400, the phase from 150, known at 600: nothing fires afterwards."""
    short = gaps((0, 13.0), (100, 13.0), (300, 11.0), (500, 13.0))
    known = [snapshot(600, 13.0, trigger_ns=150), snapshot(800, 11.0, trigger_ns=150)]
    assert at(fire(spec(both(BEGUN, GAP)), [*short, *known])) == [(700, 800)]
    # That it failed again at 400 is a falling edge, though it was never seen to hold.
    assert at(fire(spec(both(BEGUN, GAP), edge="falling"), [*short, *known])) == [(400, 600)]


# -- cost -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("many", [1, 21])
def test_a_state_is_judged_without_asking_every_object(
    many: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One trigger costs the same with 1 and 21 objects: counted in encounters and projections."""
    calls: list[int] = []
    honest: Callable[..., Any] = Polyline.project_all

    def counted(self: Polyline, points: Any) -> Any:
        calls.append(len(points))
        return honest(self, points)

    watch = TriggerWatch(spec(both(GAP, FAST)), PATH, 0)
    targets = {f"ot{i + 1}": car(f"ot{i + 1}", 0, 60.0 + 8 * i, 0.0, 5.0) for i in range(many)}
    monkeypatch.setattr(Polyline, "project_all", counted)
    for stamp_ns in (MS, 2 * MS):
        watch.observe(Snapshot(car("vut", stamp_ns, 9.0, 0.0, 5.0), targets, PATH, S, {}))
    assert calls == [5, 5]
