"""References that no object may take: one that is long over, one that leads out of the fence.

Both are sound otherwise, so that they are refused for the reason that is tested and no other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline, Pose2
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
_WALK_M = 10.0
_ACCELERATION_MPS2 = 1.0
_STRIDE_M = 0.5


def stale(
    reference_id: str,
    state: ObjectState,
    current: Reference | None,
    event_version: str,
    now_ns: int,
) -> Reference:
    """Return the object's own reference once more, or a walk straight ahead, expired a second ago.

    Args:
        reference_id: of the new reference.
        state: the object's newest.
        current: its newest reference from the manager, None before the first.
        event_version: of the run.
        now_ns: session time.
    """
    if current is not None:
        points = current.points
    else:
        path = _ahead(state.pose, _WALK_M)
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
    """Make a reference from the object's next place straight to beyond the fence, with a stop.

    Args:
        reference_id: of the new reference.
        state: the object's newest.
        current: its newest reference from the manager, None before the first.
        event_version: of the run.
        now_ns: session time.
        fence: corners, m, frame map.
    """
    execute_ns = now_ns + seconds_to_ns(LEAD_S)
    here = state if current is None else sample(current, execute_ns)
    # Whoever is farther away than its farthest corner is outside.
    reach_m = max(math.dist((here.x_m, here.y_m), corner) for corner in fence) + BEYOND_M
    cruise_mps = max(here.speed_mps, _WALK_MPS)
    path = _ahead(Pose2(here.x_m, here.y_m, here.yaw_rad), reach_m)
    braking_mps2 = max(1.0, cruise_mps**2 / reach_m)
    speeds = here.speed_mps, cruise_mps, _ACCELERATION_MPS2, braking_mps2
    return Reference(
        reference_id=reference_id,
        object_id=state.object_id,
        event_version=event_version,
        purpose="adapted",
        dispatched_ns=now_ns,
        execute_at_ns=execute_ns,
        expires_at_ns=execute_ns + seconds_to_ns(VALID_S),
        points=tuple(drive_along(path, 0.0, *speeds)),
    )


def _ahead(start: Pose2, length_m: float) -> Polyline:
    count = max(2, math.ceil(length_m / _STRIDE_M) + 1)
    return Polyline([start.to_parent(length_m * i / (count - 1), 0.0) for i in range(count)])
