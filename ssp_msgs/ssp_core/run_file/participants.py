"""The participants of a run: their manoeuvres, the triggers that start these, and conditions."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from ssp_core.motion.state import DEFAULT_SIZES, Size
from ssp_core.run_file.values import (
    Finite,
    NonNegative,
    ObjectId,
    Outline,
    Path2,
    Point,
    Positive,
    Start,
    Strict,
    without_defaults,
)
from ssp_core.vocabulary import ObjectClass, ObjectWord


def path_length_m(path: Path2) -> float:
    """Return the length of a path through points, m."""
    return sum(math.dist(a, b) for a, b in pairwise(path))


class SpeedChange(Strict):
    """A new speed of the driver from this session time on."""

    at_s: NonNegative
    cruise_mps: NonNegative


class GiveWay(Strict):
    """A place on the VUT's path at which everyone who comes along another path has priority."""

    line_m: NonNegative = Field(
        description="where the VUT's front waits, arc length of the VUT's path"
    )
    zone_m: tuple[NonNegative, NonNegative] = Field(
        description="conflict zone, first and last arc length of the VUT's path"
    )
    priority_path: Path2 = Field(description="path of the objects with priority, frame map")
    priority_zone_m: tuple[NonNegative, NonNegative] = Field(
        description="conflict zone, first and last arc length of the priority path"
    )
    critical_gap_s: Positive = Field(
        4.1,
        description="least time that the next object with priority needs up to the conflict zone "
        "when the VUT's front is at the line; with less the VUT gives way",
    )

    @model_validator(mode="after")
    def _places_in_order(self) -> GiveWay:
        for name, (first, last) in (
            ("zone_m", self.zone_m),
            ("priority_zone_m", self.priority_zone_m),
        ):
            if first >= last:
                raise ValueError(f"{name} begins at {first:g} m and ends at {last:g} m; swap them")
        if self.line_m > self.zone_m[0]:
            raise ValueError(
                f"line_m is {self.line_m:g} m, beyond the begin of zone_m, {self.zone_m[0]:g} m; "
                "the VUT waits before the zone"
            )
        length_m = path_length_m(self.priority_path)
        if self.priority_zone_m[0] >= length_m:
            raise ValueError(
                f"priority_zone_m begins at {self.priority_zone_m[0]:g} m and priority_path is "
                f"{length_m:.1f} m long; give a longer path"
            )
        return self


class Driver(Strict):
    """The VUT's built-in driver: speed profile, and what it does when something is in its way."""

    cruise_mps: Positive
    acceleration_mps2: Positive = 2.0
    comfortable_deceleration_mps2: Positive = 2.5
    headway_s: Positive = 1.4
    standstill_gap_m: Positive = 3.0
    reacts: bool = True
    external: bool = Field(
        False, description="true: the VUT is driven by commands on vut/command, which may go silent"
    )
    aeb_deceleration_mps2: Positive | None = Field(
        None, description="emergency braking when nothing else avoids a collision; null: none"
    )
    later: list[SpeedChange] = Field([], description="changes of cruise speed while it drives")
    gives_way: list[GiveWay] = Field([], description="places at which it accepts gaps or waits")

    @model_serializer(mode="wrap")
    def _without_places_that_are_not_given(
        self, dump: SerializerFunctionWrapHandler
    ) -> dict[str, Any]:
        return without_defaults(dump(self), gives_way=[])


class Motion(Strict):
    """A drive along a path: from standstill to cruise_mps, held, and to a standstill at its end."""

    path: Path2
    cruise_mps: Positive
    acceleration_mps2: Positive = 2.0
    deceleration_mps2: Positive = 2.0
    times_s: list[NonNegative] | None = Field(
        None,
        description="when it is at each place of the path, from a standstill to a standstill; "
        "null: the speed and the accelerations say when",
    )

    @model_serializer(mode="wrap")
    def _without_times_that_are_not_given(
        self, dump: SerializerFunctionWrapHandler
    ) -> dict[str, Any]:
        return without_defaults(dump(self), times_s=None)

    @model_validator(mode="after")
    def _each_place_has_its_time(self) -> Motion:
        if self.times_s is None:
            return self
        if len(self.times_s) != len(self.path):
            raise ValueError(f"times_s has {len(self.times_s)} times for {len(self.path)} places")
        if any(later <= before for before, later in pairwise(self.times_s)):
            raise ValueError("times_s must rise")
        return self


_RUN_OUT = "drives on for so long after it, and stops; null: goes on to its path's end"


class LaneChange(Strict):
    """A move sideways from the tracked path while driving on, then parallel to it."""

    kind: Literal["lane_change"]
    lateral_shift_m: Finite = Field(description="+ is left")
    duration_s: Positive
    cruise_mps: Positive
    deceleration_mps2: Positive = 2.0
    run_out_s: Positive | None = Field(None, description=_RUN_OUT)


class FollowPath(Strict):
    """A drive along a path of its own that starts where the object stands."""

    kind: Literal["follow_path"]
    motion: Motion


class Brake(Strict):
    """A braking along the tracked path, to a lower speed at once."""

    kind: Literal["brake"]
    to_mps: NonNegative = Field(description="speed to end at; 0 is a standstill")
    deceleration_mps2: Positive
    run_out_s: Positive | None = Field(None, description=_RUN_OUT)


class Hold(Strict):
    """No manoeuvre: the object goes on as it came, standing or driving, and is sent nothing."""

    kind: Literal["hold"]


Manoeuvre = Annotated[LaneChange | FollowPath | Brake | Hold, Field(discriminator="kind")]


class ParticipantSpec(Strict):
    """VUT or OT: what it is, where it starts, and what it is to do before the trigger."""

    id: ObjectId
    object_class: ObjectWord
    start: Start
    approach: Motion | None = None
    tracker: Literal["lqr"] = Field(
        "lqr", description="how an OT follows its references: linear-quadratic regulators"
    )

    @property
    def cls(self) -> ObjectClass:
        return ObjectClass.from_word(self.object_class)

    @property
    def size(self) -> Size:
        return DEFAULT_SIZES[self.cls]


class TrafficSpec(Strict):
    """A vehicle that SUMO drives."""

    id: ObjectId
    object_class: ObjectWord
    lane: Annotated[int, Field(ge=0)] = Field(description="index into road.lanes")
    x_m: Finite = Field(description="front bumper at the start, block frame")
    speed_mps: NonNegative


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
    polygon: Outline


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
    """A condition that holds while at least one of these does."""

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


class Adaptation(Strict):
    """The adaptation after the trigger.

    It keeps the time gap at the conflict point for any VUT speed.

    The manager sends the OT references for the same path with another speed profile, so that it
    meets the VUT as specified. It ends when the one that decides the gap is about to arrive, and
    when the VUT responds to the OT.
    """

    anchor: Point | None = Field(
        None,
        description="conflict point on the VUT's path, frame map; null: where the OT comes into "
        "the VUT's corridor",
    )
    first: Literal["initiator", "vut"] = Field(description="who arrives first")
    gap_s: Finite = Field(description="second arrival minus first departure (METHOD 1)")
    rate_hz: Annotated[float, Field(gt=0, le=20)] = 10.0
    lead_time_s: NonNegative = Field(0.1, description="execute_at minus dispatch")
    speed_share: tuple[Positive, Positive] = Field(
        (0.6, 1.4), description="slowest and fastest, as shares of the manoeuvre's own speed"
    )
    acceleration_mps2: Positive | None = Field(
        None, description="hardest acceleration; null: what the site allows"
    )
    deceleration_mps2: Positive | None = Field(
        None, description="hardest braking; null: what the site allows"
    )
    dead_band_s: NonNegative = Field(0.03, description="errors of the gap that are let be")
    freeze_s: NonNegative = Field(
        0.4, description="no more changes once what decides the gap is nearer than this"
    )
    response_mps2: Positive | None = Field(
        1.5,
        description="a VUT that brakes harder once the manoeuvre has begun responds to it; null: "
        "it never does",
    )


class TriggerSpec(Strict):
    """Fires once, at the instant from which the condition has held for held_for_s.

    ``edge`` as in OpenSCENARIO: none fires also when the condition holds from the first; rising
    needs it to become true, falling to become false.
    """

    id: str
    condition: Condition
    edge: Literal["none", "rising", "falling"] = "none"
    held_for_s: NonNegative = 0.0
    not_before_s: NonNegative = Field(0.0, description="session time")
    object_id: ObjectId = Field(description="the OT that gets the manoeuvre")
    manoeuvre: Manoeuvre
    lead_time_s: NonNegative = Field(0.1, description="execute_at minus dispatch")
    adaptation: Adaptation | None = None
