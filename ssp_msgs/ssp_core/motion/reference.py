"""References: what an object target is to do from ``execute_at`` on (Reference.msg without ROS)."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import overload

import numpy as np

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import FloatArray, wrap_angle, wrap_angles
from ssp_core.value_class import value_class

# In so short a step the way that is driven strays from a straight one by 1 cm at 8 m/s^2 across.
PLACES_S = 0.1
# Slower than this is the rounding of a profile that stands.
_MOVES_MPS = 1e-6
# Purpose of a reference that is a driver's plan (METHOD 8.4).
PLAN = "plan"


@value_class(frozen=True, slots=True)
class ReferencePoint:
    """One point for the object's reference point, frame map.

    Args:
        t_s: s after the reference's execute_at.
        x_m: m, east.
        y_m: m, north.
        yaw_rad: rad, counter-clockwise from east.
        speed_mps: m/s along the heading, >= 0.
        acceleration_mps2: m/s^2 along the heading.
        curvature_1pm: 1/m, + turns left.
    """

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float
    curvature_1pm: float


class Points(Sequence[ReferencePoint]):
    """Reference points held as columns; a point is made when somebody asks for it.

    Args:
        columns: t, x, y, yaw, speed, acceleration, curvature; shape (7, n), C-contiguous. They are
            made read-only.

    Raises:
        ValueError: another shape.
    """

    __slots__ = ("_rows", "columns")

    def __init__(self, columns: FloatArray) -> None:
        if columns.ndim != 2 or columns.shape[0] != 7:
            raise ValueError(f"reference points need shape (7, n), got {columns.shape}")
        self.columns: FloatArray = np.ascontiguousarray(columns, dtype=np.float64)
        self.columns.flags.writeable = False
        self._rows: bytes | None = None

    def row_bytes(self) -> bytes:
        """Return the points one by one as they are sent: seven little-endian doubles each."""
        if self._rows is None:
            self._rows = self.columns.T.astype("<f8", order="C", copy=False).tobytes()
        return self._rows

    def __len__(self) -> int:
        return int(self.columns.shape[1])

    @overload
    def __getitem__(self, index: int) -> ReferencePoint: ...
    @overload
    def __getitem__(self, index: slice) -> Points: ...
    def __getitem__(self, index: int | slice) -> ReferencePoint | Points:
        if isinstance(index, slice):
            return Points(self.columns[:, index])
        return ReferencePoint(*self.columns[:, index].tolist())

    def __iter__(self) -> Iterator[ReferencePoint]:
        return (ReferencePoint(*row) for row in self.columns.T.tolist())

    def __eq__(self, other: object) -> bool:
        if isinstance(other, Points):
            return bool(np.array_equal(self.columns, other.columns))
        if isinstance(other, Sequence):
            return list(self) == list(other)
        return NotImplemented

    def __hash__(self) -> int:
        return hash(tuple(self))

    def __repr__(self) -> str:
        return f"Points({len(self)})"


@dataclass(frozen=True)
class Reference:
    """A timed trajectory; field meanings as in Reference.msg.

    Any points may be held, broken ones too: ``check_reference`` of the object target judges them.
    """

    reference_id: str
    object_id: str
    event_version: str
    purpose: str
    dispatched_ns: int
    execute_at_ns: int
    expires_at_ns: int
    points: Sequence[ReferencePoint]

    @cached_property
    def columns(self) -> FloatArray:
        """Points as columns t, x, y, yaw, speed, acceleration, curvature; shape (7, n)."""
        if isinstance(self.points, Points):
            return self.points.columns
        rows = [
            (p.t_s, p.x_m, p.y_m, p.yaw_rad, p.speed_mps, p.acceleration_mps2, p.curvature_1pm)
            for p in self.points
        ]
        return np.array(rows, dtype=np.float64).reshape(-1, 7).T.copy()

    @cached_property
    def places(self) -> FloatArray:
        """Points as columns, and places between those that are more than PLACES_S apart in motion.

        They are what ``between`` gives, at most PLACES_S apart; where there are none, it is
        ``columns`` itself.
        """
        columns = self.columns
        counts = np.ceil(moving_steps_s(columns) / PLACES_S - 1e-6).astype(np.intp)
        if (counts <= 1).all():
            return columns
        counts = np.maximum(counts, 1)
        step = np.repeat(np.arange(len(counts)), counts)
        u = (np.arange(len(step)) - np.repeat(np.cumsum(counts) - counts, counts)) / counts[step]
        a, b = columns[:, step], columns[:, step + 1]
        places = a + u * (b - a)
        h = u * u * (3.0 - 2.0 * u)
        g_a, g_b = u * (1.0 - u) ** 2 * (b[0] - a[0]), u * u * (u - 1.0) * (b[0] - a[0])
        for row, part in ((1, np.cos), (2, np.sin)):
            tangents = g_a * a[4] * part(a[3]) + g_b * b[4] * part(b[3])
            places[row] = a[row] + h * (b[row] - a[row]) + tangents
        places[3] = wrap_angles(a[3] + u * wrap_angles(b[3] - a[3]))
        return np.column_stack((places, columns[:, -1]))

    def row_bytes(self) -> bytes:
        """Return the points as they are sent; kept where they are columns already."""
        points = self.points
        return (points if isinstance(points, Points) else Points(self.columns)).row_bytes()

    @cached_property
    def times_s(self) -> list[float]:
        """Times of the points after execute_at."""
        times: list[float] = self.columns[0].tolist()
        return times

    @cached_property
    def end_ns(self) -> int:
        """Time of the last point. Raises IndexError for a reference without points."""
        return self.execute_at_ns + seconds_to_ns(self.times_s[-1])


def moving_steps_s(columns: FloatArray) -> FloatArray:
    """Compute the times from point to point, 0 where an object stands at both; shape (n - 1,).

    Args:
        columns: of a reference, shape (7, n), n >= 1.
    """
    t, speed = columns[0], columns[4]
    return np.where(np.maximum(speed[:-1], speed[1:]) > _MOVES_MPS, np.diff(t), 0.0)


def between(a: ReferencePoint, b: ReferencePoint, t_s: float) -> ReferencePoint:
    """Interpolate by a cubic Hermite in position (speeds are its tangents), else linearly."""
    span_s = b.t_s - a.t_s
    u = (t_s - a.t_s) / span_s
    h_a, h_b = (1.0 + 2.0 * u) * (1.0 - u) ** 2, u * u * (3.0 - 2.0 * u)
    g_a, g_b = u * (1.0 - u) ** 2 * span_s, u * u * (u - 1.0) * span_s
    va, vb = a.speed_mps, b.speed_mps
    x = h_a * a.x_m + h_b * b.x_m
    x += g_a * va * math.cos(a.yaw_rad) + g_b * vb * math.cos(b.yaw_rad)
    y = h_a * a.y_m + h_b * b.y_m
    y += g_a * va * math.sin(a.yaw_rad) + g_b * vb * math.sin(b.yaw_rad)
    return ReferencePoint(
        t_s=t_s,
        x_m=x,
        y_m=y,
        yaw_rad=wrap_angle(a.yaw_rad + u * wrap_angle(b.yaw_rad - a.yaw_rad)),
        speed_mps=va + u * (vb - va),
        acceleration_mps2=a.acceleration_mps2 + u * (b.acceleration_mps2 - a.acceleration_mps2),
        curvature_1pm=a.curvature_1pm + u * (b.curvature_1pm - a.curvature_1pm),
    )


def sample(reference: Reference, t_ns: int) -> ReferencePoint:
    """Return the point that the object should be at, interpolated between the reference's points.

    Before the first point it is that point without acceleration; after the last one a standstill
    at that point.

    Args:
        reference: one that ``check_reference`` accepted.
        t_ns: session time, ns.

    Raises:
        IndexError: the reference has no points.
    """
    t_s = ns_to_seconds(t_ns - reference.execute_at_ns)
    times = reference.times_s
    if t_s < times[0]:
        return replace(reference.points[0], t_s=t_s, acceleration_mps2=0.0)
    if t_s >= times[-1]:
        return replace(reference.points[-1], t_s=t_s, speed_mps=0.0, acceleration_mps2=0.0)
    i = bisect.bisect_right(times, t_s)
    return between(reference.points[i - 1], reference.points[i], t_s)
