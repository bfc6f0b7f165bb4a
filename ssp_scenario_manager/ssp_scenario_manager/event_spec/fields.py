"""Fields of a K*: their paths, their units, what each measures, and the limits of the platforms."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Literal

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
    """Return names of the units that measure a dimension, the SI unit first."""
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
        """Tell whether a value, or all of another span, lies inside."""
        low, high = (other.low, other.high) if isinstance(other, Span) else (other, other)
        return self.low <= low + _EPS and high <= self.high + _EPS

    def meets(self, other: Span) -> bool:
        """Tell whether both have a value in common."""
        return self.low <= other.high + _EPS and other.low <= self.high + _EPS

    def nearest(self, value: float) -> float:
        """Return the value moved inside."""
        return min(max(value, self.low), self.high)


Part = str | int

# A name, after a dot but for the first, or an index.
_PART = re.compile(r"(?:^|(?<!^)\.)([^.\[\]]+)|\[(\d{1,6})\]")
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
    """Split a path into its parts; list indices are ints. A path that isn't one gives ()."""
    parts: list[Part] = []
    at = 0
    while at < len(path):
        match = _PART.match(path, at)
        if match is None:
            return ()
        name, index = match.groups()
        parts.append(name if name is not None else int(index))
        at = match.end()
    return tuple(parts)


def join(parts: tuple[Part, ...]) -> str:
    """Join the parts of a path."""
    text = ""
    for part in parts:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


def get(value: Any, path: str) -> Any:
    """Return the value at a path.

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


def put(value: Any, path: str, new: Any) -> None:
    """Set the value at a path whose parents are there."""
    *parents, last = split(path)
    for part in parents:
        value = value[part]
    value[last] = new


def has(value: Any, path: str) -> bool:
    """Tell whether a mapping has an entry at a path, null included."""
    try:
        get(value, path)
    except LookupError:
        return False
    return True


def leaves(value: Any, at: tuple[Part, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Yield every (path, value) without parts; an empty list or mapping is one too."""
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from leaves(item, (*at, key))
    elif isinstance(value, list) and value:
        for index, item in enumerate(value):
            yield from leaves(item, (*at, index))
    else:
        yield join(at), value


def granules(value: Any, at: tuple[Part, ...] = ()) -> Iterator[str]:
    """Yield paths of the smallest things that are judged: a word, a quantity, a list, a cell."""
    if isinstance(value, dict) and value and frozenset(value) not in _WHOLE:
        for key, item in value.items():
            yield from granules(item, (*at, key))
    else:
        yield join(at)


def owner(path: str, entries: Mapping[str, Any]) -> str | None:
    """Return the entry of a path: its own or its nearest ancestor's; None without one."""
    while path:
        if path in entries:
            return path
        path = path[: max(path.rfind("."), path.rfind("["), 0)]
    return None


def within(path: str, ancestor: str) -> bool:
    """Tell whether a path is the ancestor or lies below it."""
    return path == ancestor or path.startswith((ancestor + ".", ancestor + "["))


@lru_cache(maxsize=1 << 14)
def matches(path: str, pattern: str) -> bool:
    """Tell whether a path is of a pattern's shape; ``*`` stands for one name each."""
    names, pattern_names = path.split("."), pattern.split(".")
    pairs = zip(names, pattern_names, strict=False)
    return len(names) == len(pattern_names) and all(want in ("*", name) for name, want in pairs)


def show(value: Any) -> str:
    """Return a field's value as people write it."""
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


# range: both ends; floor: at least min; ceiling: at most max; exact: one value, min = max.
Shape = Literal["range", "floor", "ceiling", "exact"]


@dataclass(frozen=True, slots=True)
class Rule:
    """A quantity's meaning, its form, and the values that the platforms can do (SI units)."""

    dimension: Dimension
    shape: Shape
    limit: Span

    @property
    def needs(self) -> tuple[str, ...]:
        """The ends that it must have; it has no other."""
        return {"floor": ("min",), "ceiling": ("max",)}.get(self.shape, ("min", "max"))


LONGEST_CLIP_S = 120.0
_SPEED = Span(0.0, 16.0)
_ACCELERATION = Span(0.1, 5.0)
_CLIP = Span(0.0, LONGEST_CLIP_S)
RULES: dict[str, Rule] = {
    "source.rate": Rule("frequency", "exact", Span(1.0, 240.0)),
    "topology.lane_width.*": Rule("length", "range", Span(2.5, 5.0)),
    # A turn at a junction in a town has a radius of 7 m and more.
    "topology.curvature.*": Rule("curvature", "range", Span(0.0, 0.15)),
    "participants.*.region.gap": Rule("length", "range", Span(0.0, 200.0)),
    "events.clip.*": Rule("time", "exact", _CLIP),
    "events.*.start": Rule("time", "range", _CLIP),
    "constraints.speeds.*.*": Rule("speed", "range", _SPEED),
    "constraints.time_gap": Rule("time", "range", Span(0.0, 20.0)),
    "constraints.thresholds.*": Rule("time", "exact", Span(0.5, 10.0)),
    "constraints.camera.hfov": Rule("angle", "range", Span(math.radians(20), math.radians(140))),
    "constraints.camera.width": Rule("pixels", "floor", Span(64.0, 4096.0)),
    "constraints.camera.rate": Rule("frequency", "range", Span(1.0, 60.0)),
    "constraints.camera.visible_fraction": Rule("share", "range", Span(0.5, 1.0)),
    "constraints.site.length": Rule("length", "floor", Span(20.0, 2000.0)),
    "constraints.site.lateral_clearance": Rule("length", "floor", Span(0.1, 50.0)),
    "constraints.safety.speed": Rule("speed", "ceiling", _SPEED),
    "constraints.safety.acceleration": Rule("acceleration", "ceiling", _ACCELERATION),
    "constraints.safety.separation": Rule("length", "floor", Span(0.3, 10.0)),
    "constraints.safety.duration": Rule("time", "ceiling", Span(10.0, 120.0)),
}
# Fields whose meaning depends on the event: on the trigger's quantity, and on the kind's units.
TRIGGER_FIELD = "constraints.trigger.below"
_TRIGGER = {
    "relative_distance": Rule("length", "range", Span(2.0, 100.0)),
    "time_to_arrival": Rule("time", "range", Span(0.5, 20.0)),
}
MANOEUVRE_FIELD = "constraints.manoeuvre"
_MANOEUVRE = {
    "speed": Rule("speed", "range", _SPEED),
    "acceleration": Rule("acceleration", "range", _ACCELERATION),
    "time": Rule("time", "range", Span(0.5, 10.0)),
    "length": Rule("length", "range", Span(0.1, 20.0)),
}
# Quantities of manoeuvres whose sign is a side, + left.
_SIDED = {"offset": Rule("length", "range", Span(-2.0, 2.0))}


def rule_of(path: str, trigger_quantity: str, manoeuvre_units: Mapping[str, str]) -> Rule | None:
    """Return the rule of the quantity at a path; None where it is not known.

    Args:
        path: of the quantity.
        trigger_quantity: ``constraints.trigger.quantity``.
        manoeuvre_units: units by name, of the kind of interaction (`Kind.manoeuvre`).
    """
    if path == TRIGGER_FIELD:
        return _TRIGGER.get(trigger_quantity)
    if path.startswith(MANOEUVRE_FIELD + "."):
        name = path[len(MANOEUVRE_FIELD) + 1 :]
        unit = UNITS.get(manoeuvre_units.get(name, ""))
        if unit and name in _SIDED:
            return _SIDED[name]
        return _MANOEUVRE.get(unit.dimension) if unit else None
    return _rule_of(path)


@lru_cache(maxsize=1 << 12)
def _rule_of(path: str) -> Rule | None:
    return next((rule for pattern, rule in RULES.items() if matches(path, pattern)), None)
