"""The events of a run in result.json: the facts that it states, and those that aren't known."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ssp_core.motion.event import PhaseBegan
from ssp_core.motion.passing import Passing
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState, Size
from ssp_core.run_file.model import RunSpec, WantedPassing
from ssp_core.vocabulary import ObjectClass, Phase, Role, Verdict
from ssp_core.world.plant import FaultFact
from ssp_scenario_manager.run.in_process import run_in_process
from ssp_scenario_manager.run.result import (
    RunEvents,
    happened_by,
    misses,
    result_keys,
    time_gap_text,
)

S = 1_000_000_000


def fault(name: str, at_ns: int, value: float = math.nan) -> FaultFact:
    return FaultFact("sil_world", name, "ot1", True, value, "", at_ns)


def passed(other_first: bool | None, gap_s: float | None) -> Passing:
    """Return a passing in which one of them arrives first; None: the other never arrives."""
    if other_first is None:
        return Passing()
    return Passing("merge", None, 1.0, 2.0 if other_first else 0.0, gap_s)


@pytest.fixture
def empty(run: RunSpec) -> Callable[..., RunEvents]:
    """A run without any report of a world."""

    def make(began_ns: int | None, *faults: FaultFact) -> RunEvents:
        truths: dict[str, Any] = {run.vut.id: [], **{t.id: [] for t in run.targets}}
        return RunEvents.measure(run, began_ns, (), (), faults, truths)

    return make


def test_no_gap_is_stated_of_a_run_that_never_reached_its_conflict(run: RunSpec) -> None:
    limits = run.limits.model_copy(update={"jump_m": 1.0, "frozen_s": 0.3})
    run = run.model_copy(update={"limits": limits})
    result, record = run_in_process(run)
    whole = result.happened
    truths = {i: record.truths(i) for i in (run.vut.id, *(t.id for t in run.targets))}

    def keys(*phases: Phase) -> dict[str, Any]:
        began = [p for p in whole.phases if p.phase in phases]
        return result_keys(run, RunEvents.measure(run, 0, began, whole.triggers, (), truths))

    met, unmet = keys(*Phase), keys(Phase.APPROACH, Phase.TRIGGER)
    assert (met["initiator_first"], met["time_gap_s"] > 0.0) == (True, True)
    assert (unmet["initiator_first"], unmet["time_gap_s"]) == (None, None)
    assert unmet["triggers"] == met["triggers"] != []
    assert unmet["min_distance_m"] == met["min_distance_m"] > 0.0
    assert time_gap_text(unmet["time_gap_s"]) == "no time gap"


def test_faults_are_told_by_number_and_kind_in_the_same_order(
    run: RunSpec, empty: Callable[..., RunEvents]
) -> None:
    late, early = fault("10 link_delay", 3 * S, 0.2), fault("2 state_nan", 2 * S)
    one, other = (
        result_keys(run, empty(0, *order))["faults"] for order in ((late, early), (early, late))
    )
    assert one == other
    assert [(f["number"], f["kind"], f["value"], f["at_s"]) for f in one] == [
        (2, "state_nan", None, 2.0),
        (10, "link_delay", 0.2, 3.0),
    ]


def test_times_count_from_the_start_and_are_unknown_without_one(
    run: RunSpec, empty: Callable[..., RunEvents]
) -> None:
    began_ns = 1_700_000_000 * S
    for start_ns, at_s in ((began_ns, 2.5), (None, None)):
        happened = empty(start_ns, fault("0 link_cut", began_ns + 5 * S // 2))
        assert result_keys(run, happened)["faults"][0]["at_s"] == at_s
        json.dumps(result_keys(run, happened), allow_nan=False)


def test_what_nothing_tells_is_null_and_not_empty(
    run: RunSpec, empty: Callable[..., RunEvents], tmp_path: Path
) -> None:
    assert happened_by(tmp_path / "no-bag", run) is None
    nothing, unseen = result_keys(run, None), result_keys(run, empty(0))
    assert list(nothing) == list(unseen)
    assert (nothing["phases"], nothing["faults"]) == (None, None)
    assert (unseen["phases"], unseen["faults"], unseen["min_distance_m"]) == ([], [], None)
    assert (nothing["seed"], nothing["mode"]) == (run.seed, run.mode)
    live = result_keys(replace_mode(run), replace(empty(0), began_ns=None))
    assert (live["mode"], live["time_gap_s"], live["min_distance_m"]) == ("live", None, None)


def replace_mode(run: RunSpec) -> RunSpec:
    return run.model_copy(update={"mode": "live"})


# -- the event as K* wants it (METHOD 4.4) ---------------------------------------------------------


@pytest.mark.parametrize(
    ("first", "bounds", "seen", "said"),
    [
        ("initiator", (0.2, 6.0), passed(True, 0.2), None),
        ("initiator", (0.2, 6.0), passed(True, 6.0), None),
        ("initiator", (None, 6.0), passed(True, -3.0), None),
        ("initiator", (None, None), passed(True, None), None),
        ("vut", (0.2, None), passed(False, 40.0), None),
        ("initiator", (0.2, 6.0), passed(True, 0.199), "0.199 s, K* wants 0.2 to 6 s"),
        ("initiator", (0.2, 6.0), passed(True, 6.001), "6.001 s, K* wants 0.2 to 6 s"),
        ("initiator", (0.2, 6.0), passed(True, math.nan), "nan s, K* wants 0.2 to 6 s"),
        (
            "initiator",
            (0.2, None),
            passed(True, None),
            "none, ot1 never left the conflict zone (more road beyond it, or a longer run, would "
            "do); K* wants 0.2 to inf s",
        ),
        (
            "initiator",
            (0.2, None),
            Passing("merge", None, 1.0, None, None),
            "none, the VUT never reached the conflict zone (more road up to it, or a longer run, "
            "would do); K* wants 0.2 to inf s",
        ),
        (
            "vut",
            (0.2, None),
            passed(False, None),
            "none, the VUT never left the conflict zone (more road beyond it, or a longer run, "
            "would do); K* wants 0.2 to inf s",
        ),
        ("initiator", (0.2, 6.0), passed(None, None), "passing order: ot1 never came into"),
        (
            "initiator",
            (None, None),
            passed(False, 1.0),
            "passing order: the VUT before ot1, K* wants ot1 before the VUT",
        ),
        (
            "vut",
            (None, None),
            passed(True, 1.0),
            "passing order: ot1 before the VUT, K* wants the VUT before ot1",
        ),
    ],
)
def test_a_passing_misses_with_quantity_value_and_range(
    run: RunSpec,
    empty: Callable[..., RunEvents],
    first: Any,
    bounds: tuple[float | None, float | None],
    seen: Passing,
    said: str | None,
) -> None:
    wanted = WantedPassing(first=first, least_gap_s=bounds[0], most_gap_s=bounds[1])
    found = misses(run.model_copy(update={"passing": wanted}), replace(empty(0), passing=seen))
    assert found == [] if said is None else said in found[0]


def test_a_range_that_nothing_lies_in_is_no_range() -> None:
    with pytest.raises(ValueError, match="least_gap_s is above most_gap_s"):
        WantedPassing(first="vut", least_gap_s=2.0, most_gap_s=1.0)


def test_nobody_judges_the_passing_of_a_run_that_was_made_by_hand(
    run: RunSpec, empty: Callable[..., RunEvents]
) -> None:
    assert run.passing is None
    assert misses(run, replace(empty(0), passing=passed(None, None))) == []


def test_the_resolution_is_the_last_one_of_the_whole_recording(
    run: RunSpec, state: Callable[..., ObjectState]
) -> None:
    """TTC is 2 s, 5 s from 2 s on, 2 s again from 4 s to 5 s: resolved at 5 s, announced at 2 s."""

    def gap_m(t_s: float) -> float:
        return 50.0 if 2.0 <= t_s < 4.0 or t_s >= 5.0 else 20.0

    def at(t_s: float) -> tuple[ObjectState, ObjectState]:
        vut = state("vut", stamp_ns=int(t_s * S), speed_mps=10.0)
        nose_to_tail = vut.size.front_m + vut.size.rear_m
        return vut, state("ot1", stamp_ns=vut.stamp_ns, x_m=gap_m(t_s) + nose_to_tail)

    run = run.model_copy(update={"passing": WantedPassing(first="initiator")})

    def events_until(end_s: int) -> RunEvents:
        pairs = [at(0.5 * k) for k in range(2 * end_s + 1)]
        announced = [
            PhaseBegan(S // 2, Phase.CONFLICT, "TTC 2.00 s"),
            PhaseBegan(2 * S, Phase.RESOLUTION, "TTC 5.00 s"),
        ]
        truths = {"vut": [a for a, _ in pairs], "ot1": [b for _, b in pairs]}
        return RunEvents.measure(run, 0, announced, (), (), truths)

    (_, resolution) = result_keys(run, events_until(8))["phases"]
    assert (resolution["phase"], resolution["at_s"], resolution["announced_s"]) == (
        "resolution",
        5.0,
        2.0,
    )
    cut = replace(events_until(4), passing=passed(True, None))
    (only,) = result_keys(run, cut)["phases"]
    assert (only["phase"], only["at_s"]) == ("conflict", 0.5)
    assert misses(run, cut)[0].startswith("resolution: the conflict began again and lasts")


def test_a_sound_run_whose_passing_is_not_as_wanted_is_off_spec(run: RunSpec) -> None:
    limits = run.limits.model_copy(update={"jump_m": 1.0, "frozen_s": 0.3})
    run = run.model_copy(update={"limits": limits})
    whole, _ = run_in_process(run)
    gap_s = whole.passing.time_gap_s
    assert gap_s is not None
    assert whole.verdict is Verdict.VALID
    for wanted, verdict in (
        (WantedPassing(first="initiator", most_gap_s=gap_s), Verdict.VALID),
        (WantedPassing(first="initiator", most_gap_s=gap_s - 0.01), Verdict.OFF_SPEC),
        (WantedPassing(first="vut"), Verdict.OFF_SPEC),
    ):
        result, _ = run_in_process(run.model_copy(update={"passing": wanted}))
        assert (result.verdict, result.happened) == (verdict, whole.happened)
        assert result.ok == (not result.reasons)


def test_the_nearest_is_found_of_a_box_that_lies_off_its_reference_point(run: RunSpec) -> None:
    """Its reference point is nearest to the other first, its box 9 m behind that later."""
    (target,) = run.targets

    def at(id_: str, second: int, x_m: float, size: Size) -> ObjectState:
        car = ObjectClass.CAR
        return ObjectState(id_, car, Role.OT, second * S, x_m, 0.0, 0.0, 0.0, 0.0, 0.0, size)

    behind, person = Size(-10.0, 13.0, 1.0, 1.5), DEFAULT_SIZES[ObjectClass.PEDESTRIAN]
    truths = {
        run.vut.id: [at(run.vut.id, second, 0.0, behind) for second in (0, 1)],
        target.id: [at(target.id, 0, -5.0, person), at(target.id, 1, -14.0, person)],
    }
    happened = RunEvents.measure(run, 0, (), (), (), truths)
    assert happened.min_distance_m == pytest.approx(0.75)
