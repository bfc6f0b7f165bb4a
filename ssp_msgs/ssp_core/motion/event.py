"""The event of METHOD 1 over time.

It has the phases as they happen and as they were recorded; ``passing`` says how the two pass.

Live, "staying so" and "for good" can only be waited for: a phase begins at the instant at which its
condition began, and is reported once the condition has stayed for its confirmation time. With a
whole recording at hand they are known.
"""

from __future__ import annotations

from array import array
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Protocol, overload

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import (
    Encounter,
    Observable,
    encounter,
    is_conflict,
    is_observable,
)
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Packed, Series, StateSeries
from ssp_core.value_class import value_class
from ssp_core.vocabulary import Phase

TRIGGER_CONFIRMATION_S = 0.2
RESOLUTION_CONFIRMATION_S = 1.0
# "Staying so" for a lead vehicle that brakes: it has no corridor to arrive in.
BRAKING_HOLD_S = 0.2
# A trigger that no conflict follows within this time leads to none.
NO_CONFLICT_S = 12.0
TOLERANCE_S = 1e-9


class Thresholds(Protocol):
    """The start of a conflict, s; None takes no part (run_file.model.ConflictThresholds)."""

    @property
    def ttc_s(self) -> float | None: ...

    @property
    def arrival_gap_s(self) -> float | None: ...


def _conflicts(meeting: Encounter, thresholds: Thresholds) -> bool:
    return is_conflict(meeting, thresholds.ttc_s, thresholds.arrival_gap_s)


# -- phases while they happen ----------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class PhaseBegan:
    """A phase has begun: when, and what was measured then."""

    stamp_ns: int
    phase: Phase
    evidence: str


@value_class(frozen=True, slots=True)
class PhaseWatch:
    """Present phase, and since when the condition of the next one has held.

    ``conflict`` is the first conflict after a trigger that is still being confirmed.
    """

    phase: Phase = Phase.APPROACH
    since_ns: int | None = None
    evidence: str = ""
    conflict: PhaseBegan | None = None


def _text(meeting: Encounter, target: ObjectState, kind: Observable) -> str:
    if kind == "braking":
        observation = f"deceleration {-target.acceleration_mps2:.2f} m/s^2"
    elif kind == "closing":
        observation = f"its speed {target.speed_mps:.2f} m/s, the VUT's closing in"
    else:
        observation = f"arrival gap {meeting.arrival_gap_s:.2f} s, lateral speed "
        observation += f"{meeting.towards_mps:.2f} m/s"
    return f"gap {meeting.gap_m:.1f} m, TTC {meeting.ttc_s:.2f} s, {observation}"


def next_phase(
    watch: PhaseWatch,
    vut: ObjectState,
    target: ObjectState,
    path: Polyline,
    thresholds: Thresholds,
    kind: Observable = "lateral",
) -> tuple[PhaseWatch, PhaseBegan | None]:
    """Take the states of one instant into account.

    Args:
        watch: what the instants before led to; at first ``PhaseWatch()``.
        vut: state of the VUT.
        target: state of the object target that carries the event, same stamp.
        path: the VUT's path.
        thresholds: when a conflict begins.
        kind: what makes the target's manoeuvre observable.

    Returns:
        The new watch, and the phase that has been confirmed, if any.
    """
    if watch.phase is Phase.RESOLUTION:
        return watch, None
    if watch.phase is Phase.TRIGGER and watch.conflict is not None:
        return PhaseWatch(Phase.CONFLICT), watch.conflict
    meeting = encounter(vut, target, path)
    conflict = _conflicts(meeting, thresholds)
    if watch.phase is Phase.APPROACH:
        is_met, confirm_s, following = (
            is_observable(kind, meeting, target),
            TRIGGER_CONFIRMATION_S,
            Phase.TRIGGER,
        )
    elif watch.phase is Phase.TRIGGER:
        is_met, confirm_s, following = conflict, 0.0, Phase.CONFLICT
    else:
        is_met, confirm_s, following = not conflict, RESOLUTION_CONFIRMATION_S, Phase.RESOLUTION
    if not is_met:
        return PhaseWatch(watch.phase), None
    if watch.since_ns is None:
        watch = replace(watch, since_ns=vut.stamp_ns, evidence=_text(meeting, target, kind))
    elif watch.phase is Phase.APPROACH and conflict and watch.conflict is None:
        start = PhaseBegan(vut.stamp_ns, Phase.CONFLICT, _text(meeting, target, kind))
        watch = replace(watch, conflict=start)
    since = watch.since_ns if watch.since_ns is not None else vut.stamp_ns
    if vut.stamp_ns - since < seconds_to_ns(confirm_s):
        return watch, None
    begun = PhaseBegan(since, following, watch.evidence)
    return PhaseWatch(following, conflict=watch.conflict), begun


# -- phases of a recording -------------------------------------------------------------------------


@value_class(frozen=True, slots=True)
class Instant:
    """VUT and one object at one time."""

    t_s: float
    vut: ObjectState
    other: ObjectState


class _Instants(Sequence[Instant]):
    """Instants of a long series, made when they are asked for."""

    def __init__(self, series: StateSeries, vut_id: str, object_id: str) -> None:
        self._series, self._vut_id, self._object_id = series, vut_id, object_id
        self._rows = array(
            "q", (i for i, (_, now) in enumerate(series) if vut_id in now and object_id in now)
        )

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, at: int) -> Instant: ...
    @overload
    def __getitem__(self, at: slice) -> list[Instant]: ...
    def __getitem__(self, at: int | slice) -> Instant | list[Instant]:
        if isinstance(at, slice):
            return [self[i] for i in range(*at.indices(len(self)))]
        t_s, states = self._series[self._rows[at]]
        return Instant(t_s, states[self._vut_id], states[self._object_id])


def instants_of(series: Series, vut_id: str, object_id: str) -> Sequence[Instant]:
    """Return the instants at which both are present."""
    if isinstance(series, StateSeries):
        return _Instants(series, vut_id, object_id)
    return [
        Instant(t_s, states[vut_id], states[object_id])
        for t_s, states in series
        if vut_id in states and object_id in states
    ]


@dataclass(frozen=True, slots=True)
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
        """Return the phase at a time."""
        if t_s < self.trigger_s:
            return "approach"
        if self.conflict_s is None or t_s < self.conflict_s:
            return "trigger"
        if self.resolution_s is None or t_s < self.resolution_s:
            return "conflict"
        return "resolution"


def find_event(
    instants: Sequence[Instant],
    path: Polyline,
    thresholds: Thresholds,
    observable: Observable = "lateral",
    harmless: bool = False,
    for_good_s: float | None = None,
) -> RecordedEvent | None:
    """Return the event of one OT, None when its manoeuvre never becomes observable.

    "Staying so" means until the OT is in the corridor, or for one ahead in it at least
    BRAKING_HOLD_S.

    Args:
        instants: of the recording, in time order.
        path: the VUT's path, frame map.
        thresholds: when a conflict begins.
        observable: ``lateral``: the OT enters the VUT's corridor from the side, ahead of the VUT
            or, where it never does that, behind it; ``braking``: it brakes in the corridor ahead;
            ``closing``: it is there, and the VUT closes in on it.
        harmless: an entry behind the VUT is an event without a conflict, too.
        for_good_s: what lasts so long is for good, or to the last instant where that is sooner
            (METHOD 4.1); None: to the last instant.
    """
    meetings = Packed(Encounter, (encounter(now.vut, now.other, path) for now in instants))
    if observable == "lateral":
        ahead, behind = _arrivals(instants, meetings)
        arrival = behind if ahead is None else ahead
        if arrival is None:
            return None
        trigger = arrival
        while trigger > 0 and is_observable(
            "lateral", meetings[trigger - 1], instants[trigger - 1].other
        ):
            trigger -= 1
    else:
        index = _first_observable_ahead(instants, meetings, observable)
        if index is None:
            return None
        trigger = arrival = ahead = index
    under = [i for i in range(trigger + 1, len(instants)) if _conflicts(meetings[i], thresholds)]
    if ahead is None and not under and not harmless:
        return None
    return RecordedEvent(
        object_id=instants[0].other.object_id,
        trigger_s=instants[trigger].t_s,
        arrival_s=instants[arrival].t_s,
        conflict_s=instants[under[0]].t_s if under else None,
        resolution_s=_resolution_s(instants, under, for_good_s),
    )


def _resolution_s(
    instants: Sequence[Instant], under: Sequence[int], for_good_s: float | None
) -> float | None:
    """Return the time from which no threshold is passed for good; None: not in these instants."""
    for last, following in pairwise([*under, len(instants)]):
        start = last + 1
        if start == following:
            continue
        start_s = instants[start].t_s
        if following == len(instants):
            return start_s
        lasts_s = instants[following].t_s - start_s
        if for_good_s is not None and lasts_s > for_good_s + TOLERANCE_S:
            return start_s
    return None


def resolution_ns(
    instants: Sequence[Instant], path: Polyline, thresholds: Thresholds, conflict_ns: int
) -> int | None:
    """Return the stamp after the conflict's start from which no threshold is passed to the end.

    The end is the last of the instants.

    Looked at from the end, so that a long recording costs no more than its resolution.
    """
    since_ns = None
    for now in reversed(instants):
        in_conflict = now.vut.stamp_ns <= conflict_ns or _conflicts(
            encounter(now.vut, now.other, path), thresholds
        )
        if in_conflict:
            break
        since_ns = now.vut.stamp_ns
    return since_ns


def _arrivals(
    instants: Sequence[Instant], meetings: Sequence[Encounter]
) -> tuple[int | None, int | None]:
    """Return indices of the first overlaps with the corridor that have a beginning.

    The first index is of one ahead of the VUT, the second of one behind its front.
    """
    ahead = behind = None
    for i in range(1, len(instants)):
        if meetings[i].in_corridor and not meetings[i - 1].in_corridor:
            if meetings[i].gap_m > -instants[i].other.size.length_m:
                ahead = i if ahead is None else ahead
            else:
                behind = i if behind is None else behind
    return ahead, behind


def _first_observable_ahead(
    instants: Sequence[Instant], meetings: Sequence[Encounter], observable: Observable
) -> int | None:
    """Return the index from which what an object ahead does shows for BRAKING_HOLD_S."""
    start: int | None = None
    for i, (now, meeting) in enumerate(zip(instants, meetings, strict=True)):
        if meeting.gap_m < 0.0 or not is_observable(observable, meeting, now.other):
            start = None
            continue
        if start is None:
            start = i
        if now.t_s - instants[start].t_s >= BRAKING_HOLD_S - TOLERANCE_S:
            return start
    return None
