"""The road that a run takes place on, and the scenery beside it, in the road's frame."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ssp_core.run_file.values import (
    Finite,
    NonNegative,
    Positive,
    Start,
    Strict,
    Yaw,
    without_defaults,
)

# On one road; more would be felt in every frame.
MOST_SCENERY = 1000
# Of one junction; more is a mistake.
MOST_JUNCTION_ROADS = 300
SceneryExtent = Annotated[float, Field(ge=0.5, le=300)]


class Building(Strict):
    """A building: a rectangle of walls on the ground.

    Its length lies along the road turned to the left by ``yaw_rad``.
    """

    type: Literal["building"]
    s_m: Finite = Field(description="of its middle")
    l_m: Finite = Field(description="of its middle, + left")
    yaw_rad: Yaw = 0.0
    length_m: SceneryExtent
    width_m: SceneryExtent
    height_m: SceneryExtent


class Sign(Strict):
    """A traffic sign on a post."""

    type: Literal["sign"]
    s_m: Finite
    l_m: Finite = Field(description="+ left")
    kind: Literal["speed_limit", "crossing", "stop", "yield", "other"] = Field(
        description="other: a plain plate"
    )
    value: Annotated[int, Field(ge=1, le=999)] | None = Field(
        None, description="number printed on it: a speed limit's, in the place's own unit"
    )
    direction: Literal["forward", "backward"] = Field(
        "forward", description="of the traffic that it faces"
    )

    @model_validator(mode="after")
    def _has_its_number(self) -> Sign:
        if (self.value is not None) != (self.kind == "speed_limit"):
            raise ValueError("a sign has a value if it is a speed_limit, and no other has one")
        return self


class Tree(Strict):
    """A broad-leaved tree."""

    type: Literal["tree"]
    s_m: Finite
    l_m: Finite = Field(description="+ left")
    height_m: Annotated[float, Field(ge=1, le=60)] = 7.0


class Pole(Strict):
    """A bare post; with a lamp, a street lamp whose arm reaches towards the road."""

    type: Literal["pole"]
    s_m: Finite
    l_m: Finite = Field(description="+ left")
    height_m: Annotated[float, Field(ge=0.5, le=60)] = 7.5
    lamp: bool = False


SceneryItem = Annotated[Building | Sign | Tree | Pole, Field(discriminator="type")]
Scenery = Annotated[list[SceneryItem], Field(max_length=MOST_SCENERY)]


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


class PartialCrossing(Strict):
    """A zebra that covers some of the lanes: a marking, and no crossing of the road."""

    x_m: Finite
    right_m: Finite
    left_m: Finite


class JunctionRoad(Strict):
    """A road of the junction that the run's road leads through: an arm, or a connecting road.

    Its frame is its own: arc length along its reference line, and distance to its left.
    """

    origin: Start = Field(description="pose of its reference line's start, frame map")
    length_m: Positive
    pieces: list[CurvePiece] = Field([], description="empty: straight; else they sum to length_m")
    lanes: Annotated[list[Lane], Field(min_length=1)]
    junction_at: Literal["start", "end", "both"] = Field(
        description="the end of an arm that meets the junction; both: a connecting road in it"
    )

    @property
    def left_edge_m(self) -> float:
        """Lateral position of the carriageway's left edge, its own frame."""
        return max(lane.y_m + lane.width_m / 2 for lane in self.lanes)

    @property
    def right_edge_m(self) -> float:
        """Lateral position of the carriageway's right edge, its own frame."""
        return min(lane.y_m - lane.width_m / 2 for lane in self.lanes)


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
    further_crossings_x_m: list[Finite] = Field([], description="of other zebra crossings")
    partial_crossings: list[PartialCrossing] = Field(
        [], description="zebras over some of the lanes, block frame"
    )
    speed_limit_mps: Positive = 13.9
    scenery: Scenery = Field([], description="what the map has beside the road, block frame")
    junction: Annotated[list[JunctionRoad], Field(max_length=MOST_JUNCTION_ROADS)] = Field(
        [], description="all roads of the junction that the road leads through; empty: of none"
    )

    @model_serializer(mode="wrap")
    def _without_empty_lists(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_defaults(
            dump(self), scenery=[], further_crossings_x_m=[], partial_crossings=[], junction=[]
        )

    @property
    def crossings_x_m(self) -> list[float]:
        """Middles of all zebra crossings along the road, block frame."""
        first = [] if self.crossing_x_m is None else [self.crossing_x_m]
        return sorted([*first, *self.further_crossings_x_m])

    @property
    def zebras_m(self) -> list[tuple[float, float, float]]:
        """Middle, right and left border of each zebra, in order, block frame.

        The borders of those that cross the whole road are infinite.
        """
        whole = [(x_m, -math.inf, math.inf) for x_m in self.crossings_x_m]
        return sorted([*whole, *((z.x_m, z.right_m, z.left_m) for z in self.partial_crossings)])

    @property
    def left_edge_m(self) -> float:
        """Lateral position of the carriageway's left edge, block frame."""
        return max(lane.y_m + lane.width_m / 2 for lane in self.lanes)

    @property
    def right_edge_m(self) -> float:
        """Lateral position of the carriageway's right edge, block frame."""
        return min(lane.y_m - lane.width_m / 2 for lane in self.lanes)
