"""When the phases of a recorded event begin (METHOD 1), measured from ground truth."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ssp_core.state import ObjectState
from ssp_eval.labels.geometry import CORRIDOR_MARGIN_M, Corridor, Extent, ttc_s

# Below this a participant has no predicted arrival.
_MOVING_MPS = 0.1


@dataclass(frozen=True)
class EventThresholds:
    """Thresholds of METHOD 1's definitions.

    Args:
        lateral_mps: lateral speed from which a manoeuvre is observable.
        ttc_s: TTC under which there is a conflict.
        arrival_gap_s: gap between predicted arrivals under which there is a conflict.
    """

    lateral_mps: float = 0.2
    ttc_s: float = 2.5
    arrival_gap_s: float = 1.5


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
    samples: Sequence[Sample], corridor: Corridor, thresholds: EventThresholds
) -> Event | None:
    """The event of one OT, None when it never enters the VUT's corridor from the side.

    Args:
        samples: in time order.
        corridor: of the VUT over the whole clip.
        thresholds: METHOD 1.
    """
    extents = [corridor.extent(s.other, CORRIDOR_MARGIN_M) for s in samples]
    arrival = _arrival(samples, extents, corridor)
    if arrival is None:
        return None
    trigger = arrival
    while trigger > 0 and _inwards(corridor, samples[trigger - 1]) > thresholds.lateral_mps:
        trigger -= 1
    critical = _critical(samples, extents, corridor, arrival, thresholds)
    under = [i for i in range(trigger + 1, len(samples)) if critical[i]]
    conflict_s = samples[under[0]].t_s if under else None
    resolution_s = None
    if under and under[-1] + 1 < len(samples):
        resolution_s = samples[under[-1] + 1].t_s
    first = samples[0].other.object_id
    return Event(first, samples[trigger].t_s, samples[arrival].t_s, conflict_s, resolution_s)


def _inwards(corridor: Corridor, sample: Sample) -> float:
    return corridor.lateral_speed_inwards_mps(sample.other)


def _arrival(
    samples: Sequence[Sample], extents: Sequence[Extent], corridor: Corridor
) -> int | None:
    """Index of the first overlap with the corridor, ahead of the VUT, that has a beginning."""
    for i in range(1, len(samples)):
        entered = corridor.overlaps(extents[i]) and not corridor.overlaps(extents[i - 1])
        if entered and extents[i].s_max_m > corridor.front_m(samples[i].vut):
            return i
    return None


def _critical(
    samples: Sequence[Sample],
    extents: Sequence[Extent],
    corridor: Corridor,
    arrival: int,
    thresholds: EventThresholds,
) -> list[bool]:
    """Per sample: TTC or the gap between the predicted arrivals is under its threshold.

    The conflict zone is what the OT covers of the corridor. Who is in it has arrived (0 s); who
    has left it, or doesn't move towards it, doesn't arrive.
    """
    inside = [corridor.overlaps(extent) for extent in extents]
    stay = [extents[i] for i in range(arrival, len(samples)) if inside[i]]
    zone_start_m = min(extent.s_min_m for extent in stay)
    zone_end_m = max(extent.s_max_m for extent in stay)
    critical = []
    for i, sample in enumerate(samples):
        front_m = corridor.front_m(sample.vut)
        vut_s = _vut_arrival_s(sample, corridor, front_m, zone_start_m, zone_end_m)
        if inside[i]:
            other_s = 0.0
        elif i > arrival:
            other_s = math.inf
        else:
            inwards_mps = _inwards(corridor, sample)
            gap_m = corridor.gap_to_side_m(extents[i])
            other_s = gap_m / inwards_mps if inwards_mps > _MOVING_MPS else math.inf
        both_there = vut_s == 0.0 and other_s == 0.0
        gap_s = math.inf if both_there or math.isinf(vut_s + other_s) else abs(vut_s - other_s)
        # TTC is infinite outside the corridor; not asking saves most of the work.
        closing = inside[i] and ttc_s(corridor, sample.vut, sample.other) < thresholds.ttc_s
        critical.append(closing or gap_s < thresholds.arrival_gap_s)
    return critical


def _vut_arrival_s(
    sample: Sample, corridor: Corridor, front_m: float, zone_start_m: float, zone_end_m: float
) -> float:
    if front_m >= zone_start_m:
        rear_m = front_m - sample.vut.size.length_m
        return 0.0 if rear_m <= zone_end_m else math.inf
    speed_mps = corridor.velocity(sample.vut)[0]
    return (zone_start_m - front_m) / speed_mps if speed_mps > _MOVING_MPS else math.inf
