"""Units of the quantities in a K*: which a field wants, which are known, and their SI values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

from ssp_scenario_manager.spec.fields import matches
from ssp_scenario_manager.spec.model import Interval

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

# Field pattern: what the field measures. constraints.trigger.below depends on its quantity and
# constraints.manoeuvre.* on the kind of interaction; both are settled in `dimension_of`.
FIELDS: dict[str, Dimension] = {
    "source.rate": "frequency",
    "topology.lane_width.*": "length",
    "topology.curvature.*": "curvature",
    "participants.*.region.gap": "length",
    "events.clip.start": "time",
    "events.clip.end": "time",
    "events.*.start": "time",
    "constraints.speeds.*.*": "speed",
    "constraints.time_gap": "time",
    "constraints.thresholds.*": "time",
    "constraints.camera.hfov": "angle",
    "constraints.camera.width": "pixels",
    "constraints.camera.rate": "frequency",
    "constraints.camera.visible_fraction": "share",
    "constraints.site.*": "length",
    "constraints.safety.speed": "speed",
    "constraints.safety.acceleration": "acceleration",
    "constraints.safety.separation": "length",
    "constraints.safety.duration": "time",
}
TRIGGER_FIELD = "constraints.trigger.below"
TRIGGER_DIMENSIONS: dict[str, Dimension] = {
    "relative_distance": "length",
    "time_to_arrival": "time",
}
MANOEUVRE_FIELD = "constraints.manoeuvre"


def units_of(dimension: Dimension) -> list[str]:
    """Names of the units that measure a dimension, the SI unit first."""
    return [name for name, unit in UNITS.items() if unit.dimension == dimension]


def dimension_of(
    path: str, trigger_quantity: str, manoeuvre_units: dict[str, str]
) -> Dimension | None:
    """What a quantity field measures; None where nobody knows.

    Args:
        path: of the quantity.
        trigger_quantity: ``constraints.trigger.quantity``.
        manoeuvre_units: units by name, of the kind of interaction (`Kind.manoeuvre`).
    """
    if path == TRIGGER_FIELD:
        return TRIGGER_DIMENSIONS.get(trigger_quantity)
    if path.startswith(MANOEUVRE_FIELD + "."):
        unit = manoeuvre_units.get(path[len(MANOEUVRE_FIELD) + 1 :])
        return UNITS[unit].dimension if unit in UNITS else None
    return _dimension_of(path)


@lru_cache(maxsize=1 << 12)
def _dimension_of(path: str) -> Dimension | None:
    return next((what for pattern, what in FIELDS.items() if matches(path, pattern)), None)


@dataclass(frozen=True, slots=True)
class Span:
    """An interval in SI units; an open side is infinite."""

    low: float
    high: float

    @property
    def mid(self) -> float:
        """Its middle; of a half-open span its closed end."""
        if math.isinf(self.low) or math.isinf(self.high):
            return self.high if math.isinf(self.low) else self.low
        return 0.5 * (self.low + self.high)

    def holds(self, other: Span) -> bool:
        """Whether the other lies inside."""
        return self.low <= other.low + _EPS and other.high <= self.high + _EPS

    def meets(self, other: Span) -> bool:
        """Whether both have a value in common."""
        return self.low <= other.high + _EPS and other.low <= self.high + _EPS


# Comparisons forgive what a conversion of units rounds away.
_EPS = 1e-9


def si(interval: Interval) -> Span:
    """An interval in SI units.

    Raises:
        ValueError: nobody knows its unit.
    """
    unit = UNITS.get(interval.unit)
    if unit is None:
        raise ValueError(f"no unit is called {interval.unit!r}; known: {', '.join(UNITS)}")
    low = -math.inf if interval.min is None else interval.min * unit.factor
    high = math.inf if interval.max is None else interval.max * unit.factor
    return Span(low, high)
