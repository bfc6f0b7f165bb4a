"""The passing of two participants through a conflict zone: relation, order and time gap."""

from __future__ import annotations

import math
from array import array
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise

from ssp_core.motion.corridor import Corridor, Extent
from ssp_core.motion.encounter import AGAINST_RAD, is_crossing, swept_stations
from ssp_core.motion.event import Instant, RecordedEvent
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Packed


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
    places = _Places(instants, corridor)
    start = next((i for i, now in enumerate(instants) if now.t_s >= since_s), None)
    if start is None:
        return Passing()
    if places.inside[start]:
        return places.followed(start) if places.is_ahead(start) else Passing()
    entry = next((i for i in places.entries if i > start), None)
    return Passing() if entry is None else places.entered(entry)


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
    places = _Places(instants, corridor)
    if event is not None and places.entries:
        arrival_s = event.arrival_s
        return places.entered(min(places.entries, key=lambda i: abs(instants[i].t_s - arrival_s)))
    if places.entries:
        return places.entered(places.entries[0])
    if not places.inside[0] or not places.is_ahead(0):
        return Passing()
    since_s = -math.inf if event is None else event.trigger_s
    return places.followed(next((i for i, now in enumerate(instants) if now.t_s >= since_s), 0))


def crossed_zone(
    after: Iterable[ObjectState],
    before: Iterable[ObjectState],
    own: Extent,
    corridor: Corridor,
    *,
    turns: bool,
) -> Zone:
    """Compute the zone that both swept corridors share.

    It counts from before the entry to after the exit. An object that turns is at its entry mostly
    beside the corridor still. Beside a bend its swept corridor, laid along the path at its
    reference point, may cover nothing while its body does: then the body's part counts.

    Args:
        after: states of the object that crosses, from its entry into the corridor on.
        before: those before its entry, the last one first.
        own: extent at the entry.
        corridor: of the other one.
        turns: it comes against the corridor's direction, and turns.
    """
    start_m, end_m = (math.inf, -math.inf) if turns else (own.s_min_m, own.s_max_m)
    for way in (after, before):
        for other in way:
            span = swept_stations(other, corridor.path, corridor.half_width_m)
            if span is None:
                break
            start_m, end_m = min(start_m, span[0]), max(end_m, span[1])
    return Zone(start_m, end_m) if start_m <= end_m else Zone(own.s_min_m, own.s_max_m)


class _Places:
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
        own_s = self._arrival_s(extent.s_min_m)
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
            after = (instants[i].other for i in range(entry, len(instants)))
            before = (instants[i].other for i in range(entry - 1, -1, -1))
            zone = crossed_zone(after, before, extents[entry], self._corridor, turns=against)
            relation = "crossing"
        else:
            relation, departure_s = "merge", instants[entry].t_s
            whole = (i for i in range(entry, left) if self._corridor.holds(extents[i]))
            zone = Zone(extents[entry].s_min_m, extents[next(whole, left - 1)].s_max_m)
        arrival_s, own_s = instants[entry].t_s, self._arrival_s(zone.start_m)
        gap_s = None
        if own_s is not None and arrival_s <= own_s:
            gap_s = None if departure_s is None else own_s - departure_s
        elif own_s is not None:
            end_m = zone.start_m if relation == "merge" else zone.end_m
            cleared_s = self._arrival_s(end_m + instants[0].vut.size.length_m)
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

    def _arrival_s(self, station_m: float) -> float | None:
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
