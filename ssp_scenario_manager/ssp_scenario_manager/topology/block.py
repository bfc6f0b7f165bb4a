"""A block: one stretch of road in one direction of travel, the unit that events are placed on."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

from ssp_core.run_file.road import SceneryItem
from ssp_core.world.reference_line import ReferenceLine

Segment = Literal["straight", "curve", "junction"]
Boundary = Literal["kerb", "sidewalk", "shoulder", "verge", "any"]
RoadType = Literal["urban", "rural", "motorway", "proving_ground", "any"]


@dataclass(frozen=True, slots=True)
class BlockLane:
    """A driving lane over the whole length of a block.

    Args:
        y_m: offset of its centre from the reference line, + left.
        width_m: narrowest width along the block.
        forward: it leads along the block (the VUT's direction of travel).
        name: of the lane in the map, for messages and exports.
    """

    y_m: float
    width_m: float
    forward: bool
    name: str


@dataclass(frozen=True, slots=True)
class ConflictArea:
    """Where an interaction can take place on the block: arc lengths, m."""

    kind: Literal["merge", "crossing", "following"]
    start_s_m: float
    end_s_m: float


@dataclass(frozen=True)
class Block:
    """One stretch of road (METHOD 2.1), driven along +s; a road with two directions is two blocks.

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
        permitted: manoeuvres, words of spec.model.ManoeuvreWord.
        entrances: ids of blocks that lead into this one.
        exits: ids of blocks that this one leads into.
        conflict_areas: candidates, per kind of relation.
        crossing_s_m: arc length of a marked crossing, if any.
        speed_limit_mps: None where the map doesn't say.
        shoulder_right_m: width between the rightmost lane and the kerb or sidewalk.
        shoulder_left_m: as on the right.
        notes: for people.
        scenery: what stands beside the road, in the block's frame.
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
    crossing_s_m: float | None = None
    speed_limit_mps: float | None = None
    shoulder_left_m: float = 0.0
    shoulder_right_m: float = 0.0
    notes: tuple[str, ...] = field(default=())
    scenery: tuple[SceneryItem, ...] = ()

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
        blocks: sorted by id.
        rejected: what was found and can't be a block, as (name, reason).
    """

    source: str
    sha256: str
    kind: Literal["site", "opendrive", "sumo"]
    blocks: tuple[Block, ...]
    rejected: tuple[tuple[str, str], ...] = ()
