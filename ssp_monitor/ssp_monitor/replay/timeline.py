"""Which time of the bag belongs to which time of the steady clock, and the other way round."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

SLOWEST, FASTEST = 0.01, 1000.0
_RATES = (
    *(base * power for power in (0.01, 0.1, 1.0, 10.0, 100.0) for base in (1.0, 2.0, 5.0)),
    FASTEST,
)


@dataclass(frozen=True, slots=True)
class Timeline:
    """A straight line: bag time advances ``rate`` times as fast as the steady clock.

    Every change gives a new timeline that goes on from where the old one was, so that nothing is
    repeated, left out or drifts away.

    Args:
        bag_ns: bag time at ``steady_ns``; before it bag time stands there.
        steady_ns: steady clock.
        rate: bag seconds per second, above 0.
        paused: bag time stands.
    """

    bag_ns: int
    steady_ns: int
    rate: float = 1.0
    paused: bool = False

    def at(self, steady_ns: int) -> int:
        """Bag time at a time of the steady clock."""
        if self.paused or steady_ns <= self.steady_ns:
            return self.bag_ns
        return self.bag_ns + math.floor((steady_ns - self.steady_ns) * self.rate)

    def due_ns(self, bag_ns: int) -> int | None:
        """When something of the bag is due, steady clock; None while paused."""
        if self.paused:
            return None
        return self.steady_ns + math.ceil((bag_ns - self.bag_ns) / self.rate)

    def set_paused(self, paused: bool, now_ns: int) -> Timeline:
        """Standing from now on, or going on from where it stands."""
        if paused == self.paused:
            return self
        return Timeline(self.at(now_ns), max(now_ns, self.steady_ns), self.rate, paused)

    def set_rate(self, rate: float, now_ns: int) -> Timeline:
        """Another rate from now on.

        Raises:
            ValueError: the rate is outside SLOWEST to FASTEST.
        """
        if not SLOWEST <= rate <= FASTEST:
            raise ValueError(f"the rate must be from {SLOWEST:g} to {FASTEST:g}, got {rate:g}")
        return Timeline(self.at(now_ns), max(now_ns, self.steady_ns), rate, self.paused)

    def moved_to(self, bag_ns: int) -> Timeline:
        """A paused timeline at another bag time; a timeline that runs stays as it is."""
        return replace(self, bag_ns=bag_ns) if self.paused else self


def faster(rate: float) -> float:
    """The next rate of 1, 2, 5, 10 and so on above this one."""
    return next((known for known in _RATES if known > rate * 1.001), FASTEST)


def slower(rate: float) -> float:
    """The next rate of that row below this one."""
    return next((known for known in reversed(_RATES) if known < rate * 0.999), SLOWEST)
