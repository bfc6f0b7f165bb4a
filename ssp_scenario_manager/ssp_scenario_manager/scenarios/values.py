"""Values inside part C and in which order they are tried, and what K* and the place want of
participants.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from ssp_core.motion.state import DEFAULT_SIZES, Size
from ssp_core.run_file.model import ConflictThresholds, WantedPassing
from ssp_core.vocabulary import ObjectClass, ObjectWord
from ssp_scenario_manager.event_spec.fields import UNITS, si, units_of
from ssp_scenario_manager.event_spec.model import Event, Interval, Quantity
from ssp_scenario_manager.scenarios.base import CannotPlace, PlaceLimits

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


# Accelerations of an approach, m/s^2, for those who can't do the usual.
_APPROACH_MPS2 = {"truck": 1.2, "bus": 1.2, "cyclist": 1.2}
_USUAL_MPS2 = 2.0


def size_of(event: Event, name: str) -> Size:
    """Extent of a participant."""
    return DEFAULT_SIZES[ObjectClass.from_word(event.participants[name].class_)]


def classes_of(event: Event) -> dict[str, ObjectWord]:
    """Object classes by participants' ids."""
    return {name: who.class_ for name, who in event.participants.items()}


def thresholds_of(event: Event) -> ConflictThresholds:
    """When a conflict begins, by part C: the middle of what it gives."""

    def middle(interval: Interval | None) -> float | None:
        if interval is None:
            return None
        known = in_si(interval)
        sides = [side for side in (known.min, known.max) if side is not None]
        return sum(sides) / len(sides) if sides else None

    needs = event.constraints.thresholds
    return ConflictThresholds(ttc_s=middle(needs.ttc), arrival_gap_s=middle(needs.arrival_gap))


def approach_acceleration(event: Event, name: str, limits: PlaceLimits) -> float:
    """With which a participant gets to its cruise speed, m/s^2."""
    usual = _APPROACH_MPS2.get(event.participants[name].class_, _USUAL_MPS2)
    return min(usual, limits.acceleration_mps2)


def acceleration_limit(event: Event, limits: PlaceLimits) -> float:
    """The least of what place and K* allow, m/s^2."""
    most = in_si(event.constraints.safety.acceleration).max
    return min(limits.acceleration_mps2, most if most is not None else math.inf)


def vehicle_speed_limit(event: Event, limits: PlaceLimits) -> float:
    """The least of what place, road and K* allow, m/s."""
    most = in_si(event.constraints.safety.speed).max
    return min(limits.speed_mps, limits.speed_limit_mps, most if most is not None else math.inf)


def speed_bounds(event: Event, name: str, phases: tuple[str, ...]) -> tuple[float, float]:
    """Largest minimum and smallest maximum of a participant's speed over some phases, m/s."""
    known = event.constraints.speeds.get(name, {})
    found = [in_si(q) for phase, q in known.items() if phase in phases and isinstance(q, Interval)]
    return (
        max((q.min for q in found if q.min is not None), default=0.0),
        min((q.max for q in found if q.max is not None), default=math.inf),
    )


def initiator_first(event: Event) -> bool:
    """The passing order of K*."""
    return event.interaction.passing_order[0] == event.interaction.initiator


def wanted_passing(event: Event) -> WantedPassing:
    """Order and time gap of K*; a side of the gap that it leaves open may be any."""
    gap = event.constraints.time_gap
    known = in_si(gap) if isinstance(gap, Interval) else None
    return WantedPassing(
        first="initiator" if initiator_first(event) else "vut",
        least_gap_s=None if known is None else known.min,
        most_gap_s=None if known is None else known.max,
    )
