"""The lane that a lane change goes to, counted in lane ids of the exported map.

OpenSCENARIO's ``RelativeTargetLane`` counts lane ids, whatever type and width the lanes have: a
strip of width 0 between two driving lanes counts like any other.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import defusedxml.ElementTree as safe_xml

from ssp_core.errors import InputError
from ssp_core.geometry import Pose2
from ssp_core.world.reference_line import NotOneToOne
from ssp_scenario_manager.maps.lane_layout import LaneHere, lanes_at
from ssp_scenario_manager.maps.opendrive_road import RoadRecord, read_road
from ssp_scenario_manager.maps.reference_line import Unusable, road_line
from ssp_scenario_manager.maps.xml_input import BadElement, number

# A goal this near to its lane's middle is that middle.
_MIDDLE_M = 0.001
# No lane is further beside its road's line.
_WIDEST_ROAD_M = 200.0


@dataclass(frozen=True, slots=True)
class GoalLane:
    """The lane in which a lane change ends.

    Args:
        ids: from the own lane's id to the goal's, + left of the direction of travel.
        offset_m: of the goal from that lane's middle, + left of the road's own direction.
    """

    ids: int
    offset_m: float


@dataclass(frozen=True, slots=True)
class Beside:
    """The middle of a lane beside one.

    Args:
        shift_m: from the place, + left of the direction of travel.
        along: 1 where that is the road's own direction, else -1.
    """

    shift_m: float
    along: int


@dataclass(frozen=True, slots=True)
class _Place:
    """A pose on a road of the map.

    Args:
        t_m: offset from the road's line.
        along: 1 where the pose points in the road's own direction, else -1.
    """

    lanes: list[LaneHere]
    own: LaneHere
    t_m: float
    along: int


def goal_lane(map_data: bytes, start: Pose2, shift_m: float) -> GoalLane:
    """Find the lane that lies beside a place on a map.

    Args:
        map_data: of the exported OpenDRIVE map.
        start: pose of who changes lane, in its own lane, frame map.
        shift_m: sideways to the goal, + left of the direction of travel.

    Raises:
        InputError: the map has no lane at one of both places.
    """
    place = _place(map_data, start)
    goal_t = None if place is None else place.t_m + place.along * shift_m
    goal = None if place is None or goal_t is None else _lane_of(place.lanes, goal_t)
    if place is None or goal_t is None or goal is None:
        raise InputError(
            f"has no lane {abs(shift_m):.2f} m beside the one at x {start.x_m:.1f} m, "
            f"y {start.y_m:.1f} m, so that a lane change has no goal",
            remedy="compile for another block, or for another target",
        )
    ids = goal.id - place.own.id
    # Lane 0 has no width, and players skip it.
    if (goal.id > 0) != (place.own.id > 0):
        ids -= 1 if ids > 0 else -1
    offset = round(goal_t - goal.centre_m, 3)
    return GoalLane(place.along * ids, offset if abs(offset) > _MIDDLE_M else 0.0)


def lane_beside(map_data: bytes, start: Pose2, ids: int) -> Beside:
    """Find the middle of the lane so many lane ids beside a place, as a player does.

    Args:
        map_data: OpenDRIVE.
        start: on a lane, frame map.
        ids: as in a relative goal, + left of the direction of travel.

    Raises:
        InputError: the map has no such lane.
    """
    place = _place(map_data, start)
    lanes = {} if place is None else {lane.id: lane for lane in place.lanes}
    if place is not None:
        goal = place.own.id + place.along * ids
        if goal == 0 or (goal > 0) != (place.own.id > 0):
            goal += 1 if goal >= 0 and place.own.id < 0 else -1
        if goal in lanes:
            return Beside(place.along * (lanes[goal].centre_m - place.t_m), place.along)
    raise InputError(
        f"has no lane {ids} beside x {start.x_m:.1f} m, y {start.y_m:.1f} m",
        remedy="compile the event for another place of the map",
    )


def _place(map_data: bytes, pose: Pose2) -> _Place | None:
    """Find the road in whose lane a pose lies; of several the one whose middle is nearest."""
    places = []
    for element in safe_xml.fromstring(map_data).iter("road"):
        if not _may_hold(element, pose):
            continue
        try:
            one = _on_road(read_road(element), pose)
        except BadElement as error:
            raise InputError(
                f"its <{error.element.tag}> {error.problem}", remedy="mend the map, or give another"
            ) from error
        if one is not None:
            places.append(one)
    return min(places, key=lambda one: abs(one.t_m - one.own.centre_m), default=None)


def _may_hold(road: Element, pose: Pose2) -> bool:
    """Tell whether a road can be near a place; a short one that starts far away can't."""
    start = road.find("planView/geometry")
    if start is None:
        return False
    away = math.hypot(number(start, "x", 0.0) - pose.x_m, number(start, "y", 0.0) - pose.y_m)
    return away <= number(road, "length", 0.0) + _WIDEST_ROAD_M


def _on_road(road: RoadRecord, pose: Pose2) -> _Place | None:
    """Find the lane of a pose on one road; None where it has none there."""
    try:
        line = road_line(road)
        s, t = line.to_local(pose.x_m, pose.y_m)
    except (Unusable, NotOneToOne):
        return None
    if not 0.0 <= s <= line.length_m:
        return None
    lanes = lanes_at(road, s)
    own = _lane_of(lanes, t)
    if own is None:
        return None
    turned = math.cos(pose.yaw_rad - line.pose(s).yaw_rad)
    return _Place(lanes, own, t, 1 if turned > 0.0 else -1)


def _lane_of(lanes: list[LaneHere], t_m: float) -> LaneHere | None:
    """Return the lane that holds an offset, or None."""
    holding = [lane for lane in lanes if abs(t_m - lane.centre_m) < 0.5 * lane.width_m]
    return min(holding, key=lambda lane: abs(t_m - lane.centre_m), default=None)
