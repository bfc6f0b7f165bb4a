"""Limits of the site, and thresholds of a conflict."""

from __future__ import annotations

from pydantic import (
    Field,
)

from ssp_core.run_spec.values import NonNegative, Positive, Strict


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
