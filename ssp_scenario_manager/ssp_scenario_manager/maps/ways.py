"""Ways: stretches of road of any map format, and how those that continue one another are joined."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ssp_core.geometry import wrap_angle
from ssp_core.run_file.road import SceneryItem
from ssp_core.world.reference_line import ReferenceLine
from ssp_core.world.scenery import reversed_item, shifted
from ssp_scenario_manager.maps.block import Boundary, RoadType, headings
from ssp_scenario_manager.maps.crossings import Crossing

End = Literal["start", "end"]
WayEnd = tuple[int, End]
_SIDES: tuple[End, End] = ("end", "start")

# Ways are joined where their lanes agree to this, and their lines meet to this.
_LANE_M = 0.05
_MEET_M = 0.02
_MEET_RAD = 0.01
_DRIFT_M = 0.05
# Joined ways end where more would be of no use, or would run back beside themselves.
_LONGEST_M = 2000.0
_MOST_PIECES = 2000
_MOST_TURN_RAD = 3.0


@dataclass(frozen=True, slots=True)
class WayLane:
    """A driving lane: offset of its centre (+ left of the way's line), narrowest width."""

    name: str
    y_m: float
    width_m: float
    along: bool


@dataclass(frozen=True, slots=True)
class Side:
    """The roadside beyond the outermost driving lane."""

    boundary: Boundary
    shoulder_m: float = 0.0
    sidewalk_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Rules:
    """The rules for traffic in one direction, whose left and right are its own."""

    speed_mps: float | None
    change_left: bool
    change_right: bool


@dataclass(frozen=True)
class Way:
    """A stretch of road.

    Args:
        roads: names of the roads that it is made of, in its order.
        span_m: its part of its one road, None where it is all of it.
        lanes: driving lanes from right to left.
        right: beyond the rightmost of them.
        left: beyond the leftmost of them.
        along: rules for traffic along it.
        against: rules for traffic against it.
        crossings: zebras on its lanes, along its line.
        junction: that it leads through, None outside of one.
        noun: what the map's roads are called in names.
        both: traffic against it has its block from this way too, not from one of its own.
        scenery: what stands beside it, along its line.
        left_hand: traffic keeps to the left.
        lane: the one lane of a road that it is, along that lane's own middle, where it shifts;
            empty: it has all lanes of its road.
    """

    roads: tuple[str, ...]
    span_m: tuple[float, float] | None
    line: ReferenceLine
    lanes: tuple[WayLane, ...]
    right: Side
    left: Side
    road_type: RoadType
    along: Rules
    against: Rules
    crossings: tuple[Crossing, ...] = ()
    junction: str | None = None
    notes: tuple[str, ...] = ()
    noun: str = "road"
    both: bool = True
    scenery: tuple[SceneryItem, ...] = ()
    left_hand: bool = False
    lane: str = ""

    @property
    def name(self) -> str:
        """``road 12``, ``road 12 [30-85 m]`` or ``roads 0+11+8``; long lists are shortened.

        Of one lane ``road 12 lane -1`` or ``road 12 lane -1 [30-85 m]``.
        """
        if len(self.roads) == 1:
            own = f"{self.noun} {self.roads[0]}{f' {self.lane}' if self.lane else ''}"
            if self.span_m is None:
                return own
            return f"{own} [{self.span_m[0]:g}-{self.span_m[1]:g} m]"
        if len(self.roads) <= 5:
            return f"{self.noun}s {'+'.join(self.roads)}"
        return f"{self.noun}s {self.roads[0]}+...+{self.roads[-1]}"

    def reversed(self) -> Way:
        """Return the same way in the other direction."""
        length = self.line.length_m
        return replace(
            self,
            roads=self.roads[::-1],
            line=self.line.reversed(),
            lanes=tuple(
                WayLane(lane.name, -lane.y_m, lane.width_m, not lane.along)
                for lane in reversed(self.lanes)
            ),
            right=self.left,
            left=self.right,
            along=self.against,
            against=self.along,
            crossings=tuple(zebra.reversed(length) for zebra in self.crossings[::-1]),
            scenery=tuple(reversed_item(item, length) for item in self.scenery),
        )


def _lanes_agree(a: Way, b: Way) -> bool:
    return len(a.lanes) == len(b.lanes) and all(
        one.along == other.along
        and abs(one.y_m - other.y_m) <= _LANE_M
        and abs(one.width_m - other.width_m) <= _LANE_M
        for one, other in zip(a.lanes, b.lanes, strict=True)
    )


def _rules_agree(a: Way, b: Way) -> bool:
    return (
        (a.road_type, a.along, a.against) == (b.road_type, b.along, b.against)
        and (a.right.boundary, a.left.boundary) == (b.right.boundary, b.left.boundary)
        and a.left_hand == b.left_hand
        and a.junction is None
        and b.junction is None
    )


def _narrower(a: Side, b: Side) -> Side:
    return Side(a.boundary, min(a.shoulder_m, b.shoulder_m), min(a.sidewalk_m, b.sidewalk_m))


def joined(a: Way, b: Way) -> Way | None:
    """Join two ways, b after a; None if they differ, don't meet, or it would get too long."""
    length = a.line.length_m + b.line.length_m
    if not (_lanes_agree(a, b) and _rules_agree(a, b)) or length > _LONGEST_M:
        return None
    if len(a.line.pieces) + len(b.line.pieces) > _MOST_PIECES:
        return None
    end, start = a.line.pose(a.line.length_m), b.line.pose(0.0)
    if (
        math.hypot(end.x_m - start.x_m, end.y_m - start.y_m) > _MEET_M
        or abs(wrap_angle(end.yaw_rad - start.yaw_rad)) > _MEET_RAD
    ):
        return None
    line = ReferenceLine(a.line.origin, [*a.line.pieces, *b.line.pieces])
    goal, target = line.pose(length), b.line.pose(b.line.length_m)
    if math.hypot(goal.x_m - target.x_m, goal.y_m - target.y_m) > _DRIFT_M:
        return None
    turns = headings(line, np.cumsum([0.0, *(piece.length_m for piece in line.pieces)]))
    if float(turns.max() - turns.min()) > _MOST_TURN_RAD:
        return None
    same_road = a.roads[-1:] == b.roads[:1]
    roads = a.roads + (b.roads[1:] if same_road else b.roads)
    span = None
    if len(roads) == 1 and a.span_m is not None and b.span_m is not None:
        span = (min(a.span_m[0], b.span_m[0]), max(a.span_m[1], b.span_m[1]))
    return Way(
        roads=roads,
        span_m=span,
        line=line,
        lanes=tuple(
            WayLane(one.name, one.y_m, min(one.width_m, other.width_m), one.along)
            for one, other in zip(a.lanes, b.lanes, strict=True)
        ),
        right=_narrower(a.right, b.right),
        left=_narrower(a.left, b.left),
        road_type=a.road_type,
        along=a.along,
        against=a.against,
        crossings=a.crossings
        + tuple(zebra.at(zebra.s_m + a.line.length_m) for zebra in b.crossings),
        notes=tuple(dict.fromkeys(a.notes + b.notes)),
        noun=a.noun,
        both=a.both,
        scenery=a.scenery + tuple(shifted(item, a.line.length_m) for item in b.scenery),
        left_hand=a.left_hand,
    )


# Per end of a joined way, the ends of others that traffic goes on to.
Meets = Mapping[WayEnd, tuple[WayEnd, ...]]


def join_ways(
    ways: Sequence[Way], contacts: Collection[tuple[WayEnd, WayEnd]]
) -> tuple[list[Way], Meets]:
    """Join ways that simply continue one another, and tell which ends of which meet.

    Two ways do where each is all that the other's end meets, and `joined` finds nothing against it.
    The first of those that are joined gives the direction. Single lanes are joined with nothing,
    and keep nothing from being joined.
    """
    all_meets: dict[WayEnd, set[WayEnd]] = {}
    meets: dict[WayEnd, set[WayEnd]] = {}
    for a, b in contacts:
        if a != b:
            single = ways[a[0]].lane or ways[b[0]].lane
            for found_meets in (all_meets,) if single else (all_meets, meets):
                found_meets.setdefault(a, set()).add(b)
                found_meets.setdefault(b, set()).add(a)
    joined_indices: set[int] = set()
    joined_ways: list[Way] = []
    place: dict[WayEnd, WayEnd] = {}
    for i, first in enumerate(ways):
        if i in joined_indices:
            continue
        joined_indices.add(i)
        way = first
        outer: dict[End, WayEnd] = {"start": (i, "start"), "end": (i, "end")}
        for side in _SIDES:
            while True:
                partners = meets.get(outer[side], set())
                if len(partners) != 1:
                    break
                (j, end) = next(iter(partners))
                if j in joined_indices or len(meets[(j, end)]) != 1:
                    break
                follows = ways[j] if (end == "start") == (side == "end") else ways[j].reversed()
                longer = joined(way, follows) if side == "end" else joined(follows, way)
                if longer is None:
                    break
                way = longer
                joined_indices.add(j)
                outer[side] = (j, "end" if end == "start" else "start")
        for side in _SIDES:
            place[outer[side]] = (len(joined_ways), side)
        joined_ways.append(way)
    way_meets: dict[WayEnd, tuple[WayEnd, ...]] = {}
    for old, new in place.items():
        partners = {place[other] for other in all_meets.get(old, set()) if other in place}
        way_meets[new] = tuple(sorted(partners))
    return joined_ways, way_meets
