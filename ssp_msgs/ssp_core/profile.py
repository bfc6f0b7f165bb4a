"""Reference points for the manoeuvres of a run: driving along a path, and changing lane.

Speeds follow a trapezoid over time whose corners are rounded by a moving average of ``ramp_s``, so
that acceleration is continuous and an object with actuator lag can follow it. A moving average
keeps the distance, so the standstill is exactly at the end of the path.
"""

from __future__ import annotations

import bisect
import math
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import FloatArray, Polyline, Pose2, wrap_angle
from ssp_core.reference import ReferencePoint

DEFAULT_STEP_S = 0.05
DEFAULT_RAMP_S = 0.4
# Heading turns over at most this far to each side of a path's vertex.
_BLEND_M = 1.0
# Two points closer in time than this are one.
_SAME_TIME_S = 1e-6


@dataclass(frozen=True, slots=True)
class _Piece:
    """Constant acceleration from ``start_s`` on."""

    start_s: float
    distance_m: float
    speed_mps: float
    acceleration_mps2: float


class SpeedProfile:
    """Accelerate or slow down to cruise speed, hold it, brake to a standstill after a distance.

    With less room than cruise speed needs, the highest speed is lower.

    Args:
        start_mps: speed at t = 0, >= 0.
        cruise_mps: speed to hold, > 0.
        distance_m: distance to the standstill, > 0.
        acceleration_mps2: largest acceleration, > 0.
        deceleration_mps2: largest deceleration, > 0.
        ramp_s: time over which acceleration builds up, >= 0.

    Raises:
        ValueError: a value out of range, or too little distance to brake.
    """

    def __init__(
        self,
        start_mps: float,
        cruise_mps: float,
        distance_m: float,
        acceleration_mps2: float,
        deceleration_mps2: float,
        ramp_s: float = DEFAULT_RAMP_S,
    ) -> None:
        values = (start_mps, cruise_mps, distance_m, acceleration_mps2, deceleration_mps2, ramp_s)
        if not all(math.isfinite(v) for v in values):
            raise ValueError(f"a speed profile needs finite values, got {values}")
        if start_mps < 0.0 or ramp_s < 0.0:
            raise ValueError(f"start speed and ramp must be >= 0, got {start_mps} and {ramp_s}")
        if min(cruise_mps, acceleration_mps2, deceleration_mps2) <= 0.0:
            raise ValueError("cruise speed, acceleration and deceleration must be > 0")
        self._start_mps = start_mps
        self._ramp_s = ramp_s
        # What the average lags behind at the start it gains before it stands still.
        room = distance_m - 0.5 * start_mps * ramp_s
        braking = start_mps**2 / (2.0 * deceleration_mps2)
        if room < braking - 1e-9 or distance_m <= 0.0:
            raise ValueError(
                f"{distance_m:.2f} m is too short to stop from {start_mps:.2f} m/s: braking at "
                f"{deceleration_mps2:g} m/s^2 takes {braking + distance_m - room:.2f} m"
            )
        peak = cruise_mps
        if cruise_mps > start_mps:
            a, d = acceleration_mps2, deceleration_mps2
            top = math.sqrt(max((2.0 * a * d * room + d * start_mps**2) / (a + d), 0.0))
            peak = max(start_mps, min(cruise_mps, top))
        self._pieces = self._plan(start_mps, peak, room, acceleration_mps2, deceleration_mps2)
        self._starts = [p.start_s for p in self._pieces]
        self.peak_mps = max(peak, start_mps)
        self.duration_s = self._pieces[-1].start_s + ramp_s
        self.distance_m = distance_m

    @staticmethod
    def _plan(v0: float, peak: float, room_m: float, a: float, d: float) -> list[_Piece]:
        first = a if peak >= v0 else -d
        t_change = abs(peak - v0) / abs(first)
        s_change = 0.5 * (v0 + peak) * t_change
        s_brake = peak * peak / (2.0 * d)
        t_hold = max(room_m - s_change - s_brake, 0.0) / peak if peak > 0.0 else 0.0
        t_brake = t_change + t_hold
        return [
            _Piece(0.0, 0.0, v0, first),
            _Piece(t_change, s_change, peak, 0.0),
            _Piece(t_brake, s_change + peak * t_hold, peak, -d),
            _Piece(t_brake + peak / d, s_change + peak * t_hold + s_brake, 0.0, 0.0),
        ]

    def _sharp(self, t_s: float) -> tuple[float, float, float]:
        """Distance, speed and integral of distance of the trapezoid; start speed before t = 0."""
        if t_s < 0.0:
            v = self._start_mps
            return v * t_s, v, 0.5 * v * t_s * t_s
        integral = 0.0
        i = bisect.bisect_right(self._starts, t_s) - 1
        for k in range(i):
            p = self._pieces[k]
            integral += _integral(p, self._starts[k + 1] - p.start_s)
        p = self._pieces[i]
        u = t_s - p.start_s
        return (
            p.distance_m + p.speed_mps * u + 0.5 * p.acceleration_mps2 * u * u,
            p.speed_mps + p.acceleration_mps2 * u,
            integral + _integral(p, u),
        )

    def at(self, t_s: float) -> tuple[float, float, float]:
        """Distance in m, speed in m/s and acceleration in m/s^2 at a time in s from the start."""
        if t_s >= self.duration_s:
            return self.distance_m, 0.0, 0.0
        now = self._sharp(t_s)
        width = self._ramp_s
        if width <= _SAME_TIME_S:
            i = bisect.bisect_right(self._starts, max(t_s, 0.0)) - 1
            return now[0], now[1], self._pieces[i].acceleration_mps2
        before = self._sharp(t_s - width)
        distance = (now[2] - before[2]) / width + 0.5 * self._start_mps * width
        speed = max((now[0] - before[0]) / width, 0.0)
        return distance, speed, (now[1] - before[1]) / width

    def times(self, dt_s: float) -> list[float]:
        """Times 0, dt, 2 dt, … and the end, rising strictly.

        Raises:
            ValueError: dt_s isn't positive.
        """
        if not dt_s > 0.0:
            raise ValueError(f"dt_s must be positive, got {dt_s}")
        count = math.ceil(self.duration_s / dt_s - _SAME_TIME_S)
        return [i * dt_s for i in range(count)] + [self.duration_s]


def _integral(piece: _Piece, u_s: float) -> float:
    """Integral of distance over ``u_s`` seconds of a piece."""
    return (
        piece.distance_m * u_s
        + piece.speed_mps * u_s**2 / 2.0
        + piece.acceleration_mps2 * u_s**3 / 6.0
    )


class _Heading:
    """Continuous heading and its curvature along a polyline.

    A polyline's own heading jumps at its vertices. Here it turns linearly with arc length from the
    middle of one segment to the middle of the next, and no further than _BLEND_M from the vertex.
    """

    def __init__(self, path: Polyline) -> None:
        steps = np.diff(path.points, axis=0)
        yaw = np.unwrap(np.arctan2(steps[:, 1], steps[:, 0]))
        lengths = np.diff(path.stations_m)
        blend = np.minimum(0.5 * np.minimum(lengths[:-1], lengths[1:]), _BLEND_M)
        inner = path.stations_m[1:-1]
        knots: FloatArray = np.stack((inner - blend, inner + blend), axis=1).ravel()
        self._stations_m = np.concatenate((path.stations_m[:1], knots, path.stations_m[-1:]))
        self._yaw_rad = np.repeat(yaw, 2)

    def at(self, station_m: float) -> tuple[float, float]:
        """Heading in rad and curvature in 1/m, + turns left."""
        s, yaw = self._stations_m, self._yaw_rad
        i = min(max(int(np.searchsorted(s, station_m, side="right")) - 1, 0), len(s) - 2)
        span = s[i + 1] - s[i]
        curvature = float((yaw[i + 1] - yaw[i]) / span) if span > 0.0 else 0.0
        inside = min(max(station_m - float(s[i]), 0.0), float(span))
        return wrap_angle(float(yaw[i]) + curvature * inside), curvature


def drive_along(
    path: Polyline,
    start_station_m: float,
    start_speed_mps: float,
    cruise_mps: float,
    acceleration_mps2: float,
    deceleration_mps2: float,
    dt_s: float = DEFAULT_STEP_S,
    ramp_s: float = DEFAULT_RAMP_S,
) -> list[ReferencePoint]:
    """Points along a path: to cruise speed, held, and to a standstill at the path's end.

    Args:
        path: frame map, m.
        start_station_m: arc length at t = 0.
        start_speed_mps: speed at t = 0, >= 0.
        cruise_mps: speed to hold; not reached where the path is too short for it.
        acceleration_mps2: largest acceleration, > 0.
        deceleration_mps2: largest deceleration, > 0.
        dt_s: time between points.
        ramp_s: time over which acceleration builds up.

    Raises:
        ValueError: a value out of range, or too little path left to stop.
    """
    speed = SpeedProfile(
        start_speed_mps,
        cruise_mps,
        path.length_m - start_station_m,
        acceleration_mps2,
        deceleration_mps2,
        ramp_s,
    )
    heading = _Heading(path)
    points = []
    for t in speed.times(dt_s):
        distance, v, a = speed.at(t)
        station = start_station_m + distance
        pose = path.pose(station)
        yaw, curvature = heading.at(station)
        points.append(ReferencePoint(t, pose.x_m, pose.y_m, yaw, v, a, curvature))
    return points


@dataclass(frozen=True, slots=True)
class _Shift:
    """Quintic from one lateral position to another with zero rate and acceleration at both ends."""

    start_m: float
    shift_m: float
    duration_s: float

    def at(self, t_s: float) -> tuple[float, float, float]:
        """Lateral position in m, its rate in m/s and its acceleration in m/s^2."""
        u = min(max(t_s / self.duration_s, 0.0), 1.0)
        k, d = self.shift_m, self.duration_s
        return (
            self.start_m + k * u**3 * (10.0 + u * (6.0 * u - 15.0)),
            30.0 * k * u**2 * (1.0 - u) ** 2 / d,
            60.0 * k * u * (1.0 - u) * (1.0 - 2.0 * u) / (d * d),
        )


def lane_change(
    path: Polyline,
    start_station_m: float,
    start_speed_mps: float,
    lateral_shift_m: float,
    duration_s: float,
    cruise_mps: float,
    deceleration_mps2: float,
    acceleration_mps2: float = 2.0,
    start_offset_m: float = 0.0,
    end_station_m: float | None = None,
    dt_s: float = DEFAULT_STEP_S,
    ramp_s: float = DEFAULT_RAMP_S,
) -> list[ReferencePoint]:
    """Points of a lane change: sideways over time while driving on, then parallel to the path.

    The speed along the path goes to cruise speed meanwhile, and the motion ends in a standstill
    beside the path's end (or ``end_station_m``). In the path's frame, with curvature k, offset y
    and station s: v_t = (1 - k y) s', v_n = y', heading = path + atan2(v_n, v_t).

    Args:
        path: frame map, m.
        start_station_m: arc length at t = 0.
        start_speed_mps: speed along the path at t = 0, > 0.
        lateral_shift_m: m, + is left.
        duration_s: of the sideways motion, > 0.
        cruise_mps: speed along the path afterwards.
        deceleration_mps2: largest deceleration, > 0.
        acceleration_mps2: largest acceleration, > 0.
        start_offset_m: lateral position at t = 0, m left of the path.
        end_station_m: where to stand; the path's end when None.
        dt_s: time between points.
        ramp_s: time over which acceleration builds up.

    Raises:
        ValueError: a value out of range, too little path left to stop, or the object would stand
            before the lane change is complete.
    """
    if not duration_s > 0.0:
        raise ValueError(f"the duration of a lane change must be positive, got {duration_s}")
    end = path.length_m if end_station_m is None else end_station_m
    speed = SpeedProfile(
        start_speed_mps,
        cruise_mps,
        end - start_station_m,
        acceleration_mps2,
        deceleration_mps2,
        ramp_s,
    )
    if duration_s >= speed.duration_s or start_speed_mps <= 0.0:
        raise ValueError(
            f"a lane change of {duration_s:g} s needs a moving object all the while; this one "
            f"starts at {start_speed_mps:.2f} m/s and stands after {speed.duration_s:.2f} s"
        )
    shift = _Shift(start_offset_m, lateral_shift_m, duration_s)
    heading = _Heading(path)
    times = sorted({*speed.times(dt_s), duration_s})
    times = [b for a, b in zip([-1.0, *times], times, strict=False) if b - a > _SAME_TIME_S]
    points = []
    for t in times:
        distance, s1, s2 = speed.at(t)
        station = start_station_m + distance
        y, y1, y2 = shift.at(t)
        yaw, k = heading.at(station)
        foot = path.pose(station)
        # Across the smooth heading: the polyline's own would throw the offset about at a vertex.
        east, north = Pose2(foot.x_m, foot.y_m, yaw).to_parent(0.0, y)
        along, across = (1.0 - k * y) * s1, y1
        along_rate, across_rate = (1.0 - k * y) * s2 - k * y1 * s1, y2
        v = math.hypot(along, across)
        if v > 1e-6:
            a = (along * along_rate + across * across_rate) / v
            turn = k * s1 + (along * across_rate - across * along_rate) / (v * v)
            curvature = turn / v
            yaw = wrap_angle(yaw + math.atan2(across, along))
        else:
            a, curvature = s2, k / (1.0 - k * y)
        points.append(ReferencePoint(t, east, north, yaw, v, a, curvature))
    return points
