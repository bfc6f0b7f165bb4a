"""Reference points for the manoeuvres of a run: driving along a path, braking, changing lane."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import FloatArray, Polyline, wrap_angles
from ssp_core.motion.reference import Points
from ssp_core.motion.speed_profile import DEFAULT_RAMP_S, SAME_TIME_S, SpeedProfile

DEFAULT_STEP_S = 0.05
# Heading turns over at most this far to each side of a path's vertex.
_BLEND_M = 1.0
# Two places along a path closer than this are one.
_SAME_PLACE_M = 1e-7
# So often stations and room are corrected for the path's bends.
_MOST_ROUNDS = 60


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
        """Return heading in rad, unwrapped, and curvature in 1/m, + turns left; shape (n,) each."""
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
    """Plan points along a path: to cruise speed, held, and to a standstill at the path's end.

    Args:
        path: frame map, m.
        start_station_m: arc length at t = 0.
        start_speed_mps: speed at t = 0, >= 0.
        cruise_mps: speed to hold; not reached where the path is too short for it.
        acceleration_mps2: largest acceleration, > 0.
        deceleration_mps2: largest deceleration, > 0.
        dt_s: time between two points, > 0.
        ramp_s: time over which acceleration builds up.

    Raises:
        ValueError: a value out of range, or too little path left to stop.
    """

    def speed(room_m: float) -> SpeedProfile:
        return SpeedProfile(
            start_speed_mps, cruise_mps, room_m, acceleration_mps2, deceleration_mps2, ramp_s
        )

    return _driven(path, start_station_m, path.length_m, _Shift(), speed, dt_s)


def brake_along(
    path: Polyline,
    start_station_m: float,
    start_speed_mps: float,
    to_mps: float,
    deceleration_mps2: float,
    start_offset_m: float = 0.0,
    end_station_m: float | None = None,
    dt_s: float = DEFAULT_STEP_S,
    ramp_s: float = DEFAULT_RAMP_S,
) -> Points:
    """Plan points of a braking at once to a speed, held, and to a standstill at the path's end.

    To 0 m/s it stands where the braking ends.

    Args:
        path: frame map, m.
        start_station_m: arc length at t = 0.
        start_speed_mps: speed along the path at t = 0, above to_mps.
        to_mps: speed to brake to, >= 0.
        deceleration_mps2: of the braking and of the stop at the path's end, > 0.
        start_offset_m: lateral position, kept all the while, m left of the path.
        end_station_m: where to stand; the path's end when None.
        dt_s: time between two points, > 0.
        ramp_s: time over which deceleration builds up.

    Raises:
        ValueError: a value out of range, nothing to brake from, or too little path left to stop.
    """
    if not 0.0 <= to_mps < start_speed_mps:
        raise ValueError(
            f"braking goes from a speed to a lower one; this goes from {start_speed_mps:.2f} m/s "
            f"to {to_mps:.2f} m/s"
        )
    stop_m = 0.5 * start_speed_mps * (start_speed_mps / deceleration_mps2 + ramp_s)

    def speed(room_m: float) -> SpeedProfile:
        cruise = to_mps
        if to_mps == 0.0:
            # SpeedProfile says when the path is too short for it.
            cruise, room_m = start_speed_mps, min(room_m, stop_m)
        return SpeedProfile(
            start_speed_mps, cruise, room_m, deceleration_mps2, deceleration_mps2, ramp_s
        )

    end = path.length_m if end_station_m is None else end_station_m
    return _driven(path, start_station_m, end, _Shift(start_offset_m), speed, dt_s)


def _beside_foot(
    path: Polyline, stations_m: FloatArray, yaw_rad: FloatArray, offset_m: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """Return the places at an offset from a path, across the smooth heading.

    The polyline's own would throw the offset about at a vertex.
    """
    x, y = path.places(stations_m)
    return x - np.sin(yaw_rad) * offset_m, y + np.cos(yaw_rad) * offset_m


@dataclass(frozen=True, slots=True)
class _Shift:
    """Quintic from one lateral position to another with zero rate and acceleration at both ends."""

    start_m: float = 0.0
    shift_m: float = 0.0
    duration_s: float = 0.0

    def over(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return lateral position in m, its rate in m/s and acceleration in m/s^2, shape (n,)."""
        if self.shift_m == 0.0:
            still = np.zeros_like(times_s)
            return still + self.start_m, still, still
        u = np.clip(times_s / self.duration_s, 0.0, 1.0)
        k, d = self.shift_m, self.duration_s
        left = 1.0 - u
        return (
            self.start_m + k * u * u * u * (10.0 + u * (6.0 * u - 15.0)),
            30.0 * k * (u * left) ** 2 / d,
            60.0 * k * u * left * (1.0 - 2.0 * u) / (d * d),
        )


def _driven(
    path: Polyline,
    start_station_m: float,
    end_station_m: float,
    shift: _Shift,
    speed_over: Callable[[float], SpeedProfile],
    dt_s: float,
) -> Points:
    """Plan points of an object that drives beside a path, at a speed and an offset over time.

    The speed u is the object's own, parallel to the path. Beside a bend it passes stations faster
    or slower than u: with curvature k and offset y, s' = u / (1 - k y), so s = s0 + integral of
    u dt + integral of y d(heading). Its speed doesn't step where the bend begins.

    Args:
        path: frame map, m.
        start_station_m: of the path, at t = 0.
        end_station_m: beside which it stands at the end.
        shift: its lateral position, m left of the path.
        speed_over: u over time, for the room in m that there is to drive.
        dt_s: time between two points, > 0.

    Raises:
        ValueError: no such speed, or the path bends too tightly for the offset.
    """
    heading = _Heading(path)
    room_m = end_station_m - start_station_m
    for _ in range(_MOST_ROUNDS):
        speed = speed_over(room_m)
        times = speed.times(dt_s)
        if 0.0 < shift.duration_s < times[-1]:
            times = np.sort(np.append(times, shift.duration_s))
            times = times[np.append(True, np.diff(times) > SAME_TIME_S)]
        distance, u, u1 = speed.over(times)
        offset, y1, y2 = shift.over(times)
        stations = _stations(heading, start_station_m + distance, offset)
        miss_m = end_station_m - float(stations[-1])
        # A braking to a standstill needs less room than there is.
        if abs(miss_m) < _SAME_PLACE_M or speed.distance_m < room_m:
            break
        room_m += miss_m
    yaw, k = heading.over(stations)
    x, y = _beside_foot(path, stations, yaw, offset)
    v = np.hypot(u, y1)
    moves = v > 1e-6
    safe = np.where(moves, v, 1.0)
    a = np.where(moves, (u * u1 + y1 * y2) / safe, u1)
    bend = k / (1.0 - k * offset)
    turn = bend * u + (u * y2 - y1 * u1) / (safe * safe)
    curvature = np.where(moves, turn / safe, bend)
    yaw = wrap_angles(yaw + np.where(moves, np.arctan2(y1, u), 0.0))
    return Points(np.array((times, x, y, yaw, v, a, curvature)))


def _stations(heading: _Heading, driven_m: FloatArray, offset_m: FloatArray) -> FloatArray:
    """Return stations of an object at offsets beside a path, from what it has driven so far itself.

    Raises:
        ValueError: the path bends too tightly for the offset.
    """
    stations = driven_m
    if not offset_m.any():
        return stations
    middle = 0.5 * (offset_m[1:] + offset_m[:-1])
    for _ in range(_MOST_ROUNDS):
        yaw, curvature = heading.over(stations)
        next_stations: FloatArray = driven_m + np.append(0.0, np.cumsum(middle * np.diff(yaw)))
        moved_m = float(np.abs(next_stations - stations).max())
        stations = next_stations
        if moved_m < _SAME_PLACE_M:
            return stations
    tightest = float((curvature * offset_m).max())
    raise ValueError(
        f"beside its path by up to {float(np.abs(offset_m).max()):.2f} m it can't drive: a bend of "
        f"the path leaves {max(1.0 - tightest, 0.0):.2f} of its length there"
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
    """Plan points of a lane change: sideways while driving on, then parallel to the path.

    The speed parallel to the path goes to cruise speed meanwhile, and the motion ends in a
    standstill beside the path's end (or ``end_station_m``). With that speed u and the offset y, the
    heading is that of the path + atan2(y', u), and the speed hypot(u, y').

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
        dt_s: time between two points, > 0.
        ramp_s: time over which acceleration builds up.

    Raises:
        ValueError: a value out of range, too little path left to stop, or the object would stand
            before the lane change is complete.
    """
    if not duration_s > 0.0:
        raise ValueError(f"the duration of a lane change must be positive, got {duration_s}")
    if start_speed_mps <= 0.0:
        raise ValueError(
            f"a lane change needs a moving object, this one starts at {start_speed_mps:.2f} m/s"
        )

    def speed(room_m: float) -> SpeedProfile:
        profile = SpeedProfile(
            start_speed_mps, cruise_mps, room_m, acceleration_mps2, deceleration_mps2, ramp_s
        )
        if duration_s >= profile.duration_s:
            raise ValueError(
                f"a lane change of {duration_s:g} s needs a moving object all the while; this one "
                f"starts at {start_speed_mps:.2f} m/s and stands after {profile.duration_s:.2f} s"
            )
        return profile

    end = path.length_m if end_station_m is None else end_station_m
    shift = _Shift(start_offset_m, lateral_shift_m, duration_s)
    return _driven(path, start_station_m, end, shift, speed, dt_s)
