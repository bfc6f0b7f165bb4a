"""Reference points for the manoeuvres of a run: driving along a path, braking, changing lane."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import FloatArray, Polyline, wrap_angles
from ssp_core.reference import Points
from ssp_core.speed_profile import DEFAULT_RAMP_S, SAME_TIME_S, SpeedProfile

DEFAULT_STEP_S = 0.05
# Heading turns over at most this far to each side of a path's vertex.
_BLEND_M = 1.0


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

    def over(self, stations_m: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Heading in rad, unwrapped, and curvature in 1/m, + turns left; shape (n,) each."""
        s, yaw = self._stations_m, self._yaw_rad
        i = np.clip(np.searchsorted(s, stations_m, side="right") - 1, 0, len(s) - 2)
        span = s[i + 1] - s[i]
        curvature = np.where(span > 0.0, (yaw[i + 1] - yaw[i]) / np.where(span > 0.0, span, 1), 0.0)
        inside = np.clip(stations_m - s[i], 0.0, span)
        return yaw[i] + curvature * inside, curvature


def drive_along(
    path: Polyline,
    start_station_m: float,
    start_speed_mps: float,
    cruise_mps: float,
    acceleration_mps2: float,
    deceleration_mps2: float,
    dt_s: float = DEFAULT_STEP_S,
    ramp_s: float = DEFAULT_RAMP_S,
) -> Points:
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
    return _beside(path, start_station_m, 0.0, speed, dt_s)


def brake_along(
    path: Polyline,
    start_station_m: float,
    start_speed_mps: float,
    to_mps: float,
    deceleration_mps2: float,
    start_offset_m: float = 0.0,
    dt_s: float = DEFAULT_STEP_S,
    ramp_s: float = DEFAULT_RAMP_S,
) -> Points:
    """Points of a braking: down to a speed at once, held, and to a standstill at the path's end.

    To 0 m/s it stands where the braking ends.

    Args:
        path: frame map, m.
        start_station_m: arc length at t = 0.
        start_speed_mps: speed along the path at t = 0, above to_mps.
        to_mps: speed to brake to, >= 0.
        deceleration_mps2: of the braking and of the stop at the path's end, > 0.
        start_offset_m: lateral position, kept all the while, m left of the path.
        dt_s: time between points.
        ramp_s: time over which deceleration builds up.

    Raises:
        ValueError: a value out of range, nothing to brake from, or too little path left to stop.
    """
    if not 0.0 <= to_mps < start_speed_mps:
        raise ValueError(
            f"braking goes from a speed to a lower one; this goes from {start_speed_mps:.2f} m/s "
            f"to {to_mps:.2f} m/s"
        )
    room = path.length_m - start_station_m
    cruise = to_mps
    if to_mps == 0.0:
        cruise = start_speed_mps
        stop = 0.5 * start_speed_mps * (start_speed_mps / deceleration_mps2 + ramp_s)
        room = min(room, stop)  # SpeedProfile says when the path is too short for it
    speed = SpeedProfile(
        start_speed_mps, cruise, room, deceleration_mps2, deceleration_mps2, ramp_s
    )
    return _beside(path, start_station_m, start_offset_m, speed, dt_s)


def _beside(
    path: Polyline, start_station_m: float, offset_m: float, speed: SpeedProfile, dt_s: float
) -> Points:
    """Points of a speed along a path, at a constant offset to its left."""
    times = speed.times(dt_s)
    distance, v, a = speed.over(times)
    stations = start_station_m + distance
    yaw, curvature = _Heading(path).over(stations)
    x, y = _beside_foot(path, stations, yaw, offset_m)
    stretch = 1.0 - curvature * offset_m
    return Points(
        np.array((times, x, y, wrap_angles(yaw), stretch * v, stretch * a, curvature / stretch))
    )


def _beside_foot(
    path: Polyline, stations_m: FloatArray, yaw_rad: FloatArray, offset_m: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Places at an offset from a path, across the smooth heading.

    The polyline's own would throw the offset about at a vertex.
    """
    x, y = path.places(stations_m)
    return x - np.sin(yaw_rad) * offset_m, y + np.cos(yaw_rad) * offset_m


@dataclass(frozen=True, slots=True)
class _Shift:
    """Quintic from one lateral position to another with zero rate and acceleration at both ends."""

    start_m: float
    shift_m: float
    duration_s: float

    def over(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Lateral position in m, its rate in m/s and its acceleration in m/s^2; shape (n,) each."""
        u = np.clip(times_s / self.duration_s, 0.0, 1.0)
        k, d = self.shift_m, self.duration_s
        left = 1.0 - u
        return (
            self.start_m + k * u * u * u * (10.0 + u * (6.0 * u - 15.0)),
            30.0 * k * (u * left) ** 2 / d,
            60.0 * k * u * left * (1.0 - 2.0 * u) / (d * d),
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
) -> Points:
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
    times = np.sort(np.append(speed.times(dt_s), duration_s))
    times = times[np.append(True, np.diff(times) > SAME_TIME_S)]
    distance, s1, s2 = speed.over(times)
    stations = start_station_m + distance
    offset, y1, y2 = shift.over(times)
    yaw, k = _Heading(path).over(stations)
    x, y = _beside_foot(path, stations, yaw, offset)
    stretch = 1.0 - k * offset
    along, across = stretch * s1, y1
    along_rate, across_rate = stretch * s2 - k * y1 * s1, y2
    v = np.hypot(along, across)
    moves = v > 1e-6
    safe = np.where(moves, v, 1.0)
    a = np.where(moves, (along * along_rate + across * across_rate) / safe, s2)
    turn = k * s1 + (along * across_rate - across * along_rate) / (safe * safe)
    curvature = np.where(moves, turn / safe, k / stretch)
    yaw = wrap_angles(yaw + np.where(moves, np.arctan2(across, along), 0.0))
    return Points(np.array((times, x, y, yaw, v, a, curvature)))
