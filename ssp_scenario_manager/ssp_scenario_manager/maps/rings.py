"""Rings of a map: roundabouts whose entries and exits are junctions of their own.

OpenDRIVE and SUMO describe a roundabout as several small junctions with short roads between them.
A route over it leads through some of them, so that they, and the roads between them, are made one
junction here. Corners of a block of houses make a closed way, too, but no round one.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from ssp_core.geometry import wrap_angle
from ssp_scenario_manager.maps.block import Block, Library, headings

# The name of a ring's junction begins with it.
_NAME = "ring "
# A ring's lanes are at most so far from its middle; those of a roundabout of three lanes are 40 m.
MOST_RADIUS_M = 60.0
# They are so near to a circle, as a share of its radius. On CARLA's towns the roundest ways around
# houses are 0.17 from one.
MOST_OUT_OF_ROUND = 0.12
# It turns once around, to within this, and no block of it turns so much to the other side.
_TURN_RAD = 0.5
_STEP_M = 2.0


def is_ring(junction: str | None) -> bool:
    """Tell whether a junction is one that was made of those of a ring."""
    return junction is not None and junction.startswith(_NAME)


def _turn_rad(block: Block) -> float:
    """Return how much a block turns to the side on which its traffic goes around, rad."""
    start, end = headings(block.line, np.array([0.0, block.length_m]))
    return float(start - end if block.left_hand else end - start)


def _seam_rad(before: Block, after: Block) -> float:
    """Return how much traffic turns to that side from one block to the next, rad."""
    end, start = before.line.pose(before.length_m), after.line.pose(0.0)
    turn = wrap_angle(start.yaw_rad - end.yaw_rad)
    return -turn if after.left_hand else turn


def _closed_ways(blocks: Sequence[Block]) -> Iterator[tuple[Block, ...]]:
    """Yield the ways along blocks that come back to where they began after one turn."""
    most_m, most_rad = 2.0 * math.pi * MOST_RADIUS_M, 2.0 * math.pi + _TURN_RAD
    turns = {one.block_id: _turn_rad(one) for one in blocks if one.length_m <= most_m}
    known = {one.block_id: one for one in blocks if turns.get(one.block_id, -math.inf) > -_TURN_RAD}

    def onward(way: list[Block], length_m: float, turned_rad: float) -> Iterator[tuple[Block, ...]]:
        first = way[0].block_id
        for name in way[-1].exits:
            if name == first and _is_once(turned_rad + _seam_rad(way[-1], way[0])):
                yield tuple(way)
            # Each is found once, from the block whose id is the least.
            if name not in known or name <= first or known[name] in way:
                continue
            after = known[name]
            longer_m = length_m + after.length_m
            rad = turned_rad + _seam_rad(way[-1], after) + turns[name]
            if longer_m <= most_m and rad <= most_rad:
                yield from onward([*way, after], longer_m, rad)

    for block in known.values():
        yield from onward([block], block.length_m, turns[block.block_id])


def _is_once(turned_rad: float) -> bool:
    return abs(turned_rad - 2.0 * math.pi) < _TURN_RAD


def _is_round(way: Sequence[Block]) -> bool:
    places = np.concatenate(
        [one.line.to_map_many(np.arange(0.0, one.length_m, _STEP_M), 0.0) for one in way]
    )
    radii_m = np.hypot(*(places - places.mean(axis=0)).T)
    mean_m = float(radii_m.mean())
    return mean_m <= MOST_RADIUS_M and bool(
        np.abs(radii_m - mean_m).max() <= MOST_OUT_OF_ROUND * mean_m
    )


def with_rings(library: Library) -> Library:
    """Return a library in which the junctions of a ring, and the roads between them, are one."""
    names: dict[str, frozenset[str]] = {}
    between: dict[str, frozenset[str]] = {}
    for way in _closed_ways(library.blocks):
        junctions = frozenset(one.junction for one in way if one.junction is not None)
        if len(junctions) < 2 or not _is_round(way):
            continue
        # A ring of several lanes may be found more than once.
        junctions = junctions.union(*(names.get(name, ()) for name in junctions))
        names |= dict.fromkeys(junctions, junctions)
        between |= {one.block_id: junctions for one in way if one.junction is None}
    if not names:
        return library

    def of_ring(block: Block) -> Block:
        ring = names.get(block.junction or "") or between.get(block.block_id)
        if ring is None:
            return block
        # Several of its ways may have been found one after the other.
        name = _NAME + min(names[min(ring)])
        permitted = block.permitted - {"crossing"}
        return replace(block, junction=name, segment="junction", permitted=permitted)

    return replace(library, blocks=tuple(of_ring(block) for block in library.blocks))
