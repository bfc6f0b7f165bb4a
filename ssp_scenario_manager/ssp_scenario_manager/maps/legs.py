"""Legs of a route: the part of each road that it takes, and the roads before and beyond it.

A map ends a road at each junction, and SUMO's networks also where a lane is added. What leads to a
junction, and away from it, is therefore several roads, of which a route takes the straightest.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from ssp_core.geometry import FloatArray, Pose2, wrap_angle
from ssp_core.world.reference_line import NotOneToOne, ReferenceLine
from ssp_scenario_manager.maps.block import Block, BlockLane, headings
from ssp_scenario_manager.maps.reference_line import Unusable, smooth_line
from ssp_scenario_manager.maps.rings import is_ring

# A lane goes on in another that begins this near to its end, in this direction.
LANES_MEET_M = 0.3
_MEET_RAD = 0.4
# A route keeps so much of the roads that lead to the junction and away from it.
APPROACH_M = 150.0
EXIT_M = 100.0
# Along bends the middle of a lane is sampled at this, along straights at the other.
_BEND_STEP_M = 1.0
_STRAIGHT_STEP_M = 5.0
# A route that turns by less goes straight on.
STRAIGHT_ON_RAD = math.radians(30.0)
# A road before or beyond the first one belongs to a route if both meet in this direction.
_SEAM_RAD = 0.1
# Lanes of a ring's arms are wider than those of the roads before, which have at least this.
_UNFLARED_M = 3.0
# Of widths.
_ROUNDING_M = 0.01
# A route over a ring has places at this step, and is smoothed over so many to each side.
_EVEN_STEP_M = 1.0
_MOST_REACH = 4
# A line's places are looked at in this step.
_STEP_M = 0.5


@dataclass(frozen=True, slots=True)
class Leg:
    """A lane of a block, and the part of it that a route takes."""

    block: Block
    lane: BlockLane
    start_s_m: float
    end_s_m: float

    @property
    def length_m(self) -> float:
        """Length of the part along the block's reference line."""
        return self.end_s_m - self.start_s_m

    def places(self) -> FloatArray:
        """Return the places along its middle, near enough to each other for its bends.

        Raises:
            Unusable: the lane comes back beside itself.
        """
        length = self.end_s_m - self.start_s_m
        step = _STRAIGHT_STEP_M if self.block.line.is_straight else _BEND_STEP_M
        s = np.linspace(self.start_s_m, self.end_s_m, max(2, math.ceil(length / step) + 1))
        try:
            return self.block.line.to_map_many(s, self.lane.y_m)
        except NotOneToOne as error:
            raise Unusable(f"{self.block.block_id} {self.lane.name}: {error}") from error


def _lane_pose(block: Block, lane: BlockLane, s_m: float) -> Pose2 | None:
    """Return a lane's pose; None where a block that comes back beside itself has none there."""
    with suppress(NotOneToOne):
        return Pose2(*block.line.to_map(s_m, lane.y_m), block.line.pose(s_m).yaw_rad)
    return None


def lane_pairs(before: Block, after: Block) -> Iterator[tuple[float, BlockLane, BlockLane]]:
    """Yield lanes that lead the same way at the seam of two blocks, and how far they are apart."""
    for one in before.forward_lanes:
        end = _lane_pose(before, one, before.length_m)
        for other in after.forward_lanes:
            start = _lane_pose(after, other, 0.0)
            if end is None or start is None:
                continue
            if abs(wrap_angle(end.yaw_rad - start.yaw_rad)) <= _MEET_RAD:
                yield math.hypot(end.x_m - start.x_m, end.y_m - start.y_m), one, other


def lanes_apart_m(before: Block, after: Block) -> float:
    """Return the distance of the nearest two lanes that go on in one another, m; inf: none do."""
    return min((apart for apart, _, _ in lane_pairs(before, after)), default=math.inf)


def lanes_beside(first: Leg, last: Leg) -> list[BlockLane]:
    """Return the lanes beside that of a route which its approach and its exit have in one place."""
    beyond = [replace(lane, y_m=lane.y_m - last.lane.y_m) for lane in last.block.lanes]
    return [
        BlockLane(y_m, min(lane.width_m, other.width_m), lane.forward, lane.name)
        for lane in first.block.lanes
        if lane is not first.lane
        for other in beyond
        if other.forward == lane.forward
        and abs(other.y_m - (y_m := lane.y_m - first.lane.y_m)) <= LANES_MEET_M
    ]


def continued(leg: Leg, other: Block, *, back: bool) -> BlockLane | None:
    """Return the lane of another block that leads to a leg's lane, or that it leads to."""
    before, after = (other, leg.block) if back else (leg.block, other)
    turn_rad = after.line.pose(0.0).yaw_rad - before.line.pose(before.length_m).yaw_rad
    if abs(wrap_angle(turn_rad)) > _SEAM_RAD:
        return None
    near: list[tuple[float, str, BlockLane]] = []
    for apart_m, one, two in lane_pairs(before, after):
        own, its = (two, one) if back else (one, two)
        if own == leg.lane and apart_m <= LANES_MEET_M:
            near.append((apart_m, its.name, its))
    return min(near, key=lambda found: found[:2])[2] if near else None


def _has_lane(block: Block, own: BlockLane, beside: BlockLane) -> bool:
    """Tell whether a block has a lane where a route has one beside its own."""
    return any(
        lane.forward == beside.forward
        and abs(lane.y_m - own.y_m - beside.y_m) <= LANES_MEET_M
        and lane.width_m >= beside.width_m - _ROUNDING_M
        for lane in block.lanes
    )


def turn_of(block: Block) -> float:
    """Return how much a block turns, to either side, rad."""
    return abs(float(np.ptp(headings(block.line, np.array([0.0, block.length_m])))))


def _straight_part_m(block: Block, most_m: float, most_rad: float, *, back: bool) -> float:
    """Return how much of a block before its end, or from its start on, turns by less than that."""
    beyond_m = np.linspace(0.0, most_m, math.ceil(most_m / _BEND_STEP_M) + 1)
    yaws = headings(block.line, block.length_m - beyond_m if back else beyond_m)
    turns = np.abs(yaws - yaws[0]) >= most_rad
    return float(beyond_m[np.argmax(turns) - 1]) if turns.any() else most_m


def prolonged(
    legs: Sequence[Leg],
    blocks_by_id: Mapping[str, Block],
    beside: Sequence[BlockLane],
    *,
    back: bool,
) -> Iterator[Leg]:
    """Yield the roads before a route's approach, or beyond its exit, nearest first.

    Of several the straightest is taken, a lane that shifts only where there is no other. It is
    neither narrower nor slower than the route, has its lanes beside, and together they turn by less
    than 30 degrees. Lanes flare towards a ring, so that the road before one may be narrower, down
    to 3 m; of one that turns by more, a part is taken.

    Args:
        legs: of the route, from the approach to the exit.
        blocks_by_id: blocks by their ids.
        beside: lanes beside the route's own.
        back: before the approach; else beyond the exit.
    """
    leg, most_m = (legs[0], APPROACH_M) if back else (legs[-1], EXIT_M)
    width_m = min(one.lane.width_m for one in legs) - _ROUNDING_M
    ring = is_ring(legs[1].block.junction)
    if ring:
        width_m = min(width_m, _UNFLARED_M - _ROUNDING_M)
    limits = [x for one in legs if (x := one.block.speed_limit_mps) is not None]
    limit_mps = min(limits, default=math.inf)
    leg_ids = {one.block.block_id for one in legs}
    room_m, turned_rad = most_m - leg.block.length_m, 0.0
    while room_m > 0.0:
        candidates: list[tuple[bool, float, str, Leg]] = []
        for name in leg.block.entrances if back else leg.block.exits:
            block = blocks_by_id.get(name)
            if block is None or name in leg_ids or block.junction == legs[1].block.junction:
                continue
            lane, limit = continued(leg, block, back=back), block.speed_limit_mps
            if lane is None or lane.width_m < width_m:
                continue
            if limit is not None and (limit < limit_mps or not limits):
                continue
            if not all(_has_lane(block, lane, other) for other in beside):
                continue
            part_m, turn_rad = min(room_m, block.length_m), turn_of(block)
            if ring and turned_rad + turn_rad >= STRAIGHT_ON_RAD:
                left_rad = STRAIGHT_ON_RAD - turned_rad
                part_m, turn_rad = _straight_part_m(block, part_m, left_rad, back=back), left_rad
            start_m = block.length_m - part_m if back else 0.0
            onward = Leg(block, lane, start_m, start_m + part_m)
            if part_m > 0.0:
                candidates.append((block.shifting, turn_rad, name, onward))
        if not candidates:
            return
        _, turn_rad, name, leg = min(candidates, key=lambda one: one[:3])
        turned_rad += turn_rad
        if turned_rad >= STRAIGHT_ON_RAD and not ring:
            return
        leg_ids.add(name)
        room_m -= leg.end_s_m - leg.start_s_m
        yield leg
        if turned_rad >= STRAIGHT_ON_RAD:
            return


@cache
def _weights(reach: int) -> FloatArray:
    """Return the weights of places for the middle one of the parabola that fits best to them."""
    around = np.arange(-reach, reach + 1, dtype=np.float64)
    weights: FloatArray = np.linalg.pinv(np.vander(around, 3, increasing=True))[0]
    return weights


def _smoothed(places: FloatArray) -> FloatArray:
    """Return places along others at an even step, each on the parabola that fits those around it.

    Arcs stay arcs, and lanes that meet to a few centimetres, as a ring's do, make no bend.
    """
    s = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))))
    even = np.linspace(0.0, s[-1], max(2, round(s[-1] / _EVEN_STEP_M) + 1))
    samples = np.column_stack([np.interp(even, s, xy) for xy in places.T])
    smooth_places = samples.copy()
    for reach in range(2, min(_MOST_REACH, (len(samples) - 1) // 2) + 1):
        windows = np.lib.stride_tricks.sliding_window_view(samples, 2 * reach + 1, axis=0)
        # Near an end the reach is as far as the end.
        smooth_places[reach : len(samples) - reach] = windows @ _weights(reach)
    return smooth_places


def joined_line(legs: Sequence[Leg], smoothed: bool) -> tuple[ReferenceLine, list[float]]:
    """Return the line along some legs, and the arc lengths at which each of them ends.

    Args:
        legs: of a route, and of the roads before and beyond it.
        smoothed: whether the route is one over a ring.

    Raises:
        Unusable: there is no such line.
    """
    places = [leg.places()[min(i, 1) :] for i, leg in enumerate(legs)]
    along = np.concatenate(places)
    if smoothed:
        along = _smoothed(along)
    line = smooth_line([(float(x), float(y)) for x, y in along])
    chords = [float(np.hypot(*np.diff(xy, axis=0).T).sum()) for xy in places]
    for i in range(1, len(places)):
        chords[i] += math.dist(places[i - 1][-1], places[i][0])
    try:
        line.to_map_many(np.arange(0.0, line.length_m, _STEP_M), 0.0)
    except NotOneToOne as error:
        raise Unusable(f"comes back beside itself: {error}") from error
    # Corners that are rounded off shorten the line by a few millimetres.
    ends = np.cumsum(chords)
    return line, [float(end) for end in ends * (line.length_m / ends[-1])]
