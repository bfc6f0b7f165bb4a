"""Values inside part C: which may be chosen, and in which order they are tried."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from ssp_scenario_manager.interactions.base import CannotPlace
from ssp_scenario_manager.spec.model import Event, Interval, Quantity
from ssp_scenario_manager.spec.units import UNITS, si, units_of

# Values per quantity: the preferred one, and further ones from end to end of the interval.
_SPREAD = (0.5, 0.25, 0.75, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Choice:
    """What a quantity may be.

    Args:
        field: its path in K*.
        unit: of the values.
        values: preferred first, then ever further from it.
        why: where the first comes from.
    """

    field: str
    unit: str
    values: tuple[float, ...]
    why: str


def in_si(interval: Interval) -> Interval:
    """The same interval in the SI unit of what it measures; an unknown unit stays as it is."""
    if interval.unit not in UNITS:
        return interval
    span = si(interval)
    return Interval(
        min=None if math.isinf(span.low) else span.low,
        max=None if math.isinf(span.high) else span.high,
        unit=units_of(UNITS[interval.unit].dimension)[0],
    )


def quantity_at(event: Event, field: str) -> Quantity | None:
    """The quantity at a field's path, in SI units; None where K* has none.

    Only the fields that a compiler chooses values for are known: speeds, the trigger's threshold,
    manoeuvre quantities and the gap at the start.
    """
    found = _raw(event, field)
    return in_si(found) if isinstance(found, Interval) else found


def _raw(event: Event, field: str) -> Quantity | None:
    parts = field.split(".")
    c = event.constraints
    if parts[:2] == ["constraints", "speeds"] and len(parts) == 4:
        return next((q for p, q in c.speeds.get(parts[2], {}).items() if p == parts[3]), None)
    if parts == ["constraints", "trigger", "below"]:
        return c.trigger.below
    if parts[:2] == ["constraints", "manoeuvre"] and len(parts) == 3:
        return c.manoeuvre.get(parts[2])
    if parts[0] == "participants" and parts[2:] == ["region", "gap"]:
        who = event.participants.get(parts[1])
        return None if who is None else who.region.gap
    return None


def choose(
    event: Event,
    field: str,
    unit: str,
    preferred: Mapping[str, float],
    *,
    at_most: float = float("inf"),
    at_least: float = 0.0,
) -> Choice:
    """The values that a quantity may have: inside its interval and inside the place's limits.

    Args:
        event: K*.
        field: path of the quantity.
        unit: that it must have.
        preferred: values that are tried first, by field; a value outside the interval is moved to
            its end.
        at_most: the place's upper limit.
        at_least: the lower one.

    Raises:
        CannotPlace: it is unresolved or missing, has another unit or no side, or lies outside of
            what the place allows.
    """
    found = quantity_at(event, field)
    if not isinstance(found, Interval):
        state = "missing" if found is None else found
        raise CannotPlace(f"{field} is {state}; it needs an interval in {unit}")
    if found.unit != unit:
        raise CannotPlace(f"{field} is in {found.unit}; it must be in {unit}")
    if found.min is None and found.max is None:
        raise CannotPlace(f"{field} has neither min nor max")
    low = max(found.min if found.min is not None else at_least, at_least)
    high = min(found.max if found.max is not None else at_most, at_most)
    if high == float("inf"):
        high = low
    if low > high:
        raise CannotPlace(
            f"{field} must be within {_side(found.min)} and {_side(found.max)} {unit}; "
            f"the place allows {at_least:g} to {at_most:g} {unit}"
        )
    if field in preferred:
        first, why = min(max(preferred[field], low), high), "validated in simulation"
        if first != preferred[field]:
            why += f" as {preferred[field]:g} {unit}, moved into what K* and place allow"
    else:
        first, why = _middle(found, low, high)
    values = [first]
    for share in sorted(_SPREAD, key=lambda share: abs(low + share * (high - low) - first)):
        value = low + share * (high - low)
        if all(abs(value - known) > 1e-9 for known in values):
            values.append(value)
    return Choice(field, unit, tuple(values), why)


def _middle(interval: Interval, low: float, high: float) -> tuple[float, str]:
    """The middle of K*'s interval, moved into what the place allows."""
    if interval.min is None or interval.max is None:
        return (low if interval.max is None else high), "the side that K* gives"
    middle = 0.5 * (interval.min + interval.max)
    if low <= middle <= high:
        return middle, "middle of what K* allows"
    return min(max(middle, low), high), "the place's limit, next to the middle of what K* allows"


def fixed(event: Event, field: str, unit: str, value: float, why: str) -> Choice:
    """A quantity whose value follows from others: it must lie inside its interval, if it has one.

    Raises:
        CannotPlace: it doesn't, or the interval has another unit.
    """
    found = quantity_at(event, field)
    if isinstance(found, Interval):
        if found.unit != unit:
            raise CannotPlace(f"{field} is in {found.unit}; it must be in {unit}")
        if not inside(found, value):
            raise CannotPlace(
                f"{field} would be {value:.2f} {unit}, which is not within {_side(found.min)} "
                f"and {_side(found.max)} {unit}"
            )
    return Choice(field, unit, (value,), why)


def inside(interval: Interval, value: float) -> bool:
    """A value lies in a closed interval, within 1e-9."""
    low = interval.min is None or value >= interval.min - 1e-9
    return low and (interval.max is None or value <= interval.max + 1e-9)


def _side(value: float | None) -> str:
    return "any" if value is None else f"{value:g}"


def combinations(choices: Mapping[str, Choice]) -> Iterator[dict[str, float]]:
    """Every combination of values by name, the preferred ones first, then ever further away."""
    names = list(choices)
    sizes = [len(choices[name].values) for name in names]
    for total in range(sum(sizes) - len(sizes) + 1):
        for rank in _ranks(sizes, total):
            yield {name: choices[name].values[i] for name, i in zip(names, rank, strict=True)}


def _ranks(sizes: list[int], total: int) -> Iterator[tuple[int, ...]]:
    """Indices into lists of these sizes that sum up to a total, in order."""
    if not sizes:
        if total == 0:
            yield ()
        return
    for first in range(min(sizes[0] - 1, total) + 1):
        for rest in _ranks(sizes[1:], total - first):
            yield (first, *rest)


def chosen(
    choices: Mapping[str, Choice], values: Mapping[str, float]
) -> dict[str, tuple[float, str, str]]:
    """What was chosen, as a plan says it: (value, unit, why) by field."""
    told = {}
    for name, choice in choices.items():
        why = choice.why
        if values[name] != choice.values[0]:
            why = f"{choice.values[0]:g} {choice.unit} ({why}) doesn't work here"
        told[choice.field] = (round(values[name], 6), choice.unit, why)
    return told
