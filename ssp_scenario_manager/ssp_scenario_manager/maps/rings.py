"""Rings of a map: roundabouts whose entries and exits are junctions of their own.

OpenDRIVE and SUMO describe a roundabout as several small junctions with short roads between them.
A route over it leads through some of them, so that they, and the roads between them, are made one
junction here. Corners of a block of houses make a closed way, too, but no round one.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
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
MOST_OUT_OF_ROUND = 0.1
# It turns once around, to within this.
_TURN_RAD = 0.5
_MOST_BLOCKS = 100
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


def _onward(block: Block, blocks_by_id: Mapping[str, Block]) -> list[Block]:
    """Return the blocks that keep most to the side of the ring, up to the next road.

    What leaves a ring turns away from it, at the latest where its connecting roads end.
    """
    chains: list[tuple[float, list[Block]]] = []
    for name in block.exits:
        chain, turned_rad = [block], 0.0
        while (
            name in blocks_by_id and blocks_by_id[name] not in chain and len(chain) <= _MOST_BLOCKS
        ):
            turned_rad += _seam_rad(chain[-1], blocks_by_id[name]) + _turn_rad(blocks_by_id[name])
            chain.append(blocks_by_id[name])
            if chain[-1].junction is None or len(chain[-1].exits) != 1:
                break
            name = chain[-1].exits[0]
        chains.append((turned_rad, chain[1:]))
    return max(chains, key=lambda one: one[0], default=(0.0, []))[1]


def _closed_ways(blocks: Sequence[Block]) -> Iterator[tuple[Block, ...]]:
    """Yield the ways along blocks that come back to where they began after one turn."""
    blocks_by_id = {one.block_id: one for one in blocks}
    for first in blocks:
        way, length_m, turned_rad = [first], first.length_m, _turn_rad(first)
        while first.junction is None and length_m <= 2.0 * math.pi * MOST_RADIUS_M:
            onward = _onward(way[-1], blocks_by_id)
            after = onward[: onward.index(first)] if first in onward else onward
            for one in after:
                turned_rad += _seam_rad(way[-1], one) + _turn_rad(one)
                length_m += one.length_m
                way.append(one)
            if first in onward:
                if abs(turned_rad + _seam_rad(way[-1], first) - 2.0 * math.pi) < _TURN_RAD:
                    yield tuple(way)
                break
            if not onward or len(way) > _MOST_BLOCKS:
                break


def _is_round(way: Sequence[Block]) -> bool:
    places = np.concatenate(
        [one.line.to_map_many(np.arange(0.0, one.length_m, _STEP_M), 0.0) for one in way]
    )
    radii_m = np.hypot(*(places - places.mean(axis=0)).T)
    mean_m = float(radii_m.mean())
    return mean_m <= MOST_RADIUS_M and bool(
        np.abs(radii_m - mean_m).max() <= MOST_OUT_OF_ROUND * mean_m
    )


def _lanes_beside(way: Sequence[Block], library: Library) -> Iterator[str]:
    """Yield what else a ring's roads have, where lanes shift: it is in the ring, and no exit."""
    roads = {road for one in way if one.junction is None for road in one.roads}
    shift = {road for one in library.shifting if one.junction is None for road in one.roads}
    for one in library.drivable:
        if one.junction is None and set(one.roads) <= roads & shift:
            yield one.block_id


def with_rings(library: Library) -> Library:
    """Return a library in which the junctions of a ring, and the roads between them, are one.

    Closed ways that share a junction are those of a grid of streets, and no rings.
    """
    rings: dict[frozenset[str], set[str]] = {}
    for way in _closed_ways(library.drivable):
        junctions = frozenset(one.junction for one in way if one.junction is not None)
        if len(junctions) > 1 and _is_round(way):
            rings.setdefault(junctions, set()).update(one.block_id for one in way)
            rings[junctions].update(_lanes_beside(way, library))
    shared = Counter(name for junctions in rings for name in junctions)
    inside: dict[str, list[str]] = {}
    for one in library.drivable:
        if one.junction is not None:
            inside.setdefault(one.junction, []).append(one.block_id)
    names: dict[str, str] = {}
    for junctions, way_ids in rings.items():
        if all(shared[name] == 1 for name in junctions):
            ids = way_ids.union(*(inside[name] for name in junctions))
            names |= dict.fromkeys(ids, _NAME + min(junctions))

    def of_ring(block: Block) -> Block:
        if block.block_id not in names:
            return block
        permitted = block.permitted - {"crossing"}
        junction = names[block.block_id]
        return replace(block, junction=junction, segment="junction", permitted=permitted)

    if not names:
        return library
    blocks, shifting = (tuple(map(of_ring, some)) for some in (library.blocks, library.shifting))
    return replace(library, blocks=blocks, shifting=shifting)
