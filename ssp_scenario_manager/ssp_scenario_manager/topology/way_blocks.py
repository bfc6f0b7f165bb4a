"""Blocks from ways: one per direction of travel, and one per straight part of a bent one."""

from __future__ import annotations

from dataclasses import replace

from ssp_core.run_file.road import MOST_SCENERY, SceneryItem
from ssp_core.world.scenery import Clearance, shifted
from ssp_scenario_manager.topology.areas import conflict_areas
from ssp_scenario_manager.topology.bends import segment_of, straight_parts
from ssp_scenario_manager.topology.block import Block, BlockLane, ConflictArea
from ssp_scenario_manager.topology.junctions import MOST_WAYS, JunctionPath, junction_areas
from ssp_scenario_manager.topology.ways import Network, Side, Way, WayEnd

# Offsets stay this far from the centre of curvature, as a share of the radius.
_REACH = 0.95


def block_id(way: Way, forward: bool) -> str:
    """Id of a way's block in one direction."""
    return f"{way.name} {'forward' if forward else 'backward'}"


def _room_m(way: Way) -> tuple[float, float]:
    """How far to the right (negative) and left places have coordinates all along the way."""
    bends = [k for p in way.line.pieces for k in (p.start_curvature_1pm, p.end_curvature_1pm)]
    most, least = max(0.0, *bends), min(0.0, *bends)
    return (
        _REACH / least if least < 0.0 else float("-inf"),
        _REACH / most if most > 0.0 else float("inf"),
    )


def _cut_side(side: Side, room_m: float) -> Side:
    """A side no wider than there is room for it."""
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
    """The block of a way for traffic along it."""
    lanes = tuple(BlockLane(lane.y_m, lane.width_m, lane.along, lane.name) for lane in way.lanes)
    right_room, left_room = _room_m(way)
    right = _cut_side(way.right, min(x.y_m - x.width_m / 2 for x in lanes) - right_room)
    left = _cut_side(way.left, left_room - max(x.y_m + x.width_m / 2 for x in lanes))
    length = way.line.length_m
    crossing = min(way.crossings_m, key=lambda s: abs(s - length / 2), default=None)
    permitted = _permitted(way)
    scenery, notes = _beside(way)
    areas: tuple[ConflictArea, ...] = ()
    if way.junction is None:
        areas = conflict_areas(length, lanes, permitted, crossing)
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
        crossing_s_m=crossing,
        speed_limit_mps=way.along.speed_mps,
        shoulder_left_m=left.shoulder_m,
        shoulder_right_m=right.shoulder_m,
        notes=way.notes + notes,
        scenery=scenery,
    )


def _beside(way: Way) -> tuple[tuple[SceneryItem, ...], tuple[str, ...]]:
    """What of a way's scenery can stand beside its block, and a note about the rest."""
    clearance = Clearance(way.line, [(lane.y_m, lane.width_m) for lane in way.lanes])
    kept = [item for item in way.scenery if clearance.problem(item) is None]
    fewer = kept[:MOST_SCENERY]
    notes = []
    if len(kept) < len(way.scenery):
        notes.append(f"{len(way.scenery) - len(kept)} objects or signs that stand on the lanes or "
                     "have no place along the block are left out")  # fmt: skip
    if len(fewer) < len(kept):
        notes.append(f"only {MOST_SCENERY} of {len(kept)} objects and signs are kept")
    return tuple(fewer), tuple(notes)


def _part(way: Way, from_m: float, to_m: float) -> Way:
    return replace(
        way,
        line=way.line.section(from_m, to_m),
        crossings_m=tuple(s - from_m for s in way.crossings_m if from_m <= s <= to_m),
        scenery=tuple(shifted(item, -from_m) for item in way.scenery if from_m <= item.s_m <= to_m),
    )


def _straights(way: Way, whole: Block) -> list[Block]:
    """The straight parts of a bent block, as blocks of their own."""
    found = []
    for low, high in straight_parts(way.line):
        entrances = whole.entrances if low == 0.0 else (whole.block_id,)
        exits = whole.exits if high >= whole.length_m - 1e-6 else (whole.block_id,)
        name = f"{whole.block_id} [{low:.0f}-{high:.0f} m]"
        block = _block(_part(way, low, high), name, entrances, exits)
        note = f"a straight part of {whole.block_id}"
        found.append(replace(block, notes=(*block.notes, note)))
    return found


def _tight(way: Way) -> str | None:
    """Why a way's lanes have no coordinates along its line; None: they have."""
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


def network_blocks(network: Network) -> tuple[list[Block], list[tuple[str, str]]]:
    """All blocks of joined ways, and what can't be one, with the reason.

    A way gives a block per direction in which it has lanes. Straight parts of 50 m or more of bent
    ways outside of junctions are blocks beside the whole, which they overlap.
    """
    rejected = []
    usable = []
    for way in network.ways:
        why = _tight(way)
        if why is not None:
            rejected.append((way.name, why))
        usable.append(why is None)
    blocks: list[Block] = []
    through: dict[str, list[JunctionPath]] = {}
    for index, way in enumerate(network.ways):
        for forward in (True, False):
            if not usable[index] or not _leads(way, forward):
                continue
            ends: tuple[WayEnd, WayEnd] = ((index, "start"), (index, "end"))
            enter, leave = ends if forward else ends[::-1]
            entrances = _neighbours(network, usable, enter, entering=False)
            exits = _neighbours(network, usable, leave, entering=True)
            seen = way if forward else way.reversed()
            block = _block(seen, block_id(way, forward), entrances, exits)
            if len(way.roads) > 1:
                joins = f"joins {way.noun}s {', '.join(seen.roads)}"
                block = replace(block, notes=(*block.notes, joins))
            blocks.append(block)
            if way.junction is not None:
                path = JunctionPath(
                    block.block_id, way.junction, seen.line, block.forward_lanes, entrances, exits
                )
                through.setdefault(way.junction, []).append(path)
            elif block.segment == "curve":
                blocks += _straights(seen, block)
    for junction, paths in through.items():
        if len(paths) > MOST_WAYS:
            many = f"has {len(paths)} ways through it; their conflict areas weren't looked for"
            rejected.append((f"junction {junction}", many))
    areas = {
        name: found for paths in through.values() for name, found in junction_areas(paths).items()
    }
    return [
        replace(block, conflict_areas=areas[block.block_id]) if block.block_id in areas else block
        for block in blocks
    ], rejected


def _leads(way: Way, forward: bool) -> bool:
    """Whether a way gives a block in a direction."""
    return (forward or way.both) and any(lane.along == forward for lane in way.lanes)


def _neighbours(
    network: Network, usable: list[bool], end: WayEnd, *, entering: bool
) -> tuple[str, ...]:
    """Ids of the blocks that enter, or leave, their way at the ends that an end meets."""
    found = set()
    for other, at in network.meets.get(end, ()):
        way = network.ways[other]
        forward = (at == "start") == entering
        if usable[other] and _leads(way, forward):
            found.add(block_id(way, forward))
    return tuple(sorted(found))
