"""Blocks of a road network: its ways, cut to what can be driven, and their conflict areas."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.run_file.road import MOST_SCENERY, SceneryItem
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_core.world.scenery import Clearance, shifted
from ssp_scenario_manager.maps.block import (
    Block,
    BlockLane,
    ConflictArea,
    conflict_areas,
    headings,
    segment_of,
    straight_parts,
)
from ssp_scenario_manager.maps.ways import Side, Way, WayEnd, join_ways

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
    joined_ways, meets = join_ways(ways, contacts)
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
