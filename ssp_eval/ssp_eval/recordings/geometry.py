"""The place and motion of an object relative to the VUT, from which labels are proposed.

Everything is measured along a corridor's path. Along the one that the VUT drove, extended straight
at both ends, "ahead" and "beside" mean the same in a bend as on a straight road. Stations run along
the path, offsets are + to the left.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ssp_core.geometry import Pose2
from ssp_core.motion.corridor import Corridor
from ssp_core.motion.encounter import (
    AGAINST_RAD,
    OBSERVABLE_LATERAL_MPS,
    is_crossing,
)
from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import ObjectClass
from ssp_eval.recordings.sight import MIN_SHARE, clear_share

_EYE_HEIGHT_M = 1.45
# Seen from the VUT's front, an object this far to the side is beside it rather than ahead.
_BESIDE_RAD = math.radians(60.0)
# Below this speed an object is stationary.
STATIONARY_MPS = 0.3
_WALKER_STATIONARY_MPS = 0.15
# An object this near the middle of the VUT's path isn't leaving it yet.
_LEAVING_M = 0.5
# An object ahead that opens the gap faster pulls away from the VUT.
_RECEDING_MPS = 3.0


def position_word(corridor: Corridor, vut: ObjectState, other: ObjectState) -> str:
    """Return the position slot (METHOD 5.1): where an object is, seen from the VUT.

    Level with the VUT, or ahead but more than 60 degrees off its front: ``left`` or ``right``.
    Otherwise ahead or behind; ``front`` and ``rear`` where it reaches into the VUT's corridor,
    else the corner on whose side its middle lies.
    """
    extent = corridor.extent(other)
    front_m = corridor.front_m(vut)
    rear_m = front_m - vut.size.length_m
    side = "left" if extent.l_min_m + extent.l_max_m > 0 else "right"
    inside = corridor.overlaps(extent)
    if extent.s_max_m < rear_m:
        return "rear" if inside else f"rear_{side}"
    if inside:
        return "front"
    middle_m = (extent.s_min_m + extent.s_max_m) / 2.0 - front_m
    beside = abs(extent.l_min_m + extent.l_max_m) / 2.0 > middle_m * math.tan(_BESIDE_RAD)
    return side if extent.s_min_m <= front_m or beside else f"front_{side}"


def motion_word(corridor: Corridor, vut: ObjectState, other: ObjectState) -> str:
    """Return the motion slot (METHOD 5.1): how an object moves over the ground, in the VUT's frame.

    The direction of its velocity against the VUT's path decides between crossing (45 to 135
    degrees), oncoming, and the same direction. In the same direction, lateral speed above the
    threshold towards a path that it doesn't drive on yet is a cut-in, and away from one that it
    reached into a cut-out; an object ahead in the corridor that opens the gap fast is receding.
    """
    walker = other.object_class is ObjectClass.PEDESTRIAN
    standstill = _WALKER_STATIONARY_MPS if walker else STATIONARY_MPS
    if abs(other.speed_mps) < standstill:
        return "stationary"
    along_mps, left_mps = corridor.velocity(other)
    direction_rad = abs(math.atan2(left_mps, along_mps))
    if direction_rad > AGAINST_RAD:
        return "oncoming"
    if is_crossing(direction_rad):
        return "crossing_from_right" if left_mps > 0 else "crossing_from_left"
    extent = corridor.extent(other)
    offset_m = (extent.l_min_m + extent.l_max_m) / 2.0
    if abs(left_mps) > OBSERVABLE_LATERAL_MPS and not walker:
        inwards = left_mps * offset_m < 0
        if inwards:
            return "cutting_in_from_left" if offset_m > 0 else "cutting_in_from_right"
        if corridor.overlaps(extent) and abs(offset_m) >= _LEAVING_M:
            return "cutting_out"
    ahead = extent.s_min_m > corridor.front_m(vut)
    opening_mps = along_mps - corridor.velocity(vut)[0]
    if ahead and corridor.overlaps(extent) and opening_mps > _RECEDING_MPS:
        return "receding"
    return "same_direction"


def _eye(vut: ObjectState) -> Pose2:
    """Return the usual place of a forward camera: half-way to the front."""
    return Pose2(*vut.pose.to_parent(vut.size.front_m / 2.0, 0.0), vut.yaw_rad)


def is_hidden(vut: ObjectState, other: ObjectState, obstacles: Sequence[ObjectState]) -> bool:
    """Return True when obstacles leave less than a quarter of an object in the VUT camera's sight.

    Args:
        vut: state of the VUT.
        other: state of the object.
        obstacles: neither the VUT nor that object.
    """
    if not obstacles:
        return False
    eye = _eye(vut)
    eye_m = np.array([eye.x_m, eye.y_m, _EYE_HEIGHT_M])
    return clear_share(eye_m, other, obstacles) < MIN_SHARE


def in_view(vut: ObjectState, other: ObjectState, hfov_rad: float, range_m: float) -> bool:
    """Return True when some corner of an object lies in the forward camera's field and range.

    Occlusion by others is another question: is_hidden.
    """
    eye = _eye(vut)
    for x_m, y_m in [*other.box.corners(), (other.x_m, other.y_m)]:
        ahead_m, left_m = eye.to_local(x_m, y_m)
        inside = ahead_m > 0 and abs(math.atan2(left_m, ahead_m)) <= hfov_rad / 2.0
        if inside and math.hypot(ahead_m, left_m) <= range_m:
            return True
    return False
