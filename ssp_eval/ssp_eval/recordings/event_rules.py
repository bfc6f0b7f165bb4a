"""What a K* sets for whoever measures an event: thresholds, what is observable, the window."""

from __future__ import annotations

from ssp_core.interaction import Observable
from ssp_core.run_spec import ConflictThresholds
from ssp_eval.recordings.crop import Window
from ssp_scenario_manager.interactions import KINDS
from ssp_scenario_manager.spec.model import Event, Interval, Quantity, Unresolved
from ssp_scenario_manager.spec.units import si


def event_thresholds(event: Event) -> ConflictThresholds:
    """A K*'s thresholds of the conflict (METHOD 1), in s; an interval counts with its middle."""
    limits = event.constraints.thresholds
    return ConflictThresholds(ttc_s=_middle(limits.ttc), arrival_gap_s=_middle(limits.arrival_gap))


def _middle(interval: Interval | None) -> float | None:
    if interval is None:
        return None
    ends = [end for end in (interval.min, interval.max) if end is not None]
    return sum(ends) / len(ends) if ends else None


def event_observable(event: Event) -> Observable | None:
    """What makes the manoeuvre of a K*'s kind of interaction observable, None: no such kind."""
    kind = KINDS.get(event.interaction.type)
    return None if kind is None else kind.observable


def middle_s(start: Quantity | Unresolved) -> float | None:
    """The middle of an event's time, s; None where it is unresolved or open."""
    if isinstance(start, str) or start.min is None or start.max is None:
        return None
    return si(start).mid


def window_of(event: Event) -> Window | None:
    """a and r of METHOD 4.1: how much of the source clip lies before its trigger and from its
    resolution on; None where K* doesn't say."""
    parts = event.events
    times = [
        middle_s(when)
        for when in (
            parts.clip.start, parts.trigger.start, parts.resolution.start, parts.clip.end
        )
    ]  # fmt: skip
    start_s, trigger_s, resolution_s, end_s = times
    if start_s is None or trigger_s is None or resolution_s is None or end_s is None:
        return None
    return Window(trigger_s - start_s, end_s - resolution_s, f"K* {event.name}")
