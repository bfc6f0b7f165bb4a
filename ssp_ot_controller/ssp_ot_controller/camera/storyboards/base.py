"""What the scenarios' modules share: road, camera, light, and the VUT that carries the camera."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import Lane, Road
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass, Role
from ssp_ot_controller.camera.motion import Actor, Line, Ramp

LANE_M = 3.4
VUT_START_M = 10.0
CAR = DEFAULT_SIZES[ObjectClass.CAR]


@dataclass(frozen=True)
class Play:
    """What one scenario shows; map and block frame are the same, the VUT's lane is at y = 0."""

    road: Road
    camera: Camera
    look: Look
    vut: Actor
    others: tuple[Actor, ...]


@dataclass(frozen=True)
class LaneCounts:
    """Lanes of the road that is drawn: in the VUT's direction, and oncoming."""

    same: int = 2
    opposite: int = 2

    @property
    def total(self) -> int:
        return self.same + self.opposite


def road(counts: LaneCounts) -> Road:
    """A city road with sidewalks; the VUT's lane is the rightmost."""
    lanes = [
        Lane(y_m=i * LANE_M, width_m=LANE_M, direction="forward" if i < counts.same else "backward")
        for i in range(counts.total)
    ]
    return Road(
        origin=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
        length_m=260.0,
        lanes=lanes,
        sidewalk_left_m=2.4,
        sidewalk_right_m=2.4,
        crossing_x_m=None,
    )


def camera() -> Camera:
    """Another one than in the sessions."""
    return Camera(
        width_px=960,
        height_px=540,
        hfov_deg=66.0,
        rate_hz=24.0,
        forward_m=1.6,
        height_m=1.35,
        pitch_down_rad=0.02,
        jpeg_quality=92,
    )


def look(rng: np.random.Generator) -> Look:
    """The light of an evening."""
    return Look(
        palette="dusk_city",
        fog_per_m=float(rng.uniform(0.001, 0.002)),
        sun_azimuth_deg=float(rng.uniform(15.0, 40.0)),
        sun_elevation_deg=float(rng.uniform(9.0, 16.0)),
        exposure=1.15,
        noise_sigma=2.0,
    )


def vut(speed_mps: float, ramps: tuple[Ramp, ...]) -> Actor:
    """The car with the camera, in its lane."""
    along = Line(VUT_START_M, speed_mps, ramps)
    return Actor(VUT_ID, ObjectClass.CAR, Role.VUT, along, Line(0.0, 0.0))


def oncoming(counts: LaneCounts, start_m: float, speed_mps: float) -> tuple[Actor, ...]:
    """A car in the outer oncoming lane; nobody on a one-way road."""
    if counts.opposite == 0:
        return ()
    car = Actor(
        "oncoming_car",
        ObjectClass.CAR,
        Role.TRAFFIC,
        Line(start_m, -speed_mps),
        Line((counts.total - 1) * LANE_M, 0.0),
        math.pi,
    )
    return (car,)
