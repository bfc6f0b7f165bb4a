"""A manoeuvre played faster or slower: the same path, another speed, by one law in closed form.

A manoeuvre has its own time tau, 0 where it begins as planned. Its pace is r = d tau / dt: 1 as
planned. With v(tau) and a(tau) as planned, an object that plays it at pace r drives the very same
path with speed r v and acceleration r^2 a + r' v. Since r stays > 0 it never reverses, and it
stands where the manoeuvre ends. The pace goes to a wanted one as a critically damped second-order
system does, r'' = w^2 (wanted - r) - 2 w r', so that speed and acceleration are continuous wherever
a new wish comes; from an own time on it goes back to 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.geometry import FloatArray, wrap_angle
from ssp_core.motion.reference import Points, ReferencePoint, between

# Natural frequencies of the law, 1/s: most of a change is made within 1 s; nothing presses on the
# way back, which comes on top of whatever the manoeuvre itself brakes.
OMEGA_1PS = 3.0
HOME_1PS = 1.0
_NEWTON_STEPS = 6
# Newton's steps take no pace for slower than this.
_SLOWEST = 0.05
_SAME_TIME_S = 1e-4


@dataclass(frozen=True, slots=True)
class _Leg:
    """The law from one instant on: own time, pace and its change then, and the wanted pace."""

    own_s: float
    rate: float
    change_1ps: float
    wanted: float
    omega_1ps: float = OMEGA_1PS

    def at(self, t_s: float) -> tuple[float, float, float]:
        """Own time, pace and change of pace, t_s after the leg's beginning."""
        w = self.omega_1ps
        off = self.rate - self.wanted
        slope = self.change_1ps + w * off
        fade = math.exp(-w * t_s)
        gone = off * (1.0 - fade) / w + slope * (1.0 - (1.0 + w * t_s) * fade) / (w * w)
        now = off + slope * t_s
        return (
            self.own_s + self.wanted * t_s + gone,
            self.wanted + now * fade,
            (slope - w * now) * fade,
        )

    def over(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As ``at``, for an array of times; shape (n,) each."""
        w = self.omega_1ps
        off = self.rate - self.wanted
        slope = self.change_1ps + w * off
        fade = np.exp(-w * t_s)
        gone = off * (1.0 - fade) / w + slope * (1.0 - (1.0 + w * t_s) * fade) / (w * w)
        now = off + slope * t_s
        own = self.own_s + self.wanted * t_s + gone
        return own, self.wanted + now * fade, (slope - w * now) * fade

    def when(self, own_s: float) -> float:
        """The inverse of own time: s after the leg's beginning, for an own time from then on.

        The pace is positive, so that own time rises and Newton's steps converge.
        """
        t = max(own_s - self.own_s, 0.0) / self.wanted
        for _ in range(_NEWTON_STEPS):
            reached, rate, _ = self.at(t)
            t = max(t + (own_s - reached) / max(rate, _SLOWEST), 0.0)
        return t

    def when_each(self, own_s: FloatArray) -> FloatArray:
        """As ``when``, for an array of own times; shape (n,)."""
        t = np.maximum(own_s - self.own_s, 0.0) / self.wanted
        for _ in range(_NEWTON_STEPS):
            reached, rate, _ = self.over(t)
            t = np.maximum(t + (own_s - reached) / np.maximum(rate, _SLOWEST), 0.0)
        return t


@dataclass(frozen=True, slots=True)
class Pace:
    """How a manoeuvre's own time passes in session time.

    Args:
        start_ns: session time from which on this holds.
        leg: the law from then on.
        switch_s: after so long it goes back to 1; inf: it is 1 already.
        home: the law from there on.
    """

    start_ns: int
    leg: _Leg
    switch_s: float = math.inf
    home: _Leg | None = None

    def at(self, now_ns: int) -> tuple[float, float, float]:
        """Own time in s, pace, and change of pace in 1/s at a session time."""
        t = ns_to_seconds(now_ns - self.start_ns)
        if self.home is not None and t >= self.switch_s:
            return self.home.at(t - self.switch_s)
        return self.leg.at(t)

    def when_each(self, own_s: FloatArray) -> FloatArray:
        """Times in s after start_ns at which own times are reached; shape (n,)."""
        if self.home is None:
            return self.leg.when_each(own_s)
        first = own_s <= self.home.own_s
        t = np.empty_like(own_s)
        t[first] = self.leg.when_each(own_s[first])
        t[~first] = self.switch_s + self.home.when_each(own_s[~first])
        return t

    def rates(self, t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Pace and its change at times in s after start_ns; shape (n,) each."""
        _, rate, change = self.leg.over(t_s)
        if self.home is None:
            return rate, change
        _, later_rate, later_change = self.home.over(np.maximum(t_s - self.switch_s, 0.0))
        later = t_s >= self.switch_s
        return np.where(later, later_rate, rate), np.where(later, later_change, change)

    def reached_ns(self, own_s: float) -> int:
        """Session time at which an own time that lies ahead is reached."""
        if self.home is not None and own_s > self.home.own_s:
            seconds = self.switch_s + self.home.when(own_s)
        else:
            seconds = self.leg.when(own_s)
        return self.start_ns + round(seconds * NS_PER_S)

    @property
    def wanted(self) -> float:
        """The pace that it goes to before it goes back to 1."""
        return self.leg.wanted


def as_planned(execute_at_ns: int) -> Pace:
    """The manoeuvre as it was dispatched."""
    return Pace(execute_at_ns, _Leg(0.0, 1.0, 0.0, 1.0))


def toward(before: Pace, start_ns: int, wanted: float, until_s: float) -> Pace:
    """Goes on from a pace to a wanted one, until an own time, and then back to 1."""
    own, rate, change = before.at(start_ns)
    leg = _Leg(own, rate, change, wanted)
    if until_s <= own:
        return Pace(start_ns, _Leg(own, rate, change, 1.0, HOME_1PS))
    switch_s = leg.when(until_s)
    _, later_rate, later_change = leg.at(switch_s)
    home = _Leg(until_s, later_rate, later_change, 1.0, HOME_1PS)
    return Pace(start_ns, leg, switch_s, home)


def wanted_rate(before: Pace, start_ns: int, own_s: float, in_s: float) -> float:
    """The wanted pace with which an own time is reached so long after start_ns; inf: none does.

    Own time is linear in the wanted pace: tau = r1 T + (r0 - r1) A + (r0' + w (r0 - r1)) B with
    A = (1 - e^(-wT)) / w and B = (1 - (1 + wT) e^(-wT)) / w^2.
    """
    own, rate, change = before.at(start_ns)
    if in_s <= 0.0:
        return math.inf
    w = OMEGA_1PS
    fade = math.exp(-w * in_s)
    a = (1.0 - fade) / w
    b = (1.0 - (1.0 + w * in_s) * fade) / (w * w)
    room = in_s - a - w * b
    if room <= 1e-9:
        return math.inf
    return (own_s - own - rate * (a + w * b) - change * b) / room


def play(columns: FloatArray, pace: Pace) -> Points:
    """A manoeuvre's points at a pace, from the pace's start on.

    Args:
        columns: of the manoeuvre over its own time, shape (7, n).
        pace: how its own time passes.
    """
    own_s, _, _ = pace.at(pace.start_ns)
    first = _point_at(columns, own_s)
    later = columns[:, columns[0] > own_s + _SAME_TIME_S]
    points = np.concatenate((first[:, None], later), axis=1)
    t = pace.when_each(points[0])
    t[0] = 0.0
    rate, change = pace.rates(t)
    speed, acceleration = points[4], points[5]
    points[5] = rate * rate * acceleration + change * speed
    points[4] = rate * speed
    # At its end it stands, and nothing is left of the acceleration that brought it there.
    points[5, -1] = np.where(points[4, -1] > 0.0, points[5, -1], 0.0)
    points[0] = t
    return Points(points)


def _point_at(columns: FloatArray, own_s: float) -> FloatArray:
    """The manoeuvre's point at an own time, shape (7,)."""
    i = int(np.searchsorted(columns[0], own_s, side="right"))
    if i == 0 or i == columns.shape[1]:
        edge = columns[:, min(i, columns.shape[1] - 1)].copy()
        edge[0] = own_s
        edge[5] = 0.0
        return edge
    a, b = ReferencePoint(*columns[:, i - 1].tolist()), ReferencePoint(*columns[:, i].tolist())
    p = between(a, b, own_s)
    return np.array(
        (own_s, p.x_m, p.y_m, wrap_angle(p.yaw_rad), p.speed_mps, p.acceleration_mps2,
         p.curvature_1pm)
    )  # fmt: skip
