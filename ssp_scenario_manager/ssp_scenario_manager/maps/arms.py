"""Arms of a junction: the roads that lead to it and away from it, as a run's road has them.

A map cuts an arm into several roads, as where its lanes shift or their number changes. An arm is
followed along the lanes that go on in one another, to where it ends or another junction begins; one
that is shorter than 15 m, over that junction too.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ssp_core.geometry import wrap_angle
from ssp_core.run_file.road import JunctionRoad, Lane
from ssp_core.run_file.values import Point, Start
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_scenario_manager.maps.block import Block, BlockLane, Library
from ssp_scenario_manager.maps.legs import LANES_MEET_M, Leg, continued, joined_line, turn_of
from ssp_scenario_manager.maps.reference_line import Unusable

# So much of each arm is part of a junction's surroundings.
ARM_M = 60.0
# Carriageways whose middles are this near to each other where they meet the junction are one arm.
_ONE_ARM_M = 0.5
# An arm that keeps all its lanes for so long is one road; of a shorter one each lane is.
_WHOLE_M = 30.0
# One that is shorter than this goes on over another junction: lanes may part just before a ring.
_LEAST_M = 15.0
_STEP_M = 1.0

_End = Literal["start", "end"]


@dataclass(frozen=True, slots=True)
class Arm:
    """An arm along one of its lanes.

    Args:
        legs: its parts, from the junction on.
        line: along the middle of the lane, in the direction of traffic; None of a single part.
        whole: all lanes of the first part go on along all of them.
    """

    legs: tuple[Leg, ...]
    line: ReferenceLine | None
    whole: bool

    @property
    def length_m(self) -> float:
        """Length along the middle of the lane, or of a single part along its block."""
        return self.legs[0].length_m if self.line is None else self.line.length_m


def arm_of(
    block: Block,
    lane: BlockLane,
    blocks_by_id: Mapping[str, Block],
    junction: str | None,
    *,
    back: bool,
) -> Arm:
    """Return the arm along a lane of the road that meets the junction, 60 m of it at most.

    Args:
        block: the road.
        lane: leads to the junction, or away from it.
        blocks_by_id: blocks by their ids.
        junction: whose arm it is.
        back: it leads to the junction.
    """
    legs = list(_legs(block, lane, blocks_by_id, junction, back=back))
    same = next((i for i, leg in enumerate(legs) if not _same_lanes(legs[0], leg)), len(legs))
    if same == len(legs) or sum(leg.length_m for leg in legs[:same]) >= _WHOLE_M:
        line = _line(legs[:same], back=back)
        if same == 1 or (line is not None and _has_room(line, _beside(legs[0]))):
            return Arm(tuple(legs[:same]), line, whole=True)
    # Of fewer parts where all of them make no line.
    for count in range(len(legs), 1, -1):
        if (line := _line(legs[:count], back=back)) is not None:
            return Arm(tuple(legs[:count]), line, whole=False)
    return Arm((legs[0],), None, whole=True)


def _legs(
    block: Block,
    lane: BlockLane,
    blocks_by_id: Mapping[str, Block],
    junction: str | None,
    *,
    back: bool,
) -> Iterator[Leg]:
    """Yield the parts of an arm along a lane: of several ways on, the straightest."""
    long_m, leg_ids = 0.0, {block.block_id}
    leg = _part(block, lane, ARM_M, back=back)
    yield leg
    while (long_m := long_m + leg.length_m) < ARM_M:
        candidates: list[tuple[bool, float, str, Block, BlockLane]] = []
        for name in leg.block.entrances if back else leg.block.exits:
            other = blocks_by_id.get(name)
            if other is None or name in leg_ids or other.junction == junction:
                continue
            if other.junction is not None and long_m >= _LEAST_M:
                continue
            if (on := continued(leg, other, back=back)) is not None:
                candidates.append((other.shifting, turn_of(other), name, other, on))
        if not candidates:
            return
        *_, name, other, on = min(candidates, key=lambda one: one[:3])
        leg_ids.add(name)
        leg = _part(other, on, ARM_M - long_m, back=back)
        yield leg


def _part(block: Block, lane: BlockLane, most_m: float, *, back: bool) -> Leg:
    long_m = min(most_m, block.length_m)
    start_m = block.length_m - long_m if back else 0.0
    return Leg(block, lane, start_m, start_m + long_m)


def _same_lanes(leg: Leg, other: Leg) -> bool:
    """Tell whether the lanes of one part go on in those of another, and in no more."""
    lanes, its = leg.block.lanes, other.block.lanes
    return len(lanes) == len(its) and all(
        a.forward == b.forward
        and abs((a.y_m - leg.lane.y_m) - (b.y_m - other.lane.y_m)) <= LANES_MEET_M
        and abs(a.width_m - b.width_m) <= LANES_MEET_M
        for a, b in zip(lanes, its, strict=True)
    )


def _line(legs: Sequence[Leg], *, back: bool) -> ReferenceLine | None:
    """Return the line along the lane of several parts; None of one, or where they make none."""
    with suppress(Unusable):
        if len(legs) > 1:
            return joined_line(legs[::-1] if back else legs, smoothed=False)[0]
    return None


def _has_room(line: ReferenceLine, lanes: Sequence[BlockLane]) -> bool:
    """Tell whether lanes along a line have a place everywhere."""
    stations = np.arange(0.0, line.length_m, _STEP_M)
    with suppress(NotOneToOne):
        for lane in lanes:
            for side in (-0.5, 0.5):
                line.to_map_many(stations, lane.y_m + side * lane.width_m)
        return True
    return False


def _beside(leg: Leg) -> list[BlockLane]:
    """Return the lanes of a part as seen from the middle of its own."""
    return [replace(lane, y_m=lane.y_m - leg.lane.y_m) for lane in leg.block.lanes]


def junction_roads(library: Library, junction: str) -> list[JunctionRoad]:
    """Return the connecting roads of a junction and its arms, each road once."""
    here = library.drivable
    inside = [block for block in here if block.junction == junction and not block.passage]
    blocks_by_id = {block.block_id: block for block in here if block.junction != junction}
    arms: dict[str, _End] = {}
    for block in inside:
        arms |= {name: "end" for name in block.entrances if name in blocks_by_id}
    for block in inside:
        arms |= {name: "start" for name in block.exits if name in blocks_by_id and name not in arms}
    roads = [_junction_road(block.line, block.lanes, "both") for block in inside]
    # Both directions of a road are blocks, each with all lanes.
    carriageways: list[tuple[Point, list[tuple[Block, _End]]]] = []
    for name, end in arms.items():
        block = blocks_by_id[name]
        middle_m = 0.5 * (block.left_edge_m + block.right_edge_m)
        mouth = block.line.to_map(block.length_m if end == "end" else 0.0, middle_m)
        for at, blocks in carriageways:
            if math.dist(mouth, at) < _ONE_ARM_M:
                blocks.append((block, end))
                break
        else:
            carriageways.append((mouth, [(block, end)]))
    for _, blocks in carriageways:
        roads += _carriageway(blocks, blocks_by_id, junction)
    return roads


def _carriageway(
    blocks: Sequence[tuple[Block, _End]], blocks_by_id: Mapping[str, Block], junction: str
) -> Iterator[JunctionRoad]:
    """Yield the roads of one arm: one where its lanes stay beside each other, else one a lane."""
    arms = [
        (arm_of(block, lane, blocks_by_id, junction, back=end == "end"), end)
        for block, end in blocks
        for lane in block.forward_lanes
    ]
    block, end = blocks[0]
    if not all(arm.whole for arm, _ in arms):
        for arm, at in arms:
            leg, width_m = arm.legs[0], min(leg.lane.width_m for leg in arm.legs)
            line = arm.line or leg.block.line.section(leg.start_s_m, leg.end_s_m)
            y_m = leg.lane.y_m if arm.line is None else 0.0
            yield _junction_road(line, [replace(leg.lane, y_m=y_m, width_m=width_m)], at)
        return
    longest, end_of = max(arms, key=lambda one: one[0].length_m if one[0].line else 0.0)
    if longest.line is not None:
        yield _junction_road(longest.line, _beside(longest.legs[0]), end_of)
        return
    part = min(ARM_M, block.length_m)
    low = block.length_m - part if end == "end" else 0.0
    yield _junction_road(block.line.section(low, low + part), block.lanes, end)


def _junction_road(
    line: ReferenceLine, lanes: Sequence[BlockLane], end: Literal["start", "end", "both"]
) -> JunctionRoad:
    return JunctionRoad(
        origin=Start(
            x_m=line.origin.x_m, y_m=line.origin.y_m, yaw_rad=wrap_angle(line.origin.yaw_rad)
        ),
        length_m=line.length_m,
        pieces=[] if line.is_straight else list(line.pieces),
        lanes=[
            Lane(
                y_m=lane.y_m,
                width_m=lane.width_m,
                direction="forward" if lane.forward else "backward",
            )
            for lane in lanes
        ],
        junction_at=end,
    )
