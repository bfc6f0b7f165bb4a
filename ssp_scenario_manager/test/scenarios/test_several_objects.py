"""Events with further participants: scripts of their own, and a conflict that isn't theirs."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import combinations
from typing import Any

import numpy as np
import pytest

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import box_distance
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import TrafficSpec
from ssp_core.vocabulary import PHASES, Phase, Verdict
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.closed_loop.starts.box import draw_run_values, gap_draw
from ssp_scenario_manager.closed_loop.starts.places import Places
from ssp_scenario_manager.closed_loop.starts.start import prepared, without_event
from ssp_scenario_manager.compile.area import OperatingArea, clear_traffic
from ssp_scenario_manager.compile.compiler import load_area
from ssp_scenario_manager.compile.place import Order, Realisation, realise
from ssp_scenario_manager.compile.targets.foreseen import foresee
from ssp_scenario_manager.compile.targets.map_file import map_file
from ssp_scenario_manager.compile.targets.openscenario import scenario_xml
from ssp_scenario_manager.compile.targets.player import play
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.run.feasibility import driven
from ssp_scenario_manager.run.in_process import run_in_process
from ssp_scenario_manager.scenarios.base import CannotPlace
from ssp_scenario_manager.scenarios.further import further_ids
from tests.support.events.several import EXAMPLES, LEAD, ONCOMING, WAITING, several, with_further

SITES = ("boulevard", "south_loop")
# esmini plays an export as the session does (docs/exports.md).
MOST_APART_M = 0.3


@cache
def area_of(site: str) -> OperatingArea:
    return load_area(site, None)[0]


@cache
def placed(example: str, site: str) -> Realisation:
    return place(several(example), site)


def place(event: Event, site: str = "boulevard") -> Realisation:
    area = area_of(site)
    return realise(Order(event, "sha256:test", area, "sumo", 1, {}), area.library.blocks[0])


def run_of(example: str, site: str = "boulevard") -> RunSpec:
    return placed(example, site).task.run.model_copy(update={"camera": None, "traffic": []})


@pytest.mark.parametrize("example", EXAMPLES)
def test_a_reviewed_event_with_further_participants_passes_its_checks(example: str) -> None:
    assert check_event(several(example)) == []


@pytest.mark.parametrize("site", SITES)
@pytest.mark.parametrize("example", EXAMPLES)
def test_what_compiles_runs_valid_with_the_conflict_of_the_initiator(
    example: str, site: str
) -> None:
    event, run = several(example), run_of(example, site)
    further = further_ids(event)
    assert further
    assert {t.id for t in run.targets} == set(event.participants) - {"vut"}
    result, record = driven(run)
    assert (result.verdict, result.reasons) == (Verdict.VALID, ())
    assert result.phase_s(Phase.RESOLUTION) is not None
    assert result.happened.intrusions == ()
    for name in further:
        states, region = record.truths(name), event.constraints.speeds[name]["approach"]
        assert {s.object_class.word for s in states} == {event.participants[name].class_}
        fastest = max(s.speed_mps for s in states)
        assert not isinstance(region, str)
        assert region.si.low - 0.1 <= fastest <= region.si.high + 0.1


@pytest.mark.parametrize("example", EXAMPLES)
def test_nobody_starts_or_comes_near_a_further_participant(example: str) -> None:
    _, record = driven(run_of(example))
    for one, other in combinations(sorted(several(example).participants), 2):
        pairs = zip(record.truths(one), record.truths(other), strict=True)
        assert min(box_distance(a.box, b.box) for a, b in pairs) > 0.5


@pytest.mark.parametrize("example", EXAMPLES)
def test_the_event_is_that_of_the_initiator_alone(example: str) -> None:
    """Phases and time gap are those of the shipped event at the same place."""
    kind, _ = EXAMPLES[example]
    alone = place(load_event(kind)[0]).task.run.model_copy(update={"camera": None, "traffic": []})
    result, expected = (driven(run)[0] for run in (run_of(example), alone))
    for phase in (Phase.TRIGGER, Phase.CONFLICT, Phase.RESOLUTION):
        assert result.phase_s(phase) == pytest.approx(expected.phase_s(phase), abs=0.25)
    assert result.passing.time_gap_s == pytest.approx(expected.passing.time_gap_s, abs=0.1)


@pytest.mark.parametrize("example", EXAMPLES)
def test_a_player_shows_every_participant_as_the_session_does(example: str) -> None:
    made = placed(example, "boulevard")
    run, chart = made.task.run, map_file(made.task, made.block, None)
    seen = foresee(run)
    scenario = scenario_xml(made.task, chart, seen, external=False)
    played = play(scenario, chart.data, made.block.line)
    _, record = driven(run)
    for target in run.targets:
        track, states = played[target.id], record.truths(target.id)
        times = np.array([ns_to_seconds(s.stamp_ns) for s in states])
        x_m, y_m = (np.interp(times, track[:, 0], track[:, i]) for i in (1, 2))
        apart_m = np.hypot(x_m - [s.x_m for s in states], y_m - [s.y_m for s in states])
        assert apart_m[times <= (seen.over_s or times[-1])].max() <= MOST_APART_M, target.id


# -- C4 --------------------------------------------------------------------------------------------


def cell(**changes: str) -> dict[str, Any]:
    return {**LEAD[4], **changes}


REFUSED = {
    "a slow lead": (
        (*LEAD[:2], (60.0, 90.0), (4.0, 5.0), cell(longitudinal="closing")),
        "participants.ot2.region.gap",
        "TTC between the VUT and ot2 may be 0.50 s",
    ),
    "one that stands in the lane": (
        (
            *LEAD[:2],
            (80.0, 90.0),
            (0.0, 0.0),
            cell(motion="stationary", speed_trend="standing", longitudinal="closing"),
        ),
        "participants.ot2.region.gap",
        "TTC between the VUT and ot2 may be 0.21 s",
    ),
    "one behind that can't brake": (
        ("car", ("vut_lane", "behind"), (20.0, 30.0), (12.0, 14.0), cell(position="rear")),
        "participants.ot2.region.gap",
        "TTC between the VUT and ot2 may be 0.00 s",
    ),
    "one that cuts in": (
        (
            "car",
            ("left_lane", "ahead"),
            (70.0, 90.0),
            (12.0, 14.0),
            cell(position="front_left", motion="cutting_in_from_left", lateral="right"),
        ),
        "motion.ot2.trigger.motion",
        "which makes it an initiator",
    ),
    "one that changes its speed": (
        (*LEAD[:4], cell(speed_trend="any")),
        "motion.ot2.trigger.speed_trend",
        "drives along its lane at one speed",
    ),
    "one that drives beside the road": (
        ("cyclist", ("right_kerb", "ahead"), *LEAD[2:4], cell(position="front_right")),
        "motion.ot2.trigger.speed_trend",
        "a further participant that drives, drives in a lane",
    ),
    "one on another road": (
        ("car", ("left_road", "ahead"), *LEAD[2:4], cell(position="front_left")),
        "participants.ot2.region.place",
        "keeps to the VUT's road",
    ),
}


@pytest.mark.parametrize("what", REFUSED)
def test_c4_refuses_a_further_participant_that_would_be_the_conflict(what: str) -> None:
    further, field, reason = REFUSED[what]
    failures = check_event(with_further("cut_in", {"ot2": further}))
    assert {f.check for f in failures} == {"C4"}, failures
    found = next(f for f in failures if f.field == field)
    assert reason in found.reason


# -- the compiler, where K* leaves room for a conflict ---------------------------------------------


def test_a_place_at_which_it_would_be_the_conflict_is_refused_by_its_quantity() -> None:
    wrong_way = (ONCOMING[0], ("vut_lane", "ahead"), *ONCOMING[2:])
    with pytest.raises(CannotPlace, match=r"ot2 is in conflict .* \(TTC 2\.\d\d s, under 2\.5 s\)"):
        place(with_further("vru_crossing", {"ot2": wrong_way}))


def test_starts_that_overlap_are_refused_by_their_distance() -> None:
    beside = ("car", ("left_lane", "ahead"), (39.0, 40.0), *LEAD[3:])
    with pytest.raises(CannotPlace, match=r"ot2 would start 0\.00 m from ot1, 0\.5 m keep them"):
        place(with_further("cut_in", {"ot2": beside}))


def test_the_compiler_chooses_a_gap_that_keeps_clear() -> None:
    """The middle of K*'s gap would put its start on the car that cuts in."""
    near = ("car", ("left_lane", "ahead"), (36.0, 46.0), *LEAD[3:])
    chosen = place(with_further("cut_in", {"ot2": near})).plan.choices[
        "participants.ot2.region.gap"
    ]
    assert chosen[0] > 41.0
    assert chosen[1:] == ("m", "41 m (middle of what K* allows) doesn't work here")


def test_a_road_without_its_lane_is_refused() -> None:
    made = placed("oncoming_while_a_pedestrian_crosses", "boulevard")
    one_way = tuple(lane for lane in made.block.lanes if lane.forward)
    area = area_of("boulevard")
    order = Order(several("oncoming_while_a_pedestrian_crosses"), "v", area, "sumo", 1, {})
    block = replace(made.block, lanes=one_way)
    with pytest.raises(CannotPlace, match="no lane in the opposite direction, in which ot2 drives"):
        realise(order, block)


# -- sessions, surroundings, and the closed loop ---------------------------------------------------


def test_a_session_in_which_another_is_in_conflict_first_is_off_spec() -> None:
    run = run_of("lead_ahead_of_a_cut_in")
    other, lead = run.targets
    assert lead.approach is not None
    start = lead.start.model_copy(update={"x_m": 75.0})
    path = [(75.0, 0.0), lead.approach.path[-1]]
    slower = lead.approach.model_copy(update={"cruise_mps": 9.5, "path": path})
    near = lead.model_copy(update={"start": start, "approach": slower})
    thresholds = run.thresholds.model_copy(update={"ttc_s": 25.0})
    changed = run.model_copy(update={"targets": [other, near], "thresholds": thresholds})
    result, _ = run_in_process(changed)
    assert result.verdict is Verdict.OFF_SPEC, result.reasons
    (reason,) = [text for text in result.reasons if text.startswith("initiator: ")]
    assert "ot2 is in conflict with the VUT" in reason
    assert reason.endswith("K* wants the conflict with ot1")


def test_surroundings_keep_out_of_the_lane_of_an_oncoming_participant() -> None:
    made = placed("oncoming_while_a_pedestrian_crosses", "boulevard")
    lane = next(
        lane
        for lane in made.block.lanes
        if lane.y_m == made.plan.targets["ot2"].start.l_m and not lane.forward
    )
    near_m = made.plan.targets["ot2"].start.s_m + 30.0
    vehicle = TrafficSpec(id="near", object_class="car", lane=2, x_m=near_m, speed_mps=9.0)
    kept, left_out = clear_traffic([vehicle], [lane], made.plan)
    assert (kept, left_out) == ([], ["near: it starts too close behind a participant"])


def test_a_start_draws_the_speed_of_a_further_participant() -> None:
    event, run = several("lead_ahead_of_a_cut_in"), run_of("lead_ahead_of_a_cut_in")
    drawn, values = draw_run_values(prepared(run), event, 3)
    assert 12.0 <= values["targets.1.approach.cruise_mps"] <= 14.0
    # It goes on in the event-free twin, in which the initiator does nothing.
    assert without_event(drawn, 20.0).targets == drawn.targets


def test_a_vut_that_begins_elsewhere_keeps_its_gap_to_one_that_drives() -> None:
    event = several("oncoming_while_a_pedestrian_crosses")
    draw = gap_draw(prepared(run_of("oncoming_while_a_pedestrian_crosses")), event, 3)
    assert draw.bounds_m is not None
    compiled_m = Places(draw.run).gap_m(draw.run.targets[1])
    for gap_m in (draw.bounds_m.low, draw.bounds_m.high):
        run, gaps = draw.with_gap(gap_m)
        assert gaps == {"participants.ot1.region.gap": pytest.approx(gap_m, abs=0.01)}
        assert run.targets[1].id == "ot2"
        assert Places(run).gap_m(run.targets[1]) == pytest.approx(compiled_m, abs=0.01)
        assert run.targets[0].start == draw.run.targets[0].start


def test_the_examples_cover_what_stands_and_what_drives_both_ways() -> None:
    assert {motion[4]["motion"] for motion in (LEAD, ONCOMING, WAITING)} == {
        "same_direction",
        "oncoming",
        "stationary",
    }
    assert all(set(event.motion["ot1"]) == set(PHASES) for event in map(several, EXAMPLES))
