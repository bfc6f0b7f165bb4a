"""A pedestrian steps off the right kerb and crosses ahead of the VUT."""

from __future__ import annotations

import math

import numpy as np

from ssp_core.vocabulary import ObjectClass, Role
from ssp_ot_controller.camera.motion import Actor, Line, Ramp
from ssp_ot_controller.camera.storyboards import base

STAND_M = 3.5  # from the VUT's front to the pedestrian's path in the end


def play(rng: np.random.Generator, lanes: base.LaneCounts) -> base.Play:
    """The pedestrian waits, walks, and the VUT stops before the path."""
    speed = float(rng.uniform(8.8, 9.6))
    step_s = float(rng.uniform(2.3, 2.7))
    brake_s, stop_s = step_s + 1.0, 3.0
    walk = float(rng.uniform(1.3, 1.45))
    stand = base.VUT_START_M + speed * brake_s + 0.5 * speed * stop_s
    crossing = stand + base.CAR.front_m + STAND_M
    kerb = -base.LANE_M / 2
    pedestrian = Actor(
        "ot1",
        ObjectClass.PEDESTRIAN,
        Role.OT,
        Line(crossing, 0.0),
        Line(kerb - 0.6, 0.0, (Ramp(step_s, 0.6, walk),)),
        math.pi / 2,
    )
    return base.Play(
        base.road(lanes),
        base.camera(),
        base.look(rng),
        base.vut(speed, (Ramp(brake_s, stop_s, -speed),)),
        (pedestrian, *base.oncoming(lanes, 118.0, 10.0)),
    )
