"""The VUT's built-in driver: keeps its path and speed, and reacts to what is in its way.

Steering is pure pursuit. Speed is the adaptive-cruise form of the Intelligent Driver Model: the
model's own acceleration, softened towards what constant-acceleration kinematics call for, so that
a short gap to a slightly slower vehicle gives moderate braking. Obstacles are vehicles whose box is
in the corridor, and people and cyclists who are in it or will be when the VUT comes by.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.geometry import Polyline, wrap_angle
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import Driver
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.car_following import following_acceleration, free_acceleration
from ssp_ot_controller.core.bodies import LIMITS, Command

VULNERABLE = frozenset({ObjectClass.PEDESTRIAN, ObjectClass.CYCLIST})

# METHOD 1: a corridor is the vehicle's width plus this on each side.
CORRIDOR_MARGIN_M = 0.3
# Two passages of the same place count as meeting when they are closer in time than this.
_MEETING_MARGIN_S = 1.0
# Speed below which the time that the VUT needs past a place isn't stretched further.
_MIN_PASSING_MPS = 1.0
# Sideways speed below which somebody beside the corridor isn't on the way into it.
_STEPPING_MPS = 0.2
_LOOKAHEAD_S = 0.6
_MIN_LOOKAHEAD_M = 4.0
_MIN_GAP_M = 0.1


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Something to keep a gap to.

    Args:
        object_id: whose it is; empty for the path's end.
        gap_m: from the VUT's front to it along the path, > 0.
        speed_mps: along the path.
        acceleration_mps2: along the path.
    """

    object_id: str
    gap_m: float
    speed_mps: float
    acceleration_mps2: float


@dataclass(frozen=True, slots=True)
class _Extent:
    """An object in the path's frame: interval along and across, and velocity."""

    rear_m: float
    front_m: float
    right_m: float
    left_m: float
    along_mps: float
    across_mps: float


def _extent(state: ObjectState, path: Polyline, place: tuple[float, float]) -> _Extent:
    """Extent about the projection of the reference point; the path counts as straight there."""
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
    """True when an object is so far beside the path that none of its corners is in the corridor."""
    station, offset = place
    size = other.size
    reach = max(size.front_m, size.rear_m) + 0.5 * size.width_m
    return 0.0 < station < path.length_m and abs(offset) > half_m + reach


def _occupied_s(other: _Extent, half_m: float) -> tuple[float, float] | None:
    """From when to when (s from now) an extent is within half_m of the path; None for never."""
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


def _arrival_s(gap_m: float, speed_mps: float, driver: Driver) -> float:
    """Earliest arrival: accelerating as the driver would, up to cruise speed."""
    a, v0 = driver.acceleration_mps2, speed_mps
    top = max(driver.cruise_mps, v0)
    t_top = (top - v0) / a
    s_top = 0.5 * (v0 + top) * t_top
    if gap_m <= s_top:
        return (math.sqrt(v0 * v0 + 2.0 * a * gap_m) - v0) / a
    return t_top + (gap_m - s_top) / top


def find_obstacles(
    vut: ObjectState, others: Sequence[ObjectState], path: Polyline, driver: Driver
) -> list[Obstacle]:
    """Everything ahead in the VUT's corridor, or predicted to be there when the VUT comes by.

    A vulnerable road user who is only predicted to be there is an obstacle that stands, so that
    the VUT stops before the place where they cross.

    Args:
        vut: the VUT.
        others: all other objects.
        path: of the VUT, frame map.
        driver: for its cruise speed and acceleration.
    """
    return _find_obstacles(vut, others, path, driver, _places(vut, others, path))


def _places(
    vut: ObjectState, others: Sequence[ObjectState], path: Polyline
) -> list[tuple[float, float]]:
    """Station and offset of the VUT, then of everybody else."""
    return path.project_all([(vut.x_m, vut.y_m), *((o.x_m, o.y_m) for o in others)])


def _find_obstacles(
    vut: ObjectState,
    others: Sequence[ObjectState],
    path: Polyline,
    driver: Driver,
    places: Sequence[tuple[float, float]],
) -> list[Obstacle]:
    own = _extent(vut, path, places[0])
    half = vut.size.width_m / 2.0 + CORRIDOR_MARGIN_M
    found = []
    for other, place in zip(others, places[1:], strict=True):
        vulnerable = other.object_class in VULNERABLE
        if not vulnerable and _is_beside(other, path, place, half):
            continue
        e = _extent(other, path, place)
        if e.front_m <= own.front_m:
            continue
        gap = e.rear_m - own.front_m
        if vulnerable:
            if not _meets(vut, e, gap, half, driver):
                continue
            # Their motion along the path is no reason to close in on them while they cross.
            ahead = e.along_mps if abs(e.across_mps) <= _STEPPING_MPS else 0.0
        elif e.left_m < -half or e.right_m > half:
            continue
        else:
            ahead = e.along_mps
        speed_up = other.acceleration_mps2 if ahead > 0.0 else 0.0
        found.append(Obstacle(other.object_id, max(gap, _MIN_GAP_M), ahead, speed_up))
    return found


def _meets(vut: ObjectState, other: _Extent, gap_m: float, half_m: float, driver: Driver) -> bool:
    occupied = _occupied_s(other, half_m)
    if occupied is None:
        return False
    enter_s, leave_s = occupied
    speed = max(vut.speed_mps, 0.0)
    arrives_s = _arrival_s(max(gap_m, 0.0), speed, driver)
    length = other.front_m - other.rear_m + vut.size.length_m
    passed_s = (max(gap_m, 0.0) + length) / max(speed, _MIN_PASSING_MPS)
    return enter_s < passed_s + _MEETING_MARGIN_S and leave_s > arrives_s - _MEETING_MARGIN_S


def follow(speed_mps: float, obstacle: Obstacle, driver: Driver) -> float:
    """Acceleration in m/s^2 with one obstacle ahead."""
    return following_acceleration(
        speed_mps, obstacle.gap_m, obstacle.speed_mps, obstacle.acceleration_mps2, driver
    )


def steer(vut: ObjectState, path: Polyline) -> float:
    """Curvature in 1/m of pure pursuit: 2 y / L^2 to the path's point at a distance ahead."""
    return _steer(vut, path, path.project(vut.x_m, vut.y_m)[0])


def _steer(vut: ObjectState, path: Polyline, station: float) -> float:
    ahead = max(_MIN_LOOKAHEAD_M, _LOOKAHEAD_S * vut.speed_mps)
    target = path.pose(station + ahead)
    x, y = vut.pose.to_local(target.x_m, target.y_m)
    return 2.0 * y / max(x * x + y * y, 1e-6)


def drive(
    vut: ObjectState, others: Sequence[ObjectState], path: Polyline, driver: Driver, dt_s: float
) -> Command:
    """The driver's command for the next step.

    The VUT accelerates to cruise speed, keeps its gap to obstacles if the driver reacts, and
    stands with its reference point at the path's end.

    Args:
        vut: state of the VUT.
        others: all other objects; their order doesn't matter.
        path: to be driven, frame map.
        driver: of the run.
        dt_s: time for which the command is held.
    """
    limits = LIMITS[vut.object_class]
    v = max(vut.speed_mps, 0.0)
    b = driver.comfortable_deceleration_mps2
    # A little above cruise speed the driver only eases off.
    wanted = max(min(free_acceleration(v, driver), (driver.cruise_mps - v) / dt_s), -b)
    places = _places(vut, others if driver.reacts else (), path)
    station = places[0][0]
    left = path.length_m - station
    if v * v / (2.0 * b) >= left - v * limits.acceleration_lag_s:
        wanted = min(wanted, -v * v / (2.0 * left) if left > 0.05 else -b)
    if driver.reacts:
        for obstacle in _find_obstacles(vut, others, path, driver, places):
            wanted = min(wanted, follow(v, obstacle, driver))
    acceleration = min(max(wanted, -limits.deceleration_mps2), limits.acceleration_mps2)
    bound = limits.curvature_1pm
    return Command(acceleration, min(max(_steer(vut, path, station), -bound), bound), vut.yaw_rad)
