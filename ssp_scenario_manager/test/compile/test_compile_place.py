"""Plans in frame map: what a place must offer, and that turning it changes nothing."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

from ssp_core.geometry import Box, Polyline, Pose2
from ssp_core.run_file.model import LinkDisturbance
from ssp_core.run_file.participants import (
    Brake,
    FollowPath,
    Hold,
    LaneChange,
    RelativeDistance,
    TimeToArrival,
)
from ssp_core.safety.fence import box_excess_m
from ssp_scenario_manager.compile.area import OperatingArea, check_in_fence
from ssp_scenario_manager.compile.place import Order, Realisation, realise, road_of
from ssp_scenario_manager.compile.task import PlaceLink, Target
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.maps.crossings import Crossing
from ssp_scenario_manager.maps.site import Site, load_site, site_library, site_version
from ssp_scenario_manager.scenarios.base import CannotPlace
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from ssp_scenario_manager.scenarios.values import quantity_at
from ssp_scenario_manager.triggers.fireability import cannot_fire
from tests.support.events.blocks import block_of

# Where roads cross: test_maps_crossing_car.py.
EVENTS = sorted(name for name, kind in KINDS.items() if not kind.at_junction)
SITES = ("boulevard", "north_track", "south_loop")


@cache
def event(name: str) -> Event:
    return load_event(name)[0]


def area(site: Site) -> OperatingArea:
    link = PlaceLink(kind="site", name=site.name, sha256=site_version(site))
    return OperatingArea(link, site_library(site), site)


@cache
def shipped(name: str) -> Site:
    return load_site(name)[0]


def changed(name: str, changes: dict[str, Any]) -> Site:
    """A shipped site with other values at some dotted paths."""
    value = shipped(name).model_dump(mode="json", by_alias=True)
    for path, new in changes.items():
        *way, last = (int(p) if p.isdigit() else p for p in path.split("."))
        node: Any = value
        for key in way:
            node = node[key]
        node[last] = new
    return Site.model_validate(value)


# By event, site and target.
_MADE: dict[tuple[str, str, Target], Realisation] = {}


def make(
    name: str, site: Site, target: Target = "sumo", preferred: dict[str, float] | None = None
) -> Realisation:
    """The event on a site; without preferred values made once for all tests, which only read it."""
    place = area(site)
    key = name, site_version(site), target
    if preferred is None and key in _MADE:
        return _MADE[key]
    order = Order(event(name), "sha256:event", place, target, 1, preferred or {})
    made = realise(order, place.library.blocks[0])
    return made if preferred else _MADE.setdefault(key, made)


@pytest.mark.parametrize("name", EVENTS)
@pytest.mark.parametrize("site", SITES)
def test_every_event_can_run_on_every_site(name: str, site: str) -> None:
    made = make(name, shipped(site))
    run = made.task.run
    assert cannot_fire(run) == []
    assert (run.scenario, run.interaction, run.initiator) == (name, name, "ot1")
    assert run.observable == KINDS[name].observable
    assert run.event_version == "sha256:event"
    assert run.site_version == site_version(shipped(site))
    assert run.seed == 1
    assert made.left_out == ()
    # Ω_safe is the stricter of site and K*.
    limits = shipped(site).limits
    assert run.limits.speed_mps == min(limits.speed_mps, 15.0)
    assert run.limits.acceleration_mps2 == min(limits.acceleration_mps2, 4.5)
    assert (run.thresholds.arrival_gap_s is None) == (not KINDS[name].uses_arrival_gap)
    # Anchors and their places in both frames agree.
    line = made.block.line
    for anchors in made.task.anchors.values():
        for place in (anchors.start, anchors.goal, anchors.conflict):
            assert line.to_map(place.s_m, place.l_m) == pytest.approx((place.x_m, place.y_m))
    start = made.task.anchors["vut"].start
    assert (run.vut.start.x_m, run.vut.start.y_m) == pytest.approx((start.x_m, start.y_m))
    assert {t.field for t in made.task.tunings} >= {"constraints.trigger.below"}
    for tuning in made.task.tunings:
        found = quantity_at(event(name), tuning.field)
        if isinstance(found, Interval):
            assert (tuning.min, tuning.max, tuning.unit) == (found.min, found.max, found.unit)


def test_manoeuvres_and_conditions_are_those_of_the_kind() -> None:
    kinds: dict[str, tuple[type, type]] = {
        "cut_in": (LaneChange, RelativeDistance),
        "lead_braking": (Brake, RelativeDistance),
        "slow_lead": (Hold, RelativeDistance),
        "vru_crossing": (FollowPath, TimeToArrival),
        "occluded_crossing": (FollowPath, TimeToArrival),
    }
    for name, (manoeuvre, condition) in kinds.items():
        (trigger,) = make(name, shipped("boulevard")).task.run.triggers
        assert isinstance(trigger.manoeuvre, manoeuvre)
        assert isinstance(trigger.condition, condition)
    held, left = make("cut_out", shipped("boulevard")).task.run.triggers
    assert (held.object_id, left.object_id) == ("ot1", "ot2")
    assert isinstance(held.manoeuvre, Hold)
    assert isinstance(left.manoeuvre, LaneChange)
    assert held.condition == left.condition
    assert isinstance(held.condition, RelativeDistance)
    assert held.condition.object_id == "ot1"
    occluded = make("occluded_crossing", shipped("boulevard")).task.run
    assert [t.id for t in occluded.targets if t.approach is None] == ["ot1", "ot2"]


def test_only_a_track_session_is_physical() -> None:
    track = make("cut_in", shipped("north_track"), "track").task.run
    assert (track.domain, track.stand_in) == ("physical", True)
    simulated = make("cut_in", shipped("north_track"), "sumo").task.run
    assert (simulated.domain, simulated.stand_in) == ("simulation", False)
    assert track.disturbance == shipped("north_track").disturbance
    assert simulated.disturbance == LinkDisturbance()


def test_a_road_keeps_its_markings_whatever_the_event() -> None:
    assert make("vru_crossing", shipped("boulevard")).task.run.road.crossing_x_m == 110.0
    assert make("cut_in", shipped("boulevard")).task.run.road.crossing_x_m == 110.0
    assert make("occluded_crossing", shipped("boulevard")).task.run.road.crossing_x_m == 110.0


def test_the_marking_of_the_event_comes_first() -> None:
    """Parts of a road are crossed by others too; a zebra over one lane isn't a road's."""
    marks = (
        Crossing(60.0),
        Crossing(150.0),
        Crossing(190.0),
        Crossing(300.0, 2.0, False, -9.0, 0.5),
    )
    block = block_of(crossings=marks)
    for event_at_m, first in ((150.0, 150.0), (60.0, 60.0), (None, 190.0)):
        road = road_of(block, event_at_m)
        assert road.crossing_x_m == first
        assert road.crossings_x_m == [60.0, 150.0, 190.0]
        (partial,) = road.partial_crossings
        assert partial.x_m == 300.0
        assert (partial.right_m, partial.left_m) == (road.right_edge_m, 0.5)
    assert road_of(block_of()).crossings_x_m == []


@pytest.mark.parametrize("name", ["cut_in", "vru_crossing"])
def test_turning_a_site_changes_nothing_in_the_block(name: str) -> None:
    """METHOD 2.4: the transform is rigid."""
    pose = Pose2(-31.5, 77.25, math.radians(-141.0))
    turned_site = changed(
        "boulevard",
        {"blocks.0.origin": {"x_m": pose.x_m, "y_m": pose.y_m, "yaw_rad": pose.yaw_rad}},
    )
    straight, turned = make(name, shipped("boulevard")), make(name, turned_site)
    assert turned.plan == straight.plan
    for before, after in zip(
        (straight.task.run.vut, *straight.task.run.targets),
        (turned.task.run.vut, *turned.task.run.targets),
        strict=True,
    ):
        local = pose.to_local(after.start.x_m, after.start.y_m)
        assert local == pytest.approx((before.start.x_m, before.start.y_m), abs=1e-6)
        assert math.cos(after.start.yaw_rad - pose.yaw_rad - before.start.yaw_rad) == (
            pytest.approx(1.0)
        )
    assert turned.task.run.road.lanes == straight.task.run.road.lanes
    assert turned.task.run.traffic == straight.task.run.traffic


def test_preferred_values_are_taken() -> None:
    values = {"constraints.trigger.below": 17.0, "constraints.speeds.vut.approach": 12.6}
    made = make("cut_in", shipped("north_track"), "track", preferred=values)
    assert made.task.trigger.below == 17.0
    assert made.task.run.driver.cruise_mps == 12.6
    assert {t.field: t.reason for t in made.task.tunings}["constraints.trigger.below"] == (
        "validated in simulation"
    )


STRIP = {"block": "straight", "from_s_m": 0.0, "to_s_m": 420.0}


def fenced(**fence: Any) -> dict[str, Any]:
    """A fence, with all regions inside of it."""
    inside = {**STRIP, **fence, "to_l_m": 17.0}
    fence = {**inside, "to_l_m": 19.0}
    return {"geofence": fence, "ot_reachable": [inside], "safe_stop_zones": [inside]}


REFUSED: dict[str, tuple[str, str, dict[str, Any], str]] = {
    # event, site, changes, reason
    "geofence": (
        "vru_crossing",
        "north_track",
        fenced(from_l_m=-2.0),
        "ot1 would leave the geofence at x ",
    ),
    "vut out of the fence": (
        "cut_in",
        "north_track",
        fenced(to_s_m=300.0, from_l_m=-8.0),
        "vut would leave the geofence",
    ),
    "reachable": (
        "cut_in",
        "north_track",
        {"ot_reachable": [{**STRIP, "from_l_m": 1.9, "to_l_m": 19.0}]},
        "ot1 would leave what OTs can reach",
    ),
    "reachable of a parked truck": (
        "occluded_crossing",
        "north_track",
        {"ot_reachable": [{**STRIP, "from_l_m": -3.0, "to_l_m": 17.0}]},
        "ot2 would leave what OTs can reach",
    ),
    "safe stop behind": (
        "cut_in",
        "north_track",
        {"safe_stop_zones": [{**STRIP, "to_s_m": 60.0, "from_l_m": -2.0, "to_l_m": 2.0}]},
        r"no safe-stop zone can be reached from s = \d+ m on",
    ),
    "safe stop far aside": (
        "cut_in",
        "north_track",
        {"safe_stop_zones": [{**STRIP, "from_l_m": 12.0, "to_l_m": 17.0}]},
        "no safe-stop zone can be reached",
    ),
    "camera": (
        "cut_in",
        "north_track",
        {"camera.hfov_deg": 50.0},
        r"camera\.hfov_deg is 50 deg, K\* needs at least 60",
    ),
    "small pictures": (
        "cut_in",
        "north_track",
        {"camera.width_px": 240},
        r"camera\.width_px is 240 px, K\* needs at least 640",
    ),
    "speed": ("cut_in", "north_track", {"limits.speed_mps": 10.0}, "the place allows 0 to 10 m/s"),
    "braking": (
        "lead_braking",
        "north_track",
        {"limits.acceleration_mps2": 3.0},
        r"the place allows 0 to 3 m/s\^2",
    ),
}


@pytest.mark.parametrize(("event_name", "who"), [("cut_in", "vut"), ("vru_crossing", "vut")])
@pytest.mark.parametrize("wall_m", [1e-6, 0.01, 0.1])
def test_a_thin_wall_across_the_lanes_is_part_of_the_fence(
    event_name: str, who: str, wall_m: float
) -> None:
    low, high, at = -6.75, 17.25, 200.3
    wall = [(at + wall_m, high), (at + wall_m, -1.0), (at, -1.0), (at, high)]
    fence = [(0.0, low), (400.0, low), (400.0, high), *wall, (0.0, high)]
    beyond = {"block": "main", "from_s_m": 201.0, "to_s_m": 400.0, "from_l_m": -4.0, "to_l_m": 15.0}
    changes = {"geofence": {"points": fence}, "ot_reachable": [beyond], "safe_stop_zones": [beyond]}
    with pytest.raises(CannotPlace, match=rf"{who} would leave the geofence at x (19\d|20\d)\."):
        make(event_name, changed("boulevard", changes))


@pytest.mark.parametrize(("y_m", "to_x_m"), [(1.0, 120.0), (1.75, 2.0)])
def test_a_thin_wall_between_the_lanes_of_a_lane_change_is_part_of_the_fence(
    y_m: float, to_x_m: float
) -> None:
    """A centimetre wide along the road; neither lane touches it, and the lane change crosses it."""
    low, high, end = -6.75, 17.25, 400.0
    wall = [(x, y_m + side) for side in (-0.005, 0.005) for x in (end, to_x_m)]
    fence = [(0.0, low), (end, low), *wall[:2], *wall[:1:-1], (end, high), (0.0, high)]
    lanes = {"block": "main", "from_s_m": 0.0, "to_s_m": end}
    left = {**lanes, "from_l_m": y_m + 0.02, "to_l_m": 15.0}
    right = {**lanes, "from_l_m": -4.0, "to_l_m": y_m - 0.02}
    changes = {
        "geofence": {"points": fence},
        "ot_reachable": [left, right],
        "safe_stop_zones": [left, right],
    }
    with pytest.raises(CannotPlace, match=r"ot1: .* the object is 0\.900 m outside the geofence"):
        make("cut_in", changed("boulevard", changes))


@pytest.mark.parametrize("site", ["boulevard", "north_track"])  # the second lies askew in the map
@pytest.mark.parametrize("step", [0, 1])
def test_a_way_that_leaves_the_fence_between_two_samples_is_refused(site: str, step: int) -> None:
    """A walker half a metre long is looked at every metre; the wall stands where none is."""
    made = make("vru_crossing", shipped(site))
    run, line = made.task.run, made.block.line
    manoeuvre = run.triggers[0].manoeuvre
    assert isinstance(manoeuvre, FollowPath)
    walker = run.targets[0]
    path = Polyline(manoeuvre.motion.path)
    steps = round(path.length_m)
    samples = [path.pose(path.length_m * k / steps) for k in range(steps + 1)]
    here, there = samples[step : step + 2]
    s_m, l_m = line.to_local(0.5 * (here.x_m + there.x_m), 0.5 * (here.y_m + there.y_m))
    end_m = made.block.length_m - 1.0
    corners = [(1.0, -40.0), (end_m, -40.0), (end_m, 40.0), (1.0, 40.0)]
    wall = [(end_m, l_m), (s_m - 1.0, l_m), (end_m, l_m + 1e-3)]
    whole = [line.to_map(*at) for at in corners]
    fence = [line.to_map(*at) for at in (*corners[:2], *wall, *corners[2:])]
    size = walker.size
    boxes = [Box(one, size.front_m, size.rear_m, size.width_m) for one in samples]
    assert max(box_excess_m(box, fence) for box in boxes) == 0.0
    check_in_fence(run.model_copy(update={"geofence": whole}), made.block, made.plan)
    with pytest.raises(CannotPlace, match="ot1 would leave the geofence"):
        check_in_fence(run.model_copy(update={"geofence": fence}), made.block, made.plan)


@pytest.mark.parametrize("case", REFUSED)
def test_a_place_that_does_not_offer_what_is_needed(case: str) -> None:
    name, site, changes, reason = REFUSED[case]
    with pytest.raises(CannotPlace, match=reason):
        make(name, changed(site, changes), "track")


def test_reachable_regions_bind_on_physical_sites_whatever_the_target() -> None:
    """A simulation of a track is to show what the track can do."""
    _, site, changes, reason = REFUSED["reachable"]
    with pytest.raises(CannotPlace, match=reason):
        make("cut_in", changed(site, changes), "sumo")
    simulated = {**changes, "domain": "simulation"}
    assert make("cut_in", changed(site, simulated), "sumo").task.run.domain == "simulation"


def test_surroundings_that_come_into_the_way_are_left_out_and_told() -> None:
    def vehicle(name: str, lane: int, x_m: float, speed_mps: float) -> dict[str, Any]:
        return {
            "id": name,
            "object_class": "car",
            "lane": lane,
            "x_m": x_m,
            "speed_mps": speed_mps,
        }

    traffic = [
        vehicle("ahead", 0, 30.0, 5.0),
        vehicle("far", 0, 250.0, 13.9),
        vehicle("slow", 1, 200.0, 3.0),
        vehicle("behind", 1, 20.0, 13.0),
        vehicle("oncoming", 2, 300.0, 8.0),
        vehicle("ot1", 3, 200.0, 8.0),
    ]
    site = changed("boulevard", {"blocks.0.traffic": traffic})
    made = make("cut_in", site)
    assert [t.id for t in made.task.run.traffic] == ["far", "oncoming"]
    assert [text.split(":")[0] for text in made.left_out] == ["ahead", "slow", "behind", "ot1"]
    # Fires about 8.8 s after the start; the walker is in lane 3 about 9 s later.
    meeting = [vehicle("meets", 3, 110.0 + 17.0 * 8.0, 8.0), vehicle("passes", 3, 160.0, 8.0)]
    crossing = make("vru_crossing", changed("boulevard", {"blocks.0.traffic": meeting}))
    assert [t.id for t in crossing.task.run.traffic] == ["passes"]
    assert crossing.left_out == ("meets: it would pass the crossing with ot1 in its lane",)


def test_a_map_has_documented_limits_and_a_camera_as_needed() -> None:
    library = area(shipped("boulevard")).library
    place = OperatingArea(
        PlaceLink(kind="opendrive", name="town.xodr", sha256="sha256:map"),
        library,
        None,
        b"<OpenDRIVE/>",
        "town.xodr",
    )
    need = event("cut_in")
    limits = place.limits(need)
    assert (limits.speed_mps, limits.acceleration_mps2, limits.separation_m) == (15.0, 4.5, 0.5)
    assert place.camera(need).hfov_deg == 75.0
    value = need.model_dump(mode="json", by_alias=True)
    value["constraints"]["camera"]["hfov"] = {"min": 80.0, "max": 100.0, "unit": "deg"}
    assert place.camera(Event.model_validate(value)).hfov_deg == 80.0
    made = realise(Order(need, "sha256:event", place, "sumo", 1, {}), library.blocks[0])
    assert (made.task.run.site, made.task.run.domain, made.task.run.traffic) == (
        "town.xodr",
        "simulation",
        [],
    )
    # 3 m beyond sidewalks of 3 m.
    xs, ys = zip(*made.task.run.geofence, strict=True)
    assert (min(ys), max(ys)) == pytest.approx((-1.75 - 6.0, 12.25 + 6.0))
    assert (min(xs), max(xs)) == pytest.approx((0.0, 400.0))


def test_a_block_whose_frame_ends_near_the_road_is_refused() -> None:
    site = changed(
        "boulevard",
        {
            "blocks.0.pieces": [
                {
                    "length_m": 60.0,
                    "start_curvature_1pm": 0.08,
                    "end_curvature_1pm": 0.08,
                },
                {"length_m": 340.0},
            ]
        },
    )
    place = area(shipped("boulevard"))
    block = replace(place.library.blocks[0], line=_line(site))
    with pytest.raises(CannotPlace):
        realise(Order(event("cut_in"), "v", place, "sumo", 1, {}), block)


def _line(site: Site) -> Any:
    from ssp_core.world.reference_line import ReferenceLine

    return ReferenceLine(site.blocks[0].origin.pose, site.blocks[0].pieces)
