"""The newest states of one object, from which windows are cut (METHOD 4.3b).

This file owns what is remembered and where windows may begin: old samples are forgotten now and
then, and the beginnings move with them. Reads no clock.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from typing import NamedTuple

from ssp_core.clock import ns_to_seconds
from ssp_core.safety.window import LEAST_SAMPLES, WINDOW_S, Window

# Three sigma of the distance between two places.
SIGMAS = 3.0 * math.sqrt(2.0)
# So much is remembered.
_REMEMBERED_S = 3.0


class MotionSample(NamedTuple):
    """One state; a tuple, since one is made for each state of each object.

    Args:
        t_s: since the first.
        yaw_rad: without jumps by a whole turn.
        way_m: integral of the stated speed.
        turn_rads: integral of the yaw.
    """

    t_s: float
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    std_m: float
    way_m: float
    turn_rads: float


class MotionSamples:
    """Samples in rising time, and the numbers of those with which windows begin.

    Args:
        position_std_m: no place counts as less certain than this.
        pause_s: without a state for longer than this, windows begin anew.

    Attributes:
        rows: the samples.
        t_s: the time of each.
        speed_from: with which the newest window of the speed begins.
        way_from: with which the newest window of the direction begins.
    """

    def __init__(self, position_std_m: float, pause_s: float) -> None:
        self.rows: list[MotionSample] = []
        self.t_s: list[float] = []
        self.speed_from = self.way_from = 0
        self._begin = 0  # no window, shifted or not, reaches back behind this one
        self._zero_ns = 0
        self._most_std_m = position_std_m
        self._pause_s = pause_s

    def lag_s(self, stamp_ns: int) -> float:
        """Return how far a stamp lies before the newest sample; -inf where there is none."""
        if not self.t_s:
            return -math.inf
        return self.t_s[-1] - ns_to_seconds(stamp_ns - self._zero_ns)

    def append(
        self,
        stamp_ns: int,
        x_m: float,
        y_m: float,
        yaw_rad: float,
        speed_mps: float,
        std_m: float,
    ) -> bool:
        """Add a state that is newer than the newest.

        Returns:
            True after a pause: windows begin anew.
        """
        rows, most = self.rows, self._most_std_m
        t = way = turn = 0.0
        paused = False
        if rows:
            t = ns_to_seconds(stamp_ns - self._zero_ns)
            last_t, _, _, last_yaw, last_speed, _, way, turn = rows[-1]
            yaw_rad = last_yaw + math.remainder(yaw_rad - last_yaw, math.tau)
            dt = t - last_t
            way += 0.5 * (last_speed + speed_mps) * dt
            turn += 0.5 * (last_yaw + yaw_rad) * dt
            paused = dt > self._pause_s
            if paused:
                self.restart(len(rows))
        else:
            self._zero_ns = stamp_ns
        std_m = std_m if std_m <= most else most
        rows.append(MotionSample(t, x_m, y_m, yaw_rad, speed_mps, std_m, way, turn))
        self.t_s.append(t)
        # Now and then, so that it costs nothing.
        if len(rows) >= 64 and self.t_s[len(rows) // 2] < t - _REMEMBERED_S:
            self._forget(len(rows) // 2)
        return paused

    def _forget(self, number: int) -> None:
        del self.t_s[:number], self.rows[:number]
        self._begin = max(self._begin - number, 0)
        self.speed_from = max(self.speed_from - number, 0)
        self.way_from = max(self.way_from - number, 0)

    def restart(self, at: int) -> None:
        """Let windows begin with the sample of this number at the earliest."""
        self._begin = self.speed_from = self.way_from = at

    # -- windows -------------------------------------------------------------------------------

    def window_start(self) -> int | None:
        """Give the newest sample from which a window ends now; None: there is none."""
        n = len(self.t_s) - 1
        latest = self.t_s[n] - WINDOW_S + 1e-9
        first = self.speed_from
        while first + 1 <= n - (LEAST_SAMPLES - 1) and self.t_s[first + 1] <= latest:
            first += 1
        self.speed_from = first
        fits = first <= n - (LEAST_SAMPLES - 1) and self.t_s[first] <= latest
        return first if fits else None

    def window(self, first: int) -> Window:
        """Give the window from a sample to the newest one."""
        a, b = self.rows[first], self.rows[-1]
        span = b.t_s - a.t_s
        return Window(
            span,
            (b.x_m - a.x_m) / span,
            (b.y_m - a.y_m) / span,
            (b.way_m - a.way_m) / span,
            (b.turn_rads - a.turn_rads) / span,
        )

    def shifted(self, first: int, delay_s: float) -> Window | None:
        """Give the window with its motion, or its places, so much older; both end by now."""
        begin, end = self.t_s[first], self.t_s[-1]
        older = abs(delay_s)
        if begin - older < self.t_s[self._begin]:
            return None
        span = end - begin
        old, new = (begin - older, end - older), (begin, end)
        places, motion = (new, old) if delay_s > 0.0 else (old, new)

        (ax, ay, _, _), (bx, by, _, _) = map(self._at, places)
        (_, _, a_way, a_turn), (_, _, b_way, b_turn) = map(self._at, motion)
        return Window(
            span,
            (bx - ax) / span,
            (by - ay) / span,
            (b_way - a_way) / span,
            (b_turn - a_turn) / span,
        )

    def _at(self, t: float) -> tuple[float, float, float, float]:
        """Give x, y, way and turn between two samples."""
        i = min(max(bisect_right(self.t_s, t) - 1, 0), len(self.t_s) - 2)
        a, b = self.rows[i], self.rows[i + 1]
        share = (t - a.t_s) / (b.t_s - a.t_s)
        return (
            a.x_m + share * (b.x_m - a.x_m),
            a.y_m + share * (b.y_m - a.y_m),
            a.way_m + share * (b.way_m - a.way_m),
            a.turn_rads + share * (b.turn_rads - a.turn_rads),
        )

    # -- figures -------------------------------------------------------------------------------

    def chord_m(self, first: int) -> float:
        """Return the distance from a sample's place to the newest one."""
        a, b = self.rows[first], self.rows[-1]
        return math.hypot(b.x_m - a.x_m, b.y_m - a.y_m)

    def noise_m(self, first: int) -> float:
        """Return how uncertain the distance from a sample's place to the newest one is."""
        return SIGMAS * max(self.rows[first].std_m, self.rows[-1].std_m)

    def step(self, k: int) -> tuple[float, float, float]:
        """Return the time and the way, along x and y, from the sample before to this one."""
        a, b = self.rows[k - 1], self.rows[k]
        return b.t_s - a.t_s, b.x_m - a.x_m, b.y_m - a.y_m

    def fastest_mps(self, since_s: float) -> float:
        """Return the largest amount of the speeds stated since a time."""
        return max(abs(one.speed_mps) for one in self.rows if one.t_s >= since_s)

    def net_way_m(self, span_s: float) -> tuple[float, float]:
        """Give the chord of the last seconds, and how many of them the states cover.

        Returns:
            Way in m and time in s, at most ``span_s``; 0 and 0 where there is no state.
        """
        if not self.t_s:
            return 0.0, 0.0
        since = self.t_s[-1] - span_s
        first = max(bisect_right(self.t_s, since + 1e-9) - 1, 0)
        covered = min(self.t_s[-1] - self.t_s[first], span_s)
        return self.chord_m(first), covered

    @property
    def position_std_m(self) -> float:
        """Return how uncertain the newest place is; no more than counts."""
        return self.rows[-1].std_m if self.rows else 0.0
