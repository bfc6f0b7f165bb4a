"""Limits of the site, thresholds of a conflict, and what K* wants of the passing."""

from __future__ import annotations

import math
from typing import Literal

from pydantic import Field, model_validator

from ssp_core.run_spec.values import Finite, NonNegative, Positive, Strict

_TOLERANCE_S = 1e-9


class Limits(Strict):
    """Limits of the site; passing one is a safety event."""

    speed_mps: Positive
    acceleration_mps2: Positive
    stop_deceleration_mps2: Positive = 4.0
    separation_m: NonNegative = 0.5
    state_age_s: Positive = 0.3
    heartbeat_s: Positive = 0.5
    ack_s: Positive = 0.5
    error_longitudinal_m: Positive = 2.0
    error_lateral_m: Positive = 0.8
    error_yaw_rad: Positive = 0.35
    duration_s: Positive = 60.0
    position_std_m: Positive = Field(0.5, description="localisation's own stated uncertainty")
    jump_m: Positive = Field(1.0, description="between a position and where the last one led")
    frozen_s: Positive = Field(0.3, description="a moving object whose position stands")
    clock_offset_s: Positive = 0.05
    link_delay_s: Positive = Field(0.5, description="there and back")
    start_region_m: Positive = Field(1.5, description="from an object's start when it is armed")
    trigger_age_s: Positive | None = Field(
        None, description="no trigger is judged on an older state of the VUT; null: two periods"
    )


class ConflictThresholds(Strict):
    """METHOD 1: conflict starts when TTC or the predicted arrival gap is under these.

    An event whose K* gives no threshold for one of them is judged by the other alone.
    """

    ttc_s: Positive | None = 2.5
    arrival_gap_s: Positive | None = 1.5


class WantedPassing(Strict):
    """What K* says of how VUT and initiator pass the conflict zone (METHOD 1, 4.4)."""

    first: Literal["initiator", "vut"] = Field(description="who arrives first")
    least_gap_s: Finite | None = Field(
        None, description="of second arrival minus first departure; null: any"
    )
    most_gap_s: Finite | None = Field(None, description="as least_gap_s")

    @model_validator(mode="after")
    def _is_a_range(self) -> WantedPassing:
        if self.bounds_s[0] > self.bounds_s[1]:
            raise ValueError("least_gap_s is above most_gap_s")
        return self

    @property
    def initiator_first(self) -> bool:
        return self.first == "initiator"

    @property
    def bounds_s(self) -> tuple[float, float]:
        """Least and largest time gap, infinite where it may be any."""
        return (
            -math.inf if self.least_gap_s is None else self.least_gap_s,
            math.inf if self.most_gap_s is None else self.most_gap_s,
        )

    def misses(
        self, initiator: str, initiator_first: bool | None, gap_s: float | None
    ) -> list[str]:
        """What of a passing isn't as K* wants it, each with quantity, value and range.

        A gap is asked for only where K* bounds it; one that never came is a miss then too.

        Args:
            initiator: its id.
            initiator_first: it arrived before the VUT; None: it never arrived.
            gap_s: time gap at the conflict point; None: one of them never arrived or never left.
        """
        names = (initiator, "the VUT")
        first, second = names if self.initiator_first else names[::-1]
        wanted = f"K* wants {first} before {second}"
        if initiator_first is None:
            return [f"passing order: {initiator} never came into the VUT's corridor, {wanted}"]
        if initiator_first is not self.initiator_first:
            return [f"passing order: {second} before {first}, {wanted}"]
        least, most = self.bounds_s
        if math.isinf(least) and math.isinf(most):
            return []
        wanted = f"K* wants {least:g} to {most:g} s"
        if gap_s is None:
            last = f"{second} never reached the conflict zone, or {first} never left it"
            return [f"time gap at the conflict point: none, {last}; {wanted}"]
        if not least - _TOLERANCE_S <= gap_s <= most + _TOLERANCE_S:
            return [f"time gap at the conflict point: {gap_s:.3f} s, {wanted}"]
        return []
