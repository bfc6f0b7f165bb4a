"""Plane geometry in ENU: angles, poses, polylines with arc length, oriented boxes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def wrap_angle(angle_rad: float) -> float:
    """The same angle in (-pi, pi]."""
    wrapped = math.remainder(angle_rad, 2.0 * math.pi)
    return math.pi if wrapped <= -math.pi else wrapped


@dataclass(frozen=True, slots=True)
class Pose2:
    """Position and heading in the plane: m, m, rad counter-clockwise from the x axis."""

    x_m: float
    y_m: float
    yaw_rad: float

    def to_parent(self, x_m: float, y_m: float) -> tuple[float, float]:
        """A point of this pose's frame (x forward, y left) in the parent frame: R p + t."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return self.x_m + c * x_m - s * y_m, self.y_m + s * x_m + c * y_m

    def to_local(self, x_m: float, y_m: float) -> tuple[float, float]:
        """A point of the parent frame in this pose's frame: R^T (p - t)."""
        c, s = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        dx, dy = x_m - self.x_m, y_m - self.y_m
        return c * dx + s * dy, -s * dx + c * dy


@dataclass(frozen=True, slots=True)
class Box:
    """An oriented rectangle on the ground, given from a reference point inside or near it."""

    pose: Pose2
    front_m: float
    rear_m: float
    width_m: float

    def corners(self) -> list[tuple[float, float]]:
        """The four corners, counter-clockwise from the front left, in the parent frame."""
        half = self.width_m / 2.0
        return [
            self.pose.to_parent(self.front_m, half),
            self.pose.to_parent(-self.rear_m, half),
            self.pose.to_parent(-self.rear_m, -half),
            self.pose.to_parent(self.front_m, -half),
        ]


def _axes(corners: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    axes = []
    for (x0, y0), (x1, y1) in ((corners[0], corners[1]), (corners[1], corners[2])):
        length = math.hypot(x1 - x0, y1 - y0)
        axes.append(((x1 - x0) / length, (y1 - y0) / length))
    return axes


def boxes_overlap(a: Box, b: Box) -> bool:
    """True when the two rectangles share area or touch (separating axis test)."""
    ca, cb = a.corners(), b.corners()
    for ax, ay in _axes(ca) + _axes(cb):
        pa = [x * ax + y * ay for x, y in ca]
        pb = [x * ax + y * ay for x, y in cb]
        if max(pa) < min(pb) or max(pb) < min(pa):
            return False
    return True


def _segment_distance(
    p: tuple[float, float], a: tuple[float, float], b: tuple[float, float]
) -> float:
    dx, dy = b[0] - a[0], b[1] - a[1]
    norm = dx * dx + dy * dy
    t = 0.0 if norm == 0.0 else ((p[0] - a[0]) * dx + (p[1] - a[1]) * dy) / norm
    t = min(1.0, max(0.0, t))
    return math.hypot(p[0] - a[0] - t * dx, p[1] - a[1] - t * dy)


def box_distance(a: Box, b: Box) -> float:
    """Smallest distance between two rectangles in m; 0 when they overlap."""
    if boxes_overlap(a, b):
        return 0.0
    ca, cb = a.corners(), b.corners()
    best = math.inf
    for ps, qs in ((ca, cb), (cb, ca)):
        for p in ps:
            for i in range(4):
                best = min(best, _segment_distance(p, qs[i], qs[(i + 1) % 4]))
    return best


def point_in_polygon(x_m: float, y_m: float, polygon: Sequence[tuple[float, float]]) -> bool:
    """True inside a simple polygon (even-odd rule); points on the edge may go either way."""
    inside = False
    j = len(polygon) - 1
    for i, (xi, yi) in enumerate(polygon):
        xj, yj = polygon[j]
        if (yi > y_m) != (yj > y_m) and x_m < (xj - xi) * (y_m - yi) / (yj - yi) + xi:
            inside = not inside
        j = i
    return inside


class Polyline:
    """A path through points, addressed by arc length.

    Args:
        points: shape (n, 2) with n >= 2, m, consecutive points distinct.

    Raises:
        ValueError: too few, repeated or non-finite points.
    """

    def __init__(self, points: Sequence[Sequence[float]] | FloatArray) -> None:
        array = np.array(points, dtype=np.float64)
        if array.ndim != 2 or array.shape[0] < 2 or array.shape[1] != 2:
            raise ValueError(f"a path needs at least two (x, y) points, got shape {array.shape}")
        if not np.isfinite(array).all():
            raise ValueError("a path's points must be finite")
        steps = np.diff(array, axis=0)
        lengths = np.hypot(steps[:, 0], steps[:, 1])
        if (lengths <= 0.0).any():
            raise ValueError("a path's consecutive points must differ")
        self.points: FloatArray = array
        self.stations_m: FloatArray = np.concatenate(([0.0], np.cumsum(lengths)))
        self._yaw = np.arctan2(steps[:, 1], steps[:, 0])
        turns = np.array(
            [wrap_angle(b - a) for a, b in zip(self._yaw[:-1], self._yaw[1:], strict=True)]
        )
        self._curvature = np.zeros(len(array))
        if len(turns):
            self._curvature[1:-1] = turns / (0.5 * (lengths[:-1] + lengths[1:]))

    @property
    def length_m(self) -> float:
        return float(self.stations_m[-1])

    def pose(self, station_m: float, offset_m: float = 0.0) -> Pose2:
        """Pose at an arc length, offset_m to the left of it; extended straight at both ends."""
        i = int(np.searchsorted(self.stations_m, station_m, side="right")) - 1
        i = min(max(i, 0), len(self._yaw) - 1)
        along = station_m - float(self.stations_m[i])
        yaw = float(self._yaw[i])
        c, s = math.cos(yaw), math.sin(yaw)
        x = float(self.points[i, 0]) + c * along - s * offset_m
        y = float(self.points[i, 1]) + s * along + c * offset_m
        return Pose2(x, y, wrap_angle(yaw))

    def curvature(self, station_m: float) -> float:
        """Curvature in 1/m at an arc length, + turns left, interpolated between the points."""
        return float(np.interp(station_m, self.stations_m, self._curvature))

    def project(self, x_m: float, y_m: float) -> tuple[float, float]:
        """Arc length of the nearest point of the path, and the signed offset (+ is left)."""
        a, b = self.points[:-1], self.points[1:]
        d = b - a
        t = ((x_m - a[:, 0]) * d[:, 0] + (y_m - a[:, 1]) * d[:, 1]) / (d**2).sum(axis=1)
        t = np.clip(t, 0.0, 1.0)
        px, py = a[:, 0] + t * d[:, 0], a[:, 1] + t * d[:, 1]
        distance = np.hypot(x_m - px, y_m - py)
        i = int(np.argmin(distance))
        station = float(self.stations_m[i] + t[i] * math.hypot(d[i, 0], d[i, 1]))
        side = d[i, 0] * (y_m - a[i, 1]) - d[i, 1] * (x_m - a[i, 0])
        return station, math.copysign(float(distance[i]), side) if side else float(distance[i])

    def project_beyond(self, x_m: float, y_m: float) -> tuple[float, float]:
        """As project, but the path goes on straight beyond both its ends."""
        station, offset = self.project(x_m, y_m)
        if 0.0 < station < self.length_m:
            return station, offset
        along, across = self.pose(station).to_local(x_m, y_m)
        return station + along, across
