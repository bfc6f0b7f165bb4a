"""Ways, stretches of road of any map format, and the blocks and junction areas made of them."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np

from ssp_core.geometry import FloatArray, wrap_angle
from ssp_core.run_file.road import MOST_SCENERY, SceneryItem
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_core.world.scenery import Clearance, reversed_item, shifted
from ssp_scenario_manager.maps.block import (
    Block,
    BlockLane,
    Boundary,
    ConflictArea,
    RoadType,
    conflict_areas,
    headings,
    segment_of,
    straight_parts,
)
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


def _joined_ways(
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


_SAMPLES = 24
_GAP = 2
# More ways than this through one junction are no junction of a road network.
MOST_WAYS = 200


def _half_width_m(block: Block) -> float:
    """Return half the width of its forward lanes together."""
    left = max(lane.y_m + lane.width_m / 2 for lane in block.forward_lanes)
    return 0.5 * (left - min(lane.y_m - lane.width_m / 2 for lane in block.forward_lanes))


def _samples(block: Block) -> tuple[FloatArray, FloatArray]:
    """Return arc lengths and places along the middle of a way's forward lanes."""
    s = np.linspace(0.0, block.line.length_m, _SAMPLES)
    lanes = block.forward_lanes
    return s, block.line.to_map_many(s, sum(lane.y_m for lane in lanes) / len(lanes))


def _stretches(s: FloatArray, hit: FloatArray) -> list[tuple[float, float]]:
    """Return runs of samples that are hit, over gaps of up to two, widened by half a step."""
    if not hit.any():
        return []
    half = 0.5 * float(s[1] - s[0])
    at = np.flatnonzero(hit)
    for a, b in pairwise(at):
        if b - a <= _GAP + 1:
            hit[a:b] = True
    padded = np.concatenate(([False], hit, [False]))
    starts = np.flatnonzero(padded[1:] & ~padded[:-1])
    ends = np.flatnonzero(~padded[1:] & padded[:-1]) - 1
    return [
        (max(0.0, float(s[a]) - half), min(float(s[-1]), float(s[b]) + half))
        for a, b in zip(starts, ends, strict=True)
    ]


def junction_areas(through: Sequence[Block]) -> dict[str, tuple[ConflictArea, ...]]:
    """Return areas per block of one junction, by kind and place.

    Two ways that come from different blocks conflict where their corridors overlap: as ``merge``
    where both go on to the same block, else as ``crossing``. Ways from the same block only part.
    """
    sampled = [_samples(block) for block in through]
    places = np.array([xy for _, xy in sampled])
    x, y = places[..., 0], places[..., 1]
    half = np.array([_half_width_m(block) for block in through])
    areas_by_block: dict[str, tuple[ConflictArea, ...]] = {}
    for i, block in enumerate(through):
        dx = x[i][None, :, None] - x[:, None, :]
        dy = y[i][None, :, None] - y[:, None, :]
        near = (dx * dx + dy * dy < ((half + half[i]) ** 2)[:, None, None]).any(axis=2)
        hits = {"merge": np.zeros(_SAMPLES, dtype=bool), "crossing": np.zeros(_SAMPLES, dtype=bool)}
        for j in map(int, np.flatnonzero(near.any(axis=1))):
            other = through[j]
            if j == i or set(block.entrances) & set(other.entrances):
                continue
            hits["merge" if set(block.exits) & set(other.exits) else "crossing"] |= near[j]
        s = sampled[i][0]
        areas = [ConflictArea("merge", a, b) for a, b in _stretches(s, hits["merge"])]
        areas += [ConflictArea("crossing", a, b) for a, b in _stretches(s, hits["crossing"])]
        areas_by_block[block.block_id] = tuple(
            sorted(areas, key=lambda area: (area.kind, area.start_s_m))
        )
    return areas_by_block


# Offsets stay this far from the centre of curvature, as a share of the radius.
_REACH = 0.95
# A line that turns by less comes nowhere back beside itself; places of others are tried at a step.
_LEAST_LOOP_RAD = 3.0
_LOOP_STEP_M = 0.5


def block_id(way: Way, forward: bool) -> str:
    """Return the id of a way's block in one direction."""
    return f"{way.name} {'forward' if forward else 'backward'}"


def _room_m(way: Way) -> tuple[float, float]:
    """Return how far to the right (negative) and left places have coordinates all along the way."""
    bends = [k for p in way.line.pieces for k in (p.start_curvature_1pm, p.end_curvature_1pm)]
    most, least = max(0.0, *bends), min(0.0, *bends)
    return (
        _REACH / least if least < 0.0 else float("-inf"),
        _REACH / most if most > 0.0 else float("inf"),
    )


def _cut_side(side: Side, room_m: float) -> Side:
    """Return a side no wider than there is room for it."""
    shoulder = min(side.shoulder_m, max(0.0, room_m))
    return Side(side.boundary, shoulder, min(side.sidewalk_m, max(0.0, room_m - shoulder)))


def _permitted(way: Way) -> frozenset[str]:
    words = {"keep_lane", "stop"}
    if way.along.change_left:
        words.add("lane_change_left")
    if way.along.change_right:
        words.add("lane_change_right")
    if way.road_type != "motorway" and way.junction is None:
        words.add("crossing")
    return frozenset(words)


def _block(way: Way, name: str, entrances: tuple[str, ...], exits: tuple[str, ...]) -> Block:
    """Return the block of a way for traffic along it."""
    lanes = tuple(BlockLane(lane.y_m, lane.width_m, lane.along, lane.name) for lane in way.lanes)
    right_room, left_room = _room_m(way)
    right = _cut_side(way.right, min(x.y_m - x.width_m / 2 for x in lanes) - right_room)
    left = _cut_side(way.left, left_room - max(x.y_m + x.width_m / 2 for x in lanes))
    length = way.line.length_m
    permitted = _permitted(way)
    scenery, notes = _beside(way)
    notes += tuple(
        f"a zebra at {zebra.s_m:.1f} m covers some of its lanes only: a marking, and no crossing"
        for zebra in way.crossings
        if not zebra.whole
    )
    areas: tuple[ConflictArea, ...] = ()
    if way.junction is None:
        marked = [zebra.s_m for zebra in way.crossings if zebra.whole]
        areas = conflict_areas(length, lanes, permitted, marked)
    return Block(
        block_id=name,
        line=way.line,
        lanes=lanes,
        road_type=way.road_type,
        segment="junction" if way.junction is not None else segment_of(way.line),
        left_boundary=left.boundary,
        right_boundary=right.boundary,
        sidewalk_left_m=left.sidewalk_m,
        sidewalk_right_m=right.sidewalk_m,
        permitted=permitted,
        entrances=entrances,
        exits=exits,
        conflict_areas=areas,
        crossings=way.crossings,
        speed_limit_mps=way.along.speed_mps,
        shoulder_left_m=left.shoulder_m,
        shoulder_right_m=right.shoulder_m,
        notes=way.notes + notes,
        scenery=scenery,
        left_hand=way.left_hand,
        roads=way.roads,
        junction=way.junction,
    )


def _beside(way: Way) -> tuple[tuple[SceneryItem, ...], tuple[str, ...]]:
    """Return the part of a way's scenery that can stand beside its block, and notes on the rest."""
    clearance = Clearance(way.line, [(lane.y_m, lane.width_m) for lane in way.lanes])
    clear_items = [item for item in way.scenery if clearance.problem(item) is None]
    fewer = clear_items[:MOST_SCENERY]
    notes = []
    if len(clear_items) < len(way.scenery):
        notes.append(
            f"{len(way.scenery) - len(clear_items)} objects or signs that stand on the lanes or "
            "have no place along the block are left out"
        )
    if len(fewer) < len(clear_items):
        notes.append(f"only {MOST_SCENERY} of {len(clear_items)} objects and signs are kept")
    return tuple(fewer), tuple(notes)


def _part(way: Way, from_m: float, to_m: float) -> Way:
    return replace(
        way,
        line=way.line.section(from_m, to_m),
        crossings=tuple(
            zebra.at(zebra.s_m - from_m) for zebra in way.crossings if from_m <= zebra.s_m <= to_m
        ),
        scenery=tuple(shifted(item, -from_m) for item in way.scenery if from_m <= item.s_m <= to_m),
    )


def _straights(way: Way, whole: Block) -> list[Block]:
    """Return the straight parts of a bent block, as blocks of their own."""
    parts = []
    for low, high in straight_parts(way.line):
        entrances = whole.entrances if low == 0.0 else (whole.block_id,)
        exits = whole.exits if high >= whole.length_m - 1e-6 else (whole.block_id,)
        name = f"{whole.block_id} [{low:.0f}-{high:.0f} m]"
        block = _block(_part(way, low, high), name, entrances, exits)
        note = f"a straight part of {whole.block_id}"
        parts.append(replace(block, notes=(*block.notes, note)))
    return parts


def _tight(way: Way) -> str | None:
    """Give the reason why a way's lanes have no coordinates along its line; None: they have."""
    right_room, left_room = _room_m(way)
    left = max(lane.y_m + lane.width_m / 2 for lane in way.lanes)
    right = min(lane.y_m - lane.width_m / 2 for lane in way.lanes)
    for edge, room in ((left, left_room), (right, right_room)):
        if abs(edge) >= abs(room) and edge * room > 0.0:
            return (
                f"its lanes reach {abs(edge):.1f} m from the reference line on the inner side of a "
                f"bend of {abs(room) / _REACH:.1f} m radius, where nothing has coordinates"
            )
    return None


def _beside_itself(way: Way) -> str | None:
    """Give the reason why a way in a junction comes too near to itself; None: it doesn't."""
    turned_rad = float(np.ptp(headings(way.line, _joints(way.line))))
    if way.junction is None or turned_rad < _LEAST_LOOP_RAD:
        return None
    s = np.linspace(0.0, way.line.length_m, math.ceil(way.line.length_m / _LOOP_STEP_M) + 1)
    for name, y_m in (("its line", 0.0), *((lane.name, lane.y_m) for lane in way.lanes)):
        try:
            way.line.to_map_many(s, y_m)
        except NotOneToOne as error:
            return f"turns by {math.degrees(turned_rad):.0f} degrees, and of {name}, {error}"
    return None


def _joints(line: ReferenceLine) -> FloatArray:
    return np.cumsum([0.0, *(piece.length_m for piece in line.pieces)])


def in_known_junctions(
    ways: Sequence[Way], junctions: Collection[str]
) -> tuple[list[Way], list[tuple[str, str]]]:
    """Take ways out of junctions that the map doesn't have.

    Returns:
        The ways, and what is wrong with those, for the rejections of the map.
    """
    missing = {
        way.name: f"is in junction {way.junction}, which isn't there"
        for way in ways
        if way.junction is not None and way.junction not in junctions
    }
    sound_ways = [replace(way, junction=None) if way.name in missing else way for way in ways]
    return sound_ways, list(missing.items())


@dataclass(frozen=True)
class NetworkBlocks:
    """The blocks of a map's ways.

    Args:
        blocks: of ways with all lanes of their road.
        shifting: of ways that are a single lane.
        rejected: what can't be a block, with the reason.
    """

    blocks: tuple[Block, ...]
    shifting: tuple[Block, ...]
    rejected: list[tuple[str, str]]


def network_blocks(
    ways: Sequence[Way], contacts: Collection[tuple[WayEnd, WayEnd]]
) -> NetworkBlocks:
    """Return all blocks of a map's ways, by id, and what can't be one, with the reason.

    A way gives a block per direction in which it has lanes. Straight parts of 50 m or more of bent
    ways outside of junctions are blocks beside the whole, which they overlap.

    Args:
        ways: in the map's order; those that simply continue one another are joined.
        contacts: pairs of ends that meet.
    """
    joined_ways, meets = _joined_ways(ways, contacts)
    tight = {
        i: why
        for i, way in enumerate(joined_ways)
        if (why := _tight(way) or _beside_itself(way)) is not None
    }
    rejected = [(joined_ways[i].name, why) for i, why in tight.items()]

    def neighbours(end: WayEnd, *, entering: bool) -> tuple[str, ...]:
        """Return ids of the blocks that enter, or leave, their way at ends that meet this one."""
        beside = ((joined_ways[i], (at == "start") == entering, i) for i, at in meets.get(end, ()))
        return tuple(
            sorted(
                {
                    block_id(way, forward)
                    for way, forward, i in beside
                    if i not in tight and _leads(way, forward)
                }
            )
        )

    blocks: list[Block] = []
    shifting: list[Block] = []
    through: dict[str, list[Block]] = {}
    for index, way in enumerate(joined_ways):
        for forward in (True, False):
            if index in tight or not _leads(way, forward):
                continue
            ends: tuple[WayEnd, WayEnd] = ((index, "start"), (index, "end"))
            enter, leave = ends if forward else ends[::-1]
            exits = neighbours(leave, entering=True)
            directed_way = way if forward else way.reversed()
            entrances = neighbours(enter, entering=False)
            block = _block(directed_way, block_id(way, forward), entrances, exits)
            if len(way.roads) > 1:
                joins = f"joins {way.noun}s {', '.join(directed_way.roads)}"
                block = replace(block, notes=(*block.notes, joins))
            if way.lane:
                shifting.append(replace(block, shifting=True))
                continue
            blocks.append(block)
            if way.junction is not None:
                through.setdefault(way.junction, []).append(block)
            elif block.segment == "curve":
                blocks += _straights(directed_way, block)
    areas: dict[str, tuple[ConflictArea, ...]] = {}
    for junction, inside in through.items():
        if len(inside) <= MOST_WAYS:
            areas |= junction_areas(inside)
            continue
        many = f"has {len(inside)} ways through it; their conflict areas weren't looked for"
        rejected.append((f"junction {junction}", many))
    blocks_with_areas = (
        replace(block, conflict_areas=areas[block.block_id]) if block.block_id in areas else block
        for block in blocks
    )
    return NetworkBlocks(_by_id(blocks_with_areas), _by_id(shifting), rejected)


def _by_id(blocks: Iterable[Block]) -> tuple[Block, ...]:
    return tuple(sorted(blocks, key=lambda block: block.block_id))


def _leads(way: Way, forward: bool) -> bool:
    """Tell whether a way gives a block in a direction."""
    return (forward or way.both) and any(lane.along == forward for lane in way.lanes)
