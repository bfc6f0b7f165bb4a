"""A slower car changes from the left lane into the VUT's."""

from __future__ import annotations

import numpy as np

from ssp_core.vocabulary import ObjectClass, Role
from ssp_ot_controller.camera.motion import Actor, Line, Ramp, Steered
from ssp_ot_controller.camera.storyboards import base

GAP_M = 15.0  # bumper gap when the lane change starts


def play(rng: np.random.Generator, lanes: base.LaneCounts) -> base.Play:
    """The VUT closes in, the car cuts in, the VUT brakes to less than its speed."""
    speed = float(rng.uniform(11.0, 12.0))
    slower = float(rng.uniform(4.1, 4.5))  # closing speed at the start
    cut_s, change_s = float(rng.uniform(2.9, 3.4)), 2.4
    brake_s = cut_s + 1.3
    ahead = GAP_M + slower * cut_s + base.CAR.front_m + base.CAR.rear_m
    # Across: a speed that swells and goes back; its integral is one lane width.
    peak = 2.0 * base.LANE_M / change_s
    across = (Ramp(cut_s, change_s / 2, -peak), Ramp(cut_s + change_s / 2, change_s / 2, peak))
    other = Actor(
        "ot1",
        ObjectClass.CAR,
        Role.OT,
        Steered(base.VUT_START_M + ahead, speed - slower, across),
        Line(base.LANE_M, 0.0, across),
    )
    return base.Play(
        base.road(lanes),
        base.camera(),
        base.look(rng),
        base.vut(speed, (Ramp(brake_s, 2.2, -slower - 0.6),)),
        (other, *base.oncoming(lanes, 150.0, 9.0)),
    )
