"""A reference made ready for being driven: plain numbers, so that a step costs microseconds.

``sample`` of ssp_core.motion.reference says what a reference means; this gives the same values.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import FloatArray, Pose2, wrap_angle
from ssp_core.motion.reference import Reference

# Rows that are made ready at once; a power of two.
_PIECE_BITS = 6
_PIECE = 1 << _PIECE_BITS


class Point(NamedTuple):
    """Where an object is to be and how fast; fields as in ReferencePoint."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float
    curvature_1pm: float


class Track:
    """One accepted reference. Reads no clock, and what it gives depends on its arguments only.

    A stream of adapted references replaces each after a few steps, so that points are made ready
    in pieces, when they are first asked for.
    """

    def __init__(self, reference: Reference) -> None:
        _, x, y, yaw, speed, acceleration, curvature = reference.columns
        steps_m = np.hypot(np.diff(x), np.diff(y))
        stations_m = np.concatenate(([0.0], np.cumsum(steps_m)))
        # Velocities are the tangents of the Hermite curve.
        vx, vy = speed * np.cos(yaw), speed * np.sin(yaw)
        self.reference = reference
        self.length_m = float(stations_m[-1])
        self._execute_at_ns = reference.execute_at_ns
        self._times_s = reference.times_s
        self._table = np.column_stack(
            (x, y, yaw, speed, acceleration, curvature, vx, vy, stations_m)
        )
        self._pieces: dict[int, list[list[float]]] = {}

    def _row(self, i: int) -> list[float]:
        piece = self._pieces.get(i >> _PIECE_BITS)
        if piece is None:
            first = i >> _PIECE_BITS << _PIECE_BITS
            piece = self._table[first : first + _PIECE].tolist()
            self._pieces[i >> _PIECE_BITS] = piece
        return piece[i & _PIECE - 1]

    def _value(self, t_s: float, column: int) -> float:
        """A column of the table at a time, linear; its ends before and after."""
        times = self._times_s
        if t_s < times[0]:
            return self._row(0)[column]
        if t_s >= times[-1]:
            return self._row(len(times) - 1)[column]
        i = bisect_right(times, t_s)
        a, b = self._row(i - 1)[column], self._row(i)[column]
        return a + (t_s - times[i - 1]) / (times[i] - times[i - 1]) * (b - a)

    @property
    def end(self) -> Pose2:
        """Where the path ends."""
        return Pose2(*self._row(len(self._times_s) - 1)[:3])

    def accelerations(self, times_s: FloatArray) -> FloatArray:
        """Accelerations at times after execute_at; 0 before the first point and from the last."""
        t = self.reference.columns[0]
        inside = (times_s >= t[0]) & (times_s < t[-1])
        return np.where(inside, np.interp(times_s, t, self._table[:, 4]), 0.0)

    def curvatures(self, times_s: FloatArray) -> FloatArray:
        """Curvatures at times after execute_at; those of both ends before and after."""
        found: FloatArray = np.interp(times_s, self.reference.columns[0], self._table[:, 5])
        return found

    def seconds(self, t_ns: int) -> float:
        """A session time in s after execute_at."""
        return ns_to_seconds(t_ns - self._execute_at_ns)

    def at(self, t_s: float) -> Point:
        """Cubic Hermite in position, linear in everything else; at rest before and after."""
        times = self._times_s
        if t_s < times[0]:
            x, y, yaw, v, _, k, _, _, _ = self._row(0)
            return Point(x, y, yaw, v, 0.0, k)
        if t_s >= times[-1]:
            x, y, yaw, _, _, k, _, _, _ = self._row(len(times) - 1)
            return Point(x, y, yaw, 0.0, 0.0, k)
        i = bisect_right(times, t_s)
        xa, ya, yaw_a, va, aa, ka, vxa, vya, _ = self._row(i - 1)
        xb, yb, yaw_b, vb, ab, kb, vxb, vyb, _ = self._row(i)
        start_s = times[i - 1]
        span_s = times[i] - start_s
        u = (t_s - start_s) / span_s
        w = 1.0 - u
        h_a, h_b = (1.0 + 2.0 * u) * w * w, u * u * (3.0 - 2.0 * u)
        g_a, g_b = u * w * w * span_s, u * u * (u - 1.0) * span_s
        return Point(
            h_a * xa + h_b * xb + g_a * vxa + g_b * vxb,
            h_a * ya + h_b * yb + g_a * vya + g_b * vyb,
            yaw_a if yaw_a == yaw_b else wrap_angle(yaw_a + u * wrap_angle(yaw_b - yaw_a)),
            va + u * (vb - va),
            aa + u * (ab - aa),
            ka + u * (kb - ka),
        )

    def curvature_1pm(self, t_s: float) -> float:
        """As ``at``, of the curvature alone."""
        return self._value(t_s, 5)

    def speed_mps(self, t_s: float) -> float:
        """As ``at``, of the speed alone."""
        return 0.0 if t_s >= self._times_s[-1] else self._value(t_s, 3)

    def left_m(self, t_s: float, ahead_m: float) -> float:
        """Length of path ahead of an object, m; negative past its end.

        Args:
            t_s: after execute_at.
            ahead_m: how far the object is ahead of its time.
        """
        return self.length_m - self._value(t_s, 8) - ahead_m
