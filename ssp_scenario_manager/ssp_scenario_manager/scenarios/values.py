"""Values inside part C in the order in which they are tried, and limits of K* and the place."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.motion.state import DEFAULT_SIZES, Size
from ssp_core.run_file.model import ConflictThresholds, Limits, WantedPassing
from ssp_core.vocabulary import ObjectClass, ObjectWord
from ssp_scenario_manager.event_spec.fields import Span
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Event, Interval, Quantity
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.scenarios.base import CannotPlace

# Values per quantity: the preferred one, and further ones from end to end of the interval.
_SPREAD = (0.5, 0.25, 0.75, 0.0, 1.0)


@dataclass(frozen=True, slots=True)
class Choice:
    """The values that a quantity may take.

    Args:
        values: preferred first, then ever further from it.
        why: where the first comes from.
        at_most: the place's upper limit.
    """

    field: str
    unit: str
    values: tuple[float, ...]
    why: str
    at_most: float = math.inf


def quantity_at(event: Event, field: str) -> Quantity | None:
    """Return the quantity at a field's path, None where K* has none."""
    at: Any = event
    for part in field.split("."):
        at = at.get(part) if isinstance(at, dict) else getattr(at, part, None)
    return at if isinstance(at, Interval) or at == UNRESOLVED else None


def choose(
    event: Event,
    field: str,
    unit: str,
    preferred: Mapping[str, float],
    *,
    at_most: float = float("inf"),
    at_least: float = 0.0,
) -> Choice:
    """Return the values of a quantity inside its interval and inside the place's limits.

    Args:
        event: the K*.
        field: path of the quantity.
        unit: that its interval is given in.
        preferred: values that are tried first, by field; a value outside the interval is moved to
            its end.
        at_most: the place's upper limit.
        at_least: the place's lower limit.

    Raises:
        CannotPlace: it is unresolved or missing, has no side, or lies outside of what the place
            allows.
    """
    quantity = quantity_at(event, field)
    if not isinstance(quantity, Interval):
        state = "missing" if quantity is None else quantity
        raise CannotPlace(f"{field} is {state}; it needs an interval in {unit}")
    span = quantity.si
    if math.isinf(span.mid):
        raise CannotPlace(f"{field} has neither min nor max")
    low, high = max(span.low, at_least), min(span.high, at_most)
    if math.isinf(high):
        high = low
    if low > high:
        raise CannotPlace(
            f"{field} must be within {_ends(span)} {unit}; "
            f"the place allows {at_least:g} to {at_most:g} {unit}"
        )
    if field in preferred:
        first, why = Span(low, high).nearest(preferred[field]), "validated in simulation"
        if first != preferred[field]:
            why += f" as {preferred[field]:g} {unit}, moved into what K* and place allow"
    elif math.isinf(span.low) or math.isinf(span.high):
        first, why = (low if math.isinf(span.high) else high), "the side that K* gives"
    else:
        first, why = Span(low, high).nearest(span.mid), "middle of what K* allows"
        if first != span.mid:
            why = f"the place's limit, next to the {why}"
    values = [first]
    for share in sorted(_SPREAD, key=lambda share: abs(low + share * (high - low) - first)):
        value = low + share * (high - low)
        if all(abs(value - other) > 1e-9 for other in values):
            values.append(value)
    return Choice(field, unit, tuple(values), why, at_most)


_HEADWAY_FIELD = "run.driver.headway_s"


def choose_headway(preferred: Mapping[str, float], headways_s: tuple[float, ...]) -> Choice:
    """Choose the driver's headway, about which K* says nothing.

    Args:
        preferred: values that are tried first, by field.
        headways_s: others, in the order in which they are tried.
    """
    if _HEADWAY_FIELD in preferred:
        first = preferred[_HEADWAY_FIELD]
        rest = tuple(value for value in headways_s if value != first)
        return Choice(_HEADWAY_FIELD, "s", (first, *rest), "validated in simulation")
    why = "short, so that the VUT doesn't slow down before the trigger"
    return Choice(_HEADWAY_FIELD, "s", headways_s, why)


def fixed(event: Event, field: str, unit: str, value: float, why: str) -> Choice:
    """Return a quantity whose value follows from others; it must lie inside any interval it has.

    Raises:
        CannotPlace: it doesn't.
    """
    quantity = quantity_at(event, field)
    if isinstance(quantity, Interval) and not quantity.si.holds(value):
        raise CannotPlace(
            f"{field} would be {value:.2f} {unit}, which is not within {_ends(quantity.si)} {unit}"
        )
    return Choice(field, unit, (value,), why)


def _ends(span: Span) -> str:
    low, high = ("any" if math.isinf(end) else f"{end:g}" for end in (span.low, span.high))
    return f"{low} and {high}"


def combinations(choices: Mapping[str, Choice]) -> Iterator[dict[str, float]]:
    """Yield every combination of values by name, the preferred ones first, then further away."""
    names = list(choices)
    sizes = [len(choices[name].values) for name in names]
    for total in range(sum(sizes) - len(sizes) + 1):
        for rank in _ranks(sizes, total):
            yield {name: choices[name].values[i] for name, i in zip(names, rank, strict=True)}


def _ranks(sizes: list[int], total: int) -> Iterator[tuple[int, ...]]:
    """Yield indices into lists of these sizes that sum up to a total, in order."""
    if not sizes:
        if total == 0:
            yield ()
        return
    for first in range(min(sizes[0] - 1, total) + 1):
        for rest in _ranks(sizes[1:], total - first):
            yield (first, *rest)


def choice_entries(
    choices: Mapping[str, Choice], values: Mapping[str, float]
) -> dict[str, tuple[float, str, str]]:
    """Return the chosen values as a plan states them: (value, unit, why) by field."""
    entries = {}
    for name, choice in choices.items():
        why = choice.why
        if values[name] != choice.values[0]:
            why = f"{choice.values[0]:g} {choice.unit} ({why}) doesn't work here"
        entries[choice.field] = (round(values[name], 6), choice.unit, why)
    return entries


# Accelerations of an approach, m/s^2, for those who can't do the usual.
_APPROACH_MPS2 = {"truck": 1.2, "bus": 1.2, "cyclist": 1.2}
_USUAL_MPS2 = 2.0


def size_of(event: Event, name: str) -> Size:
    """Return the extent of a participant."""
    return DEFAULT_SIZES[ObjectClass.from_word(event.participants[name].class_)]


def classes_of(event: Event) -> dict[str, ObjectWord]:
    """Return object classes by participants' ids."""
    return {name: who.class_ for name, who in event.participants.items()}


def thresholds_of(event: Event) -> ConflictThresholds:
    """Return the thresholds of a conflict by part C: the middle of what it gives."""

    def middle(interval: Interval | None) -> float | None:
        mid = math.inf if interval is None else interval.si.mid
        return None if math.isinf(mid) else mid

    needs = event.constraints.thresholds
    return ConflictThresholds(ttc_s=middle(needs.ttc), arrival_gap_s=middle(needs.arrival_gap))


def approach_acceleration(event: Event, name: str, limits: Limits) -> float:
    """Return the acceleration with which a participant gets to its cruise speed, m/s^2."""
    usual = _APPROACH_MPS2.get(event.participants[name].class_, _USUAL_MPS2)
    return min(usual, limits.acceleration_mps2)


def acceleration_limit(event: Event, limits: Limits) -> float:
    """Return the least of what place and K* allow, m/s²."""
    return min(limits.acceleration_mps2, event.constraints.safety.acceleration.si.high)


def vehicle_speed_limit(event: Event, limits: Limits, block: Block) -> float:
    """Return the least of what place, road and K* allow, m/s."""
    fastest = event.constraints.safety.speed.si.high
    return min(limits.speed_mps, block.speed_limit_mps or limits.speed_mps, fastest)


def speed_bounds(event: Event, name: str, phases: tuple[str, ...]) -> tuple[float, float]:
    """Return a participant's largest minimum and smallest maximum speed over phases, m/s."""
    speeds_by_phase = event.constraints.speeds.get(name, {})
    spans = [
        q.si for phase, q in speeds_by_phase.items() if phase in phases and isinstance(q, Interval)
    ]
    return max([0.0, *(q.low for q in spans)]), min([math.inf, *(q.high for q in spans)])


def initiator_first(event: Event) -> bool:
    """Tell whether the initiator passes first by K*."""
    return event.interaction.passing_order[0] == event.interaction.initiator


def wanted_passing(event: Event) -> WantedPassing:
    """Order and time gap of K*; a side of the gap that it leaves open may be any."""
    gap = event.constraints.time_gap
    span = gap.si if isinstance(gap, Interval) else Span()
    return WantedPassing(
        first="initiator" if initiator_first(event) else "vut",
        least_gap_s=finite(span.low),
        most_gap_s=finite(span.high),
    )


def finite(value: float) -> float | None:
    """Return an end of a span as files have it, None where it is open."""
    return None if math.isinf(value) else value
