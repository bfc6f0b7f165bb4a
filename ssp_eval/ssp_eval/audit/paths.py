"""How recorded paths lie on the road, and how two of them meet (METHOD 1)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ssp_core.motion.encounter import AGAINST_RAD, is_crossing, swept_stations
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.road import Lane, Road
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_eval.recordings.event import RecordedEvent, Sample
from ssp_eval.recordings.geometry import Corridor, Extent
from ssp_scenario_manager.maps.block import STRAIGHT_BELOW_1PM

_CURVATURE_STEP_M = 1.0


@dataclass(frozen=True)
class Spot:
    """A place on the road.

    Args:
        s_m: arc length along the reference line.
        l_m: offset, + left of the line.
        lane: index from right to left; None: on no lane.
    """

    s_m: float
    l_m: float
    lane: int | None


class Lanes:
    """The lanes of a run's road, seen by somebody who drives on it.

    Args:
        road: of the run.
        forward: whether the VUT drives along the reference line or against it. All that is left
            and right below is so for the VUT.
    """

    def __init__(self, road: Road, forward: bool = True) -> None:
        self.line = ReferenceLine.of_road(road)
        self.forward = forward
        self.lanes: tuple[Lane, ...] = tuple(sorted(road.lanes, key=lambda lane: lane.y_m))

    @classmethod
    def of(cls, road: Road, vut: Iterable[ObjectState]) -> Lanes:
        """The road as a recorded VUT drives on it; along the line where it never moves."""
        lanes = cls(road)
        votes = 0.0
        for state in vut:
            spot = lanes.spot(state)
            if spot is not None:
                turn = state.yaw_rad - lanes.line.pose(spot.s_m).yaw_rad
                votes += state.speed_mps * math.cos(turn)
        return lanes if votes >= 0.0 else cls(road, forward=False)

    def spot(self, state: ObjectState) -> Spot | None:
        """Where the middle of an object is; None where the road has no coordinates for it."""
        middle = (state.size.front_m - state.size.rear_m) / 2.0
        try:
            s_m, l_m = self.line.to_local(*state.pose.to_parent(middle, 0.0))
        except NotOneToOne:
            return None
        return Spot(s_m, l_m, self._lane_at(l_m))

    def _lane_at(self, l_m: float) -> int | None:
        inside = [
            (abs(lane.y_m - l_m), index)
            for index, lane in enumerate(self.lanes)
            if abs(lane.y_m - l_m) <= lane.width_m / 2.0
        ]
        return min(inside)[1] if inside else None

    def is_same_direction(self, index: int) -> bool:
        """True for a lane in the VUT's direction."""
        return (self.lanes[index].direction == "forward") == self.forward

    @property
    def same_direction(self) -> int:
        """Lanes in the VUT's direction."""
        return sum(self.is_same_direction(i) for i in range(len(self.lanes)))

    @property
    def opposite(self) -> int:
        """Oncoming lanes."""
        return len(self.lanes) - self.same_direction

    def lane_words(self, lane: int | None) -> tuple[str, ...]:
        """Which of the lanes in the VUT's direction one is: any of rightmost, middle, leftmost."""
        own = [i for i in range(len(self.lanes)) if self.is_same_direction(i)]
        if not self.forward:
            own.reverse()
        if lane is None:
            return ("off the road",)
        if lane not in own:
            return ("oncoming",)
        place = own.index(lane)
        words = ["rightmost"] if place == 0 else []
        words += ["leftmost"] if place == len(own) - 1 else []
        return tuple(words) or ("middle",)

    def place_word(self, spot: Spot, own_lane: int | None) -> str:
        """Where something is, as a word of K*'s initial regions, from the VUT's lane."""
        side = 1.0 if self.forward else -1.0
        if spot.lane is None:
            middle = (self.lanes[0].y_m + self.lanes[-1].y_m) / 2.0
            return "left_kerb" if (spot.l_m - middle) * side > 0.0 else "right_kerb"
        if spot.lane == own_lane:
            return "vut_lane"
        if not self.is_same_direction(spot.lane):
            return "oncoming_lane"
        if own_lane is None:
            return "another_lane"
        steps = round((spot.lane - own_lane) * side)
        name = "left" if steps > 0 else "right"
        return f"{name}_lane" if abs(steps) == 1 else f"{abs(steps)}_lanes_{name}"

    def segment(self, from_s_m: float, to_s_m: float) -> str:
        """``straight`` or ``curve``, by the tightest bend between two arc lengths."""
        low, high = sorted((from_s_m, to_s_m))
        steps = max(1, math.ceil((high - low) / _CURVATURE_STEP_M))
        tightest = max(
            abs(self.line.curvature_1pm(low + (high - low) * k / steps)) for k in range(steps + 1)
        )
        return "straight" if tightest < STRAIGHT_BELOW_1PM else "curve"


@dataclass(frozen=True)
class Zone:
    """The conflict zone: stations along the observer's path, across its whole corridor.

    Args:
        start_m: the conflict point.
        end_m: where it ends.
    """

    start_m: float
    end_m: float


@dataclass(frozen=True)
class Meeting:
    """How another participant's path meets the corridor of the one that it is seen from.

    Args:
        relation: merge, crossing, following, oncoming, or none where the paths don't meet.
        zone: None where they don't.
        other_arrival_s: clip time; -inf: it was there when the clip began; None: never.
        own_arrival_s: of the front of the one that it is seen from; None: never.
        time_gap_s: second arrival minus first departure, None: one of them never happens.
    """

    relation: str
    zone: Zone | None
    other_arrival_s: float | None
    own_arrival_s: float | None
    time_gap_s: float | None

    @property
    def other_first(self) -> bool | None:
        """Passing order: True when the other one arrives first; None when nobody can say."""
        if self.other_arrival_s is None:
            return None
        return self.own_arrival_s is None or self.other_arrival_s <= self.own_arrival_s


def meet(samples: Sequence[Sample], corridor: Corridor, event: RecordedEvent | None) -> Meeting:
    """Type, zone and arrivals, from the recorded paths alone.

    An object that enters the corridor crosses it where its direction makes more than 45 degrees
    with the path at that instant, else it merges. One that was in the corridor ahead from the
    beginning is followed; its zone is where it was when its manoeuvre began.

    Args:
        samples: of both, in time order, at least one.
        corridor: of the one that it is seen from (``Sample.vut``).
        event: of the other one, where there is one.
    """
    extents = [corridor.extent(s.other) for s in samples]
    inside = [corridor.overlaps(extent) for extent in extents]
    entry = _entry(samples, inside, event)
    if entry is None:
        if not inside[0] or extents[0].s_min_m < corridor.front_m(samples[0].vut):
            return Meeting("none", None, None, None, None)
        return _followed(samples, corridor, extents, event)
    direction = _direction_rad(corridor, samples[entry].other)
    if direction > AGAINST_RAD:
        relation = "oncoming"
    elif is_crossing(direction):
        relation = "crossing"
    else:
        relation = "merge"
    left = next((i for i in range(entry, len(samples)) if not inside[i]), len(samples))
    if relation == "merge":
        whole = next(
            (i for i in range(entry, left) if _wholly(corridor, extents[i])), max(entry, left - 1)
        )
        zone = Zone(extents[entry].s_min_m, extents[whole].s_max_m)
        departure_s: float | None = samples[entry].t_s
    else:
        if relation == "crossing":
            zone = _crossed(samples, corridor, extents, entry)
        else:
            covered = extents[entry:left]
            zone = Zone(min(e.s_min_m for e in covered), max(e.s_max_m for e in covered))
        departure_s = samples[left].t_s if left < len(samples) else None
    arrival_s = samples[entry].t_s
    own_s = reached_s(samples, corridor, zone.start_m)
    gap_s = None
    if own_s is not None and arrival_s <= own_s:
        gap_s = None if departure_s is None else own_s - departure_s
    elif own_s is not None:
        end_m = zone.start_m if relation == "merge" else zone.end_m
        cleared_s = reached_s(samples, corridor, end_m + samples[0].vut.size.length_m)
        # Whoever had left it when the recording begins did so at a time that nobody knows.
        if cleared_s is not None and cleared_s > samples[0].t_s:
            gap_s = arrival_s - cleared_s
    return Meeting(relation, zone, arrival_s, own_s, gap_s)


def _crossed(
    samples: Sequence[Sample], corridor: Corridor, extents: Sequence[Extent], entry: int
) -> Zone:
    """What both swept corridors share, from before the entry to after the exit."""
    start_m, end_m = extents[entry].s_min_m, extents[entry].s_max_m
    for way in (range(entry, len(samples)), range(entry - 1, -1, -1)):
        for i in way:
            span = swept_stations(samples[i].other, corridor.path, corridor.half_width_m)
            if span is None:
                break
            start_m, end_m = min(start_m, span[0]), max(end_m, span[1])
    return Zone(start_m, end_m)


def _followed(
    samples: Sequence[Sample],
    corridor: Corridor,
    extents: Sequence[Extent],
    event: RecordedEvent | None,
) -> Meeting:
    start = 0
    if event is not None:
        start = next((i for i, s in enumerate(samples) if s.t_s >= event.trigger_s), 0)
    zone = Zone(extents[start].s_min_m, extents[start].s_max_m)
    own_s = reached_s(samples, corridor, zone.start_m)
    gap_s = None if own_s is None else own_s - samples[start].t_s
    return Meeting("following", zone, -math.inf, own_s, gap_s)


def _entry(
    samples: Sequence[Sample], inside: Sequence[bool], event: RecordedEvent | None
) -> int | None:
    """Index of the event's own entry, else of the first one; None where there is none."""
    entries = [i for i in range(1, len(samples)) if inside[i] and not inside[i - 1]]
    if event is not None and entries:
        return min(entries, key=lambda i: abs(samples[i].t_s - event.arrival_s))
    return entries[0] if entries else None


def _wholly(corridor: Corridor, extent: Extent) -> bool:
    half = corridor.half_width_m
    return extent.l_min_m >= -half and extent.l_max_m <= half


def _direction_rad(corridor: Corridor, other: ObjectState) -> float:
    along, left = corridor.velocity(other)
    return abs(math.atan2(left, along))


def reached_s(samples: Sequence[Sample], corridor: Corridor, station_m: float) -> float | None:
    """When the front of the one that it is seen from reaches a station, between samples.

    None: never; the first sample's time where it is beyond from the beginning.
    """
    before: tuple[float, float] | None = None
    for sample in samples:
        front_m = corridor.front_m(sample.vut)
        if front_m >= station_m:
            if before is None or front_m <= before[1]:
                return sample.t_s
            share = (station_m - before[1]) / (front_m - before[1])
            return before[0] + share * (sample.t_s - before[0])
        before = sample.t_s, front_m
    return None
