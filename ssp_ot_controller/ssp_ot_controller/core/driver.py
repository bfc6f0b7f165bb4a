"""The VUT's built-in driver: keeps its path and speed, and reacts to what is in its way.

Steering is pure pursuit. Speed is the adaptive-cruise form of the Intelligent Driver Model: the
model's own acceleration, softened towards what constant-acceleration kinematics call for, so that
a short gap to a slightly slower vehicle gives moderate braking. Obstacles are vehicles whose box is
in the corridor, and people and cyclists who are in it or will be when the VUT comes by.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from ssp_core.geometry import Polyline, wrap_angle
from ssp_core.run_spec import Driver
from ssp_core.state import ObjectState
from ssp_core.vocab import ObjectClass
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
# Share of the softened acceleration in the mix.
_COOLNESS = 0.99


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


def _extent(state: ObjectState, path: Polyline) -> _Extent:
    """Extent about the projection of the reference point; the path counts as straight there."""
    station, offset = path.project(state.x_m, state.y_m)
    pose = path.pose(station)
    if station <= 0.0 or station >= path.length_m:
        # Beyond an end the path goes on straight.
        along, offset = pose.to_local(state.x_m, state.y_m)
        station += along
    turn = wrap_angle(state.yaw_rad - pose.yaw_rad)
    c, s = math.cos(turn), math.sin(turn)
    half, size = state.size.width_m / 2.0, state.size
    ends = [(x, y) for x in (size.front_m, -size.rear_m) for y in (half, -half)]
    stations = [station + c * x - s * y for x, y in ends]
    offsets = [offset + s * x + c * y for x, y in ends]
    return _Extent(
        min(stations),
        max(stations),
        min(offsets),
        max(offsets),
        state.speed_mps * c,
        state.speed_mps * s,
    )


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
    vut: ObjectState, others: Iterable[ObjectState], path: Polyline, driver: Driver
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
    own = _extent(vut, path)
    half = vut.size.width_m / 2.0 + CORRIDOR_MARGIN_M
    found = []
    for other in others:
        e = _extent(other, path)
        if e.front_m <= own.front_m:
            continue
        gap = e.rear_m - own.front_m
        if other.object_class in VULNERABLE:
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
    """Acceleration in m/s^2 with one obstacle ahead.

    IDM: a (1 - (v/v0)^4 - (s*/s)^2), s* = s0 + v T + v dv / (2 sqrt(a b)). CAH: the acceleration
    that just avoids a collision when the one ahead keeps its own. Of the two the milder counts,
    softened: CAH + b tanh((IDM - CAH) / b).
    """
    a, b = driver.acceleration_mps2, driver.comfortable_deceleration_mps2
    v, gap, ahead = speed_mps, obstacle.gap_m, obstacle.speed_mps
    closing = v - ahead
    wanted = driver.standstill_gap_m + v * driver.headway_s + v * closing / (2.0 * math.sqrt(a * b))
    idm = a * (1.0 - (v / driver.cruise_mps) ** 4 - (max(wanted, 0.0) / gap) ** 2)
    # The room that is left above the gap to keep at standstill.
    room = max(gap - driver.standstill_gap_m, _MIN_GAP_M)
    ahead_a = min(obstacle.acceleration_mps2, a)
    slower = max(ahead, 0.0)
    below = slower * slower - 2.0 * room * ahead_a
    if below > 0.0 and slower * closing <= -2.0 * room * ahead_a:
        cah = v * v * ahead_a / below
    else:
        cah = ahead_a - (closing * closing / (2.0 * room) if closing > 0.0 else 0.0)
    if idm >= cah:
        return idm
    return (1.0 - _COOLNESS) * idm + _COOLNESS * (cah + b * math.tanh((idm - cah) / b))


def steer(vut: ObjectState, path: Polyline) -> float:
    """Curvature in 1/m of pure pursuit: 2 y / L^2 to the path's point at a distance ahead."""
    station, _ = path.project(vut.x_m, vut.y_m)
    ahead = max(_MIN_LOOKAHEAD_M, _LOOKAHEAD_S * vut.speed_mps)
    target = path.pose(station + ahead)
    x, y = vut.pose.to_local(target.x_m, target.y_m)
    return 2.0 * y / max(x * x + y * y, 1e-6)


def drive(
    vut: ObjectState, others: Iterable[ObjectState], path: Polyline, driver: Driver, dt_s: float
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
    a, b = driver.acceleration_mps2, driver.comfortable_deceleration_mps2
    free = a * (1.0 - (v / driver.cruise_mps) ** 4)
    # A little above cruise speed the driver only eases off.
    wanted = max(min(free, (driver.cruise_mps - v) / dt_s), -b)
    station, _ = path.project(vut.x_m, vut.y_m)
    left = path.length_m - station
    if v * v / (2.0 * b) >= left - v * limits.acceleration_lag_s:
        wanted = min(wanted, -v * v / (2.0 * left) if left > 0.05 else -b)
    if driver.reacts:
        for obstacle in find_obstacles(vut, others, path, driver):
            wanted = min(wanted, follow(v, obstacle, driver))
    acceleration = min(max(wanted, -limits.deceleration_mps2), limits.acceleration_mps2)
    bound = limits.curvature_1pm
    return Command(acceleration, min(max(steer(vut, path), -bound), bound), vut.yaw_rad)
