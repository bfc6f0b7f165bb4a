"""Is a box, or a whole row of them, inside a geofence?"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ssp_core.geometry import Box, FloatArray, Point, point_in_polygon, points_in_polygon
from ssp_core.motion.state import Size

# A corner that touches the fence is inside, however its coordinates were rounded.
_ROUNDING_M = 1e-9


def corners_of(x_m: FloatArray, y_m: FloatArray, yaw_rad: FloatArray, size: Size) -> FloatArray:
    """Corners of an object at n poses of its reference point, shape (n, 4, 2), as Box.corners."""
    front, rear, half = size.front_m, -size.rear_m, size.width_m / 2.0
    local = np.array([[front, half], [rear, half], [rear, -half], [front, -half]])
    c, s = np.cos(yaw_rad)[:, None], np.sin(yaw_rad)[:, None]
    x = x_m[:, None] + c * local[:, 0] - s * local[:, 1]
    y = y_m[:, None] + s * local[:, 0] + c * local[:, 1]
    return np.stack((x, y), axis=-1)


def _to_outline_m(x_m: FloatArray, y_m: FloatArray, polygon: Sequence[Point]) -> FloatArray:
    """Smallest distance of n points to the outline of a polygon, shape (n,)."""
    nearest = np.full(len(x_m), np.inf)
    xa, ya = polygon[-1]
    for xb, yb in polygon:
        dx, dy = xb - xa, yb - ya
        px, py = x_m - xa, y_m - ya
        norm = dx * dx + dy * dy
        t = np.clip((px * dx + py * dy) / norm, 0.0, 1.0) if norm > 0.0 else 0.0
        ex, ey = px - t * dx, py - t * dy
        # minimum, other than fmin, keeps what is no number.
        nearest = np.minimum(nearest, ex * ex + ey * ey)
        xa, ya = xb, yb
    return np.asarray(np.sqrt(nearest))


def rooms_m(x_m: FloatArray, y_m: FloatArray, fence: Sequence[Point]) -> FloatArray:
    """As ``room_m`` for n points, shape (n,)."""
    distance = _to_outline_m(x_m, y_m, fence)
    return np.where(points_in_polygon(x_m, y_m, fence), distance, -distance)


def row_excess_m(
    x_m: FloatArray,
    y_m: FloatArray,
    yaw_rad: FloatArray,
    size: Size,
    fence: Sequence[Point],
) -> FloatArray:
    """As ``excess_m`` for an object at n poses of its reference point, shape (n,)."""
    reach_m = math.hypot(max(size.front_m, size.rear_m), 0.5 * size.width_m)
    # Written so that what can't be located is looked at.
    near = np.flatnonzero(~((rooms_m(x_m, y_m, fence) > reach_m) & np.isfinite(yaw_rad)))
    excess = np.zeros(len(x_m))
    if len(near):
        excess[near] = excess_m(corners_of(x_m[near], y_m[near], yaw_rad[near], size), fence)
    return excess


def excess_m(corners: FloatArray, fence: Sequence[Point]) -> FloatArray:
    """How far each box sticks out of the fence in m; 0 for a box that is inside.

    Counted are corners outside the fence and, for a fence with a notch, fence corners inside the
    box. A value that isn't finite gives infinity: what can't be located is not inside.

    Args:
        corners: shape (n, 4, 2), m, frame of the fence.
        fence: simple polygon, m.
    """
    finite = np.isfinite(corners).all(axis=(1, 2))
    excess = np.where(finite, 0.0, np.inf)
    good = np.flatnonzero(finite)
    x, y = corners[good].reshape(-1, 2).T
    depth = np.zeros(len(x))
    out = ~points_in_polygon(x, y, fence)
    if out.any():
        depth[out] = _to_outline_m(x[out], y[out], fence)
        depth[depth < _ROUNDING_M] = 0.0
    excess[good] = depth.reshape(-1, 4).max(axis=1)
    # Only a fence corner within a box's circumcircle can be inside that box.
    fx, fy = np.array(fence, dtype=np.float64).T
    centres = corners[good].mean(axis=1)
    radii = np.linalg.norm(corners[good] - centres[:, None, :], axis=-1).max(axis=1)
    reach = np.hypot(centres[:, :1] - fx, centres[:, 1:] - fy).min(axis=1)
    for i in good[(excess[good] == 0.0) & (reach < radii)]:
        box: list[Point] = [(x, y) for x, y in corners[i].tolist()]
        notch = points_in_polygon(fx, fy, box)
        if notch.any():
            excess[i] = float(_to_outline_m(fx[notch], fy[notch], box).max())
    return excess


def room_m(x_m: float, y_m: float, fence: Sequence[Point]) -> float:
    """Distance of a point inside a fence to its outline in m; negative for a point outside.

    Args:
        x_m: of the point, frame of the fence; NaN gives NaN.
        fence: simple polygon, m.
    """
    nearest = math.inf
    xa, ya = fence[-1]
    for xb, yb in fence:
        dx, dy = xb - xa, yb - ya
        px, py = x_m - xa, y_m - ya
        norm = dx * dx + dy * dy
        t = (px * dx + py * dy) / norm if norm > 0.0 else 0.0
        t = 0.0 if t < 0.0 else min(t, 1.0)
        ex, ey = px - t * dx, py - t * dy
        square = ex * ex + ey * ey
        if not square >= nearest:
            nearest = square
        xa, ya = xb, yb
    distance_m = math.sqrt(nearest)
    return distance_m if point_in_polygon(x_m, y_m, fence) else -distance_m


def box_excess_m(box: Box, fence: Sequence[Point]) -> float:
    """As ``excess_m`` for one box."""
    # Most boxes are far from the outline; what follows is for the few that aren't.
    reach_m = math.hypot(max(box.front_m, box.rear_m), 0.5 * box.width_m)
    pose = box.pose
    if not math.isfinite(pose.yaw_rad):
        return math.inf
    if room_m(pose.x_m, pose.y_m, fence) > reach_m:
        return 0.0
    return float(excess_m(np.array([box.corners()]), fence)[0])
