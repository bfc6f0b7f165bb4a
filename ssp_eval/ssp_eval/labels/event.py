"""When the phases of a recorded event begin (METHOD 1), measured from ground truth."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ssp_core.geometry import Polyline
from ssp_core.interaction import OBSERVABLE_LATERAL_MPS, Encounter, encounter, is_conflict
from ssp_core.run_spec import ConflictThresholds
from ssp_core.state import ObjectState


@dataclass(frozen=True)
class Event:
    """One OT's event: starts of its phases in clip time.

    Args:
        object_id: the OT.
        trigger_s: its manoeuvre becomes observable.
        arrival_s: its first overlap with the VUT's corridor.
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
    samples: Sequence[Sample], path: Polyline, thresholds: ConflictThresholds
) -> Event | None:
    """The event of one OT, None when it never enters the VUT's corridor from the side.

    With the whole clip at hand, "staying so" means until the OT is in the corridor, and "for good"
    means to the end of the clip.

    Args:
        samples: in time order.
        path: of the VUT over the whole clip.
        thresholds: when a conflict begins.
    """
    meetings = [encounter(s.vut, s.other, path) for s in samples]
    arrival = _arrival(samples, meetings)
    if arrival is None:
        return None
    trigger = arrival
    while trigger > 0 and meetings[trigger - 1].towards_mps > OBSERVABLE_LATERAL_MPS:
        trigger -= 1
    under = [
        i
        for i in range(trigger + 1, len(samples))
        if is_conflict(meetings[i], thresholds.ttc_s, thresholds.arrival_gap_s)
    ]
    ends = bool(under) and under[-1] + 1 < len(samples)
    return Event(
        object_id=samples[0].other.object_id,
        trigger_s=samples[trigger].t_s,
        arrival_s=samples[arrival].t_s,
        conflict_s=samples[under[0]].t_s if under else None,
        resolution_s=samples[under[-1] + 1].t_s if ends else None,
    )


def _arrival(samples: Sequence[Sample], meetings: Sequence[Encounter]) -> int | None:
    """Index of the first overlap with the corridor, ahead of the VUT, that has a beginning."""
    for i in range(1, len(samples)):
        entered = meetings[i].in_corridor and not meetings[i - 1].in_corridor
        if entered and meetings[i].gap_m > -samples[i].other.size.length_m:
            return i
    return None
