"""The car ahead of the VUT brakes abruptly."""

from __future__ import annotations

import numpy as np

from ssp_core.vocabulary import ObjectClass, Role
from ssp_ot_controller.camera.motion import Actor, Line, Ramp
from ssp_ot_controller.camera.storyboards import base

GAP_M = 24.0  # bumper gap when the car ahead begins to brake
LEAD_BRAKING_S, LATE_S, VUT_BRAKING_S = 2.7, 1.35, 3.2


def play(rng: np.random.Generator, lanes: base.LaneCounts) -> base.Play:
    """The VUT closes in slowly, the car ahead brakes nearly to a standstill, the VUT late."""
    speed = float(rng.uniform(12.2, 12.8))
    slower = float(rng.uniform(2.4, 2.8))  # closing speed at the start
    brake_s = float(rng.uniform(2.9, 3.3))
    left = float(rng.uniform(1.6, 2.2))  # speed after braking
    lead_mps = speed - slower
    ahead = GAP_M + slower * brake_s + base.CAR.front_m + base.CAR.rear_m
    lead = Actor(
        "ot1",
        ObjectClass.CAR,
        Role.OT,
        Line(
            base.VUT_START_M + ahead,
            lead_mps,
            (Ramp(brake_s, LEAD_BRAKING_S, left - lead_mps),),
        ),
        Line(0.0, 0.0),
    )
    # In the end a little slower than the car ahead, so that the gap opens again.
    vut = base.vut(speed, (Ramp(brake_s + LATE_S, VUT_BRAKING_S, left - 0.5 - speed),))
    return base.Play(
        base.road(lanes),
        base.camera(),
        base.look(rng),
        vut,
        (lead, *base.oncoming(lanes, 165.0, 9.5)),
    )
