"""Speed over time along a path: to cruise speed, held, and to a standstill after a distance.

Speeds follow a trapezoid over time whose corners are rounded by a moving average of ``ramp_s``, so
that acceleration is continuous and an object with actuator lag can follow it. A moving average
keeps the distance, so the standstill is exactly at the end of the path.
"""

from __future__ import annotations

import math

import numpy as np

from ssp_core.geometry import FloatArray

DEFAULT_RAMP_S = 0.4
# Two points closer in time than this are one.
SAME_TIME_S = 1e-6


# From when on, distance, speed and constant acceleration then, integral of distance up to then.
_Piece = tuple[float, float, float, float, float]


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
        pieces = self._plan(start_mps, peak, room, acceleration_mps2, deceleration_mps2)
        self._pieces = np.array(pieces).T
        self.duration_s = pieces[-1][0] + ramp_s
        self.distance_m = distance_m

    @staticmethod
    def _plan(v0: float, peak: float, room_m: float, a: float, d: float) -> list[_Piece]:
        first = a if peak >= v0 else -d
        t_change = abs(peak - v0) / abs(first)
        s_change = 0.5 * (v0 + peak) * t_change
        s_brake = peak * peak / (2.0 * d)
        t_hold = max(room_m - s_change - s_brake, 0.0) / peak if peak > 0.0 else 0.0
        t_brake = t_change + t_hold
        starts = [
            (0.0, 0.0, v0, first),
            (t_change, s_change, peak, 0.0),
            (t_brake, s_change + peak * t_hold, peak, -d),
            (t_brake + peak / d, s_change + peak * t_hold + s_brake, 0.0, 0.0),
        ]
        # Integral of distance up to each piece's start.
        total, pieces = 0.0, []
        for i, (t, s, v, rate) in enumerate(starts):
            pieces.append((t, s, v, rate, total))
            u = starts[i + 1][0] - t if i + 1 < len(starts) else 0.0
            total += s * u + v * u**2 / 2.0 + rate * u**3 / 6.0
        return pieces

    def _sharp(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Evaluate the trapezoid: distance, speed, acceleration and integral of distance.

        Before t = 0 it has its start speed.
        """
        index = np.searchsorted(self._pieces[0], t_s, side="right") - 1
        start, s, v, a, integral = self._pieces[:, np.maximum(index, 0)]
        u = t_s - start
        a = np.where(index < 0, 0.0, a)
        distance = s + u * (v + u * (0.5 * a))
        return distance, v + a * u, a, integral + u * (s + u * (v / 2.0 + u * (a / 6.0)))

    def over(self, times_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return distance in m, speed in m/s and acceleration in m/s^2 at times in s, shape (n,).

        The times are >= 0.
        """
        width = self._ramp_s
        distance, speed, acceleration, integral = self._sharp(times_s)
        if width > SAME_TIME_S:
            before = self._sharp(times_s - width)
            acceleration = (speed - before[1]) / width
            speed = np.maximum((distance - before[0]) / width, 0.0)
            distance = (integral - before[3]) / width + 0.5 * self._start_mps * width
        over = times_s >= self.duration_s
        return (
            np.where(over, self.distance_m, distance),
            np.where(over, 0.0, speed),
            np.where(over, 0.0, acceleration),
        )

    def at(self, t_s: float) -> tuple[float, float, float]:
        """Return distance in m, speed in m/s and acceleration in m/s^2 at a time in s.

        The time counts from the start.
        """
        distance, speed, acceleration = self.over(np.array([t_s]))
        return float(distance[0]), float(speed[0]), float(acceleration[0])

    def times(self, dt_s: float) -> FloatArray:
        """Return times 0, dt, 2 dt, … and the end, rising strictly.

        Raises:
            ValueError: dt_s isn't positive.
        """
        if not dt_s > 0.0:
            raise ValueError(f"dt_s must be positive, got {dt_s}")
        count = math.ceil(self.duration_s / dt_s - SAME_TIME_S)
        times = np.arange(count + 1, dtype=np.float64)
        times *= dt_s
        times[-1] = self.duration_s
        return times
