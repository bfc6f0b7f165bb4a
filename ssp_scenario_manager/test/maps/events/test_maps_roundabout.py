"""The event roundabout: over which roads it leads, what it needs, and what decides wait or go."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ssp_core.geometry import Polyline, Pose2
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import corridor_half_m, swept_on_way
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import TimeToArrival
from ssp_core.vocabulary import Phase, Verdict
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.compile.choose import NoBlockChosen
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Event
from ssp_scenario_manager.run.in_process import run_in_process
from ssp_scenario_manager.scenarios import over_routes
from ssp_scenario_manager.scenarios.base import CannotPlace
from ssp_scenario_manager.scenarios.motions import motions
from ssp_scenario_manager.scenarios.planning import wrong_order
from ssp_scenario_manager.scenarios.prediction import predict
from ssp_scenario_manager.scenarios.values import classes_of, thresholds_of
from tests.support.events.junctions import (
    LEFT_TURN,
    ground,
    made,
    route,
    site_without_junction,
    way_of,
)
from tests.support.events.played import shown
from tests.support.simulated_once import run_once

AROUND = (
    "junction ring: south_in > south_entry lanes[0] > ring_east lanes[0] > north_exit lanes[0] > "
    "north_out"
)
PRIORITY = (
    "junction ring: west_in > west_entry lanes[0] > ring_south lanes[0] > east_exit lanes[0] > "
    "east_out"
)


def event(**constraints: Any) -> Event:
    """The shipped event with parts of C changed."""
    value = load_event("roundabout")[0].model_dump(mode="json", by_alias=True)
    if constraints:
        value["participants"]["ot1"]["region"]["gap"] = {"min": 5, "max": 200, "unit": "m"}
    for name, given in constraints.items():
        value["constraints"][name] |= given
    return Event.model_validate(value)


def run_on(site: str) -> RunSpec:
    return made(event(), ground(site), AROUND).task.run.model_copy(update={"camera": None})


def test_two_routes_that_join_in_a_ring_and_part_again_conflict() -> None:
    area = ground("ring")
    own, other = route(area, AROUND), route(area, PRIORITY)
    assert own.passage is not None
    assert other.passage is not None
    (mine,) = (c for c in own.passage.conflicts if c.route == PRIORITY)
    (its,) = (c for c in other.passage.conflicts if c.route == AROUND)
    assert (mine.kind, mine.comes_from, its.comes_from) == ("crossing", "left", "right")
    assert (mine.s_m, mine.other_s_m) == (its.other_s_m, its.s_m)
    apart = np.subtract(own.line.to_map(mine.s_m, 0.0), other.line.to_map(mine.other_s_m, 0.0))
    assert np.hypot(*apart) < 0.35
    # From there both are one lane up to the exit by which the other one leaves.
    stations = other.passage.end_s_m + np.array([-18.0, 0.0])
    offsets = own.line.to_local_many(other.line.to_map_many(stations, 0.0))[:, 1]
    assert abs(offsets[0]) < 0.1
    assert offsets[1] < -4.0
    # Another one of the same arm goes on with the VUT, and merges.
    kinds = {
        c.route.rpartition(" ")[2]: c.kind for c in own.passage.conflicts if "west_in" in c.route
    }
    assert kinds == {"east_out": "crossing", "north_out": "merge"}


@pytest.mark.parametrize("site", ["ring", "ring_track"])
def test_it_runs_valid_and_the_vut_enters_the_ring_behind_the_vehicle(site: str) -> None:
    run = run_on(site)
    result, record = run_once(run)
    assert result.verdict is Verdict.VALID, result.reasons
    assert (result.passing.relation, result.passing.other_first) == ("crossing", True)
    blocks = {block.block_id: block for block in ground(site).library.blocks}
    for who, names in (
        ("ot1", ("west_entry", "ring_south", "east_exit")),
        ("vut", ("south_entry",)),
    ):
        track = np.array([(s.x_m, s.y_m) for s in record.truths(who)])
        for name in names:
            local = blocks[name].line.to_local_many(track)
            there = (local[:, 0] > 0.0) & (local[:, 0] < blocks[name].length_m)
            there &= np.abs(local[:, 1]) < 2.0
            assert there.sum() > 10
            assert np.abs(local[there, 1]).min() < 0.1


def test_without_a_conflict_a_session_is_off_spec() -> None:
    """Two seconds earlier the VUT passes behind the vehicle, and TTC stays over the threshold."""
    result, _ = run_once(shifted(run_on("ring"), -2.0))
    assert result.verdict is Verdict.OFF_SPEC
    assert result.phase_s(Phase.TRIGGER) is not None
    assert result.phase_s(Phase.CONFLICT) is None


def test_a_vut_that_does_not_react_hits_it() -> None:
    run = run_on("ring")
    steady = run.driver.model_copy(update={"reacts": False})
    result, _ = run_in_process(run.model_copy(update={"driver": steady}))
    assert any("collision: ot1" in reason for reason in result.reasons)


def shifted(run: RunSpec, shift_s: float) -> RunSpec:
    """The run with a vehicle that drives off so much later, and no order that is to be kept."""
    (trigger,) = run.triggers
    condition = trigger.condition
    assert isinstance(condition, TimeToArrival)
    condition = condition.model_copy(update={"below_s": condition.below_s - shift_s})
    moved = trigger.model_copy(update={"condition": condition, "not_before_s": 0.0})
    return run.model_copy(update={"triggers": [moved], "passing": None})


@pytest.mark.parametrize(
    ("shift_s", "stops", "other_first"),
    [(-1.0, False, True), (0.0, True, True), (2.0, True, True), (6.0, False, False)],
)
def test_a_shift_of_the_vehicle_changes_what_the_vut_does(
    shift_s: float, stops: bool, other_first: bool
) -> None:
    """A second earlier it needn't stop; six seconds later it goes in front of it."""
    run = shifted(run_on("ring"), shift_s)
    result, record = run_in_process(run)
    assert result.verdict is Verdict.VALID, result.reasons
    assert result.passing.other_first is other_first
    assert result.min_distance_m > 0.5
    assert run.vut.approach is not None
    path, (place,) = Polyline(run.vut.approach.path), run.driver.gives_way
    fronts = [
        (state, path.project(state.x_m, state.y_m)[0] + state.size.front_m)
        for state in record.truths("vut")
    ]
    around_m = (place.line_m - 15.0, place.zone_m[0])
    before = [s.speed_mps for s, front_m in fronts if around_m[0] < front_m < around_m[1]]
    assert (min(before) < 0.5) is stops
    # Who goes first has left the zone before the vehicle reaches it.
    its_way = Polyline(place.priority_path)
    arrives_ns = next(
        state.stamp_ns
        for state in record.truths("ot1")
        if its_way.project(state.x_m, state.y_m)[0] + state.size.front_m > place.priority_zone_m[0]
    )
    (rear_m,) = (m - s.size.length_m for s, m in fronts if s.stamp_ns == arrives_ns)
    assert (rear_m > place.zone_m[1]) is not other_first


@pytest.mark.parametrize(
    ("below_s", "ot1_first"),
    [(8.3, False), (8.5, False), (8.55, False), (8.7, True), (8.9, True)],
)
def test_who_is_first_is_foreseen_as_a_session_measures_it(below_s: float, ot1_first: bool) -> None:
    """The car was foreseen first at 8.5 s, as if it went on straight, and the VUT was first."""
    site, shipped = ground("ring"), event()
    plan, block = made(shipped, site, AROUND).plan, route(site, AROUND)
    told = motions(
        block.line,
        classes_of(shipped),
        shipped.vut_id,
        plan.vut,
        plan.targets,
        replace(plan.trigger, below=below_s),
    )
    steady = replace(told, driver=told.driver.model_copy(update={"reacts": False}))
    seen = predict(steady, "lateral", thresholds_of(shipped))
    assert bool(wrong_order(shipped, seen)) is not ot1_first
    run = run_on("ring").model_copy(update={"triggers": [told.trigger], "driver": steady.driver})
    result, _ = run_in_process(run)
    assert result.passing.other_first is ot1_first


@pytest.mark.parametrize(
    ("wanted", "site", "name", "words"),
    [
        (event(), "crossroads", LEFT_TURN, "0 routes of its junction come from the left, share"),
        (event(), "ring", PRIORITY, "the VUT turns left, which is at least 30 deg"),
        (event(), "ring", "south_in", "it leads over no connecting road of a junction"),
        (
            event(trigger={"below": {"min": 1.0, "max": 2.0, "unit": "s"}}),
            "ring",
            AROUND,
            "wouldn't reach the conflict point first",
        ),
    ],
)
def test_what_does_not_fit_is_refused_with_what_misses(
    wanted: Event, site: str, name: str, words: str
) -> None:
    with pytest.raises(CannotPlace, match=re.escape(words)):
        made(wanted, ground(site), name)


def test_a_vut_that_starts_behind_its_line_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """It ended the compiler in a traceback on rings whose arms are short and bent."""
    monkeypatch.setattr(over_routes, "_zone", lambda *_: (0.5, 20.0))
    wanted = event(manoeuvre={"critical_gap": {"min": 3.7, "max": 5.2, "unit": "s"}})
    with pytest.raises(CannotPlace, match=r"the VUT would wait \d+\.\d m before its start"):
        made(wanted, ground("ring"), AROUND)


def test_the_vut_gives_way_in_its_junction_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """A VUT that left beside the vehicle's arm crossed it far before its start: a traceback."""
    ways = []

    def swept(way: Iterable[Pose2], *others: Any) -> tuple[float, float] | None:
        poses = list(way)
        ways.append([(pose.x_m, pose.y_m) for pose in poses])
        return swept_on_way(poses, *others)

    monkeypatch.setattr(over_routes, "swept_on_way", swept)
    area = ground("ring")
    own = route(area, AROUND)
    assert own.passage is not None
    made(event(manoeuvre={"critical_gap": {"min": 3.8, "max": 5.2, "unit": "s"}}), area, AROUND)
    line = Polyline(own.line.path(0.0, own.length_m, 0.0))
    of_vut = [way for way in ways if abs(line.project(*way[0])[1]) < 0.05]
    assert of_vut
    for way in of_vut:
        stations = [line.project(*place)[0] for place in way]
        assert min(stations) >= own.passage.start_s_m - 0.1
        assert max(stations) <= own.passage.end_s_m + 0.1


def test_a_route_that_begins_behind_its_conflict_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(over_routes, "_zone", lambda *_: (150.0, 160.0))
    monkeypatch.setattr(over_routes, "swept_on_way", lambda *_: (-5.0, 3.0))
    wanted = event(manoeuvre={"critical_gap": {"min": 3.9, "max": 5.2, "unit": "s"}})
    with pytest.raises(CannotPlace, match=r"route begins 5\.0 m after the VUT's way crosses it"):
        made(wanted, ground("ring"), AROUND)


def test_a_vut_follows_a_vehicle_that_goes_on_in_its_lane(monkeypatch: pytest.MonkeyPatch) -> None:
    """It waited until the vehicle had left a long ring, and its session ended before that."""
    (shipped,) = run_on("ring").driver.gives_way
    monkeypatch.setattr(over_routes, "_FOLLOWED_M", 5.0)
    wanted = event(manoeuvre={"critical_gap": {"min": 4.0, "max": 5.2, "unit": "s"}})
    constraints = wanted.constraints.model_copy(update={"time_gap": UNRESOLVED})
    wanted = wanted.model_copy(update={"constraints": constraints})
    area = ground("ring")
    run = made(wanted, area, AROUND).task.run.model_copy(update={"camera": None})
    own = route(area, AROUND).passage
    assert own is not None
    (met,) = (one for one in own.conflicts if one.route == PRIORITY)
    (place,) = run.driver.gives_way
    assert place.priority_zone_m[1] == pytest.approx(met.other_s_m + 5.0, abs=0.001)
    result, _ = run_in_process(run)
    assert result.verdict is Verdict.VALID, result.reasons
    # The vehicle is still in the zone of both when the VUT comes into it.
    assert result.passing.other_first
    assert result.passing.time_gap_s is not None
    assert result.passing.time_gap_s < 0.0
    # On the shipped sites a vehicle leaves the ring before that.
    assert shipped.priority_zone_m[1] < met.other_s_m + 14.0


def test_a_vehicle_may_come_a_long_way_before_it_shows() -> None:
    """Foresight ended 12 s after the trigger: it wouldn't come into the VUT's corridor."""
    slow = {"circulating_speed": {"min": 2.0, "max": 2.1, "unit": "m/s"}}
    with pytest.raises(CannotPlace, match=r"after the trigger ot1 takes 1[3-9]\.\d s to"):
        made(event(manoeuvre=slow), ground("ring"), AROUND)


@pytest.mark.parametrize("name", ["roundabout", "oncoming_turn"])
def test_the_intervals_for_places_of_maps_pass_the_checks(name: str) -> None:
    page = (Path(__file__).parents[4] / "docs" / f"{name.replace('_', '-')}.md").read_text()
    given = re.search(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert given is not None
    whole = load_event(name)[0].model_dump(mode="json", by_alias=True)

    def change(value: dict[str, Any], parts: dict[str, Any]) -> None:
        for name, part in parts.items():
            if isinstance(part, dict) and not {"min", "value"} & part.keys():
                change(value[name], part)
            else:
                value[name] = part

    change(whole, yaml.safe_load(given[1]))
    assert {failure.check for failure in check_event(whole)} == {"review"}


def test_without_the_junction_nothing_compiles(tmp_path: Path) -> None:
    site = site_without_junction("ring", tmp_path)
    with pytest.raises(NoBlockChosen, match="segment straight, needs junction"):
        compile_task(Request(event="roundabout", target="sumo", site=str(site)))


@pytest.mark.parametrize("site", ["ring", "ring_track"])
def test_openscenario_plays_it(site: str, tmp_path: Path) -> None:
    """The car follows its way of the session, whose cuts of the bends move when it is out.

    No other route of the site is one that the event can take.
    """
    task = compile_task(Request(event="roundabout", target="openscenario", site=site)).task
    assert task.block.id == AROUND
    export = shown(task, route(ground(site), AROUND), tmp_path)
    assert export.apart_m() < 0.3
    assert task.run.vut.approach is not None
    planned = Corridor(
        Polyline(task.run.vut.approach.path), corridor_half_m(task.run.vut.size.width_m)
    )
    assert export.gap_differs_s(lambda _: planned) == pytest.approx(0.0, abs=0.05)
    # Also where the user drives the VUT, and the event lasts longer, it has a way up to its end.
    for name in ("roundabout.xosc", "roundabout_external.xosc"):
        way = ".//Trajectory[@name='ot1_time_to_arrival_path']//WorldPosition"
        places = [at.attrib for at in ET.parse(tmp_path / name).iterfind(way)]
        there = [(float(at["x"]), float(at["y"])) for at in places]
        steps = np.hypot(*np.diff(there, axis=0).T)
        assert there[-1] == pytest.approx(way_of(task.run)[-1], abs=0.01)
        assert steps.min() > 0.3
        assert steps.max() < 2.1
