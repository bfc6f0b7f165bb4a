"""When the phases of a recorded event begin (METHOD 1), measured from states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import Encounter, Observable, encounter, is_conflict, is_observable
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import ConflictThresholds
from ssp_eval.recordings.crop import TOLERANCE_S

# "Staying so" for a lead vehicle that brakes: it has no corridor to arrive in.
BRAKING_HOLD_S = 0.2


@dataclass(frozen=True)
class Event:
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
) -> Event | None:
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
    return Event(
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
