"""References that no object may take: one that is long over, one that leads out of the fence.

Both are sound otherwise, so that they are refused for the reason that is tested and no other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline, point_in_polygon
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.motion.reference import Reference, sample
from ssp_core.motion.state import ObjectState

# How long ago a stale reference was dispatched, and how long ago it expired.
AGE_S = 3.0
EXPIRED_S = 1.0
# A reference that is to be refused for its path comes early enough not to be late.
LEAD_S = 1.0
VALID_S = 3.0
# As far past the fence as no localisation noise could explain.
BEYOND_M = 5.0
# What a standing object is told to do.
_WALK_MPS = 1.4
_ACCELERATION_MPS2 = 1.0
_STRIDE_M = 0.5
_MAX_REACH_M = 2000.0


def stale(
    reference_id: str,
    state: ObjectState,
    current: Reference | None,
    event_version: str,
    now_ns: int,
) -> Reference:
    """The object's own reference once more, or a walk straight ahead, expired a second ago.

    Args:
        reference_id: of the new reference.
        state: of the object.
        current: its newest reference from the manager, None before the first.
        event_version: K* version of the run.
        now_ns: session time.
    """
    points = current.points if current is not None else None
    if points is None:
        path = _ahead(state.x_m, state.y_m, state.yaw_rad, 10.0)
        points = tuple(drive_along(path, 0.0, 0.0, _WALK_MPS, _ACCELERATION_MPS2, 1.0))
    execute_ns = now_ns - seconds_to_ns(AGE_S)
    return Reference(
        reference_id=reference_id,
        object_id=state.object_id,
        event_version=event_version,
        purpose="adapted",
        dispatched_ns=execute_ns,
        execute_at_ns=execute_ns,
        expires_at_ns=now_ns - seconds_to_ns(EXPIRED_S),
        points=points,
    )


def out_of_fence(
    reference_id: str,
    state: ObjectState,
    current: Reference | None,
    event_version: str,
    now_ns: int,
    fence: Sequence[tuple[float, float]],
) -> Reference:
    """From where the object will be straight ahead until it is outside the fence, and a stop there.

    Args: as for ``stale``, and the fence, m, frame map.
    """
    execute_ns = now_ns + seconds_to_ns(LEAD_S)
    if current is not None:
        start = sample(current, execute_ns)
        x, y, yaw, speed = start.x_m, start.y_m, start.yaw_rad, start.speed_mps
    else:
        x, y, yaw, speed = state.x_m, state.y_m, state.yaw_rad, state.speed_mps
    reach = _reach_m(x, y, yaw, fence) + BEYOND_M
    cruise = max(speed, _WALK_MPS)
    braking = max(1.0, cruise**2 / reach)
    path = _ahead(x, y, yaw, reach)
    points = list(drive_along(path, 0.0, speed, cruise, _ACCELERATION_MPS2, braking))
    return Reference(
        reference_id=reference_id,
        object_id=state.object_id,
        event_version=event_version,
        purpose="adapted",
        dispatched_ns=now_ns,
        execute_at_ns=execute_ns,
        expires_at_ns=execute_ns + seconds_to_ns(VALID_S),
        points=tuple(points),
    )


def _ahead(x_m: float, y_m: float, yaw_rad: float, length_m: float) -> Polyline:
    count = max(2, math.ceil(length_m / _STRIDE_M) + 1)
    step = length_m / (count - 1)
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    return Polyline([(x_m + c * step * i, y_m + s * step * i) for i in range(count)])


def _reach_m(x_m: float, y_m: float, yaw_rad: float, fence: Sequence[tuple[float, float]]) -> float:
    """How far straight ahead the fence is, m."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)
    reach = 0.0
    while reach < _MAX_REACH_M and point_in_polygon(x_m + c * reach, y_m + s * reach, fence):
        reach += _STRIDE_M
    return reach
