"""A trigger's value with which an event would happen on a block, where K*'s own values don't do."""

from __future__ import annotations

from collections.abc import Callable

from ssp_scenario_manager.interactions.base import CannotPlace
from ssp_scenario_manager.interactions.choosing import quantity_at
from ssp_scenario_manager.spec.model import Event, Interval

FIELD = "constraints.trigger.below"
# Values outside of K*'s interval are tried in this ratio, so many above and below it.
_RATIO = 1.25
_ABOVE, _BELOW = 8, 4


def fitting_trigger(event: Event, place: Callable[[Event], object]) -> str | None:
    """In words, the value nearest to K*'s interval that would do while all else stays as it is.

    Args:
        event: K*, which doesn't fit the block.
        place: places an event on the block; raises CannotPlace with the reason.

    Returns:
        None where the trigger's value isn't what is wrong.
    """
    asked = quantity_at(event, FIELD)
    if not isinstance(asked, Interval) or asked.min is None or asked.max is None:
        return None
    for value in _values(asked.min, asked.max):
        try:
            place(_with_trigger(event, Interval(min=value, max=value, unit=asked.unit)))
        except CannotPlace:
            continue
        return f"{FIELD} of {value:g} {asked.unit} would do, K* has {asked.min:g} to {asked.max:g}"
    return None


def _values(low: float, high: float) -> list[float]:
    """Rounded to a tenth, the nearest to the interval first."""
    tried = [(k, high * _RATIO**k) for k in range(1, _ABOVE + 1)]
    tried += [(k, low / _RATIO**k) for k in range(1, _BELOW + 1)]
    return [round(value, 1) for _, value in sorted(tried) if round(value, 1) > 0.0]


def _with_trigger(event: Event, below: Interval) -> Event:
    constraints = event.constraints
    trigger = constraints.trigger.model_copy(update={"below": below})
    return event.model_copy(
        update={"constraints": constraints.model_copy(update={"trigger": trigger})}
    )
