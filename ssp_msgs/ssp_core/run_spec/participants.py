"""Who takes part, and what each is to do."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from ssp_core.run_spec.values import (
    Finite,
    NonNegative,
    ObjectId,
    Path2,
    Positive,
    Start,
    Strict,
    without,
)
from ssp_core.state import DEFAULT_SIZES, Size
from ssp_core.vocab import ObjectClass, ObjectWord


class SpeedChange(Strict):
    """From this session time on the driver wants another speed."""

    at_s: NonNegative
    cruise_mps: NonNegative


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


class Motion(Strict):
    """Along a path: from standstill to cruise_mps, held, and to a standstill at its end."""

    path: Path2
    cruise_mps: Positive
    acceleration_mps2: Positive = 2.0
    deceleration_mps2: Positive = 2.0


_RUN_OUT = "drives on for so long after it, and stops; null: goes on to its path's end"


class LaneChange(Strict):
    """From the tracked path sideways while driving on, then parallel to it."""

    kind: Literal["lane_change"]
    lateral_shift_m: Finite = Field(description="+ is left")
    duration_s: Positive
    cruise_mps: Positive
    deceleration_mps2: Positive = 2.0
    run_out_s: Positive | None = Field(None, description=_RUN_OUT)


class FollowPath(Strict):
    """Along a path of its own that starts where the object stands."""

    kind: Literal["follow_path"]
    motion: Motion


class Brake(Strict):
    """Along the tracked path, to a lower speed at once."""

    kind: Literal["brake"]
    to_mps: NonNegative = Field(description="speed to end at; 0 is a standstill")
    deceleration_mps2: Positive
    run_out_s: Positive | None = Field(None, description=_RUN_OUT)


Manoeuvre = Annotated[LaneChange | FollowPath | Brake, Field(discriminator="kind")]


class ParticipantSpec(Strict):
    """VUT or OT: what it is, where it starts, and what it is to do before the trigger."""

    id: ObjectId
    object_class: ObjectWord
    start: Start
    approach: Motion | None = None
    tracker: Annotated[Literal["lqr"], BeforeValidator(without("mpc", "the tracker", "lqr"))] = (
        Field("lqr", description="how an OT follows its references: linear-quadratic regulators")
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
