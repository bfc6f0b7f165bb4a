"""Is a box, or a whole row of them, inside a geofence?"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ssp_core.geometry import Box, FloatArray
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


def _inside(points: FloatArray, polygon: FloatArray) -> NDArray[np.bool_]:
    """Even-odd rule for points of shape (k, 2)."""
    a, b = polygon, np.roll(polygon, -1, axis=0)
    px, py = points[:, None, 0], points[:, None, 1]
    spans = (a[:, 1] > py) != (b[:, 1] > py)
    rise = np.where(a[:, 1] == b[:, 1], 1.0, b[:, 1] - a[:, 1])
    left = px < a[:, 0] + (py - a[:, 1]) * (b[:, 0] - a[:, 0]) / rise
    inside: NDArray[np.bool_] = (spans & left).sum(axis=1) % 2 == 1
    return inside


def _distance_to_edges(points: FloatArray, polygon: FloatArray) -> FloatArray:
    """Smallest distance of points (k, 2) to the outline of a polygon, shape (k,)."""
    a, d = polygon, np.roll(polygon, -1, axis=0) - polygon
    rel = points[:, None, :] - a
    norm = np.maximum((d**2).sum(axis=-1), 1e-300)
    t = np.clip((rel * d).sum(axis=-1) / norm, 0.0, 1.0)
    distance: FloatArray = np.linalg.norm(rel - t[..., None] * d, axis=-1).min(axis=1)
    return distance


def rooms_m(x_m: FloatArray, y_m: FloatArray, fence: Sequence[tuple[float, float]]) -> FloatArray:
    """As ``room_m`` for n points, shape (n,)."""
    inside = np.zeros(len(x_m), dtype=np.bool_)
    nearest = np.full(len(x_m), np.inf)
    xa, ya = fence[-1]
    for xb, yb in fence:
        dx, dy = xb - xa, yb - ya
        px, py = x_m - xa, y_m - ya
        if dy != 0.0:
            spans = (y_m < yb) != (y_m < ya)
            inside ^= spans & (px < py * (dx / dy))
        norm = dx * dx + dy * dy
        t = np.clip((px * dx + py * dy) / norm, 0.0, 1.0) if norm > 0.0 else 0.0
        ex, ey = px - t * dx, py - t * dy
        # minimum, other than fmin, keeps what is no number.
        nearest = np.minimum(nearest, ex * ex + ey * ey)
        xa, ya = xb, yb
    distance = np.sqrt(nearest)
    rooms: FloatArray = np.where(inside, distance, -distance)
    return rooms


def row_excess_m(
    x_m: FloatArray,
    y_m: FloatArray,
    yaw_rad: FloatArray,
    size: Size,
    fence: Sequence[tuple[float, float]],
) -> FloatArray:
    """As ``excess_m`` for an object at n poses of its reference point, shape (n,)."""
    reach_m = math.hypot(max(size.front_m, size.rear_m), 0.5 * size.width_m)
    # Written so that what can't be located is looked at.
    near = np.flatnonzero(~((rooms_m(x_m, y_m, fence) > reach_m) & np.isfinite(yaw_rad)))
    excess = np.zeros(len(x_m))
    if len(near):
        excess[near] = excess_m(corners_of(x_m[near], y_m[near], yaw_rad[near], size), fence)
    return excess


def excess_m(corners: FloatArray, fence: Sequence[tuple[float, float]]) -> FloatArray:
    """How far each box sticks out of the fence in m; 0 for a box that is inside.

    Counted are corners outside the fence and, for a fence with a notch, fence corners inside the
    box. A value that isn't finite gives infinity: what can't be located is not inside.

    Args:
        corners: shape (n, 4, 2), m, frame of the fence.
        fence: simple polygon, m.
    """
    polygon = np.asarray(fence, dtype=np.float64)
    finite = np.isfinite(corners).all(axis=(1, 2))
    excess = np.where(finite, 0.0, np.inf)
    good = np.flatnonzero(finite)
    flat = corners[good].reshape(-1, 2)
    out = ~_inside(flat, polygon)
    depth = np.zeros(len(flat))
    if out.any():
        depth[out] = _distance_to_edges(flat[out], polygon)
        depth[depth < _ROUNDING_M] = 0.0
    excess[good] = depth.reshape(-1, 4).max(axis=1)
    # Only a fence corner within a box's circumcircle can be inside that box.
    centres = corners[good].mean(axis=1)
    radii = np.linalg.norm(corners[good] - centres[:, None, :], axis=-1).max(axis=1)
    reach = np.linalg.norm(centres[:, None, :] - polygon, axis=-1).min(axis=1)
    for i in good[(excess[good] == 0.0) & (reach < radii)]:
        notch = polygon[_inside(polygon, corners[i])]
        if len(notch):
            excess[i] = float(_distance_to_edges(notch, corners[i]).max())
    return excess


def room_m(x_m: float, y_m: float, fence: Sequence[tuple[float, float]]) -> float:
    """Distance of a point inside a fence to its outline in m; negative for a point outside.

    Args:
        x_m: of the point, frame of the fence; NaN gives NaN.
        y_m: of the point.
        fence: simple polygon, m.
    """
    inside, nearest = False, math.inf
    xa, ya = fence[-1]
    for xb, yb in fence:
        dx, dy = xb - xa, yb - ya
        px, py = x_m - xa, y_m - ya
        if (yb > y_m) != (ya > y_m) and px < dx * py / dy:
            inside = not inside
        norm = dx * dx + dy * dy
        t = (px * dx + py * dy) / norm if norm > 0.0 else 0.0
        t = 0.0 if t < 0.0 else min(t, 1.0)
        ex, ey = px - t * dx, py - t * dy
        square = ex * ex + ey * ey
        if not square >= nearest:
            nearest = square
        xa, ya = xb, yb
    return math.sqrt(nearest) if inside else -math.sqrt(nearest)


def box_excess_m(box: Box, fence: Sequence[tuple[float, float]]) -> float:
    """As ``excess_m`` for one box."""
    # Most boxes are far from the outline; what follows is for the few that aren't.
    reach_m = math.hypot(max(box.front_m, box.rear_m), 0.5 * box.width_m)
    pose = box.pose
    if not math.isfinite(pose.yaw_rad):
        return math.inf
    if room_m(pose.x_m, pose.y_m, fence) > reach_m:
        return 0.0
    return float(excess_m(np.array([box.corners()]), fence)[0])
