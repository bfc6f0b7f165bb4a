"""The event of METHOD 1 over time.

It has the VUT's corridor, the phases as they happen and as they were recorded, and how VUT and
object pass the conflict zone.

Live, "staying so" and "for good" can only be waited for: a phase begins at the instant at which its
condition began, and is reported once the condition has stayed for its confirmation time. With a
whole recording at hand they are known.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import islice, pairwise
from typing import Protocol, overload

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline, Pose2, wrap_angle
from ssp_core.motion.encounter import (
    AGAINST_RAD,
    Encounter,
    Observable,
    corridor_half_m,
    encounter,
    is_conflict,
    is_crossing,
    is_observable,
    swept_stations,
)
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Packed, Series, StateSeries
from ssp_core.value_class import value_class
from ssp_core.vocabulary import Phase

TRIGGER_CONFIRMATION_S = 0.2
RESOLUTION_CONFIRMATION_S = 1.0
# "Staying so" for a lead vehicle that brakes: it has no corridor to arrive in.
BRAKING_HOLD_S = 0.2
TOLERANCE_S = 1e-9
_EXTENSION_M = 500.0
_POINT_SPACING_M = 0.5


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
        seen = f"deceleration {-target.acceleration_mps2:.2f} m/s^2"
    elif kind == "closing":
        seen = f"its speed {target.speed_mps:.2f} m/s, the VUT's closing in"
    else:
        seen = f"arrival gap {meeting.arrival_gap_s:.2f} s, lateral speed "
        seen += f"{meeting.towards_mps:.2f} m/s"
    return f"gap {meeting.gap_m:.1f} m, TTC {meeting.ttc_s:.2f} s, {seen}"


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
        met, confirm_s, following = (
            is_observable(kind, meeting, target),
            TRIGGER_CONFIRMATION_S,
            Phase.TRIGGER,
        )
    elif watch.phase is Phase.TRIGGER:
        met, confirm_s, following = conflict, 0.0, Phase.CONFLICT
    else:
        met, confirm_s, following = not conflict, RESOLUTION_CONFIRMATION_S, Phase.RESOLUTION
    if not met:
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
        found = _shown_ahead(instants, meetings, observable)
        if found is None:
            return None
        trigger = arrival = ahead = found
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


def _shown_ahead(
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


# -- the corridor, and how two pass its conflict zone ----------------------------------------------

# So many boxes are projected at once.
_TOGETHER = 16


@value_class(frozen=True, slots=True)
class Extent:
    """Stations and offsets that a box covers along a path, m; offsets are + to the left."""

    s_min_m: float
    s_max_m: float
    l_min_m: float
    l_max_m: float


@dataclass(frozen=True, slots=True)
class Corridor:
    """The VUT's swept corridor: its path, straight on beyond its ends, and half its width."""

    path: Polyline
    half_width_m: float

    @classmethod
    def of(cls, vut: Sequence[ObjectState]) -> Corridor:
        """Return the corridor of a recorded VUT.

        Args:
            vut: its states in time order, at least one.
        """
        points = [(vut[0].x_m, vut[0].y_m)]
        for state in islice(vut, 1, None):
            if math.dist(points[-1], (state.x_m, state.y_m)) >= _POINT_SPACING_M:
                points.append((state.x_m, state.y_m))
        points.insert(0, vut[0].pose.to_parent(-_EXTENSION_M, 0.0))
        end = Pose2(*points[-1], vut[-1].yaw_rad)
        points.append(end.to_parent(_EXTENSION_M, 0.0))
        return cls(Polyline(points), corridor_half_m(vut[0].size.width_m))

    def extent(self, state: ObjectState) -> Extent:
        """Return the stations and offsets that an object's box covers."""
        return next(self.extents([state]))

    def extents(self, states: Iterable[ObjectState]) -> Iterator[Extent]:
        """Yield the stations and offsets that boxes cover.

        Many are projected at once: neighbours in time look for nearly the same pieces of the path.
        """
        more = iter(states)
        while boxes := [state.box.corners() for state in islice(more, _TOGETHER)]:
            corners = [corner for box in boxes for corner in box]
            projected = iter(self.path.project_all_beyond(corners))
            for box in boxes:
                stations, offsets = zip(*islice(projected, len(box)), strict=True)
                yield Extent(min(stations), max(stations), min(offsets), max(offsets))

    def overlaps(self, extent: Extent) -> bool:
        """Tell whether an extent reaches into the corridor sideways."""
        return extent.l_min_m <= self.half_width_m and extent.l_max_m >= -self.half_width_m

    def holds(self, extent: Extent) -> bool:
        """Tell whether an extent lies within the corridor sideways."""
        return extent.l_min_m >= -self.half_width_m and extent.l_max_m <= self.half_width_m

    def heading_rad(self, state: ObjectState) -> float:
        """Return the angle from the path's direction to where it faces, + to the left."""
        station, _ = self.path.project_beyond(state.x_m, state.y_m)
        return wrap_angle(state.yaw_rad - self.path.pose(station).yaw_rad)

    def velocity(self, state: ObjectState) -> tuple[float, float]:
        """Return the speed along the path and to its left, m/s."""
        angle = self.heading_rad(state)
        return state.speed_mps * math.cos(angle), state.speed_mps * math.sin(angle)

    def front_m(self, vut: ObjectState) -> float:
        """Return the station of the VUT's front bumper."""
        return next(self.fronts_m([vut]))

    def fronts_m(self, vut: Iterable[ObjectState]) -> Iterator[float]:
        """Yield the stations of the VUT's front bumper at many states."""
        more = iter(vut)
        while fronts := [
            state.pose.to_parent(state.size.front_m, 0.0) for state in islice(more, _TOGETHER)
        ]:
            yield from (station for station, _ in self.path.project_all_beyond(fronts))


@dataclass(frozen=True, slots=True)
class Zone:
    """The conflict zone: stations along the observer's path, across its whole corridor.

    Args:
        start_m: the conflict point.
        end_m: where it ends.
    """

    start_m: float
    end_m: float


@dataclass(frozen=True, slots=True)
class Passing:
    """The passing of another participant through the observer's corridor.

    Args:
        relation: merge, crossing, following, oncoming, or none where the paths don't meet.
        zone: None where they don't.
        other_arrival_s: -inf: it was there from the beginning; None: never.
        own_arrival_s: of the front of the one that it is seen from; None: never.
        time_gap_s: second arrival minus first departure (PET); None: one of them never happens.
    """

    relation: str = "none"
    zone: Zone | None = None
    other_arrival_s: float | None = None
    own_arrival_s: float | None = None
    time_gap_s: float | None = None

    @property
    def other_first(self) -> bool | None:
        """Passing order: True when the other one arrives first; None when it isn't determined."""
        if self.other_arrival_s is None:
            return None
        return self.own_arrival_s is None or self.other_arrival_s <= self.own_arrival_s


def passing_since(instants: Sequence[Instant], corridor: Corridor, since_s: float) -> Passing:
    """Follow how the two pass from a time on, with an object that is in the corridor by then."""
    seen = _Seen(instants, corridor)
    start = next((i for i, now in enumerate(instants) if now.t_s >= since_s), None)
    if start is None:
        return Passing()
    if seen.inside[start]:
        return seen.followed(start) if seen.is_ahead(start) else Passing()
    entry = next((i for i in seen.entries if i > start), None)
    return Passing() if entry is None else seen.entered(entry)


def passing_of(
    instants: Sequence[Instant], corridor: Corridor, event: RecordedEvent | None
) -> Passing:
    """Find how the two pass in a recording: by the event's own entry, else by the first one.

    One that was in the corridor ahead from the beginning is followed; its zone is where it was when
    its manoeuvre began.

    Args:
        instants: in time order, at least one.
        corridor: of the one that it is seen from (``Instant.vut``).
        event: of the other one, where there is one.
    """
    seen = _Seen(instants, corridor)
    if event is not None and seen.entries:
        arrival_s = event.arrival_s
        return seen.entered(min(seen.entries, key=lambda i: abs(instants[i].t_s - arrival_s)))
    if seen.entries:
        return seen.entered(seen.entries[0])
    if not seen.inside[0] or not seen.is_ahead(0):
        return Passing()
    since_s = -math.inf if event is None else event.trigger_s
    return seen.followed(next((i for i, now in enumerate(instants) if now.t_s >= since_s), 0))


class _Seen:
    """The places of both along the corridor at each instant."""

    def __init__(self, instants: Sequence[Instant], corridor: Corridor) -> None:
        self._instants = instants
        self._corridor = corridor
        self._extents = Packed(Extent, corridor.extents(now.other for now in instants))
        self.inside = [corridor.overlaps(extent) for extent in self._extents]
        self._fronts_m = array("d", corridor.fronts_m(now.vut for now in instants))
        self.entries = [
            i for i, (before, now) in enumerate(pairwise(self.inside), 1) if now and not before
        ]

    def is_ahead(self, i: int) -> bool:
        """Tell whether the object is ahead of the front of the one that it is seen from."""
        return self._extents[i].s_min_m >= self._fronts_m[i]

    def followed(self, start: int) -> Passing:
        extent = self._extents[start]
        own_s = self._reached_s(extent.s_min_m)
        gap_s = None if own_s is None else own_s - self._instants[start].t_s
        zone = Zone(extent.s_min_m, extent.s_max_m)
        return Passing("following", zone, -math.inf, own_s, gap_s)

    def entered(self, entry: int) -> Passing:
        """Return the passing of an object from its entry into the corridor on.

        It crosses where its direction makes more than 45 degrees with the path at the instant of
        its entry, else it merges, or is oncoming. An oncoming one that turns and leaves on the
        other side crosses too.
        """
        instants, extents = self._instants, self._extents
        left = next((i for i in range(entry, len(instants)) if not self.inside[i]), len(instants))
        along, leftwards = self._corridor.velocity(instants[entry].other)
        direction = abs(math.atan2(leftwards, along))
        departure_s = instants[left].t_s if left < len(instants) else None
        against = direction > AGAINST_RAD
        if against and not self._turns_through(entry, left):
            relation = "oncoming"
            covered = extents[entry:left]
            zone = Zone(min(e.s_min_m for e in covered), max(e.s_max_m for e in covered))
        elif against or is_crossing(direction):
            relation, zone = "crossing", self._crossed(entry, turns=against)
        else:
            relation, departure_s = "merge", instants[entry].t_s
            whole = (i for i in range(entry, left) if self._corridor.holds(extents[i]))
            zone = Zone(extents[entry].s_min_m, extents[next(whole, left - 1)].s_max_m)
        arrival_s, own_s = instants[entry].t_s, self._reached_s(zone.start_m)
        gap_s = None
        if own_s is not None and arrival_s <= own_s:
            gap_s = None if departure_s is None else own_s - departure_s
        elif own_s is not None:
            end_m = zone.start_m if relation == "merge" else zone.end_m
            cleared_s = self._reached_s(end_m + instants[0].vut.size.length_m)
            # Whoever had left it when the recording begins did so at a time that nobody knows.
            if cleared_s is not None and cleared_s > instants[0].t_s:
                gap_s = arrival_s - cleared_s
        return Passing(relation, zone, arrival_s, own_s, gap_s)

    def _turns_through(self, entry: int, left: int) -> bool:
        """Tell whether it turns off, and leaves the corridor on another side than it came from.

        Where the recording ends before it has left, its heading at that end decides.
        """
        last = self._instants[min(left, len(self._instants) - 1)].other
        if abs(self._corridor.heading_rad(last)) > AGAINST_RAD:
            return False
        if left == len(self._instants):
            return True
        before, after = (self._extents[i] for i in (entry - 1, left))
        return (before.l_min_m + before.l_max_m) * (after.l_min_m + after.l_max_m) < 0.0

    def _crossed(self, entry: int, *, turns: bool) -> Zone:
        """Compute the zone that both swept corridors share.

        It counts from before the entry to after the exit. An object that turns is at its entry
        mostly beside the corridor still.
        """
        start_m, end_m = self._extents[entry].s_min_m, self._extents[entry].s_max_m
        if turns:
            start_m, end_m = math.inf, -math.inf
        for way in (range(entry, len(self._instants)), range(entry - 1, -1, -1)):
            for i in way:
                other = self._instants[i].other
                span = swept_stations(other, self._corridor.path, self._corridor.half_width_m)
                if span is None:
                    break
                start_m, end_m = min(start_m, span[0]), max(end_m, span[1])
        return Zone(start_m, end_m)

    def _reached_s(self, station_m: float) -> float | None:
        """Find when the observer's front reaches a station, between instants.

        None: never; the first instant's time where it is beyond from the beginning.
        """
        fronts_m, instants = self._fronts_m, self._instants
        i = next((i for i, front_m in enumerate(fronts_m) if front_m >= station_m), None)
        if i is None:
            return None
        if i == 0 or fronts_m[i] <= fronts_m[i - 1]:
            return instants[i].t_s
        share = (station_m - fronts_m[i - 1]) / (fronts_m[i] - fronts_m[i - 1])
        return instants[i - 1].t_s + share * (instants[i].t_s - instants[i - 1].t_s)
