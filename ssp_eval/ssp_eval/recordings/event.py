"""What a recording's K* says of its event (METHOD 1, 4.1), and the recording's clip."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.errors import InputError
from ssp_core.motion.encounter import Observable
from ssp_core.motion.event import TOLERANCE_S
from ssp_core.run_file.model import ConflictThresholds
from ssp_scenario_manager.event_spec.model import Event, Interval, Quantity, Unresolved
from ssp_scenario_manager.event_spec.units import Span, units_of
from ssp_scenario_manager.scenarios.kinds import KINDS

# METHOD 4.1: approach and resolution count as located if so much of each lies in the clip.
LOCATED_S = 0.5
# K*'s times are rounded to milliseconds.
_SHOWN_S = 0.0015


@dataclass(frozen=True, slots=True)
class Window:
    """How much of the source lies before its trigger and after its resolution's start, s.

    Args:
        before_s: a of METHOD 4.1.
        after_s: r of METHOD 4.1; what lasts so long is "for good" (METHOD 1).
        source: whose lengths these are, for people.
    """

    before_s: float
    after_s: float
    source: str


@dataclass(frozen=True, slots=True)
class Crop:
    """The part of a recording that is compared, labelled and scored; times on its clip clock, s.

    Args:
        start_s: first instant.
        end_s: last instant.
        chosen_by: who or what chose it.
        short_before_s: so much of the wanted window lies before the recording's beginning.
        short_after_s: so much of it lies after the recording's end.
    """

    start_s: float
    end_s: float
    chosen_by: str
    short_before_s: float = 0.0
    short_after_s: float = 0.0

    def holds(self, t_s: float) -> bool:
        """True for a time inside, ends included."""
        return self.start_s - TOLERANCE_S <= t_s <= self.end_s + TOLERANCE_S

    @property
    def shortfall(self) -> str:
        """By how much the recording is short of the window; empty where it isn't."""
        parts = []
        if self.short_before_s > _SHOWN_S:
            parts.append(f"begins {self.short_before_s:.3f} s late")
        if self.short_after_s > _SHOWN_S:
            parts.append(f"ends {self.short_after_s:.3f} s early")
        return " and ".join(parts)


def crop_of(
    first_s: float,
    last_s: float,
    trigger_s: float | None,
    resolution_s: float | None,
    window: Window | None,
) -> Crop:
    """The clip of a recording (METHOD 4.1).

    Args:
        first_s: beginning of the recording.
        last_s: its end.
        trigger_s: start of its trigger; None: the clip is the whole recording.
        resolution_s: start of its resolution; None: the clip ends with the recording.
        window: of the source; None: nobody knows it, and the clip is the whole recording.
    """
    if trigger_s is None or window is None:
        why = "without a trigger" if window is not None else "without a source's window"
        return Crop(first_s, last_s, f"the whole recording, {why}")
    start_s = trigger_s - window.before_s
    chosen_by = f"METHOD 4.1 from {window.source}"
    if resolution_s is None:
        end_s = last_s
        chosen_by += ", to the recording's end without a resolution"
    else:
        end_s = resolution_s + window.after_s
    return Crop(
        max(first_s, start_s),
        min(last_s, end_s),
        chosen_by,
        max(0.0, first_s - start_s),
        max(0.0, end_s - last_s),
    )


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
    return interval.si


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
