"""A block, a stretch of road in one direction of travel: its conflict areas, and its bends."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from ssp_core.geometry import FloatArray
from ssp_core.run_file.road import SceneryItem
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.maps.crossings import CROSSING_HALF_M, Crossing

Segment = Literal["straight", "curve", "junction"]
Boundary = Literal["kerb", "sidewalk", "shoulder", "verge", "any"]
RoadType = Literal["urban", "rural", "motorway", "proving_ground", "any"]
# A note on blocks of a map whose traffic keeps to the left.
LEFT_HAND = "left-hand traffic"

# Lanes are neighbours up to this gap between them.
WIDEST_GAP_M = 0.5


@dataclass(frozen=True, slots=True)
class BlockLane:
    """A driving lane over the whole length of a block.

    Args:
        y_m: offset of its centre from the reference line, + left.
        width_m: narrowest width along the block.
        forward: it leads along the block (the VUT's direction of travel).
    """

    y_m: float
    width_m: float
    forward: bool
    name: str


@dataclass(frozen=True, slots=True)
class ConflictArea:
    """An area of the block where an interaction can take place: arc lengths, m."""

    kind: Literal["merge", "crossing", "following"]
    start_s_m: float
    end_s_m: float


@dataclass(frozen=True, slots=True)
class Conflict:
    """The place where another route through the same junction crosses this one, or joins it.

    Args:
        route: block_id of the other one.
        kind: ``merge`` where both go on in one lane, up to the end; of two that join and part
            again, as in a roundabout, one crosses the other.
        s_m: arc length, along this route, of the crossing of the centre lines, or of the place from
            which they are one.
        other_s_m: the same place along the other route.
        angle_rad: heading of the other route there, relative to this one's, + left.
        start_s_m: of the part of this route on which the lanes of both overlap.
        end_s_m: of the same part.
    """

    route: str
    kind: Literal["merge", "crossing"]
    s_m: float
    other_s_m: float
    angle_rad: float
    start_s_m: float
    end_s_m: float

    @property
    def comes_from(self) -> Literal["left", "right"]:
        """Return the side from which the other route comes: one that heads left is on the right."""
        return "right" if self.angle_rad > 0.0 else "left"


@dataclass(frozen=True, slots=True)
class Passage:
    """The part of a route that leads through its junction.

    Args:
        via: ids of the blocks in the junction that it leads over, at least one.
        start_s_m: arc length at which it enters the junction.
        end_s_m: arc length at which it leaves it.
        turn_rad: heading of the exit's start, relative to that of the approach's end, + left.
        conflicts: in the order in which they are met.
        arms_s_m: arc lengths between which the route is on the approach, in the junction, or on the
            exit; what it has beyond them are further roads, which aren't the junction's arms.
    """

    via: tuple[str, ...]
    start_s_m: float
    end_s_m: float
    turn_rad: float
    conflicts: tuple[Conflict, ...] = ()
    arms_s_m: tuple[float, float] = (-math.inf, math.inf)


@dataclass(frozen=True)
class Block:
    """One stretch of road (METHOD 2.1), driven along +s; a road with two directions is two blocks.

    A route through a junction is one too: along the middle of one lane of its approach, of the
    connecting road and of the exit, which its reference line follows.

    Args:
        block_id: unique in its library, such as ``road 12 forward``.
        line: reference line; s = 0 is where the block is entered.
        lanes: from right to left.
        road_type: of the map, ``any`` where it doesn't say.
        segment: by curvature and membership of a junction.
        left_boundary: beyond the leftmost lane.
        right_boundary: beyond the rightmost lane.
        sidewalk_left_m: width of a walkable strip there, a sidewalk or verge, 0 without one.
        sidewalk_right_m: as on the left.
        permitted: manoeuvres, words of event_spec.model.ManoeuvreWord.
        entrances: ids of blocks that lead into this one.
        exits: ids of blocks that this one leads into.
        conflict_areas: candidates, per kind of relation.
        crossings: zebras on its lanes.
        speed_limit_mps: None where the map doesn't say.
        shoulder_right_m: width between the rightmost lane and the kerb or sidewalk.
        shoulder_left_m: as on the right.
        scenery: what stands beside the road, in the block's frame.
        left_hand: traffic keeps to the left.
        roads: of the map, that it is made of.
        junction: that it leads through, None outside of one.
        passage: of a route, its part in the junction; None for any other block.
        shifting: it is a single lane along its own middle, and no place (``Library.shifting``).
    """

    block_id: str
    line: ReferenceLine
    lanes: tuple[BlockLane, ...]
    road_type: RoadType
    segment: Segment
    left_boundary: Boundary
    right_boundary: Boundary
    sidewalk_left_m: float
    sidewalk_right_m: float
    permitted: frozenset[str]
    entrances: tuple[str, ...] = ()
    exits: tuple[str, ...] = ()
    conflict_areas: tuple[ConflictArea, ...] = ()
    crossings: tuple[Crossing, ...] = ()
    speed_limit_mps: float | None = None
    shoulder_left_m: float = 0.0
    shoulder_right_m: float = 0.0
    notes: tuple[str, ...] = field(default=())
    scenery: tuple[SceneryItem, ...] = ()
    left_hand: bool = False
    roads: tuple[str, ...] = ()
    junction: str | None = None
    passage: Passage | None = None
    shifting: bool = False

    @property
    def crossings_s_m(self) -> tuple[float, ...]:
        """Arc lengths of the marked crossings of the whole road, the most central one first."""
        middle = self.length_m / 2.0
        stations_m = [zebra.s_m for zebra in self.crossings if zebra.whole]
        return tuple(sorted(stations_m, key=lambda s: abs(s - middle)))

    @property
    def zebras_m(self) -> tuple[tuple[float, float, float], ...]:
        """Arc length, right and left border of each zebra, in order along the block."""
        low, high = self.right_edge_m, self.left_edge_m
        zebras = [
            (zebra.s_m, max(zebra.right_m, low), min(zebra.left_m, high))
            for zebra in self.crossings
        ]
        return tuple(sorted(zebras))

    @property
    def length_m(self) -> float:
        return self.line.length_m

    @property
    def forward_lanes(self) -> tuple[BlockLane, ...]:
        """Lanes in the VUT's direction, from right to left."""
        return tuple(lane for lane in self.lanes if lane.forward)

    @property
    def backward_lanes(self) -> tuple[BlockLane, ...]:
        """Oncoming lanes, from right to left."""
        return tuple(lane for lane in self.lanes if not lane.forward)

    @property
    def right_edge_m(self) -> float:
        """Offset of the carriageway's right edge, + left of the reference line."""
        return min(lane.y_m - lane.width_m / 2 for lane in self.lanes)

    @property
    def left_edge_m(self) -> float:
        """Offset of the carriageway's left edge."""
        return max(lane.y_m + lane.width_m / 2 for lane in self.lanes)


@dataclass(frozen=True)
class Library:
    """All blocks of one map or site.

    Args:
        source: file name of the map or name of the site.
        sha256: hash of the map file, or of the site's content.
        kind: what it was read from.
        rejected: what was found and can't be a block, as (name, reason).
        faults: roads that are left out for what contradicts the map's format or itself, likewise.
        shifting: single lanes along their own middle, where they shift on their road. Routes lead
            over them; they are no places themselves, as what lies beside them isn't known.
    """

    source: str
    sha256: str
    kind: Literal["site", "opendrive", "sumo"]
    blocks: tuple[Block, ...]
    rejected: tuple[tuple[str, str], ...] = ()
    faults: tuple[tuple[str, str], ...] = ()
    shifting: tuple[Block, ...] = ()

    @property
    def drivable(self) -> tuple[Block, ...]:
        """Return all that a route may lead over."""
        return (*self.blocks, *self.shifting)


def conflict_areas(
    length_m: float,
    lanes: Collection[BlockLane],
    permitted: Collection[str],
    crossings_s_m: Collection[float] = (),
) -> tuple[ConflictArea, ...]:
    """Return the candidates of one block, in order of kind and place.

    Following: all of it, as there is a lane in the direction of travel. Merging: all of it, where
    there are two such lanes and one may be changed for the other. Crossing: at a marked crossing,
    and all of it where people may cross anywhere.
    """
    areas = []
    for at_m in crossings_s_m:
        low = max(0.0, at_m - CROSSING_HALF_M)
        high = min(length_m, at_m + CROSSING_HALF_M)
        if low < high:
            areas.append(ConflictArea("crossing", low, high))
    if "crossing" in permitted:
        areas.append(ConflictArea("crossing", 0.0, length_m))
    forward = sum(lane.forward for lane in lanes)
    if forward:
        areas.append(ConflictArea("following", 0.0, length_m))
    if forward > 1 and {"lane_change_left", "lane_change_right"} & set(permitted):
        areas.append(ConflictArea("merge", 0.0, length_m))
    return tuple(sorted(areas, key=lambda area: (area.kind, area.start_s_m, area.end_s_m)))


# A bend with a radius of more than 1000 m is driven, and seen, as a straight.
STRAIGHT_BELOW_1PM = 0.001
# Curvature is averaged over this: real maps have corrections of a few centimetres in their lines.
WINDOW_M = 10.0
# Straight parts of longer, bent blocks are blocks of their own from this length on.
SHORTEST_STRAIGHT_M = 50.0
_STEP_M = 1.0


def headings(line: ReferenceLine, s_m: FloatArray) -> FloatArray:
    """Return headings at arc lengths, relative to the line's start, unwrapped, then constant."""
    lengths = np.array([p.length_m for p in line.pieces])
    starts = np.array([p.start_curvature_1pm for p in line.pieces])
    ends = np.array([p.end_curvature_1pm for p in line.pieces])
    begins = np.concatenate(([0.0], np.cumsum(lengths)[:-1]))
    before = np.concatenate(([0.0], np.cumsum(0.5 * lengths * (starts + ends))))
    index = np.clip(np.searchsorted(begins, s_m, side="right") - 1, 0, len(lengths) - 1)
    u = np.clip(s_m - begins[index], 0.0, lengths[index])
    rate = (ends - starts)[index] / lengths[index]
    turned: FloatArray = before[index] + u * (starts[index] + 0.5 * rate * u)
    return turned


def _mean_curvatures(line: ReferenceLine) -> tuple[FloatArray, FloatArray]:
    """Return arc lengths, and the mean curvature over the window around each, 1/m."""
    length = line.length_m
    s = np.linspace(0.0, length, max(2, int(np.ceil(length / _STEP_M)) + 1))
    low = np.clip(s - WINDOW_M / 2, 0.0, max(0.0, length - WINDOW_M))
    high = np.minimum(low + WINDOW_M, length)
    return s, np.abs(headings(line, high) - headings(line, low)) / WINDOW_M


def bend_1pm(line: ReferenceLine) -> float:
    """Return the largest mean curvature over any 10 m of a line, 1/m."""
    if line.is_straight:
        return 0.0
    return float(_mean_curvatures(line)[1].max())


def segment_of(line: ReferenceLine) -> Segment:
    """Return ``straight`` where the radius over any 10 m is more than 1000 m, else ``curve``."""
    return "straight" if bend_1pm(line) < STRAIGHT_BELOW_1PM else "curve"


def straight_parts(line: ReferenceLine) -> list[tuple[float, float]]:
    """Return straight stretches of at least 50 m of a line that bends elsewhere, as arc lengths."""
    s, curvature = _mean_curvatures(line)
    flat = np.concatenate(([False], curvature < STRAIGHT_BELOW_1PM, [False]))
    starts = np.flatnonzero(flat[1:] & ~flat[:-1])
    ends = np.flatnonzero(~flat[1:] & flat[:-1]) - 1
    return [
        (float(s[a]), float(s[b]))
        for a, b in zip(starts, ends, strict=True)
        if s[b] - s[a] >= SHORTEST_STRAIGHT_M
    ]
