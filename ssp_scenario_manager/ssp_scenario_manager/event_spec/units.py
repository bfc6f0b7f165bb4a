"""Units of a K*, and what a quantity is in SI units."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Dimension = Literal[
    "time",
    "length",
    "speed",
    "acceleration",
    "curvature",
    "angle",
    "pixels",
    "frequency",
    "share",
]
# Comparisons forgive what a conversion of units rounds away.
_EPS = 1e-9


@dataclass(frozen=True, slots=True)
class Unit:
    """A unit: what it measures, and how much of the dimension's SI unit it is."""

    dimension: Dimension
    factor: float


UNITS: dict[str, Unit] = {
    "s": Unit("time", 1.0),
    "ms": Unit("time", 1e-3),
    "m": Unit("length", 1.0),
    "m/s": Unit("speed", 1.0),
    "km/h": Unit("speed", 1.0 / 3.6),
    "m/s^2": Unit("acceleration", 1.0),
    "1/m": Unit("curvature", 1.0),
    "rad": Unit("angle", 1.0),
    "deg": Unit("angle", math.pi / 180.0),
    "px": Unit("pixels", 1.0),
    "Hz": Unit("frequency", 1.0),
    "1": Unit("share", 1.0),
    "%": Unit("share", 0.01),
}


def units_of(dimension: Dimension) -> list[str]:
    """Names of the units that measure a dimension, the SI unit first."""
    return [name for name, unit in UNITS.items() if unit.dimension == dimension]


@dataclass(frozen=True, slots=True)
class Span:
    """An interval in SI units; an open side is infinite."""

    low: float = -math.inf
    high: float = math.inf

    @property
    def mid(self) -> float:
        """Its middle; of a half-open span its closed end."""
        if math.isinf(self.low) or math.isinf(self.high):
            return self.high if math.isinf(self.low) else self.low
        return 0.5 * (self.low + self.high)

    def holds(self, other: Span | float) -> bool:
        """Whether a value, or all of another span, lies inside."""
        low, high = (other.low, other.high) if isinstance(other, Span) else (other, other)
        return self.low <= low + _EPS and high <= self.high + _EPS

    def meets(self, other: Span) -> bool:
        """Whether both have a value in common."""
        return self.low <= other.high + _EPS and other.low <= self.high + _EPS

    def nearest(self, value: float) -> float:
        """The value, moved inside."""
        return min(max(value, self.low), self.high)
