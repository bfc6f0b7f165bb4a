"""What a camera on the VUT can see of a box, with other boxes in the way.

Occlusion is looked at along straight lines from the eye to points on the box: in the plane the line
is cut with the outline of each other box, and it is blocked where it runs lower than that box is
high. Wheels, windows and rounded corners don't exist here, and nothing hides itself.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from ssp_core.geometry import FloatArray
from ssp_core.motion.state import ObjectState

# Heights at which points are taken, as shares of the box's height: feet, middle, head.
_HEIGHTS = (0.1, 0.5, 0.9)
# A box counts as seen when this share of its points is.
MIN_SHARE = 0.25


def surface_points(state: ObjectState) -> FloatArray:
    """Points all round a box in map, shape (24, 3): corners and middles of sides, at 3 heights."""
    corners = np.array(state.box.corners())
    ring = np.concatenate([corners, (corners + np.roll(corners, -1, axis=0)) / 2.0])
    rows = [np.column_stack([ring, np.full(len(ring), h * state.size.height_m)]) for h in _HEIGHTS]
    return np.concatenate(rows)


def blocked(
    eye_m: FloatArray, points_m: FloatArray, others: Iterable[ObjectState]
) -> NDArray[np.bool_]:
    """Which points can't be seen from the eye because a box stands in the way.

    Args:
        eye_m: shape (3,), map.
        points_m: shape (n, 3), map.
        others: boxes that may hide something; neither the one with the eye nor the one looked at.

    Returns:
        Shape (n,).
    """
    hidden = np.zeros(len(points_m), dtype=np.bool_)
    for other in others:
        hidden |= _behind(eye_m, points_m, other)
    return hidden


def _behind(eye_m: FloatArray, points_m: FloatArray, box: ObjectState) -> NDArray[np.bool_]:
    c, s = np.cos(box.yaw_rad), np.sin(box.yaw_rad)
    rotation = np.array([[c, s], [-s, c]])
    centre = np.array([box.x_m, box.y_m])
    start = rotation @ (eye_m[:2] - centre)
    step = (points_m[:, :2] - centre) @ rotation.T - start
    low = np.array([-box.size.rear_m, -box.size.width_m / 2.0])
    high = np.array([box.size.front_m, box.size.width_m / 2.0])
    with np.errstate(divide="ignore", invalid="ignore"):
        a, b = (low - start) / step, (high - start) / step
    # Along an axis in which the line doesn't move it is inside all the way, or never.
    inside = (low <= start) & (start <= high)
    enter = np.where(step != 0.0, np.minimum(a, b), np.where(inside, -np.inf, np.inf))
    leave = np.where(step != 0.0, np.maximum(a, b), np.where(inside, np.inf, -np.inf))
    first = np.maximum(enter.max(axis=1), 0.0)
    last = np.minimum(leave.min(axis=1), 1.0)
    crosses = first < last
    rise = points_m[:, 2] - eye_m[2]
    heights = np.minimum(
        eye_m[2] + rise * np.where(crosses, first, 0.0),
        eye_m[2] + rise * np.where(crosses, last, 0.0),
    )
    return np.asarray(crosses & (heights < box.size.height_m), dtype=np.bool_)


def clear_share(eye_m: FloatArray, state: ObjectState, others: Iterable[ObjectState]) -> float:
    """Share of a box's points that no other box hides from the eye, whatever the camera's field."""
    return float(1.0 - blocked(eye_m, surface_points(state), others).mean())
