"""Lanes that end beside one that goes on, as junctions of two connecting roads (METHOD 2.1).

The last part of such a road becomes a junction: over one connecting road the lane that goes on does
so, over the other the lane that ends is left for it. Routes, conflicts and drawings then come from
there as from any junction.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from ssp_core.world.reference_line import NotOneToOne
from ssp_scenario_manager.maps.block import WIDEST_GAP_M, Block, BlockLane, Library
from ssp_scenario_manager.maps.legs import LANES_MEET_M, lane_pairs
from ssp_scenario_manager.maps.reference_line import Unusable, smooth_line

# A vehicle leaves a lane that ends over so much of its road's end: from 9 m/s on, over a lane of
# 3.5 m, with less than 1 m/s^2 sideways.
MOVES_OVER_M = 40.0
# The road has at least so much before that, where a vehicle waits.
_LEAST_BEFORE_M = 10.0
_STEP_M = 2.0


class _NoPlace(Exception):
    """A lane that ends is no place, with its quantity."""


def _onward(block: Block, after: Block) -> dict[str, BlockLane]:
    """Return by name the lanes of a block that go on, and in which lane of the next."""
    near = [pair for pair in lane_pairs(block, after) if pair[0] <= LANES_MEET_M]
    return {one.name: other for _, one, other in sorted(near, key=lambda pair: -pair[0])}


def _check_end(after: Block, blocks_by_id: Mapping[str, Block]) -> None:
    """Check that no lane begins where the next block ends: the one that seems to end may go on.

    Raises:
        _NoPlace: one does.
    """
    for name in after.exits:
        if (beyond := blocks_by_id.get(name)) is None:
            continue
        led = {lane.name for lane in _onward(after, beyond).values()}
        new = [lane.name for lane in beyond.forward_lanes if lane.name not in led]
        if new:
            raise _NoPlace(
                f"{new[0]} of {name} begins {after.length_m:.0f} m on, so that it may go on there"
            )


def _beside(block: Block, lane: BlockLane, goes_on: Mapping[str, BlockLane]) -> BlockLane:
    """Return the lane next to one, if that goes on.

    Raises:
        _NoPlace: none does.
    """
    gaps = [
        (gap_m, other.name, other)
        for other in block.forward_lanes
        if other.name in goes_on
        and (gap_m := abs(other.y_m - lane.y_m) - (other.width_m + lane.width_m) / 2)
        <= WIDEST_GAP_M
    ]
    if not gaps:
        raise _NoPlace("no lane beside it goes on")
    return min(gaps, key=lambda found: found[:2])[2]


def _junction(block: Block, after: Block, lane: BlockLane, beside: BlockLane) -> list[Block]:
    """Return the blocks of the junction in which a lane ends beside another one.

    Raises:
        _NoPlace: the road is too short.
        Unusable: the way over to the other lane has no line.
    """
    begins_m = block.length_m - MOVES_OVER_M
    if begins_m < _LEAST_BEFORE_M:
        raise _NoPlace(
            f"its road has {block.length_m:.0f} m; a vehicle needs "
            f"{_LEAST_BEFORE_M + MOVES_OVER_M:.0f} m to leave it"
        )
    share = np.linspace(0.0, 1.0, math.ceil(MOVES_OVER_M / _STEP_M) + 1)
    middles = lane.y_m + (beside.y_m - lane.y_m) * 0.5 * (1.0 - np.cos(math.pi * share))
    stations = begins_m + MOVES_OVER_M * share
    places = [
        block.line.to_map(s, y) for s, y in zip(stations.tolist(), middles.tolist(), strict=True)
    ]
    before_id = f"{block.block_id} [to {lane.name}'s end]"
    inside = replace(
        block,
        segment="junction",
        permitted=frozenset({"keep_lane", "stop"}),
        entrances=(before_id,),
        exits=(after.block_id,),
        conflict_areas=(),
        crossings=(),
        notes=(),
        scenery=(),
        junction=f"end of {block.block_id} {lane.name}",
    )
    straight = replace(
        inside,
        block_id=f"{block.block_id} beside {lane.name}'s end",
        line=block.line.section(begins_m, block.length_m),
        lanes=tuple(one for one in block.lanes if one is not lane),
    )
    over = replace(
        inside,
        block_id=f"{block.block_id} from {lane.name}",
        line=smooth_line(places),
        lanes=(BlockLane(0.0, min(lane.width_m, beside.width_m), forward=True, name=lane.name),),
    )
    before = replace(
        block,
        block_id=before_id,
        line=block.line.section(0.0, begins_m),
        exits=(straight.block_id, over.block_id),
        conflict_areas=(),
        crossings=tuple(zebra for zebra in block.crossings if zebra.s_m <= begins_m),
        scenery=tuple(item for item in block.scenery if item.s_m <= begins_m),
    )
    return [before, straight, over]


def _ends(block: Block, blocks_by_id: Mapping[str, Block]) -> Iterator[tuple[Block, BlockLane]]:
    """Yield the lanes of a block that end while another goes on, with the block that follows.

    Straight parts of a bent block lie on it, and aren't what leads to the next one.
    """
    after = blocks_by_id.get(block.exits[0]) if len(block.exits) == 1 else None
    if len(block.forward_lanes) < 2 or block.junction is not None:
        return
    if after is None or after.junction is not None or block.block_id not in after.entrances:
        return
    with suppress(NotOneToOne):
        goes_on = _onward(block, after)
        if goes_on:
            yield from ((after, lane) for lane in block.forward_lanes if lane.name not in goes_on)


def with_lane_ends(library: Library) -> Library:
    """Return a library in which lanes that end beside another one are junctions.

    Only an OpenDRIVE map says within a road where a lane ends; blocks of a site have their lanes
    over all of their length. What is no place stands in ``rejected``, with its quantity.
    """
    if library.kind != "opendrive":
        return library
    blocks_by_id = {block.block_id: block for block in library.drivable}
    junction_blocks: list[Block] = []
    rejected: list[tuple[str, str]] = []
    for block in library.blocks:
        for after, lane in _ends(block, blocks_by_id):
            try:
                _check_end(after, blocks_by_id)
                beside = _beside(block, lane, _onward(block, after))
                junction_blocks += _junction(block, after, lane, beside)
            except (_NoPlace, Unusable, NotOneToOne) as error:
                rejected.append((f"end of {block.block_id} {lane.name}", str(error)))
    blocks = sorted((*library.blocks, *junction_blocks), key=lambda block: block.block_id)
    return replace(library, blocks=tuple(blocks), rejected=(*library.rejected, *rejected))
