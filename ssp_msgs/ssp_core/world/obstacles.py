"""The obstacles on the VUT's path, as its built-in driver sees them, without a world around it.

The driver uses them in every step; the compiler uses them to foresee what the driver will do.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ssp_core.geometry import Polyline, wrap_angle
from ssp_core.motion.encounter import corridor_half_m, is_crossing
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import Driver
from ssp_core.value_class import value_class
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.car_following import earliest_arrival_s

_VULNERABLE = frozenset({ObjectClass.PEDESTRIAN, ObjectClass.CYCLIST})

# Two passages of the same place count as meeting when they are closer in time than this.
_MEETING_MARGIN_S = 1.0
# Speed below which the time that the VUT needs past a place isn't stretched further.
_MIN_PASSING_MPS = 1.0
# Sideways speed below which somebody beside the corridor isn't on the way into it.
_STEPPING_MPS = 0.2
# A vehicle that drives across the VUT's path faster than this crosses it.
_CROSSING_MPS = 0.5
_MIN_GAP_M = 0.1


@value_class(frozen=True, slots=True)
class Obstacle:
    """Something to keep a gap to.

    Args:
        gap_m: from the VUT's front to it along the path, > 0.
        speed_mps: along the path.
        acceleration_mps2: along the path.
    """

    object_id: str
    gap_m: float
    speed_mps: float
    acceleration_mps2: float


@value_class(frozen=True, slots=True)
class _Extent:
    """An object in the path's frame: interval along and across, and velocity."""

    rear_m: float
    front_m: float
    right_m: float
    left_m: float
    along_mps: float
    across_mps: float


def _extent(state: ObjectState, path: Polyline, place: tuple[float, float]) -> _Extent:
    """Return the extent about the reference point's projection; the path is straight there."""
    station, offset = place
    pose = path.pose(station)
    if station <= 0.0 or station >= path.length_m:
        # Beyond an end the path goes on straight.
        along, offset = pose.to_local(state.x_m, state.y_m)
        station += along
    turn = wrap_angle(state.yaw_rad - pose.yaw_rad)
    c, s = math.cos(turn), math.sin(turn)
    half, size = state.size.width_m / 2.0, state.size
    # Of a rectangle, the extremes along a direction are its middle and half its projected sides.
    ahead, behind = size.front_m, -size.rear_m
    along = abs(s) * half
    across = abs(c) * half
    return _Extent(
        station + min(c * ahead, c * behind) - along,
        station + max(c * ahead, c * behind) + along,
        offset + min(s * ahead, s * behind) - across,
        offset + max(s * ahead, s * behind) + across,
        state.speed_mps * c,
        state.speed_mps * s,
    )


def _is_beside(
    other: ObjectState, path: Polyline, place: tuple[float, float], half_m: float
) -> bool:
    """Tell whether an object is so far beside the path that no corner is in the corridor."""
    station, offset = place
    return 0.0 < station < path.length_m and abs(offset) > half_m + other.size.reach_m


def _heads_across(vut: ObjectState, other: ObjectState) -> bool:
    """Tell whether an object drives across the VUT's heading."""
    turn = wrap_angle(other.yaw_rad - vut.yaw_rad)
    return other.speed_mps > _CROSSING_MPS and is_crossing(turn)


def _occupied_s(other: _Extent, half_m: float) -> tuple[float, float] | None:
    """Find from when to when (s from now) an extent is within half_m of the path.

    None for never.
    """
    if other.across_mps > _STEPPING_MPS:
        enter = (-half_m - other.left_m) / other.across_mps
        leave = (half_m - other.right_m) / other.across_mps
    elif other.across_mps < -_STEPPING_MPS:
        enter = (half_m - other.right_m) / other.across_mps
        leave = (-half_m - other.left_m) / other.across_mps
    elif other.left_m >= -half_m and other.right_m <= half_m:
        return 0.0, math.inf
    else:
        return None
    return (max(enter, 0.0), leave) if leave > 0.0 else None


def places_on(
    vut: ObjectState, others: Sequence[ObjectState], path: Polyline
) -> list[tuple[float, float]]:
    """Return station and offset of the VUT, then of all others."""
    return path.project_all([(vut.x_m, vut.y_m), *((o.x_m, o.y_m) for o in others)])


def find_obstacles(
    vut: ObjectState,
    others: Sequence[ObjectState],
    path: Polyline,
    driver: Driver,
    places: Sequence[tuple[float, float]] | None = None,
) -> list[Obstacle]:
    """Find everything ahead in the VUT's corridor, or predicted there when the VUT comes by.

    A vulnerable road user, or a vehicle that crosses, which is only predicted to be there is an
    obstacle that stands, so that the VUT stops before the place where it crosses.

    Args:
        vut: in frame map, as all others and the path.
        others: all other objects.
        path: to be driven.
        driver: for its cruise speed and acceleration.
        places: station and offset of the VUT, then of the others, where they are known already.
    """
    places = places or places_on(vut, others, path)
    own = _extent(vut, path, places[0])
    half = corridor_half_m(vut.size.width_m)
    obstacles = []
    for other, place in zip(others, places[1:], strict=True):
        vulnerable = other.object_class in _VULNERABLE
        across = not vulnerable and _heads_across(vut, other)
        if not (vulnerable or across) and _is_beside(other, path, place, half):
            continue
        e = _extent(other, path, place)
        if e.front_m <= own.front_m:
            continue
        gap = e.rear_m - own.front_m
        if vulnerable or (across and abs(e.across_mps) > abs(e.along_mps)):
            if not _meets(vut, e, gap, half, driver):
                continue
            # Their motion along the path is no reason to close in on them while they cross.
            ahead = e.along_mps if abs(e.across_mps) <= _STEPPING_MPS else 0.0
        elif e.left_m < -half or e.right_m > half:
            continue
        else:
            ahead = e.along_mps
        speed_up = other.acceleration_mps2 if ahead > 0.0 else 0.0
        obstacles.append(Obstacle(other.object_id, max(gap, _MIN_GAP_M), ahead, speed_up))
    return obstacles


def _meets(vut: ObjectState, other: _Extent, gap_m: float, half_m: float, driver: Driver) -> bool:
    occupied = _occupied_s(other, half_m)
    if occupied is None:
        return False
    enter_s, leave_s = occupied
    speed = max(vut.speed_mps, 0.0)
    arrives_s = earliest_arrival_s(max(gap_m, 0.0), speed, driver)
    length = other.front_m - other.rear_m + vut.size.length_m
    passed_s = (max(gap_m, 0.0) + length) / max(speed, _MIN_PASSING_MPS)
    return enter_s < passed_s + _MEETING_MARGIN_S and leave_s > arrives_s - _MEETING_MARGIN_S
