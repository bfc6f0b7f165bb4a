"""Stretches of an OpenDRIVE road over which its lanes stay where they are.

A block has lanes at constant offsets. A road whose lanes shift, open or close is therefore cut into
stretches over which every driving lane keeps its centre within 15 cm; a lane that doesn't, or that
gets narrower than 2 m, is no driving lane there. Of one that only shifts `shifting` makes a way.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import pairwise, zip_longest
from typing import TypeVar

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_scenario_manager.maps.opendrive_road import Cubic, LaneRecord, Mark, RoadRecord, Section

STEADY_M = 0.15
NARROWEST_M = 2.0
_SAMPLES = 7
_WIDEST_M = 100.0
_BROKEN = frozenset({"broken", "broken broken", "botts dots"})
DRIVING = frozenset(
    {
        "driving",
        "entry",
        "exit",
        "onRamp",
        "offRamp",
        "connectingRamp",
        "mwyEntry",
        "mwyExit",
        "slipLane",
    }
)

_Record = TypeVar("_Record")


@dataclass(frozen=True, slots=True)
class Slot:
    """A lane over a stretch, seen along the road's own direction.

    Args:
        y_m: mean offset of its centre, + left.
        driving: usable as a driving lane here.
        along: traffic runs in the road's direction.
    """

    id: int
    type: str
    y_m: float
    width_m: float
    driving: bool
    along: bool


@dataclass(frozen=True, slots=True)
class Stretch:
    """Part of a road with steady lanes; slots stand from right to left."""

    section: Section
    start_m: float
    end_m: float
    slots: tuple[Slot, ...]


@dataclass(frozen=True, slots=True)
class _Track:
    """A lane in one interval: range of its centre, narrowest and widest place, open to cars."""

    lane: LaneRecord
    low_m: float
    high_m: float
    width_m: float
    widest_m: float
    is_open: bool


def _values(cubics: Sequence[Cubic], s: FloatArray, middle_m: float) -> FloatArray:
    """Evaluate a piecewise cubic at samples between breaks; 0 before its first record."""
    index = bisect_right(cubics, middle_m, key=_start) - 1
    if index < 0:
        return np.zeros_like(s)
    cubic = cubics[index]
    u = s - cubic.s_m
    values: FloatArray = cubic.a + u * (cubic.b + u * (cubic.c + u * cubic.d))
    return values


def active(
    records: Sequence[_Record], start_m: float, end_m: float, key: Callable[[_Record], float]
) -> Sequence[_Record]:
    """Return the records that hold somewhere between two arc lengths, each up to the next one.

    Args:
        records: in order.
        start_m: the first arc length.
        end_m: the second one.
        key: gives the arc length from which a record holds.
    """
    first = max(0, bisect_right(records, start_m, key=key) - 1)
    return records[first : bisect_left(records, end_m, key=key)]


def _start(record: Cubic | Mark) -> float:
    return record.s_m


def _is_open(lane: LaneRecord, at_m: float) -> bool:
    index = bisect_right(lane.closed, at_m, key=lambda step: step[0]) - 1
    return index < 0 or not lane.closed[index][1]


@dataclass(frozen=True, slots=True)
class LaidLane:
    """A lane at samples: the offsets of its centre, and its widths."""

    lane: LaneRecord
    centre_m: FloatArray
    width_m: FloatArray


def laid_out(road: RoadRecord, section: Section, s: FloatArray, middle: float) -> list[LaidLane]:
    """Return the lanes at samples between breaks, from right to left."""
    offset = _values(road.offsets, s, middle)
    lanes = []
    for sign in (-1, 1):
        border = offset
        side = [lane for lane in section.lanes if lane.id * sign > 0]
        for lane in sorted(side, key=lambda lane: abs(lane.id)):
            if lane.borders and not lane.widths:
                # A border is measured from lane 0's own line.
                outer = offset + _values(lane.borders, s, middle)
                width = sign * (outer - border)
            else:
                width = _values(lane.widths, s, middle)
            width = np.clip(width, 0.0, _WIDEST_M)
            lanes.append(LaidLane(lane, border + sign * width / 2.0, width))
            border = border + sign * width
    return sorted(lanes, key=lambda laid: laid.lane.id)


def _sampled(road: RoadRecord, section: Section, start_m: float, end_m: float) -> list[_Track]:
    """Compute the places of the lanes in an interval, from right to left."""
    middle = 0.5 * (start_m + end_m)
    return [
        _Track(
            laid.lane,
            float(laid.centre_m.min()),
            float(laid.centre_m.max()),
            float(laid.width_m.min()),
            float(laid.width_m.max()),
            _is_open(laid.lane, middle),
        )
        for laid in laid_out(road, section, np.linspace(start_m, end_m, _SAMPLES), middle)
    ]


def breaks(road: RoadRecord, section: Section) -> list[float]:
    """Return where the records of a section's lanes end, with its own start and end."""
    start, end = section.start_m, section.end_m
    offsets = active(road.offsets, start, end, _start)
    cubics = [*offsets, *(c for lane in section.lanes for c in (*lane.widths, *lane.borders))]
    places = [c.s_m for c in cubics]
    places += [s for lane in section.lanes for s, _ in lane.closed]
    return sorted({start, end, *(s for s in places if start < s < end)})


def _intervals(road: RoadRecord, section: Section) -> list[tuple[float, float, list[_Track]]]:
    """Return the parts of a section in which no record ends, and where the lanes lie in each."""
    steps = pairwise(breaks(road, section))
    return [(a, b, _sampled(road, section, a, b)) for a, b in steps if b - a > 1e-6]


def drivable_widths(road: RoadRecord, section: Section, a: float, b: float) -> dict[int, float]:
    """Return the lanes of a section that cars can drive in between two breaks, and their widths.

    Args:
        road: that the section is of.
        section: the section.
        a: arc length of one break.
        b: of the next one.
    """
    tracks = _sampled(road, section, a, b)
    return {track.lane.id: track.width_m for track in tracks if _drivable(track)}


def _both_ways(lane: LaneRecord) -> bool:
    return lane.direction == "both" or lane.travel == "bidirectional"


def runs_along(road: RoadRecord, lane: LaneRecord) -> bool:
    """Tell whether a lane's traffic runs in the road's direction, by its side and attribute."""
    return ((lane.id < 0) != road.left_hand) != (lane.direction == "reversed")


def direction_fault(road: RoadRecord) -> str:
    """Name the contradiction that hides where a road's traffic runs; empty: there is none."""
    words = {True: "forward", False: "backward"}
    against = {
        (lane.id, lane.travel)
        for section in road.sections
        for lane in section.lanes
        if lane.type in DRIVING
        and lane.travel in words.values()
        and lane.travel != words[runs_along(road, lane)]
    }
    if not against:
        return ""
    ids = {word: sorted(i for i, travel in against if travel == word) for word in words.values()}
    directions = " and ".join(
        f"{word} on lane {', '.join(map(str, some))}" for word, some in ids.items() if some
    )
    return (
        f"its travelDir is {directions}, against the side of the road that the lane lies on; give "
        'rule="LHT" for left-hand traffic, or correct the lanes'
    )


def _drivable(track: _Track) -> bool:
    return (
        track.lane.type in DRIVING
        and track.is_open
        and not _both_ways(track.lane)
        and track.width_m >= NARROWEST_M
    )


def _usable(track: _Track) -> bool:
    return _drivable(track) and track.high_m - track.low_m <= 2 * STEADY_M


def _merged(a: list[_Track], b: list[_Track]) -> list[_Track] | None:
    """Merge two neighbouring intervals; None where the driving lanes aren't the same."""
    both = []
    for one, other in zip(a, b, strict=True):
        joint = _Track(
            one.lane,
            min(one.low_m, other.low_m),
            max(one.high_m, other.high_m),
            min(one.width_m, other.width_m),
            max(one.widest_m, other.widest_m),
            one.is_open and other.is_open,
        )
        if not _usable(one) == _usable(other) == _usable(joint):
            return None
        both.append(joint)
    return both


def _slots(road: RoadRecord, tracks: list[_Track]) -> tuple[Slot, ...]:
    return tuple(
        Slot(
            id=track.lane.id,
            type=track.lane.type,
            y_m=0.5 * (track.low_m + track.high_m),
            width_m=track.width_m,
            driving=_usable(track),
            along=runs_along(road, track.lane),
        )
        for track in tracks
    )


def stretches(road: RoadRecord) -> tuple[list[Stretch], list[tuple[float, float, str]]]:
    """Return the stretches of a road with steady driving lanes.

    Returns:
        Them, in order, and what is no such stretch: (from, to, reason).
    """
    steady_stretches: list[Stretch] = []
    refused: list[tuple[float, float, str]] = []
    for section in road.sections:
        if section.end_m - section.start_m <= 1e-6:
            continue
        merged: list[tuple[float, float, list[_Track]]] = []
        for a, b, tracks in _intervals(road, section):
            joint = _merged(merged[-1][2], tracks) if merged else None
            if joint is None:
                merged.append((a, b, tracks))
            else:
                merged[-1] = (merged[-1][0], b, joint)
        for a, b, tracks in merged:
            if any(_usable(track) for track in tracks):
                steady_stretches.append(Stretch(section, a, b, _slots(road, tracks)))
            else:
                refused.append((a, b, _why_unusable(tracks)))
    return steady_stretches, refused


def _why_unusable(tracks: list[_Track]) -> str:
    driving = [track for track in tracks if track.lane.type in DRIVING]
    if not driving:
        return "it has no driving lane"
    parts = []
    for track in driving:
        shift = track.high_m - track.low_m
        if not track.is_open:
            parts.append(f"lane {track.lane.id} is closed to cars (access)")
        elif _both_ways(track.lane):
            parts.append(f"lane {track.lane.id} is driven in both directions")
        elif shift > 2 * STEADY_M:
            parts.append(f"lane {track.lane.id} shifts by {shift:.2f} m")
        else:
            parts.append(f"lane {track.lane.id} is {track.width_m:.2f} m wide")
    return ", ".join(parts)


def may_change(a: Slot, b: Slot, stretch: Stretch) -> bool:
    """Tell whether the marking between two neighbouring lanes lets traffic go from a to b.

    The mark between them is the outer border of the inner one. Where its ``laneChange`` says
    nothing, its type does; so it does for a broken line with ``laneChange="none"``, which editors
    write where none was chosen. What holds for at least half of the stretch counts.
    """
    inner = min((a.id, b.id), key=abs)
    if a.id * b.id < 0:
        marks = stretch.section.centre_marks
    else:
        marks = next(lane.marks for lane in stretch.section.lanes if lane.id == inner)
    here = active(marks, stretch.start_m, stretch.end_m, _start)
    allowed = 0.0
    for mark, following in zip_longest(here, here[1:]):
        end = stretch.end_m if following is None else following.s_m
        length = min(end, stretch.end_m) - max(mark.s_m, stretch.start_m)
        if length > 0.0 and _lets_through(mark, inwards=b.id == inner, rising=b.id > a.id):
            allowed += length
    return not marks or allowed >= 0.5 * (stretch.end_m - stretch.start_m)


def _lets_through(mark: Mark, *, inwards: bool, rising: bool) -> bool:
    unset = mark.lane_change == "none" and mark.type in _BROKEN
    if mark.lane_change in ("both", "none", "increase", "decrease") and not unset:
        return mark.lane_change == "both" or mark.lane_change == (
            "increase" if rising else "decrease"
        )
    # Two lines: the first word is the inner one; the line on the own side decides.
    words = mark.type.split()
    if len(words) == 2:
        return words[1 if inwards else 0] != "solid"
    return mark.type not in ("solid", "curb", "edge", "grass")


@dataclass(frozen=True, slots=True)
class LaneHere:
    """A lane at one arc length: offset of its centre (+ left of the reference line) and width."""

    id: int
    centre_m: float
    width_m: float


def lanes_at(road: RoadRecord, s_m: float) -> list[LaneHere]:
    """List all lanes of a road at an arc length, of any type and width, without lane 0."""
    within = [section for section in road.sections if section.start_m <= s_m]
    if not within:
        return []
    tracks = _sampled(road, within[-1], s_m, s_m)
    return [LaneHere(track.lane.id, track.low_m, track.width_m) for track in tracks]
