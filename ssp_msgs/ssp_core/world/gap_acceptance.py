"""Gap acceptance: how the VUT's built-in driver passes a place at which others have priority.

The driver uses it in every step; the compiler uses it to foresee what the driver will do. The
Highway Capacity Manual (HCM 2010) has the critical gaps of the field: 4.1 s for a left turn from
the major road across the oncoming lane, 4.1 to 5.2 s for the entry of a roundabout.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Literal

from ssp_core.geometry import Polyline, wrap_angle
from ssp_core.motion.encounter import ALONG_RAD
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import Driver, GiveWay
from ssp_core.value_class import value_class
from ssp_core.world.car_following import earliest_arrival_s, following_acceleration

# An object is on the priority path if it heads along it and is no further beside it: half a lane.
BESIDE_M = 1.75
# A slower object isn't on its way to the zone.
_COMING_MPS = 0.5
# The VUT comes into the zone so long after the last object with priority has left it.
BEHIND_S = 0.5
# A gap that was accepted is still accepted when it turns out to be shorter by this.
HYSTERESIS_S = 0.5
# Who gives way by slowing down isn't slower than this at the zone; else it waits at the line.
SLOWEST_YIELDING_MPS = 1.5
# One who waits at the line changes to slowing down only if it may be faster by this.
_HYSTERESIS_MPS = 1.5
# Bends that are ahead of an object let it speed up to this acceleration sideways; they are measured
# over so many metres of the path.
_SIDEWAYS_MPS2 = 4.0
_BEND_M = 4.0
# The driver looks for a gap so long before a comfortable stop at the line would begin.
LOOKS_AHEAD_S = 1.0
# Before the zone only a stop that needs more than this multiple of comfortable braking is given up.
_HARDEST = 2.0

Word = Literal["approach", "go", "yield", "wait"]


@value_class(frozen=True, slots=True)
class Coming:
    """An object with priority on its way to the conflict zone.

    Args:
        arrives_s: until its front reaches the zone, at its present speed, or with its present
            acceleration where it speeds up, as far as bends ahead of it allow; 0 within it.
        leaves_s: until its rear leaves the zone, at its present speed; inf where it stands in it.
    """

    object_id: str
    arrives_s: float
    leaves_s: float


@value_class(frozen=True, slots=True)
class Decision:
    """A decision at one place.

    Args:
        word: ``approach``: it is too far away to decide; ``go``: it drives on; ``yield``: it slows
            down and passes behind; ``wait``: it stops at the line.
        most_mps2: acceleration that it keeps below for this.
        heeded: ids of the objects with priority that this decision deals with, so that they are no
            obstacles.
        in_way: ids of those that are in the conflict zone with the VUT: obstacles, whatever another
            place deals with.
    """

    word: Word
    most_mps2: float = math.inf
    heeded: frozenset[str] = frozenset()
    in_way: frozenset[str] = frozenset()


@dataclass(frozen=True)
class Place:
    """A place at which others have priority.

    Args:
        spec: of the run file.
        path: of those with priority, frame map.
    """

    spec: GiveWay
    path: Polyline

    @cached_property
    def _bends(self) -> tuple[list[float], list[float]]:
        """Stations along the path, and the speed that the tightest bend up to the zone allows."""
        count = max(math.ceil(self.spec.priority_zone_m[0] / _BEND_M), 1)
        stations = [i * _BEND_M for i in range(count)]
        yaws = [self.path.pose(station).yaw_rad for station in (*stations, count * _BEND_M)]
        most, speeds = math.inf, []
        for first, second in zip(yaws[-2::-1], yaws[:0:-1], strict=True):
            curvature = abs(wrap_angle(second - first)) / _BEND_M
            most = min(most, math.sqrt(_SIDEWAYS_MPS2 / max(curvature, 1e-6)))
            speeds.append(most)
        return stations, speeds[::-1]

    def most_mps(self, station_m: float) -> float:
        """Return the speed that the bends between a station and the zone allow."""
        stations, speeds = self._bends
        return speeds[min(bisect_left(stations, station_m), len(speeds) - 1)]


def places_of(driver: Driver) -> tuple[Place, ...]:
    """Return the places at which a driver gives way; none of one that doesn't react."""
    if not driver.reacts:
        return ()
    return tuple(Place(spec, Polyline(spec.priority_path)) for spec in driver.gives_way)


def coming_along(place: Place, others: Sequence[ObjectState]) -> list[Coming]:
    """Return the objects that come along the priority path and haven't left the conflict zone.

    Args:
        place: at which they have priority.
        others: measured states in frame map, of everybody but the VUT.
    """
    first_m, last_m = place.spec.priority_zone_m
    arrivals = []
    projected = place.path.project_all_beyond([(o.x_m, o.y_m) for o in others])
    for other, (station, offset) in zip(others, projected, strict=True):
        turn = wrap_angle(other.yaw_rad - place.path.pose(station).yaw_rad)
        front, rear = station + other.size.front_m, station - other.size.rear_m
        if abs(offset) > BESIDE_M or abs(turn) > ALONG_RAD or front < 0.0 or rear > last_m:
            continue
        speed = other.speed_mps
        if speed > _COMING_MPS:
            way_m, faster = max(first_m - front, 0.0), max(other.acceleration_mps2, 0.0)
            arrives = _time_for(way_m, speed, faster, max(place.most_mps(front), speed))
            arrivals.append(Coming(other.object_id, arrives, (last_m - rear) / speed))
        elif front >= first_m:
            arrivals.append(Coming(other.object_id, 0.0, math.inf))
    return arrivals


def _time_for(way_m: float, speed_mps: float, acceleration_mps2: float, most_mps: float) -> float:
    """Return the time for a way at a speed that rises up to a largest one, s."""
    reached_m = math.inf
    if acceleration_mps2 > 0.0:
        reached_m = (most_mps * most_mps - speed_mps * speed_mps) / (2.0 * acceleration_mps2)
    rising_m = min(way_m, reached_m)
    # The root of way = v t + a t^2 / 2, written so that a may be 0.
    fast = math.sqrt(speed_mps * speed_mps + 2.0 * acceleration_mps2 * rising_m)
    return 2.0 * rising_m / (speed_mps + fast) + (way_m - rising_m) / most_mps


def decide(
    place: GiveWay,
    front_m: float,
    speed_mps: float,
    coming: Sequence[Coming],
    driver: Driver,
    before: Word = "approach",
) -> Decision:
    """Decide whether the VUT goes, yields or waits at a place.

    It goes in front of an object that needs the critical gap or longer to the conflict zone when
    the VUT is at the line, and behind one that has left the zone before the VUT is there. Who is in
    the zone goes on.

    Args:
        place: with stations along the VUT's path.
        front_m: station of the VUT's front.
        speed_mps: of the VUT, >= 0.
        coming: the objects with priority.
        driver: of the VUT.
        before: word of the last decision at this place.
    """
    to_line, to_zone = place.line_m - front_m, place.zone_m[0] - front_m
    b = driver.comfortable_deceleration_mps2
    everybody = frozenset(one.object_id for one in coming)
    if to_zone <= 0.0:
        # Only what is in the zone already may stand in the VUT's way.
        heeded = frozenset(one.object_id for one in coming if one.arrives_s > 0.0)
        ids_in_way = everybody - heeded if front_m <= place.zone_m[1] else frozenset[str]()
        return Decision("go", heeded=heeded, in_way=ids_in_way)
    if to_line > speed_mps * (speed_mps / (2.0 * b) + LOOKS_AHEAD_S) + driver.standstill_gap_m:
        return Decision("approach", heeded=everybody)
    is_going = before == "go"
    if is_going and speed_mps * speed_mps > 2.0 * _HARDEST * b * to_zone:
        return Decision("go", heeded=everybody)
    slack = HYSTERESIS_S if is_going else 0.0
    until = _gives_way_until(place, to_line, to_zone, speed_mps, coming, driver, slack)
    if until is None:
        return Decision("go", heeded=everybody)
    late = until + BEHIND_S
    end = 2.0 * to_zone / late - speed_mps
    if end >= SLOWEST_YIELDING_MPS + (_HYSTERESIS_MPS if before == "wait" else 0.0):
        rate = 2.0 * (to_zone - speed_mps * late) / (late * late)
        return Decision("yield", max(rate, -_HARDEST * b), everybody)
    gap = max(to_line + driver.standstill_gap_m, 0.1)
    return Decision("wait", following_acceleration(speed_mps, gap, 0.0, 0.0, driver), everybody)


def _gives_way_until(
    place: GiveWay,
    to_line: float,
    to_zone: float,
    speed_mps: float,
    coming: Iterable[Coming],
    driver: Driver,
    slack_s: float,
) -> float | None:
    """Return when the last object that the VUT gives way to has left the zone, s; None: none."""
    line_s = earliest_arrival_s(max(to_line, 0.0), speed_mps, driver)
    zone_s = earliest_arrival_s(to_zone, speed_mps, driver)
    until: float | None = None
    for one in sorted(coming, key=lambda c: c.arrives_s):
        # Behind those that were let pass the VUT is at the zone later, and meets the next ones.
        zone_s = max(zone_s, 0.0 if until is None else until + BEHIND_S)
        if until is not None:
            line_s = max(line_s, until)
        fits_before = one.arrives_s - line_s >= place.critical_gap_s - slack_s
        fits_behind = one.leaves_s + BEHIND_S - slack_s <= zone_s
        if not (fits_before or fits_behind):
            until = one.leaves_s
    return until


class PriorityWatch:
    """The decisions of one drive, each place's in its own order of time."""

    def __init__(self, driver: Driver) -> None:
        self._places = places_of(driver)
        self.words: list[Word] = ["approach"] * len(self._places)

    def __bool__(self) -> bool:
        return bool(self._places)

    def decide(
        self, front_m: float, speed_mps: float, others: Sequence[ObjectState], driver: Driver
    ) -> Decision:
        """Return the decisions of all places at this instant as one.

        Its word is that of the place that slows the VUT most.

        Args:
            front_m: station of the VUT's front along its path.
            speed_mps: of the VUT, >= 0.
            others: measured states in frame map.
            driver: of the VUT now.
        """
        decisions = [
            decide(p.spec, front_m, speed_mps, coming_along(p, others), driver, word)
            for p, word in zip(self._places, self.words, strict=True)
        ]
        self.words = [one.word for one in decisions]
        hardest = min(decisions, key=lambda one: one.most_mps2, default=Decision("approach"))
        heeded = frozenset[str]().union(*(one.heeded for one in decisions))
        in_way = frozenset[str]().union(*(one.in_way for one in decisions))
        return Decision(hardest.word, hardest.most_mps2, heeded - in_way, in_way)
