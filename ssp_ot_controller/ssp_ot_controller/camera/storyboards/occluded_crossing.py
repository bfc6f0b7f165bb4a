"""A pedestrian steps out from behind a truck that is parked at the right."""

from __future__ import annotations

import math

import numpy as np

from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.vocabulary import ObjectClass, Role
from ssp_ot_controller.camera.motion import Actor, Line, Ramp
from ssp_ot_controller.camera.storyboards import base

TRUCK = DEFAULT_SIZES[ObjectClass.TRUCK]
PEDESTRIAN = DEFAULT_SIZES[ObjectClass.PEDESTRIAN]
LATE_S, STOP_S = 1.1, 3.4
STAND_M = 4.0  # from the VUT's front to the pedestrian's path in the end
KERB_M = 0.6  # from the kerb to where the pedestrian waits
ASIDE_M = 0.05  # from the carriageway's edge to the truck, which stands on the shoulder


def play(rng: np.random.Generator, lanes: base.LaneCounts) -> base.Play:
    """The pedestrian waits hidden, steps out, and the VUT stops late before the path."""
    speed = float(rng.uniform(9.5, 10.2))
    step_s = float(rng.uniform(2.5, 2.9))
    walk = float(rng.uniform(1.35, 1.5))
    hidden_m = float(rng.uniform(1.0, 1.4))  # from the truck's front to the pedestrian
    brake_s = step_s + LATE_S
    stand = base.VUT_START_M + speed * brake_s + 0.5 * speed * STOP_S
    crossing = stand + base.CAR.front_m + STAND_M
    kerb = -base.LANE_M / 2
    pedestrian = Actor(
        "ot1",
        ObjectClass.PEDESTRIAN,
        Role.OT,
        Line(crossing, 0.0),
        Line(kerb - KERB_M, 0.0, (Ramp(step_s, 0.9, walk),)),
        math.pi / 2,
    )
    truck = Actor(
        "ot2",
        ObjectClass.TRUCK,
        Role.OT,
        Line(crossing - PEDESTRIAN.width_m / 2 - hidden_m - TRUCK.front_m, 0.0),
        Line(kerb - ASIDE_M - TRUCK.width_m / 2, 0.0),
    )
    return base.Play(
        base.road(lanes),
        base.camera(),
        base.look(rng),
        base.vut(speed, (Ramp(brake_s, STOP_S, -speed),)),
        (pedestrian, truck, *base.oncoming(lanes, 140.0, 10.0)),
    )
