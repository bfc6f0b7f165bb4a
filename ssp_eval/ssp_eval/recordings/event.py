"""The event of a recording (METHOD 1, 4.1): rules of its K*, its phases, and its clip."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from ssp_core.errors import InputError
from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import Encounter, Observable, encounter, is_conflict, is_observable
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import ConflictThresholds
from ssp_scenario_manager.event_spec.fields import Span, si, units_of
from ssp_scenario_manager.event_spec.model import Event, Interval, Quantity, Unresolved
from ssp_scenario_manager.scenarios.kinds import KINDS

# METHOD 4.1: approach and resolution count as located if so much of each lies in the clip.
LOCATED_S = 0.5
TOLERANCE_S = 1e-9
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


# "Staying so" for a lead vehicle that brakes: it has no corridor to arrive in.
BRAKING_HOLD_S = 0.2


@dataclass(frozen=True)
class RecordedEvent:
    """One OT's event: starts of its phases in clip time.

    Args:
        object_id: the OT.
        trigger_s: its manoeuvre becomes observable.
        arrival_s: its first overlap with the VUT's corridor; of a lead vehicle, which is in it all
            the time, the trigger.
        conflict_s: TTC or arrival gap falls under its threshold; None: it never does.
        resolution_s: neither is under it from here on; None: not within the clip.
    """

    object_id: str
    trigger_s: float
    arrival_s: float
    conflict_s: float | None
    resolution_s: float | None

    def phase_at(self, t_s: float) -> str:
        """The phase at a time (METHOD 1)."""
        if t_s < self.trigger_s:
            return "approach"
        if self.conflict_s is None or t_s < self.conflict_s:
            return "trigger"
        if self.resolution_s is None or t_s < self.resolution_s:
            return "conflict"
        return "resolution"


@dataclass(frozen=True)
class Sample:
    """VUT and one OT at one clip time."""

    t_s: float
    vut: ObjectState
    other: ObjectState


def samples_of(
    series: Sequence[tuple[float, Mapping[str, ObjectState]]], vut_id: str, object_id: str
) -> list[Sample]:
    """The samples in which both are present."""
    return [
        Sample(t_s, states[vut_id], states[object_id])
        for t_s, states in series
        if vut_id in states and object_id in states
    ]


def find_event(
    samples: Sequence[Sample],
    path: Polyline,
    thresholds: ConflictThresholds,
    observable: Observable = "lateral",
    harmless: bool = False,
    for_good_s: float | None = None,
) -> RecordedEvent | None:
    """The event of one OT, None when its manoeuvre never becomes observable.

    With the whole clip at hand, "staying so" means until the OT is in the corridor, or for a lead
    vehicle at least BRAKING_HOLD_S.

    Args:
        samples: in time order.
        path: of the VUT over the whole clip.
        thresholds: when a conflict begins.
        observable: ``lateral``: the OT enters the VUT's corridor from the side, ahead of the VUT
            or, where it never does that, behind it; ``braking``: it brakes in the corridor ahead.
        harmless: an entry behind the VUT is an event without a conflict, too.
        for_good_s: what lasts so long is for good, or to the last sample where that is sooner
            (METHOD 4.1); None: to the last sample.
    """
    meetings = [encounter(s.vut, s.other, path) for s in samples]
    if observable == "lateral":
        ahead, behind = _arrivals(samples, meetings)
        arrival = behind if ahead is None else ahead
        if arrival is None:
            return None
        trigger = arrival
        while trigger > 0 and is_observable(
            "lateral", meetings[trigger - 1], samples[trigger - 1].other
        ):
            trigger -= 1
    else:
        found = _braking(samples, meetings)
        if found is None:
            return None
        trigger = arrival = ahead = found
    under = [
        i
        for i in range(trigger + 1, len(samples))
        if is_conflict(meetings[i], thresholds.ttc_s, thresholds.arrival_gap_s)
    ]
    if ahead is None and not under and not harmless:
        return None
    resolution = _resolution(samples, under, for_good_s)
    return RecordedEvent(
        object_id=samples[0].other.object_id,
        trigger_s=samples[trigger].t_s,
        arrival_s=samples[arrival].t_s,
        conflict_s=samples[under[0]].t_s if under else None,
        resolution_s=None if resolution is None else samples[resolution].t_s,
    )


def _resolution(
    samples: Sequence[Sample], under: Sequence[int], for_good_s: float | None
) -> int | None:
    """Index from which no threshold is passed for good (METHOD 1); None: not in these samples.

    Args:
        samples: in time order.
        under: rising indices of the samples in conflict.
        for_good_s: see find_event.
    """
    for last, following in pairwise([*under, len(samples)]):
        start = last + 1
        if start == following:
            continue
        if following == len(samples):
            return start
        lasts_s = samples[following].t_s - samples[start].t_s
        if for_good_s is not None and lasts_s > for_good_s + TOLERANCE_S:
            return start
    return None


def _arrivals(
    samples: Sequence[Sample], meetings: Sequence[Encounter]
) -> tuple[int | None, int | None]:
    """Indices of the first overlaps with the corridor that have a beginning: ahead of the VUT, and
    behind its front."""
    ahead = behind = None
    for i in range(1, len(samples)):
        if meetings[i].in_corridor and not meetings[i - 1].in_corridor:
            if meetings[i].gap_m > -samples[i].other.size.length_m:
                ahead = i if ahead is None else ahead
            else:
                behind = i if behind is None else behind
    return ahead, behind


def _braking(samples: Sequence[Sample], meetings: Sequence[Encounter]) -> int | None:
    """Index at which an object ahead in the corridor begins to brake, and goes on doing so."""
    start: int | None = None
    for i, (sample, meeting) in enumerate(zip(samples, meetings, strict=True)):
        if meeting.gap_m < 0.0 or not is_observable("braking", meeting, sample.other):
            start = None
            continue
        if start is None:
            start = i
        if sample.t_s - samples[start].t_s >= BRAKING_HOLD_S - TOLERANCE_S:
            return start
    return None
