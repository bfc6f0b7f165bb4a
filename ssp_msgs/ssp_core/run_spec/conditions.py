"""What triggers wait for."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import (
    Field,
)

from ssp_core.run_spec.values import NonNegative, ObjectId, Point, Positive, Strict


class RelativeDistance(Strict):
    """Bumper gap along the VUT's path from the VUT to an object ahead of it."""

    type: Literal["relative_distance"]
    object_id: ObjectId
    below_m: Positive


class TimeToArrival(Strict):
    """Time until the VUT's front reaches an anchor, at its present speed."""

    type: Literal["time_to_arrival"]
    anchor: Point
    below_s: Positive


class TimeHeadway(Strict):
    """Bumper gap to an object ahead of the VUT over the VUT's speed."""

    type: Literal["time_headway"]
    object_id: ObjectId
    below_s: Positive


class TimeToCollision(Strict):
    """Bumper gap to an object over the closing speed along the VUT's path (METHOD 1)."""

    type: Literal["time_to_collision"]
    object_id: ObjectId
    below_s: Positive


class SpeedIs(Strict):
    """Speed of the VUT or an object."""

    type: Literal["speed"]
    object_id: ObjectId
    relation: Literal["above", "below"]
    value_mps: NonNegative


class InRegion(Strict):
    """The reference point of the VUT or an object lies in a polygon, frame map."""

    type: Literal["in_region"]
    object_id: ObjectId
    polygon: Annotated[list[Point], Field(min_length=3)]


class PhaseReached(Strict):
    """A phase of the event has begun."""

    type: Literal["phase_reached"]
    phase: Literal["trigger", "conflict", "resolution"]


class ElapsedTime(Strict):
    """Session time since the start of the run."""

    type: Literal["elapsed_time"]
    after_s: NonNegative


class AllOf(Strict):
    """Every one of these conditions holds."""

    type: Literal["all"]
    of: Annotated[list[Condition], Field(min_length=1)]


class AnyOf(Strict):
    """At least one of these conditions holds."""

    type: Literal["any"]
    of: Annotated[list[Condition], Field(min_length=1)]


Leaf = (
    RelativeDistance
    | TimeToArrival
    | TimeHeadway
    | TimeToCollision
    | SpeedIs
    | InRegion
    | PhaseReached
    | ElapsedTime
)
Condition = Annotated[Leaf | AllOf | AnyOf, Field(discriminator="type")]
AllOf.model_rebuild()
AnyOf.model_rebuild()
