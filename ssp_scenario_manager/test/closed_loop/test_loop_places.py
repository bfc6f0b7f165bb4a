"""Places at the start of a driven run: gaps, sight distances and offsets of K*'s box (8.1)."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache

import pytest

from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.road import CurvePiece
from ssp_scenario_manager.closed_loop.starts.box import draw_run_values, gap_draw
from ssp_scenario_manager.closed_loop.starts.places import Places
from ssp_scenario_manager.closed_loop.starts.start import (
    OffSpec,
    ShortRunUp,
    Start,
    make_start,
    prepared,
)
from ssp_scenario_manager.compile.targets.folder import prepare_run
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.scenarios.events.crossing import is_hidden
from tests.support.events.junctions import ground, made
from tests.support.events.places import site_of

LATENCY_S = 0.5
# Of a start of crossing_car whose twin has no contact.
HARMLESS = 1
Compiled = Callable[[str], tuple[RunSpec, Event]]


@pytest.fixture(scope="module")
def compiled(tmp_path_factory: pytest.TempPathFactory) -> Compiled:
    """Gives the compiled run of an event, and its K*."""

    @cache
    def make(name: str) -> tuple[RunSpec, Event]:
        folder = tmp_path_factory.mktemp("places") / name
        run = prepare_run(name, site_of(name), folder, seed=1, mode="lockstep")
        return run, load_event(name)[0]

    return make


@pytest.fixture(scope="module")
def start_of(compiled: Compiled) -> Callable[[str, int], Start]:
    @cache
    def make(name: str, seed: int) -> Start:
        return make_start(*compiled(name), seed, LATENCY_S)

    return make


def gaps_of(run: RunSpec) -> dict[str, float]:
    places = Places(run)
    return {target.id: places.gap_m(target) for target in run.targets}


def gap_bounds(event: Event, name: str) -> tuple[float, float]:
    """The gap of K*, and what rounding to a millimetre may add."""
    span = event.participants[name].region.gap
    assert isinstance(span, Interval)
    return span.si.low - 0.002, span.si.high + 0.002


@pytest.mark.parametrize(
    ("name", "seeds"),
    [("cut_in", (1, 2)), ("lead_braking", (1, 2)), ("slow_lead", (1, 2)), ("vru_crossing", (2, 4))],
)
def test_starts_begin_with_gaps_of_ks_box(
    compiled: Compiled,
    start_of: Callable[[str, int], Start],
    name: str,
    seeds: tuple[int, int],
) -> None:
    run, event = compiled(name)
    found = []
    for seed in seeds:
        start = start_of(name, seed)
        gap = gaps_of(start.run)["ot1"]
        low, high = gap_bounds(event, "ot1")
        assert low <= gap <= high
        assert start.values["participants.ot1.region.gap"] == pytest.approx(gap, abs=0.001)
        # The twin meets it: its first states are those of the start.
        vut = min(start.twin)
        assert start.twin[vut].x_m == pytest.approx(start.run.vut.start.x_m, abs=0.05)
        (trigger,) = start.run.triggers
        assert start.hand_over_s <= trigger.condition.after_s - 0.5 + 0.02  # type: ignore[union-attr]
        found.append(gap)
    assert len({round(gap, 2) for gap in [*found, gaps_of(run)["ot1"]]}) == 3, found


def test_a_gap_leaves_time_for_the_hand_over(compiled: Compiled) -> None:
    """The run-up is lengthened where needed: over shares, no gap is too small for it."""
    run, event = compiled("lead_braking")
    draw = gap_draw(prepared(run), event, 1)
    bounds = draw.bounds_m
    assert bounds is not None
    assert (bounds.low, bounds.high) == (30.0, 45.0)
    share = draw.shares["ot1"]
    assert draw.draw_m(4.0) == pytest.approx(41.0 + share * 4.0)
    assert draw.draw_m(100.0) == pytest.approx(30.0 + share * 15.0)
    # As large as K* has it, and still too small for a latency.
    with pytest.raises(ShortRunUp, match="run-up is too short"):
        make_start(run, event, 1, latency_max_s=9.0)


def test_the_gap_is_drawn_evenly_and_a_seed_gives_the_same(compiled: Compiled) -> None:
    run, event = compiled("lead_braking")
    shares = [gap_draw(run, event, seed).shares["ot1"] for seed in range(1, 401)]
    assert [gap_draw(run, event, seed).shares["ot1"] for seed in range(1, 401)] == shares
    counts = [sum(low <= share < low + 0.25 for share in shares) for low in (0.0, 0.25, 0.5, 0.75)]
    assert all(70 <= count <= 130 for count in counts), counts


def test_who_stands_at_a_marking_stays_and_the_vut_begins_elsewhere(
    compiled: Compiled, start_of: Callable[[str, int], Start]
) -> None:
    run, event = compiled("occluded_crossing")
    start = start_of("occluded_crossing", 2)
    walker, parked = ({one.id: one for one in each.targets} for each in (run, start.run))
    assert parked["ot1"].start == walker["ot1"].start
    assert start.run.vut.start.x_m != run.vut.start.x_m
    assert start.run.vut.approach is not None
    assert start.run.vut.approach.path[0] == (start.run.vut.start.x_m, start.run.vut.start.y_m)
    assert start.run.vut.approach.path[-1] == run.vut.approach.path[-1]  # type: ignore[union-attr]
    for name, gap in gaps_of(start.run).items():
        low, high = gap_bounds(event, name)
        assert low <= gap <= high
        assert start.values[f"participants.{name}.region.gap"] == pytest.approx(gap, abs=0.001)
    # The sight distance: from the parked front to the walker's side.
    size, half_m = parked["ot2"].size, parked["ot1"].size.width_m / 2.0
    free_m = parked["ot1"].start.x_m - half_m - parked["ot2"].start.x_m - size.front_m
    value = start.values["constraints.manoeuvre.occluder_gap"]
    assert free_m == pytest.approx(value, abs=0.001)
    assert 0.8 <= value <= 2.0


def test_an_occluder_that_hides_nothing_makes_no_start(
    compiled: Compiled, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, event = compiled("occluded_crossing")
    seen = []

    def never(*args: object) -> bool:
        seen.append(is_hidden(*args))  # type: ignore[arg-type]
        return False

    monkeypatch.setattr("ssp_scenario_manager.closed_loop.starts.start.is_hidden", never)
    with pytest.raises(OffSpec, match="ot2 doesn't hide ot1 from the VUT when the trigger fires"):
        make_start(run, event, 2, LATENCY_S)
    assert seen == [True]


def test_who_is_slow_ahead_has_an_offset_of_ks_box(
    compiled: Compiled, start_of: Callable[[str, int], Start]
) -> None:
    run, _ = compiled("slow_lead")
    found = []
    for seed in (1, 2):
        start = start_of("slow_lead", seed)
        (lead,) = start.run.targets
        value = start.values["constraints.manoeuvre.offset"]
        assert lead.start.y_m - start.run.vut.start.y_m == pytest.approx(value, abs=0.001)
        assert {y for _, y in lead.approach.path} == {lead.start.y_m}  # type: ignore[union-attr]
        assert -0.5 <= value <= -0.2
        found.append(value)
    assert len({*found, run.targets[0].start.y_m}) == 3


@pytest.mark.parametrize("along_m", [-12.5, 7.25])
def test_places_of_a_bent_road_keep_their_lane_and_heading(
    compiled: Compiled, along_m: float
) -> None:
    """The gap along the VUT's path changes by as much as the participant moves."""
    run, _ = compiled("lead_braking")
    bend = [CurvePiece(length_m=400.0, start_curvature_1pm=0.002, end_curvature_1pm=0.002)]
    road = run.road.model_copy(update={"pieces": bend})
    bent = run.model_copy(update={"road": road})
    line = Places(bent).line
    placed = []
    for one, s_m, l_m in ((run.vut, 15.0, 3.5), (run.targets[0], 60.0, 3.5)):
        x_m, y_m = line.to_map(s_m, l_m)
        yaw_rad = line.pose(s_m).yaw_rad
        start = one.start.model_copy(update={"x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad})
        assert one.approach is not None
        path = line.path(s_m, 390.0, l_m)
        approach = one.approach.model_copy(update={"path": path})
        placed.append(one.model_copy(update={"start": start, "approach": approach}))
    bent = bent.model_copy(update={"vut": placed[0], "targets": [placed[1]]})
    places = Places(bent)
    moved = places.with_moved_start(placed[1], along_m)
    assert places.gap_m(moved) - places.gap_m(placed[1]) == pytest.approx(along_m, abs=0.01)
    s_m, l_m = places.local(moved)
    assert l_m == pytest.approx(3.5, abs=1e-6)
    assert math.remainder(moved.start.yaw_rad - line.pose(s_m).yaw_rad, math.tau) == (
        pytest.approx(0.0, abs=1e-9)
    )
    assert moved.approach is not None
    assert moved.approach.path[0] == pytest.approx((moved.start.x_m, moved.start.y_m))
    assert moved.approach.path[-1] == pytest.approx(placed[1].approach.path[-1])  # type: ignore[union-attr]


def fenced_off(run: RunSpec, x_m: float) -> RunSpec:
    """The run with a fence that ends at x, where it ended in the direction of driving."""
    end_m = max(x for x, _ in run.geofence)
    fence = [(x_m if x == end_m else x, y) for x, y in run.geofence]
    return run.model_copy(update={"geofence": fence})


def test_a_twin_may_leave_the_site_after_the_end_of_its_event(compiled: Compiled) -> None:
    run, event = compiled("crossing_car")
    start = make_start(fenced_off(run, 400.0), event, HARMLESS, LATENCY_S)
    assert start.contact is None
    at_end_m = next(s.x_m for ns, s in start.twin.items() if ns >= start.end_s * 1e9)
    at_end_m += run.vut.size.front_m
    # A session's vehicles brake to a stand after its end.
    stands_m = at_end_m + 20.0
    assert max(s.x_m for s in start.twin.values()) > stands_m
    again = make_start(fenced_off(run, stands_m), event, HARMLESS, LATENCY_S)
    assert again.facts() == start.facts()
    until_ns = start.end_s * 1e9
    assert max(again.twin) >= until_ns
    for ns in (ns for ns in start.twin if ns <= until_ns):
        assert again.twin[ns] == start.twin[ns]
    with pytest.raises(OffSpec, match="outside_geofence: vut"):
        make_start(fenced_off(run, at_end_m - 2.0), event, HARMLESS, LATENCY_S)


def test_a_truck_gets_no_acceleration_that_it_would_refuse() -> None:
    """K* allows 3 m/s^2 for what comes over the ramp; trucks and buses reach 1.7."""
    value = load_event("merge")[0].model_dump(mode="json", by_alias=True)
    value["participants"]["ot1"]["class"] = "truck"
    event = Event.model_validate(value)
    block = "junction entry: west_in > west_east lanes[0] > east_out"
    run = made(event, ground("entry"), block).task.run
    field = "triggers.0.manoeuvre.motion.acceleration_mps2"
    drawn = [draw_run_values(run, event, seed)[1][field] for seed in range(20)]
    assert 1.5 <= min(drawn) < max(drawn) <= 1.7
