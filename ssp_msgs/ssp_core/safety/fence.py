"""Is a box inside a geofence, and so is all that it sweeps on its way?

A box is inside if its centre is, and no edge of the fence crosses it. On the way from one pose to
the next, straight in place and evenly in yaw, no corner of the fence may come into it either, and
its centre crosses no edge. Touching is inside.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ssp_core.geometry import (
    Box,
    FloatArray,
    Point,
    Pose2,
    point_in_polygon,
    points_in_polygon,
    wrap_angle,
    wrap_angles,
)
from ssp_core.motion.state import Size

# A corner that touches the fence is inside, however its coordinates were rounded.
_ROUNDING_M = 1e-9
# A way that turns by more is taken in parts, in which corners of the fence move nearly straight in
# the frame of the box: to 2 mm.
_TURN_RAD = 0.02
# From so many corners on arrays are quicker for a single box.
_MANY_CORNERS = 512


def _to_outline_m(x_m: FloatArray, y_m: FloatArray, polygon: Sequence[Point]) -> FloatArray:
    """Return the smallest distance of n points to the outline of a polygon, shape (n,)."""
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
    """Compute ``room_m`` for n points, shape (n,)."""
    distance = _to_outline_m(x_m, y_m, fence)
    return np.where(points_in_polygon(x_m, y_m, fence), distance, -distance)


def room_m(x_m: float, y_m: float, fence: Sequence[Point]) -> float:
    """Return the distance of a point in a fence to its outline in m; negative for one outside.

    Args:
        x_m: of the point, frame of the fence; NaN gives NaN.
        y_m: see x_m.
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


class KnownRoom:
    """The room around the place in a fence that was measured last.

    Places of an object follow each other by a few centimetres, and nearly all lie far from the
    outline: what lies within the known room needs no look at the outline.
    """

    def __init__(self, fence: Sequence[Point]) -> None:
        self._fence = fence
        self._x_m = self._y_m = 0.0
        self._room_m = -math.inf

    def holds(self, x_m: float, y_m: float, radius_m: float) -> bool:
        """Tell whether a circle is known to lie inside; False: the outline has to be looked at."""
        away_m = math.hypot(x_m - self._x_m, y_m - self._y_m)
        if away_m + radius_m < self._room_m:
            return True
        if math.isfinite(self._room_m) and radius_m >= self._room_m + away_m:
            # The room changes by the way at most, so that this place can't have enough of it.
            return False
        self._x_m, self._y_m = x_m, y_m
        self._room_m = room_m(x_m, y_m, self._fence)
        return radius_m < self._room_m


def way_room_m(start: Point, end: Point, fence: Sequence[Point]) -> float:
    """Return the distance of a straight way inside a fence to its outline in m.

    It is at most 0 for another way.

    Args:
        start: of the way, m, frame of the fence; one without a number gives no room.
        end: of the way.
        fence: legal outline, m.
    """
    one_m, other_m = room_m(*start, fence), room_m(*end, fence)
    if not (one_m > 0.0 and other_m > 0.0):
        return -math.inf
    room = min(one_m, other_m)
    dx, dy = end[0] - start[0], end[1] - start[1]
    square = dx * dx + dy * dy
    if square == 0.0:
        return room
    length = math.sqrt(square)
    # Of two that don't cross, one has an end where they are nearest.
    px, py = fence[-1][0] - start[0], fence[-1][1] - start[1]
    ua, va = (dx * px + dy * py) / length, (dx * py - dy * px) / length
    for x, y in fence:
        px, py = x - start[0], y - start[1]
        ub, vb = (dx * px + dy * py) / length, (dx * py - dy * px) / length
        room = min(room, math.hypot(max(-ub, 0.0, ub - length), vb))
        if (va > 0.0) != (vb > 0.0) and 0.0 <= ua + va * (ub - ua) / (va - vb) <= length:
            return 0.0
        ua, va = ub, vb
    return room


def lies_inside(inner: Sequence[Point], fence: Sequence[Point]) -> bool:
    """Tell whether all of a polygon lies inside a fence; touching is inside.

    Args:
        inner: legal outline, m, frame of the fence.
        fence: simple polygon, m.
    """
    import shapely  # type: ignore[import-untyped]  # slow to import, no types

    return bool(shapely.Polygon(fence).covers(shapely.Polygon(inner)))


def box_excess_m(box: Box, fence: Sequence[Point]) -> float:
    """Compute ``way_excess_m`` for one box where it is."""
    if _is_inside(box, fence):
        return 0.0
    pose, size = box.pose, Size(box.front_m, box.rear_m, box.width_m, 0.0)
    x, y, yaw = (np.array([v]) for v in (pose.x_m, pose.y_m, pose.yaw_rad))
    return float(way_excess_m(x, y, yaw, size, fence)[0])


def moved_excess_m(before: Pose2, box: Box, fence: Sequence[Point]) -> float:
    """Compute ``way_excess_m`` for one box that came from another pose."""
    pose = box.pose
    moved_m = math.hypot(pose.x_m - before.x_m, pose.y_m - before.y_m)
    moved_m += abs(wrap_angle(pose.yaw_rad - before.yaw_rad)) * box.reach_m
    swept = Box(pose, box.front_m + moved_m, box.rear_m + moved_m, box.width_m + 2.0 * moved_m)
    if _is_inside(swept, fence):
        return 0.0
    size = Size(box.front_m, box.rear_m, box.width_m, 0.0)
    x, y, yaw = np.array([(p.x_m, p.y_m, p.yaw_rad) for p in (before, pose)]).T
    return float(way_excess_m(x, y, yaw, size, fence)[1])


# Long fences as arrays, by the place of each in memory, with what stood there.
_SEEN: dict[int, tuple[Sequence[Point], FloatArray]] = {}
_MOST_SEEN = 8


def _corners(fence: Sequence[Point]) -> FloatArray:
    """Return a fence as an array, shape (n, 2), made once as long as the fence stays the same."""
    entry = _SEEN.get(id(fence))
    # The comparison is quick: corners that stayed are the same objects.
    if entry is None or entry[0] != fence:
        if len(_SEEN) >= _MOST_SEEN:
            _SEEN.clear()
        entry = fence[:], np.array(fence, dtype=np.float64)
        _SEEN[id(fence)] = entry
    return entry[1]


def _is_inside(box: Box, fence: Sequence[Point]) -> bool:
    """Tell whether a box is inside; both ways do the same arithmetic."""
    if len(fence) >= _MANY_CORNERS:
        return _is_inside_many(box, _corners(fence))
    return _is_inside_few(box, fence)


def _is_inside_many(box: Box, corners: FloatArray) -> bool:
    """Tell what ``_is_inside_few`` tells, with arrays.

    Args:
        box: of the object, frame of the fence.
        corners: of the fence, shape (n, 2).
    """
    pose = box.pose
    if not math.isfinite(pose.x_m + pose.y_m + pose.yaw_rad):
        return False
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    half_x, half_y = 0.5 * (box.front_m + box.rear_m), 0.5 * box.width_m
    ahead_m = 0.5 * (box.front_m - box.rear_m)
    dx, dy = corners[:, 0] - (pose.x_m + c * ahead_m), corners[:, 1] - (pose.y_m + s * ahead_m)
    xb, yb = c * dx + s * dy, c * dy - s * dx
    xa, ya = np.roll(xb, 1), np.roll(yb, 1)
    beyond = (np.minimum(xa, xb) >= half_x) | (np.maximum(xa, xb) <= -half_x)
    beyond |= (np.minimum(ya, yb) >= half_y) | (np.maximum(ya, yb) <= -half_y)
    for i in np.flatnonzero(~beyond).tolist():
        edge = float(xa[i]), float(ya[i]), float(xb[i]), float(yb[i])
        if _enters(*edge, half_x - _ROUNDING_M, half_y - _ROUNDING_M):
            return False
    over = np.flatnonzero((ya > 0.0) != (yb > 0.0))
    xa, ya, xb, yb = xa[over], ya[over], xb[over], yb[over]
    return bool(np.count_nonzero(xa + ya * (xb - xa) / (ya - yb) > 0.0) % 2)


def _is_inside_few(box: Box, fence: Sequence[Point]) -> bool:
    """Tell whether a box is inside, edge by edge: with few edges quicker than with arrays."""
    pose = box.pose
    if not math.isfinite(pose.x_m + pose.y_m + pose.yaw_rad):
        return False
    c, s = math.cos(pose.yaw_rad), math.sin(pose.yaw_rad)
    half_x, half_y = 0.5 * (box.front_m + box.rear_m), 0.5 * box.width_m
    ahead_m = 0.5 * (box.front_m - box.rear_m)
    x, y = pose.x_m + c * ahead_m, pose.y_m + s * ahead_m
    inside = False
    dx, dy = fence[-1][0] - x, fence[-1][1] - y
    xa, ya = c * dx + s * dy, c * dy - s * dx
    for px, py in fence:
        dx, dy = px - x, py - y
        xb, yb = c * dx + s * dy, c * dy - s * dx
        beyond = (
            (xa >= half_x and xb >= half_x)
            or (xa <= -half_x and xb <= -half_x)
            or (ya >= half_y and yb >= half_y)
            or (ya <= -half_y and yb <= -half_y)
        )
        if not beyond and _enters(xa, ya, xb, yb, half_x - _ROUNDING_M, half_y - _ROUNDING_M):
            return False
        if (ya > 0.0) != (yb > 0.0) and xa + ya * (xb - xa) / (ya - yb) > 0.0:
            inside = not inside
        xa, ya = xb, yb
    return inside


def _enters(xa: float, ya: float, xb: float, yb: float, half_x: float, half_y: float) -> bool:
    """Tell whether some of a segment lies within a rectangle around the origin."""
    first, last = 0.0, 1.0
    for at, step, half in ((xa, xb - xa, half_x), (ya, yb - ya, half_y)):
        if step == 0.0:
            if abs(at) >= half:
                return False
            continue
        one, other = (-half - at) / step, (half - at) / step
        first, last = max(first, min(one, other)), min(last, max(one, other))
    return first < last


def way_excess_m(
    x_m: FloatArray,
    y_m: FloatArray,
    yaw_rad: FloatArray,
    size: Size,
    fence: Sequence[Point],
) -> FloatArray:
    """Compute how far a box sticks out of the fence on its way to each pose, m; 0 for inside.

    What sticks out is the farthest corner of the box outside the fence, or the deepest place of the
    fence's outline inside the box. A value that isn't finite gives infinity, there and on the way
    to the next pose: what can't be located is not inside.

    Args:
        x_m: of the reference point, frame of the fence, shape (..., n): a way along the last axis.
        y_m: the same shape.
        yaw_rad: the same shape.
        size: of the box.
        fence: legal outline (``ssp_core.geometry.outline_problem``), m.

    Returns:
        The same shape: of the first pose of a way at that pose, of each other with all between it
        and the one before.
    """
    poses = np.stack((x_m, y_m, yaw_rad), axis=-1).astype(np.float64)
    before = np.concatenate((poses[..., :1, :], poses[..., :-1, :]), axis=-2).reshape(-1, 3)
    after = poses.reshape(-1, 3)
    finite = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    excess = np.where(finite, 0.0, np.inf)
    before, after = before[finite], after[finite]
    moved = np.hypot(*(after - before)[:, :2].T)
    rooms = rooms_m(after[:, 0], after[:, 1], fence)
    near = rooms <= size.reach_m + moved
    if near.any():
        which, starts, ends = _parts(before[near], after[near])
        parts = _excess_m(starts, ends, size, fence)
        np.maximum.at(excess, np.flatnonzero(finite)[near][which], parts)
    return excess.reshape(np.shape(x_m))


def _parts(
    before: FloatArray, after: FloatArray
) -> tuple[NDArray[np.intp], FloatArray, FloatArray]:
    """Cut ways between poses into parts that turn little: of which way each is, start, end."""
    step = after - before
    step[:, 2] = wrap_angles(step[:, 2])
    counts = np.maximum(np.ceil(np.abs(step[:, 2]) / _TURN_RAD), 1.0).astype(np.intp)
    which = np.repeat(np.arange(len(before)), counts)
    part_index = np.arange(len(which)) - np.repeat(np.cumsum(counts) - counts, counts)
    share = 1.0 / counts[which][:, None]
    starts = before[which] + step[which] * (part_index[:, None] * share)
    # A part that ends where its way does ends there to the last bit.
    last = (part_index + 1 == counts[which])[:, None]
    ends = np.where(
        last, after[which], before[which] + step[which] * ((part_index[:, None] + 1) * share)
    )
    return which, starts, ends


def _excess_m(
    before: FloatArray, after: FloatArray, size: Size, fence: Sequence[Point]
) -> FloatArray:
    """Compute the excess of n ways between two finite poses, shape (n, 3) each."""
    half_x, half_y = 0.5 * (size.front_m + size.rear_m), 0.5 * size.width_m
    corners = np.array([fence[-1], *fence], dtype=np.float64)
    there, here = (_in_box(poses, size, corners) for poses in (before, after))
    deepest = np.zeros(len(after))
    for start, end in ((here[:, :-1], here[:, 1:]), (there[:, 1:], here[:, 1:])):
        np.maximum(deepest, _deepest_m(start, end, half_x, half_y), out=deepest)
    # The centre, which lies in the origin, went to the other side of an edge.
    jumped = np.flatnonzero((np.abs(there - here) > min(half_x, half_y)).any(axis=(1, 2)))
    if len(jumped):
        crossed = _centre_crosses(there[jumped], here[jumped])
        deepest[jumped[crossed]] = np.maximum(deepest[jumped[crossed]], min(half_x, half_y))
    x, y = _points_of(after, size, [(0.0, 0.0)]).reshape(-1, 2).T
    inside = points_in_polygon(x, y, fence)
    out = np.flatnonzero(~inside | (deepest > _ROUNDING_M))
    excess = np.zeros(len(after))
    if len(out):
        at = [(a * half_x, b * half_y) for a in (1.0, -1.0) for b in (1.0, -1.0)]
        x, y = _points_of(after[out], size, at).reshape(-1, 2).T
        depth = np.where(points_in_polygon(x, y, fence), 0.0, _to_outline_m(x, y, fence))
        excess[out] = np.maximum(deepest[out], depth.reshape(-1, 4).max(axis=1))
    excess[excess <= _ROUNDING_M] = 0.0
    return excess


def _points_of(poses: FloatArray, size: Size, at: Sequence[Point]) -> FloatArray:
    """Move points given ahead and to the left of a box's centre to frame map, shape (n, k, 2)."""
    ahead, left = np.array(at).T
    ahead = ahead + 0.5 * (size.front_m - size.rear_m)
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    x, y = poses[:, :1] + c * ahead - s * left, poses[:, 1:2] + s * ahead + c * left
    return np.stack((x, y), axis=-1)


def _in_box(poses: FloatArray, size: Size, points: FloatArray) -> FloatArray:
    """Move points to frames of the box's centre (ahead, left), shape (n, k, 2)."""
    dx, dy = points[:, 0] - poses[:, :1], points[:, 1] - poses[:, 1:2]
    c, s = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    ahead = c * dx + s * dy - 0.5 * (size.front_m - size.rear_m)
    return np.stack((ahead, c * dy - s * dx), axis=-1)


def _deepest_m(start: FloatArray, end: FloatArray, half_x: float, half_y: float) -> FloatArray:
    """Compute how deep segments go into a rectangle around the origin, shape (n,).

    It is 0 where none goes into it.

    Args:
        start: of k segments for each of n boxes, shape (n, k, 2).
        end: the same shape.
        half_x: half an extent of the rectangle.
        half_y: the other half extent.
    """
    deepest = np.zeros(len(start))
    half = np.array([half_x, half_y])
    beyond = ((start >= half) & (end >= half)) | ((start <= -half) & (end <= -half))
    which, segment = np.nonzero(~beyond.any(axis=-1))
    if not len(which):
        return deepest
    (xa, ya), (dx, dy) = start[which, segment].T, (end - start)[which, segment].T
    # The depth is the least of four linear functions of the place: it is greatest at an end of the
    # segment, where it passes an axis, or where it is as far from two neighbouring sides.
    rise = half_y - half_x
    places = [np.zeros(len(which)), np.ones(len(which))]
    with np.errstate(divide="ignore", invalid="ignore"):
        places += [-xa / dx, -ya / dy]
        for a in (1.0, -1.0):
            for b in (1.0, -1.0):
                places.append((rise - b * ya + a * xa) / (b * dy - a * dx))
    t = np.clip(np.nan_to_num(np.array(places), nan=0.0), 0.0, 1.0)
    depth = np.minimum(half_x - np.abs(xa + t * dx), half_y - np.abs(ya + t * dy)).max(axis=0)
    np.maximum.at(deepest, which, depth)
    return deepest


def _centre_crosses(there: FloatArray, here: FloatArray) -> NDArray[np.bool_]:
    """Tell whether the centre's way crosses an edge, for corners seen before and after, shape (n,).

    In the frame of a box its centre stands in the origin, and an edge sweeps the quadrangle between
    where it was and where it is.
    """
    sweep = (there[:, :-1], there[:, 1:], here[:, 1:], here[:, :-1])
    inside = np.zeros(sweep[0].shape[:2], dtype=bool)
    a = sweep[-1]
    for b in sweep:
        (xa, ya), (xb, yb) = np.moveaxis(a, -1, 0), np.moveaxis(b, -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            right = xa + ya * (xb - xa) / (ya - yb) > 0.0
        inside ^= ((ya > 0.0) != (yb > 0.0)) & right
        a = b
    return np.asarray(inside.any(axis=1))
