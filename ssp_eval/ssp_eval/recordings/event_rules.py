"""What a K* sets for whoever measures an event: thresholds, what is observable, times, window."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.errors import InputError
from ssp_core.motion.encounter import Observable
from ssp_core.run_file.model import ConflictThresholds
from ssp_eval.recordings.crop import Window
from ssp_scenario_manager.event_spec.fields import Span, si, units_of
from ssp_scenario_manager.event_spec.model import Event, Interval, Quantity, Unresolved
from ssp_scenario_manager.scenarios.kinds import KINDS


@dataclass(frozen=True)
class When:
    """A time of the source clip: between two instants, which are the same where it is exact."""

    low_s: float
    high_s: float

    @property
    def middle_s(self) -> float:
        return (self.low_s + self.high_s) / 2.0

    @property
    def half_s(self) -> float:
        return (self.high_s - self.low_s) / 2.0


@dataclass(frozen=True)
class SourceTimes:
    """Part E in s of the source; None where a time is unresolved or open to one side."""

    start: When | None
    end: When | None
    trigger: When | None
    conflict: When | None
    resolution: When | None


def source_times(event: Event) -> SourceTimes:
    """When the source clip and its phases start, and when it ends.

    Raises:
        InputError: a time has no unit of time.
    """
    parts = event.events
    return SourceTimes(
        _when(parts.clip.start),
        _when(parts.clip.end),
        _when(parts.trigger.start),
        _when(parts.conflict.start),
        _when(parts.resolution.start),
    )


def _when(quantity: Quantity | Unresolved) -> When | None:
    if isinstance(quantity, str) or quantity.min is None or quantity.max is None:
        return None
    span = _span(quantity)
    return When(span.low, span.high)


def _span(interval: Interval) -> Span:
    if interval.unit not in units_of("time"):
        raise InputError(
            "is no unit of time", field="unit", value=interval.unit,
            remedy=f"{' or '.join(units_of('time'))}; `ssp spec check` says where it stands",
        )  # fmt: skip
    return si(interval)


def window_of(event: Event) -> Window | None:
    """a and r of METHOD 4.1: how much of the source clip lies before its trigger and from its
    resolution on; None where K* doesn't say."""
    at = source_times(event)
    if at.start is None or at.trigger is None or at.resolution is None or at.end is None:
        return None
    return Window(
        at.trigger.middle_s - at.start.middle_s,
        at.end.middle_s - at.resolution.middle_s,
        f"K* {event.name}",
    )


def event_thresholds(event: Event) -> ConflictThresholds:
    """A K*'s thresholds of the conflict (METHOD 1), in s; an interval counts with its middle.

    Raises:
        InputError: a threshold has no unit of time.
    """
    limits = event.constraints.thresholds
    return ConflictThresholds(ttc_s=_middle(limits.ttc), arrival_gap_s=_middle(limits.arrival_gap))


def _middle(interval: Interval | None) -> float | None:
    if interval is None or (interval.min is None and interval.max is None):
        return None
    return _span(interval).mid


def event_observable(event: Event) -> Observable | None:
    """What makes the manoeuvre of a K*'s kind of interaction observable, None: no such kind."""
    kind = KINDS.get(event.interaction.type)
    return None if kind is None else kind.observable
