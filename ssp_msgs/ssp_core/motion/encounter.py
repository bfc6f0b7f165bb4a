"""The relation of an object to the VUT: gap, TTC, arrivals at the conflict zone (METHOD 1).

Everything is measured along the VUT's path, so that it holds for straight and curved roads.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Literal

from ssp_core.geometry import Box, Polyline, Pose2, wrap_angle
from ssp_core.motion.state import ObjectState, Size
from ssp_core.value_class import value_class

# METHOD 1: a swept corridor is the vehicle's width plus this on each side.
CORRIDOR_MARGIN_M = 0.3
# METHOD 1: lateral speed towards the VUT's corridor above which a manoeuvre is observable.
OBSERVABLE_LATERAL_MPS = 0.2
# The counterpart for a lead vehicle that brakes: brake lights and closing become visible.
OBSERVABLE_BRAKING_MPS2 = 1.0
# The counterpart for one ahead that does nothing: from this TTC on, closing in on it is visible.
OBSERVABLE_CLOSING_S = 4.0
# A direction of motion between these two angles to a path crosses it; below the first it is along
# the path, above the second against it.
ALONG_RAD = math.radians(45.0)
AGAINST_RAD = math.radians(135.0)
_SLOWEST_MPS = 0.05

Observable = Literal["lateral", "braking", "closing"]


@value_class(frozen=True, slots=True)
class Encounter:
    """One object relative to the VUT at one instant.

    Args:
        gap_m: bumper gap along the VUT's path, from the VUT's front to the object's nearest
            point; negative when the object has begun to pass or is behind.
        lateral_m: offset of the object's nearest point from the VUT's path, + is left.
        clearance_m: distance of the object from the VUT's corridor, 0 when inside it.
        towards_mps: lateral speed towards the middle of the corridor, negative when leaving.
        along_mps: speed of the object along the VUT's path.
        ttc_s: bumper gap over closing speed, +inf while not closing, when the object is behind, and
            while it is outside the VUT's corridor and doesn't move towards it.
        zone_gap_m: along the VUT's path, from the VUT's front to where the conflict zone begins,
            negative when the front is beyond; +inf when the object doesn't come into the corridor.
        vut_arrival_s: until the VUT's front reaches the conflict zone at its present speed.
        object_arrival_s: until the object reaches the VUT's corridor, 0 when inside, +inf when it
            doesn't move towards it.
    """

    gap_m: float
    lateral_m: float
    clearance_m: float
    towards_mps: float
    along_mps: float
    ttc_s: float
    zone_gap_m: float
    vut_arrival_s: float
    object_arrival_s: float

    @property
    def in_corridor(self) -> bool:
        return self.clearance_m == 0.0

    @property
    def arrival_gap_s(self) -> float:
        """Gap between the two predicted arrivals at the zone, +inf when one never arrives."""
        if math.isinf(self.vut_arrival_s) or math.isinf(self.object_arrival_s):
            return math.inf
        return abs(self.vut_arrival_s - self.object_arrival_s)


def corridor_half_m(width_m: float) -> float:
    """Return half the width of a swept corridor (METHOD 1), m."""
    return width_m / 2.0 + CORRIDOR_MARGIN_M


def is_crossing(direction_rad: float) -> bool:
    """Tell whether a motion in this direction crosses a path.

    Args:
        direction_rad: angle between the motion and the path, within -pi and pi.
    """
    return ALONG_RAD < abs(direction_rad) <= AGAINST_RAD


def comes_against(own_rad: float, other_rad: float) -> bool:
    """Tell whether a heading is opposite to another one, rather than along it or across it.

    Args:
        own_rad: the one, counter-clockwise.
        other_rad: the other, in the same frame.
    """
    return abs(wrap_angle(other_rad - own_rad)) > AGAINST_RAD


def swept_stations(
    other: ObjectState, path: Polyline, half_m: float, reach_m: float = 0.0
) -> tuple[float, float] | None:
    """Return the part of a corridor along a path that an object's swept corridor covers (METHOD 1).

    Where the object crosses, this is the conflict zone: the union of it over recorded states, or,
    with a reach, what the object will cover if it goes on straight.

    Args:
        other: the object; its corridor is its width plus the margin on each side.
        path: middle of the other corridor, frame map.
        half_m: half the width of the other corridor.
        reach_m: how far ahead of and behind the object its corridor is looked at.

    Returns:
        First and last station in m; None where it covers nothing.
    """
    return _covered(other.pose, other.size, path, half_m, reach_m)


def _covered(
    pose: Pose2, size: Size, path: Polyline, half_m: float, reach_m: float
) -> tuple[float, float] | None:
    station, offset = path.project_beyond(pose.x_m, pose.y_m)
    box = Box(
        Pose2(station, offset, pose.yaw_rad - path.pose(station).yaw_rad),
        size.front_m + reach_m,
        size.rear_m + reach_m,
        2.0 * corridor_half_m(size.width_m),
    )
    corners = box.corners()
    stations = [s for s, d in corners if abs(d) <= half_m]
    stations += [
        s0 + (s1 - s0) * (edge - d0) / (d1 - d0)
        for (s0, d0), (s1, d1) in zip(corners, [*corners[1:], corners[0]], strict=True)
        for edge in (-half_m, half_m)
        if (d0 - edge) * (d1 - edge) < 0.0
    ]
    return (min(stations), max(stations)) if stations else None


def swept_on_way(
    way: Iterable[Pose2], size: Size, path: Polyline, half_m: float, across_rad: float = ALONG_RAD
) -> tuple[float, float] | None:
    """Return the part of a corridor that an object covers on its way, except along the path.

    Args:
        way: of the object's reference point, in order.
        size: the object's.
        path: middle of the other corridor, frame map.
        half_m: half the width of the other corridor.
        across_rad: angle to the path from which on it counts; 0: along the path too.
    """
    covered: list[float] = []
    for pose in way:
        station, _ = path.project_beyond(pose.x_m, pose.y_m)
        if abs(wrap_angle(pose.yaw_rad - path.pose(station).yaw_rad)) > across_rad:
            covered += _covered(pose, size, path, half_m, 0.0) or ()
    return (min(covered), max(covered)) if covered else None


def encounter(vut: ObjectState, other: ObjectState, path: Polyline) -> Encounter:
    """Return the object relative to the VUT, at the present speeds of both (METHOD 1).

    Of an object that crosses, the conflict zone is what its swept corridor covers of the VUT's. Of
    any other, it starts where the object's rearmost point along the path will be when the object
    reaches the corridor: for a cut-in it moves on with it.

    Args:
        vut: state of the VUT.
        other: state of the object at the same stamp.
        path: the VUT's path, frame map.
    """
    (vut_station, _), *projected = path.project_all_beyond(
        [(vut.x_m, vut.y_m), *other.box.corners()]
    )
    front = vut_station + vut.size.front_m
    stations = [s for s, _ in projected]
    offsets = [d for _, d in projected]
    nearest, farthest = min(stations), max(stations)
    low, high = min(offsets), max(offsets)

    heading = wrap_angle(other.yaw_rad - path.pose(0.5 * (nearest + farthest)).yaw_rad)
    along = other.speed_mps * math.cos(heading)
    leftwards = other.speed_mps * math.sin(heading)
    centre = 0.5 * (low + high)
    towards = -math.copysign(leftwards, leftwards * centre) if centre else abs(leftwards)

    half = corridor_half_m(vut.size.width_m)
    clearance = max(0.0, low - half, -half - high)
    lateral = 0.0 if low <= 0.0 <= high else (low if low > 0.0 else high)

    gap = nearest - front
    closing = vut.speed_mps - along
    ttc = gap / closing if closing > _SLOWEST_MPS and gap >= 0.0 else math.inf
    if clearance == 0.0:
        object_arrival = 0.0
    elif towards > _SLOWEST_MPS:
        object_arrival = clearance / towards
    else:
        object_arrival = math.inf
        ttc = math.inf
    zone_gap = vut_arrival = math.inf
    if math.isfinite(object_arrival):
        moved = along * object_arrival
        zone = nearest + moved, farthest + moved
        if is_crossing(heading):
            # Far enough that both corridors meet whole, up to 45 degrees.
            reach = 2.0 * (abs(centre) + half + other.size.length_m + other.size.width_m)
            zone = swept_stations(other, path, half, reach) or zone
        zone_gap = zone[0] - front
        if vut.speed_mps > _SLOWEST_MPS and zone_gap >= 0.0:
            vut_arrival = zone_gap / vut.speed_mps
        elif vut.speed_mps > _SLOWEST_MPS and zone[1] > vut_station - vut.size.rear_m:
            vut_arrival = 0.0
    return Encounter(
        gap_m=gap,
        lateral_m=lateral,
        clearance_m=clearance,
        towards_mps=towards,
        along_mps=along,
        ttc_s=ttc,
        zone_gap_m=zone_gap,
        vut_arrival_s=vut_arrival,
        object_arrival_s=object_arrival,
    )


def is_conflict(meeting: Encounter, ttc_s: float | None, arrival_gap_s: float | None) -> bool:
    """Tell whether TTC or the gap between the predicted arrivals is under its threshold (METHOD 1).

    An object that is inside the corridor and not being approached is no conflict: its arrival is
    past, so that the gap between arrivals says nothing about it.

    Args:
        meeting: of the VUT and the object at one instant.
        ttc_s: threshold of TTC; None: the event doesn't use it.
        arrival_gap_s: threshold of the arrival gap; None: the event doesn't use it.
    """
    if ttc_s is not None and meeting.ttc_s < ttc_s:
        return True
    if arrival_gap_s is None or meeting.in_corridor:
        return False
    return meeting.arrival_gap_s < arrival_gap_s


def is_observable(kind: Observable, meeting: Encounter, other: ObjectState) -> bool:
    """Tell whether the object's manoeuvre can be seen at this instant (METHOD 1).

    Args:
        kind: ``lateral``: lateral speed towards the VUT's corridor above 0.2 m/s, or the first step
            off the kerb; ``braking``: deceleration above 1 m/s^2 ahead of the VUT in its corridor;
            ``closing``: the VUT closes in on it in its corridor, with a TTC under 4 s.
        meeting: of the VUT and the object at this instant.
        other: the object's state.
    """
    if kind == "lateral":
        return meeting.towards_mps > OBSERVABLE_LATERAL_MPS
    if kind == "closing":
        return meeting.in_corridor and meeting.ttc_s < OBSERVABLE_CLOSING_S
    return meeting.in_corridor and other.acceleration_mps2 < -OBSERVABLE_BRAKING_MPS2
