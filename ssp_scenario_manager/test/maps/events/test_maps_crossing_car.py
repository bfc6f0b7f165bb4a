"""The event crossing_car: over which roads it leads, what it needs, and that it happens."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from ssp_core.clock import NS_PER_S
from ssp_core.geometry import Pose2, point_in_polygon
from ssp_core.motion.encounter import corridor_half_m
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.run_file.model import Camera
from ssp_core.run_file.participants import FollowPath
from ssp_core.vocabulary import ObjectClass, Verdict
from ssp_core.world.reference_line import CurvePiece, ReferenceLine
from ssp_core.world.road_drawing import drawing_of
from ssp_core.world.sumo_network import write_network
from ssp_scenario_manager.checks.check import check_event
from ssp_scenario_manager.compile.area import OperatingArea
from ssp_scenario_manager.compile.choose import NoBlockChosen
from ssp_scenario_manager.compile.compiler import Request, compile_task, load_area
from ssp_scenario_manager.compile.targets.foreseen import foresee
from ssp_scenario_manager.compile.targets.openscenario import export_openscenario
from ssp_scenario_manager.compile.task import PlaceLink, Task, sealed
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.arms import junction_roads
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.load import load_library
from ssp_scenario_manager.maps.routes import with_routes
from ssp_scenario_manager.maps.site import find_shipped
from ssp_scenario_manager.run.feasibility import driven
from ssp_scenario_manager.run.in_process import run_in_process
from ssp_scenario_manager.scenarios.base import CannotPlace
from ssp_scenario_manager.scenarios.block_places import END_MARGIN_M, bend_speed_mps
from ssp_scenario_manager.scenarios.events.crossing import is_hidden
from ssp_scenario_manager.scenarios.events.crossing_car import crossings
from ssp_scenario_manager.triggers.on_route import off_route
from tests.support.events.junctions import (
    RIGHT_TURN,
    STRAIGHT,
    ground,
    made,
    route,
    site_without_junction,
    way_of,
)
from tests.support.events.several import behind_a_parked_truck
from tests.support.simulated_once import run_once

# The connecting road that the car takes, by the side that it comes from.
OVER = {"right": "south_north", "left": "north_south"}
PHASES_BUT_APPROACH = ("trigger", "conflict", "resolution")
ALL_PHASES = ("approach", *PHASES_BUT_APPROACH)
Blocks = dict[str, dict[str, Any]]
_OTHER = {"left": "right", "right": "left"}


def event(side: str = "right", object_class: str = "car", **constraints: Any) -> Event:
    """The shipped event, from a side and of a class, with parts of C changed."""
    value = load_event("crossing_car")[0].model_dump(mode="json", by_alias=True)
    if side == "left":
        for part in ("participants", "motion", "interaction"):
            text = re.sub("left|right", lambda found: _OTHER[found[0]], yaml.safe_dump(value[part]))
            value[part] = yaml.safe_load(text)
    value["participants"]["ot1"]["class"] = object_class
    if constraints:
        value["participants"]["ot1"]["region"]["gap"] = {"min": 5, "max": 200, "unit": "m"}
    for name, given in constraints.items():
        value["constraints"][name] |= given
    return Event.model_validate(value)


@pytest.mark.parametrize(
    ("side", "object_class", "site"),
    [
        ("right", "car", "crossroads"),
        ("left", "car", "crossroads"),
        ("right", "motorcycle", "crossroads"),
        ("right", "truck", "crossroads"),
        ("right", "car", "cross_track"),
        ("left", "motorcycle", "cross_track"),
    ],
)
def test_it_runs_valid_over_the_connecting_roads(side: str, object_class: str, site: str) -> None:
    area = ground(site)
    run = made(event(side, object_class), area).task.run.model_copy(update={"camera": None})
    result, record = run_once(run)
    assert result.verdict is Verdict.VALID, result.reasons
    assert result.passing.other_first
    # The car keeps to the middle of the lane of its connecting road, while it is in the junction.
    known = {block.block_id: block for block in area.library.blocks}
    inside = known[OVER[side]].line
    local = inside.to_local_many(np.array([(s.x_m, s.y_m) for s in record.truths("ot1")]))
    there = local[(local[:, 0] > 0.0) & (local[:, 0] < inside.length_m)]
    assert len(there) > 20
    assert np.abs(there[:, 1]).max() < 0.15
    # So does the VUT.
    own = known["west_east"].line
    local = own.to_local_many(np.array([(s.x_m, s.y_m) for s in record.truths("vut")]))
    there = local[(local[:, 0] > 0.0) & (local[:, 0] < own.length_m)]
    assert len(there) > 20
    assert np.abs(there[:, 1]).max() < 0.15


def test_the_car_waits_before_the_junction_on_its_own_arm() -> None:
    area = ground("crossroads")
    found = made(event(), area)
    (car,) = found.task.run.targets
    arm = {block.block_id: block for block in area.library.blocks}["south_in"]
    s_m, l_m = arm.line.to_local(car.start.x_m, car.start.y_m)
    assert car.approach is None
    assert l_m == pytest.approx(-1.75, abs=1e-3)
    front_m = arm.length_m - s_m - car.size.front_m
    chosen = {tuning.field: tuning.value for tuning in found.task.tunings}
    assert front_m == pytest.approx(chosen["constraints.manoeuvre.line_distance"], abs=0.01)
    assert 0.5 <= front_m <= 3.0
    yaw = arm.line.pose(arm.length_m).yaw_rad
    assert math.cos(car.start.yaw_rad - yaw) == pytest.approx(1.0)


def test_the_zone_is_where_both_swept_corridors_cross() -> None:
    """METHOD 1: cars are 1.8 m wide, 0.3 m are on each side; the lanes cross at (1.75, -1.75)."""
    task = made(event(), ground("crossroads")).task
    half = corridor_half_m(1.8)
    xs, ys = zip(*((p.x_m, p.y_m) for p in task.conflict_zone), strict=True)
    assert (min(xs), max(xs)) == pytest.approx((1.75 - half, 1.75 + half), abs=2e-3)
    assert (min(ys), max(ys)) == pytest.approx((-1.75 - half, -1.75 + half), abs=2e-3)
    assert task.anchors["vut"].conflict.x_m == pytest.approx(1.75 - half, abs=2e-3)


def test_the_run_has_the_roads_of_the_junction() -> None:
    area = ground("crossroads")
    run = made(event(), area).task.run
    # Four arms, each once, and twelve connecting roads of one lane.
    assert [one.junction_at for one in run.road.junction].count("end") == 4
    assert [one.junction_at for one in run.road.junction].count("both") == 12
    assert [one.junction_at for one in run.road.junction].count("start") == 0
    assert [(x.y_m, x.direction) for x in run.road.lanes] == [(0.0, "forward"), (3.5, "backward")]
    assert off_route(run) == []
    # Without them the car's way lies off the run's road.
    road = run.road.model_copy(update={"junction": []})
    far = run.triggers[0].manoeuvre
    assert isinstance(far, FollowPath)
    path = [*far.motion.path, (far.motion.path[-1][0], 60.0)]
    motion = far.motion.model_copy(update={"path": path})
    trigger = run.triggers[0].model_copy(
        update={"manoeuvre": far.model_copy(update={"motion": motion})}
    )
    changed = run.model_copy(update={"triggers": [trigger]})
    assert off_route(changed) == []
    (said,) = off_route(changed.model_copy(update={"road": road}))
    assert "lies off the run's road and its surroundings" in said


def with_arms_m(area: OperatingArea, before_m: float, beyond_m: float) -> OperatingArea:
    """An area whose arms are so long before and beyond the junction, and go on in other roads."""

    def cut(block: Block) -> Block:
        if (part := block.passage) is None:
            return block
        arms = (part.start_s_m - before_m, part.end_s_m + beyond_m)
        return replace(block, passage=replace(part, arms_s_m=arms))

    blocks = tuple(map(cut, area.library.blocks))
    return replace(area, library=replace(area.library, blocks=blocks))


def test_the_car_keeps_to_the_junctions_arms() -> None:
    """The run's road has nothing of the roads beyond them."""
    area = ground("crossroads")
    whole, cut = (way_of(made(event(), one).task.run) for one in (area, with_arms_m(area, 9, 12)))
    kept_m = 12.0 - DEFAULT_SIZES[ObjectClass.CAR].front_m - END_MARGIN_M
    assert whole[-1][1] - cut[-1][1] == pytest.approx(40.0 - kept_m, abs=0.01)
    with pytest.raises(CannotPlace, match=r"needs [\d.]+ m of its arm, which is 4\.0 m long"):
        made(event(), with_arms_m(area, 4, 12))


def test_a_road_without_a_junction_is_written_as_before() -> None:
    run = made(event(), ground("crossroads")).task.run
    plain = run.road.model_copy(update={"junction": []})
    assert "junction" not in plain.model_dump(mode="json")
    assert "junction" in run.road.model_dump(mode="json")


@pytest.mark.parametrize(
    ("wanted", "name", "said"),
    [
        (event(), RIGHT_TURN, "it turns by 90 deg in the junction"),
        (event(), "west_in", "it leads over no connecting road of a junction"),
        (
            event(trigger={"below": {"min": 16, "max": 16, "unit": "s"}}),
            STRAIGHT,
            r"the VUT needs \d+ m up to where it is crossed, and the route has 162 m",
        ),
        (
            event(manoeuvre={"line_distance": {"min": 160, "max": 160, "unit": "m"}}),
            STRAIGHT,
            "the vehicle that waits would start at s = ",
        ),
        (
            event(trigger={"below": {"min": 1, "max": 1, "unit": "s"}}),
            STRAIGHT,
            r"ot1 wouldn't reach the conflict point first: after the trigger ot1 takes [\d.]+ s",
        ),
        (
            event(
                speeds={"ot1": {p: {"min": 0, "max": 14, "unit": "m/s"} for p in ALL_PHASES}},
                manoeuvre={"crossing_speed": {"min": 12, "max": 14, "unit": "m/s"}},
            ),
            STRAIGHT,
            "crossing_speed must be within 12 and 14 m/s; the place allows 0 to 8.9 m/s",
        ),
    ],
)
def test_what_doesnt_fit_is_refused_with_its_quantity(wanted: Event, name: str, said: str) -> None:
    with pytest.raises(CannotPlace, match=said):
        made(wanted, ground("crossroads"), name)


def changed_site(
    folder: Path, change: Callable[[dict[str, dict[str, Any]]], None]
) -> OperatingArea:
    """Crossroads, of which some blocks, by id, are changed."""
    site = yaml.safe_load(find_shipped("crossroads", "site").read_text())
    blocks = {block["id"]: block for block in site["blocks"]}
    change(blocks)
    path = folder / "changed.site.yaml"
    path.write_text(yaml.safe_dump(site | {"blocks": list(blocks.values())}))
    area = load_area(str(path), None)[0]
    return replace(area, library=with_routes(area.library))


# The car's way bends to the left, then to the right, with this radius.
_RADIUS_M = 14.0


def bent(blocks: Blocks) -> None:
    turn_rad = math.radians(22.0)
    arc = {"length_m": _RADIUS_M * turn_rad}
    left, right = (
        arc | {f"{end}_curvature_1pm": sign / _RADIUS_M for end in ("start", "end")}
        for sign in (1.0, -1.0)
    )
    rest_m = 18.5 - 2.0 * _RADIUS_M * math.sin(turn_rad)
    blocks["south_north"]["pieces"] = [{"length_m": 1.0}, left, right, {"length_m": rest_m}]
    blocks["north_out"]["origin"]["x_m"] -= 2.0 * _RADIUS_M * (1.0 - math.cos(turn_rad))
    for arm in ("east", "west"):
        blocks[f"{arm}_in"]["leads_to"].remove(f"{arm}_north")
        del blocks[f"{arm}_north"]


def at_speed(least_mps: float, most_mps: float) -> Event:
    return event(manoeuvre={"crossing_speed": {"min": least_mps, "max": most_mps, "unit": "m/s"}})


def test_the_car_takes_a_bend_no_faster_than_the_acceleration_limit_allows(tmp_path: Path) -> None:
    """Steering overshoots a bend that turns into the opposite one: 6.0 m/s^2 at 7.5 m/s."""
    area = changed_site(tmp_path, bent)
    run = made(at_speed(5.5, 8.9), area).task.run.model_copy(update={"camera": None})
    most_mps2 = run.limits.acceleration_mps2
    _, record = run_in_process(run)
    sideways = [abs(s.speed_mps * s.yaw_rate_radps) for s in record.truths("ot1")]
    assert 0.75 * most_mps2 < max(sideways) <= most_mps2 == 4.5
    said = r"that 4\.5 m/s\^2 sideways allow 5\.9 m/s; K\* wants at least 7\.5 m/s"
    with pytest.raises(CannotPlace, match=said):
        made(at_speed(7.5, 8.9), area)


@pytest.mark.parametrize(("side", "object_class"), [("right", "car"), ("left", "bus")])
def test_a_vut_that_keeps_its_speed_meets_it(side: str, object_class: str) -> None:
    run = made(event(side, object_class), ground("crossroads")).task.run
    steady = run.driver.model_copy(update={"reacts": False})
    result, _ = run_in_process(run.model_copy(update={"camera": None, "driver": steady}))
    assert any("collision: ot1" in reason for reason in result.reasons)


def why_below(task: Task) -> str:
    """Return the reason why the trigger's threshold was chosen."""
    tunings = task.tunings
    return next(one.reason for one in tunings if one.field == "constraints.trigger.below")


@pytest.mark.parametrize(
    ("length_m", "least_s", "why"),
    [
        # Computed for values that have room.
        (66.0, 3.2, "it is there 0.3 s before a VUT that keeps its speed"),
        # With the computed value nothing has room.
        (56.0, 2.6, "3.8 s (middle of what K* allows) doesn't work here"),
    ],
)
def test_an_approach_too_short_for_the_middle_of_the_intervals_takes_lower_values(
    length_m: float, least_s: float, why: str, tmp_path: Path
) -> None:
    def short(blocks: Blocks) -> None:
        blocks["west_in"] |= {"pieces": [{"length_m": length_m}]}
        blocks["west_in"]["origin"]["x_m"] = -9.75 - length_m

    below = {"below": {"min": least_s, "max": 5.0, "unit": "s"}}
    task = made(event(trigger=below), changed_site(tmp_path, short)).task
    assert why_below(task) == why
    steady = task.run.driver.model_copy(update={"reacts": False})
    result, _ = run_in_process(task.run.model_copy(update={"camera": None, "driver": steady}))
    assert any("collision: ot1" in reason for reason in result.reasons)


def test_a_bend_that_the_vut_doesnt_come_through_doesnt_count(tmp_path: Path) -> None:
    """An arc with a radius of 15 m ends 62 m before the VUT's start."""
    turn_rad, radius_m = 20.0 / 15.0, 15.0

    def bend(blocks: Blocks, before_m: float) -> None:
        arc = {"length_m": 20.0} | dict.fromkeys(
            ("start_curvature_1pm", "end_curvature_1pm"), 1.0 / radius_m
        )
        blocks["west_in"]["pieces"] = [arc, {"length_m": before_m}]
        blocks["west_in"]["origin"] |= {
            "x_m": -9.75 - before_m - radius_m * math.sin(turn_rad),
            "y_m": radius_m * (1.0 - math.cos(turn_rad)),
            "yaw_rad": -turn_rad,
        }

    far = made(event(), changed_site(tmp_path, partial(bend, before_m=130.0))).task
    plain = made(event(), ground("crossroads")).task
    assert far.run.vut.start.x_m == pytest.approx(plain.run.vut.start.x_m, abs=1e-3)
    values = [one.value for one in plain.tunings]
    assert [one.value for one in far.tunings] == pytest.approx(values, abs=1e-3)
    (tmp_path / "near").mkdir()
    near = changed_site(tmp_path / "near", partial(bend, before_m=60.0))
    with pytest.raises(CannotPlace, match="way of the VUT bends so much that"):
        made(event(), near)


def test_the_length_of_a_bend_doesnt_change_the_speed_in_it() -> None:
    area = ground("crossroads")
    for length_m in (50.0, 50.05, 50.5, 50.95):
        piece = CurvePiece(length_m=length_m, start_curvature_1pm=0.05, end_curvature_1pm=0.05)
        arc = ReferenceLine(Pose2(0.0, 0.0, 0.0), [piece])
        block = replace(area.library.blocks[0], line=arc)
        assert bend_speed_mps(block, 0.0, math.inf, 4.5) == pytest.approx(math.sqrt(90.0), rel=0.01)
        assert bend_speed_mps(block, length_m + 1.0, math.inf, 4.5) == math.inf


def test_a_threshold_says_for_what_it_was_chosen() -> None:
    def reason(low_s: float, high_s: float) -> str:
        below = {"below": {"min": low_s, "max": high_s, "unit": "s"}}
        return why_below(made(event(trigger=below), ground("crossroads")).task)

    assert reason(3.2, 5.0) == "it is there 0.3 s before a VUT that keeps its speed"
    assert re.fullmatch(
        r"the end of K\*'s interval; with 3\.\d+ s it is there 0\.3 s before a VUT that keeps .*",
        reason(4.6, 5.0),
    )


def test_an_export_ends_when_the_session_does(monkeypatch: pytest.MonkeyPatch) -> None:
    """A conflict may come back after the session found it resolved, and ended."""
    run = made(event(), ground("crossroads")).task.run
    result, record = driven(run)
    over_s = foresee(run).over_s
    assert over_s is not None
    resolution_ns = result.happened.resolution_ns
    assert resolution_ns is not None
    happened = replace(result.happened, resolution_ns=resolution_ns + 20 * NS_PER_S)
    monkeypatch.setattr(
        "ssp_scenario_manager.compile.targets.foreseen.driven",
        lambda _: (replace(result, happened=happened), record),
    )
    assert foresee(run).over_s == pytest.approx(over_s, abs=0.1)


def test_a_road_too_short_beyond_the_junction_is_refused_with_what_is_missing(
    tmp_path: Path,
) -> None:
    def short(blocks: Blocks) -> None:
        blocks["north_out"]["pieces"] = [{"length_m": 2.0}]

    missing_m = DEFAULT_SIZES[ObjectClass.CAR].front_m
    with pytest.raises(CannotPlace, match=rf"beyond the junction is {missing_m:.1f} m too short"):
        made(event(), changed_site(tmp_path, short))


def test_surroundings_of_the_roads_of_a_route_are_left_out_by_name(tmp_path: Path) -> None:
    def busy(blocks: Blocks) -> None:
        vehicle = {"object_class": "car", "x_m": 60.0, "speed_mps": 8.0}
        for name in ("east_out", "south_out"):
            blocks[name]["traffic"] = [vehicle | {"id": f"on_{name}", "lane": 0}]

    found = made(event(), changed_site(tmp_path, busy))
    assert found.task.run.traffic == []
    (said,) = found.left_out
    assert said.startswith("on_east_out: it drives on east_out, and surroundings don't follow a ")


def test_a_crossing_route_that_doesnt_fit_leaves_the_next_one() -> None:
    area = ground("crossroads")
    own = route(area)
    assert own.passage is not None
    (first,) = (one for _, one, _ in crossings(event(), own, area.routes_with(own)))
    conflict = next(one for one in own.passage.conflicts if one.route == first.block_id)
    assert first.passage is not None
    # Its arm is too short for a car that waits.
    short = replace(first, block_id="short", passage=replace(first.passage, start_s_m=1.0))
    conflicts = (replace(conflict, route="short"), conflict)
    both = replace(own, passage=replace(own.passage, conflicts=conflicts))
    kept = (both if block is own else block for block in area.library.blocks)
    library = replace(area.library, blocks=(*kept, short))
    assert way_of(made(event(), replace(area, library=library)).task.run).tolist() == pytest.approx(
        way_of(made(event(), area).task.run)
    )
    alone = replace(own, passage=replace(own.passage, conflicts=conflicts[:1]))
    kept = (alone if block is own else block for block in area.library.blocks)
    with pytest.raises(CannotPlace, match="the vehicle that waits would start at s = "):
        made(event(), replace(area, library=replace(area.library, blocks=(*kept, short))))


def test_without_a_road_from_that_side_there_is_no_event() -> None:
    area = ground("crossroads")
    kept = [block for block in area.library.blocks if "south_in" not in block.block_id]
    library = replace(area.library, blocks=tuple(kept))
    with pytest.raises(CannotPlace, match="0 routes of its junction cross it straight on from the"):
        made(event(), replace(area, library=library))


def test_deleting_the_junction_refuses_it(tmp_path: Path) -> None:
    path = site_without_junction("crossroads", tmp_path)
    with pytest.raises(NoBlockChosen) as caught:
        compile_task(Request(event="crossing_car", target="sumo", site=str(path)))
    assert "segment straight, needs junction (identity)" in str(caught.value)


def test_a_place_without_a_junction_is_refused_for_that_first() -> None:
    """Boulevard has two lanes too, where one is needed."""
    with pytest.raises(
        NoBlockChosen, match="no block of it fits: segment straight, needs junction"
    ):
        compile_task(Request(event="crossing_car", target="sumo", site="boulevard"))


@pytest.mark.parametrize(("object_class", "below_s"), [("car", 3.2), ("truck", 4.6), ("bus", 4.6)])
def test_a_maps_fence_has_room_for_the_whole_way(
    crossroads: Path, object_class: str, below_s: float
) -> None:
    """A map says nothing about a fence; the one of the VUT's road alone would leave the car out."""
    library = with_routes(load_library(crossroads))
    link = PlaceLink(kind="opendrive", name="x.xodr", sha256=library.sha256)
    area = OperatingArea(link, library, None, crossroads.read_bytes(), "x.xodr")
    name = "junction 9: road w backward > road we forward lane -1 > road e forward"
    wanted = event(
        object_class=object_class,
        trigger={"below": {"min": below_s, "max": below_s + 0.2, "unit": "s"}},
        time_gap={"min": 0.2, "max": 20, "unit": "s"},
        speeds={
            "vut": {p: {"min": 0, "max": 7, "unit": "m/s"} for p in PHASES_BUT_APPROACH}
            | {"approach": {"min": 6.5, "max": 7, "unit": "m/s"}}
        },
    )
    run = made(wanted, area, name).task.run
    for x_m, y_m in way_of(run).tolist():
        assert point_in_polygon(x_m, y_m, run.geofence)
    assert not point_in_polygon(30.0, 30.0, run.geofence)


def test_the_view_from_above_has_the_arms_and_the_zone() -> None:
    run = made(event(), ground("crossroads")).task.run
    drawn = drawing_of(run)
    bare = drawing_of(run.model_copy(update={"road": run.road.model_copy(update={"junction": []})}))
    more = drawn.road_lines[len(bare.road_lines) :]
    assert [line.kind for line in more].count("edge") == 2 * 4
    assert [line.kind for line in more].count("centre") == 20
    # The lane that the car takes leads up to the junction on the arm from the south.
    ends = [line.points[-1] for line in more if line.kind == "centre"]
    assert any(end == pytest.approx((1.75, -9.75), abs=1e-6) for end in ends)
    assert [zone.name for zone in drawn.conflict_zones] == ["ot1"]


def test_sumo_gets_the_roads_of_the_junction(tmp_path: Path) -> None:
    road = made(event(), ground("crossroads")).task.run.road
    text = write_network(road, tmp_path).path.read_text()
    lanes = sum(len(one.lanes) for one in road.junction)
    assert len(set(re.findall(r'<edge id="(junction_\d+_\d+)"', text))) == lanes == 20


def test_arms_that_both_directions_share_are_one(crossroads: Path) -> None:
    found = junction_roads(load_library(crossroads), "9")
    arms = [one for one in found if one.junction_at != "both"]
    assert len(found) - len(arms) == 3
    assert len(arms) == 4
    for arm in arms:
        assert arm.length_m == 60.0
        line = ReferenceLine.of_road(arm)
        at = line.pose(arm.length_m if arm.junction_at == "end" else 0.0)
        assert math.hypot(at.x_m, at.y_m) == pytest.approx(10.0)


@pytest.mark.parametrize("side", ["right", "left"])
def test_openscenario_plays_it_on_a_map_that_has_the_arms(side: str, tmp_path: Path) -> None:
    """The export plays itself: the gap to the car is the session's to 0.3 m, else it refuses."""
    found = made(event(side), ground("cross_track"))
    task = sealed(found.task.model_copy(update={"target": "openscenario", "chosen_by": "score"}))
    export_openscenario(task, found.block, None, tmp_path)
    library = load_library(tmp_path / "cross_track.xodr")
    (car,) = task.run.targets
    lanes = []
    for block in library.blocks:
        s_m, l_m = block.line.to_local_many(np.array([(car.start.x_m, car.start.y_m)]))[0]
        if 0.0 <= s_m <= block.length_m:
            lanes += [x for x in block.forward_lanes if abs(x.y_m - l_m) < 0.01]
    assert lanes


@pytest.mark.parametrize("site", ["crossroads", "cross_track"])
def test_a_parked_truck_may_hide_the_car_when_it_drives_off(site: str) -> None:
    hidden = behind_a_parked_truck()
    assert check_event(hidden) == []
    run = made(hidden, ground(site)).task.run
    result, record = driven(run)
    assert (result.verdict, result.reasons) == (Verdict.VALID, ())
    fired_ns = result.triggers[0].crossing_ns
    vut, car, truck = (
        next(state for state in record.truths(name) if state.stamp_ns >= fired_ns)
        for name in ("vut", "ot1", "ot2")
    )
    assert is_hidden(vut, car, truck, Camera().forward_m)
