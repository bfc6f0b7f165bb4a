"""What a trigger sets off, and how it is kept in time with the VUT."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import (
    Field,
)

from ssp_core.run_spec.conditions import Condition
from ssp_core.run_spec.participants import Manoeuvre
from ssp_core.run_spec.values import Finite, NonNegative, ObjectId, Point, Positive, Strict


class Adaptation(Strict):
    """After the trigger: keeps the time gap at the conflict point in spite of the VUT's speed.

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
