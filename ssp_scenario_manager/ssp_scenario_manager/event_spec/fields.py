"""Fields of a K*: their dotted paths, units and SI values, and the limits of the platforms."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

from ssp_scenario_manager.event_spec.model import Interval

Part = str | int

_PART = re.compile(r"([^.\[\]]+)|\[(\d{1,6})\]")
ROAD_FIELD = frozenset({"value", "identity", "varies", "why"})
# Mappings that a person judges as one: a field of the road, a quantity, a count, one participant
# in one phase.
_WHOLE = (
    ROAD_FIELD,
    frozenset({"min", "max", "unit"}),
    frozenset({"min", "max"}),
    frozenset({"position", "motion", "heading", "speed_trend", "longitudinal", "lateral"}),
)


@lru_cache(maxsize=1 << 13)
def split(path: str) -> tuple[Part, ...]:
    """Parts of a path; list indices are ints. A path that isn't one gives ()."""
    parts: list[Part] = []
    at = 0
    while at < len(path):
        if path[at] == "." and 0 < at < len(path) - 1:
            at += 1
        found = _PART.match(path, at)
        if found is None:
            return ()
        name, index = found.groups()
        parts.append(name if name is not None else int(index))
        at = found.end()
    return tuple(parts)


def join(parts: tuple[Part, ...]) -> str:
    """The path of its parts."""
    text = ""
    for part in parts:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


def get(value: Any, path: str) -> Any:
    """The value at a path.

    Raises:
        LookupError: there is nothing.
    """
    parts = split(path)
    if not parts:
        raise LookupError(path)
    for part in parts:
        try:
            value = value[part]
        except (TypeError, LookupError) as error:
            raise LookupError(path) from error
    return value


def has(value: Any, path: str) -> bool:
    """Whether a mapping has something at a path, null included."""
    try:
        get(value, path)
    except LookupError:
        return False
    return True


def leaves(value: Any, at: tuple[Part, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Every (path, value) that isn't made of others; an empty list or mapping is one too."""
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from leaves(item, (*at, key))
    elif isinstance(value, list) and value:
        for index, item in enumerate(value):
            yield from leaves(item, (*at, index))
    else:
        yield join(at), value


def granules(value: Any, at: tuple[Part, ...] = ()) -> Iterator[str]:
    """Paths of the smallest things that a person judges: a word, a quantity, a list, a cell."""
    if isinstance(value, dict) and value and frozenset(value) not in _WHOLE:
        for key, item in value.items():
            yield from granules(item, (*at, key))
    else:
        yield join(at)


def owner(path: str, entries: Mapping[str, Any]) -> str | None:
    """The entry of a path: its own or its nearest ancestor's; None without one."""
    while path:
        if path in entries:
            return path
        path = path[: max(path.rfind("."), path.rfind("["), 0)]
    return None


def within(path: str, ancestor: str) -> bool:
    """Whether a path is the ancestor or lies below it."""
    return path == ancestor or path.startswith((ancestor + ".", ancestor + "["))


@lru_cache(maxsize=1 << 14)
def matches(path: str, pattern: str) -> bool:
    """Whether a path is of a pattern's shape; ``*`` stands for one name each."""
    names, wanted = path.split("."), pattern.split(".")
    pairs = zip(names, wanted, strict=False)
    return len(names) == len(wanted) and all(want in ("*", name) for name, want in pairs)


def show(value: Any) -> str:
    """A field's value as people write it."""
    if isinstance(value, dict) and set(value) == {"min", "max", "unit"}:
        low, high = value["min"], value["max"]
        unit = "" if value["unit"] == "1" else f" {value['unit']}"
        if low is None or high is None:
            known_end = low if low is not None else high
            sign = "at least" if high is None else "at most"
            return "open on both sides" if known_end is None else f"{sign} {known_end:g}{unit}"
        return f"{low:g}{unit}" if low == high else f"{low:g}–{high:g}{unit}"
    if isinstance(value, dict) and set(value) == {"min", "max"}:
        return f"{value['min']}" if value["min"] == value["max"] else "{min}–{max}".format(**value)
    if isinstance(value, dict) and set(value) == ROAD_FIELD:
        if value["identity"]:
            return f"{show(value['value'])} (identity)"
        varies = value["varies"]
        text = show(value["value"])
        return text if varies is None else f"{text} (varies: {show(varies)})"
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {show(item)}" for key, item in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(show(item) for item in value) + "]"
    if value is None:
        return "null"
    return f"{value:g}" if isinstance(value, float) else str(value)


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


# range: both ends; floor: at least min; ceiling: at most max; exact: one value, min = max.
Shape = Literal["range", "floor", "ceiling", "exact"]


@dataclass(frozen=True, slots=True)
class Platform:
    """Limits in SI units (px, Hz and shares as they are)."""

    speed: Span
    acceleration: Span
    separation: Span
    duration: Span
    clip: Span
    lane_width: Span
    curvature: Span
    gap: Span
    trigger_distance: Span
    trigger_time: Span
    threshold: Span
    time_gap: Span
    manoeuvre_time: Span
    manoeuvre_length: Span
    hfov: Span
    width: Span
    camera_rate: Span
    source_rate: Span
    share: Span
    site_length: Span
    lateral_clearance: Span


PLATFORM = Platform(
    speed=Span(0.0, 16.0),
    acceleration=Span(0.1, 5.0),
    separation=Span(0.3, 10.0),
    duration=Span(10.0, 120.0),
    clip=Span(0.0, 120.0),
    lane_width=Span(2.5, 5.0),
    curvature=Span(0.0, 0.1),
    gap=Span(0.0, 200.0),
    trigger_distance=Span(2.0, 100.0),
    trigger_time=Span(0.5, 10.0),
    threshold=Span(0.5, 10.0),
    time_gap=Span(0.0, 20.0),
    manoeuvre_time=Span(0.5, 10.0),
    manoeuvre_length=Span(0.1, 20.0),
    hfov=Span(math.radians(20.0), math.radians(140.0)),
    width=Span(64.0, 4096.0),
    camera_rate=Span(1.0, 60.0),
    source_rate=Span(1.0, 240.0),
    share=Span(0.5, 1.0),
    site_length=Span(20.0, 2000.0),
    lateral_clearance=Span(0.1, 50.0),
)


@dataclass(frozen=True, slots=True)
class Rule:
    """How a quantity is given, and the name of its limit in `Platform`."""

    shape: Shape
    limit: str


RULES: dict[str, Rule] = {
    "source.rate": Rule("exact", "source_rate"),
    "topology.lane_width.*": Rule("range", "lane_width"),
    "topology.curvature.*": Rule("range", "curvature"),
    "participants.*.region.gap": Rule("range", "gap"),
    "events.clip.*": Rule("exact", "clip"),
    "events.*.start": Rule("range", "clip"),
    "constraints.speeds.*.*": Rule("range", "speed"),
    "constraints.time_gap": Rule("range", "time_gap"),
    "constraints.thresholds.*": Rule("exact", "threshold"),
    "constraints.camera.hfov": Rule("range", "hfov"),
    "constraints.camera.width": Rule("floor", "width"),
    "constraints.camera.rate": Rule("range", "camera_rate"),
    "constraints.camera.visible_fraction": Rule("range", "share"),
    "constraints.site.length": Rule("floor", "site_length"),
    "constraints.site.lateral_clearance": Rule("floor", "lateral_clearance"),
    "constraints.safety.speed": Rule("ceiling", "speed"),
    "constraints.safety.acceleration": Rule("ceiling", "acceleration"),
    "constraints.safety.separation": Rule("floor", "separation"),
    "constraints.safety.duration": Rule("ceiling", "duration"),
}
# By dimension, where the field's meaning depends on the event.
_TRIGGER = {"length": Rule("range", "trigger_distance"), "time": Rule("range", "trigger_time")}
_MANOEUVRE = {
    "speed": Rule("range", "speed"),
    "acceleration": Rule("range", "acceleration"),
    "time": Rule("range", "manoeuvre_time"),
    "length": Rule("range", "manoeuvre_length"),
}


def rule_of(path: str, dimension: str) -> Rule | None:
    """How the quantity at a path is to be given; None for a field without a rule."""
    if path == "constraints.trigger.below":
        return _TRIGGER.get(dimension)
    if path.startswith("constraints.manoeuvre."):
        return _MANOEUVRE.get(dimension)
    return next((rule for pattern, rule in RULES.items() if matches(path, pattern)), None)


def limit_of(rule: Rule) -> Span:
    """The platform's limit of a rule."""
    limit = getattr(PLATFORM, rule.limit)
    if not isinstance(limit, Span):
        raise TypeError(f"{rule.limit} is no limit")
    return limit
