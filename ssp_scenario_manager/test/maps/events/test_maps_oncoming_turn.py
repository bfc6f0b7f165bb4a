"""The event oncoming_turn: over which roads it leads, what it needs, and that it happens."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import corridor_half_m
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Phase, Verdict
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.compile.area import OperatingArea
from ssp_scenario_manager.compile.choose import NoBlockChosen
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.compile.targets.openscenario import export_openscenario
from ssp_scenario_manager.compile.task import sealed
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.arms import junction_roads
from ssp_scenario_manager.run.in_process import InProcessResult, Record, run_in_process
from ssp_scenario_manager.scenarios.base import CannotPlace
from tests.support.events.junctions import (
    LEFT_TURN,
    RIGHT_TURN,
    STRAIGHT,
    ground,
    made,
    route,
    site_without_junction,
    way_of,
)
from tests.support.simulated_once import run_once

# The connecting road that the vehicle takes, and the VUT's.
OVER, OWN = "east_south", "west_east"


def event(object_class: str = "car", **constraints: Any) -> Event:
    """The shipped event, its vehicle of a class, with parts of C changed."""
    value = load_event("oncoming_turn")[0].model_dump(mode="json", by_alias=True)
    value["participants"]["ot1"]["class"] = object_class
    if constraints:
        value["participants"]["ot1"]["region"]["gap"] = {"min": 5, "max": 200, "unit": "m"}
    for name, given in constraints.items():
        value["constraints"][name] |= given
    return Event.model_validate(value)


def run_on(site: str, object_class: str = "car") -> RunSpec:
    return made(event(object_class), ground(site)).task.run.model_copy(update={"camera": None})


def offsets_m(record: Record, area: OperatingArea, who: str, over: str) -> np.ndarray[Any, Any]:
    """Distances of a participant from the lane of a connecting road, while it is on it."""
    line = {block.block_id: block for block in area.library.blocks}[over].line
    places = np.array([(s.x_m, s.y_m) for s in record.truths(who)])
    local = line.to_local_many(places)
    there = local[np.isfinite(local[:, 0]) & (local[:, 0] > 0.0) & (local[:, 0] < line.length_m)]
    near: np.ndarray[Any, Any] = np.abs(there[np.abs(there[:, 1]) < 3.0][:, 1])
    return near


@pytest.mark.parametrize(
    ("object_class", "site"),
    [
        ("car", "crossroads"),
        ("bus", "crossroads"),
        ("truck", "cross_track"),
        ("motorcycle", "cross_track"),
    ],
)
def test_it_runs_valid_over_the_connecting_roads(object_class: str, site: str) -> None:
    result, record = run_once(run_on(site, object_class))
    assert result.verdict is Verdict.VALID, result.reasons
    assert result.passing.relation == "crossing"
    assert result.passing.other_first
    for who, over in (("ot1", OVER), ("vut", OWN)):
        beside_m = offsets_m(record, ground(site), who, over)
        assert len(beside_m) > 20
        assert beside_m.max() < 0.3
    # The VUT waits or slows down for it.
    assert min(s.speed_mps for s in record.truths("vut")[-500:]) < 4.0


def steady(run: RunSpec) -> tuple[InProcessResult, Record]:
    driver = run.driver.model_copy(update={"reacts": False})
    return run_in_process(run.model_copy(update={"driver": driver}))


@pytest.mark.parametrize(
    ("site", "object_class"),
    [("crossroads", "car"), ("cross_track", "car"), ("crossroads", "truck"), ("crossroads", "bus")],
)
def test_a_vut_that_keeps_its_speed_meets_it(site: str, object_class: str) -> None:
    result, _ = steady(run_on(site, object_class))
    assert any("collision: ot1" in reason for reason in result.reasons)


@pytest.mark.parametrize("object_class", ["car", "truck"])
def test_the_turn_shows_before_the_conflict(object_class: str) -> None:
    """It waits in the oncoming lane and is seen turning a third of a second before TTC is short."""
    run = run_on("crossroads", object_class)
    (car,) = run.targets
    assert car.approach is None
    result, _ = run_in_process(run)
    times = [result.phase_s(phase) for phase in (Phase.TRIGGER, Phase.CONFLICT)]
    trigger_s, conflict_s = (t for t in times if t is not None)
    assert conflict_s - trigger_s > 0.33
    arm = {block.block_id: block for block in ground("crossroads").library.blocks}["east_in"]
    s_m, l_m = arm.line.to_local(car.start.x_m, car.start.y_m)
    assert l_m == pytest.approx(-1.75, abs=1e-3)
    assert 0.5 <= arm.length_m - s_m - car.size.front_m <= 3.0


def test_the_zone_is_what_the_turning_body_sweeps_of_the_vuts_corridor() -> None:
    """A polygon of the swept corridor, cut by the VUT's: made by another library."""
    import shapely

    task = made(event(), ground("crossroads")).task
    run, half_m = task.run, corridor_half_m(1.8)
    way = Polyline([tuple(point) for point in way_of(run).tolist()])
    size = run.targets[0].size
    own = shapely.box(-100.0, -1.75 - half_m, 100.0, -1.75 + half_m)
    parts = []
    for at_m in np.arange(0.0, 30.0, 0.1).tolist():
        pose = way.pose(at_m)
        corners = [
            pose.to_parent(x, y) for x in (-size.rear_m, size.front_m) for y in (-half_m, half_m)
        ]
        parts.append(shapely.MultiPoint(corners).convex_hull.intersection(own))
    low_m, _, high_m, _ = shapely.union_all(parts).bounds
    xs = [p.x_m for p in task.conflict_zone]
    assert (min(xs), max(xs)) == pytest.approx((low_m, high_m), abs=0.15)
    assert task.anchors["vut"].conflict.x_m == pytest.approx(min(xs), abs=2e-3)


@pytest.mark.parametrize(
    ("wanted", "name", "said"),
    [
        (event(), RIGHT_TURN, "it turns by 90 deg in the junction"),
        (event(), LEFT_TURN, "it turns by 90 deg in the junction"),
        (event(), "west_in", "it leads over no connecting road of a junction"),
        (
            event(trigger={"below": {"min": 16, "max": 16, "unit": "s"}}),
            STRAIGHT,
            r"the VUT needs \d+ m up to where it is crossed, and the route has 161 m",
        ),
        (
            event(trigger={"below": {"min": 1, "max": 1, "unit": "s"}}),
            STRAIGHT,
            r"ot1 wouldn't reach the conflict point first: after the trigger ot1 takes [\d.]+ s",
        ),
        (
            event(
                manoeuvre={"crossing_speed": {"min": 9, "max": 12, "unit": "m/s"}},
                speeds={
                    "ot1": {
                        p: {"min": 0, "max": 12 if p != "approach" else 0, "unit": "m/s"}
                        for p in ("approach", "trigger", "conflict", "resolution")
                    }
                },
            ),
            STRAIGHT,
            r"bends so much that 4\.5 m/s\^2 sideways allow \d\.\d m/s; K\* wants at least 9 m/s",
        ),
    ],
)
def test_what_doesnt_fit_is_refused_with_its_quantity(wanted: Event, name: str, said: str) -> None:
    with pytest.raises(CannotPlace, match=said):
        made(wanted, ground("crossroads"), name)


def test_without_an_oncoming_route_that_turns_there_is_no_event() -> None:
    area = ground("crossroads")
    kept = [block for block in area.library.blocks if OVER not in block.block_id]
    with pytest.raises(CannotPlace, match="0 routes of its junction come the opposite way"):
        made(event(), replace(area, library=replace(area.library, blocks=tuple(kept))))


def test_deleting_the_junction_refuses_it(tmp_path: Path) -> None:
    path = site_without_junction("crossroads", tmp_path)
    with pytest.raises(NoBlockChosen) as caught:
        compile_task(Request(event="oncoming_turn", target="sumo", site=str(path)))
    assert "segment straight, needs junction (identity)" in str(caught.value)


@pytest.mark.parametrize("site", ["crossroads", "cross_track"])
def test_openscenario_plays_it(site: str, tmp_path: Path) -> None:
    """The export plays itself: the gap to the car is the session's to 0.3 m, else it refuses."""
    found = made(event(), ground(site))
    task = sealed(found.task.model_copy(update={"target": "openscenario", "chosen_by": "score"}))
    export_openscenario(task, found.block, None, tmp_path)
    text = (tmp_path / "oncoming_turn.xosc").read_text()
    # The session plays the turn a little slower than it was planned, so as to meet the VUT.
    speeds = [float(v) for v in re.findall(r'<AbsoluteTargetSpeed value="([\d.]+)"', text)]
    planned = found.task.run.triggers[0].manoeuvre.motion.cruise_mps  # type: ignore[union-attr]
    assert any(0.9 * planned < v < planned for v in speeds)


def test_a_map_that_turned_round_more_than_once_keeps_its_headings() -> None:
    """Maps write headings beyond a whole turn, which a run file doesn't hold."""
    area = ground("crossroads")
    own = route(area)
    inside = next(block for block in area.library.blocks if block.block_id == OWN)
    origin = replace(inside.line.origin, yaw_rad=inside.line.origin.yaw_rad + 4.0 * np.pi)
    turned = replace(inside, line=ReferenceLine(origin, inside.line.pieces))
    blocks = tuple(turned if block is inside else block for block in area.library.blocks)
    assert own.junction is not None
    found = junction_roads(replace(area.library, blocks=blocks), own.junction)
    assert all(abs(one.origin.yaw_rad) <= np.pi for one in found)
