"""The road that a run takes place on."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
)

from ssp_core.run_spec.scenery import Scenery, without_empty_scenery
from ssp_core.run_spec.values import Finite, NonNegative, Positive, Start, Strict


class Lane(Strict):
    """One lane of the block, in the block's frame (x along the road, y to the left)."""

    y_m: Finite = Field(description="lateral position of the centre line")
    width_m: Positive
    direction: Literal["forward", "backward"]


class CurvePiece(Strict):
    """A piece of a reference line whose curvature changes linearly with arc length.

    Both curvatures 0: straight; equal: an arc; else a clothoid. + turns left.
    """

    length_m: Positive
    start_curvature_1pm: Finite = 0.0
    end_curvature_1pm: Finite = 0.0


class Road(Strict):
    """The block that the run takes place on, with its transform to map (METHOD 2.4).

    The block's frame is (s, l): arc length along the reference line, which starts at the origin in
    its direction, and distance to its left. Without pieces the line is straight, and the transform
    is the rigid motion p = R p_local + t.
    """

    origin: Start
    length_m: Positive
    pieces: list[CurvePiece] = Field([], description="empty: straight; else they sum to length_m")
    lanes: Annotated[list[Lane], Field(min_length=1)]
    sidewalk_left_m: NonNegative = 0.0
    sidewalk_right_m: NonNegative = 0.0
    crossing_x_m: Finite | None = Field(None, description="zebra crossing's centre, block frame")
    speed_limit_mps: Positive = 13.9
    scenery: Scenery = Field([], description="what the map has beside the road, block frame")

    @model_serializer(mode="wrap")
    def _without_empty_scenery(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_empty_scenery(dump(self))

    @property
    def left_edge_m(self) -> float:
        """Lateral position of the carriageway's left edge, block frame."""
        return max(lane.y_m + lane.width_m / 2 for lane in self.lanes)

    @property
    def right_edge_m(self) -> float:
        """Lateral position of the carriageway's right edge, block frame."""
        return min(lane.y_m - lane.width_m / 2 for lane in self.lanes)
