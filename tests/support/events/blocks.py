"""Blocks of road."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from ssp_core.geometry import Pose2
from ssp_core.run_file.road import CurvePiece
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.maps.block import Block, BlockLane

TWO_EACH_WAY = ((0.0, True), (3.5, True), (7.0, False), (10.5, False))


def block_of(
    pieces: Sequence[CurvePiece] = (CurvePiece(length_m=400.0),),
    origin: Pose2 = Pose2(0.0, 0.0, 0.0),  # noqa: B008 -- frozen
    lanes: Sequence[tuple[float, bool]] = TWO_EACH_WAY,
    width_m: float = 3.5,
    **changes: Any,
) -> Block:
    """A town road with sidewalks, 400 m straight along x by default.

    Args:
        pieces: of the reference line.
        origin: its start.
        lanes: offset of each centre (+ left), and whether it leads along the road.
        width_m: of every lane.
        changes: other fields of the block.
    """
    line = ReferenceLine(origin, pieces)
    fields: dict[str, Any] = {
        "block_id": "main",
        "line": line,
        "lanes": tuple(
            BlockLane(y, width_m, forward, f"lane {i}") for i, (y, forward) in enumerate(lanes)
        ),
        "road_type": "urban",
        "segment": "straight" if line.is_straight else "curve",
        "left_boundary": "sidewalk",
        "right_boundary": "sidewalk",
        "sidewalk_left_m": 3.0,
        "sidewalk_right_m": 3.0,
        "permitted": frozenset({"keep_lane", "lane_change_left", "lane_change_right", "crossing"}),
        "speed_limit_mps": 13.9,
    }
    return Block(**{**fields, **changes})
