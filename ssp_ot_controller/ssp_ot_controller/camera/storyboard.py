"""Motion for synthetic clips: closed formulas of time, without dynamics, control or traffic.

A clip shows the same interaction as a session (a car cuts in from the left; a pedestrian crosses
from the right) with its own speeds, distances, timing and look.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ssp_core.errors import InputError
from ssp_core.names import VUT_ID
from ssp_core.run_spec import Camera, Lane, Look, Road, Start
from ssp_core.state import DEFAULT_SIZES, ObjectState
from ssp_core.vocab import ObjectClass, Role
from ssp_ot_controller.camera.motion import Actor, Line, Ramp, Steered

Interaction = Literal["cut_in", "vru_crossing"]
INTERACTIONS: tuple[Interaction, ...] = ("cut_in", "vru_crossing")
_LANE_M = 3.4


@dataclass(frozen=True)
class Storyboard:
    """A whole clip before it is drawn; map and block frame are the same."""

    scenario: Interaction
    seed: int
    road: Road
    camera: Camera
    look: Look
    fps: float
    duration_s: float
    vut: Actor
    others: tuple[Actor, ...]

    def times(self) -> list[float]:
        """Times of the frames in s, from 0."""
        return [k / self.fps for k in range(round(self.duration_s * self.fps))]

    def states(self, t_s: float) -> tuple[ObjectState, ...]:
        """All objects, the VUT too, sorted by id."""
        actors = sorted((self.vut, *self.others), key=lambda actor: actor.object_id)
        return tuple(actor.state(t_s) for actor in actors)


def storyboard(scenario: str, seed: int) -> Storyboard:
    """The clip of a scenario; the seed varies speeds, timing and light a little.

    Raises:
        InputError: there is no such scenario.
    """
    if scenario not in INTERACTIONS:
        raise InputError(
            "is no scenario", field="scenario", value=scenario, remedy=f"one of {INTERACTIONS}"
        )
    rng = np.random.default_rng(np.random.SeedSequence([seed, INTERACTIONS.index(scenario)]))
    return _cut_in(seed, rng) if scenario == "cut_in" else _vru_crossing(seed, rng)


def _road(lanes_forward: int) -> Road:
    forward = [
        Lane(y_m=i * _LANE_M, width_m=_LANE_M, direction="forward") for i in range(lanes_forward)
    ]
    backward = Lane(y_m=lanes_forward * _LANE_M, width_m=_LANE_M, direction="backward")
    return Road(
        origin=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
        length_m=260.0,
        lanes=[*forward, backward],
        sidewalk_left_m=2.4,
        sidewalk_right_m=2.4,
        crossing_x_m=None,
    )


def _camera() -> Camera:
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


def _look(rng: np.random.Generator) -> Look:
    return Look(
        palette="dusk_city",
        fog_per_m=float(rng.uniform(0.001, 0.002)),
        sun_azimuth_deg=float(rng.uniform(15.0, 40.0)),
        sun_elevation_deg=float(rng.uniform(9.0, 16.0)),
        exposure=1.15,
        noise_sigma=2.0,
    )


def _vut(speed_mps: float, ramps: tuple[Ramp, ...]) -> Actor:
    return Actor(VUT_ID, ObjectClass.CAR, Role.VUT, Line(10.0, speed_mps, ramps), Line(0.0, 0.0))


def _cut_in(seed: int, rng: np.random.Generator) -> Storyboard:
    speed = float(rng.uniform(11.0, 12.0))
    slower = float(rng.uniform(4.1, 4.5))  # closing speed at the start
    cut_s, change_s = float(rng.uniform(2.9, 3.4)), 2.4
    gap_m = 15.0  # bumper gap when the lane change starts
    brake_s = cut_s + 1.3
    size = DEFAULT_SIZES[ObjectClass.CAR]
    ahead = gap_m + slower * cut_s + size.front_m + size.rear_m
    # Across: a speed that swells and goes back; its integral is one lane width.
    peak = 2.0 * _LANE_M / change_s
    across = (Ramp(cut_s, change_s / 2, -peak), Ramp(cut_s + change_s / 2, change_s / 2, peak))
    other = Actor(
        "ot1",
        ObjectClass.CAR,
        Role.OT,
        Steered(10.0 + ahead, speed - slower, across),
        Line(_LANE_M, 0.0, across),
    )
    oncoming = Actor(
        "oncoming_car",
        ObjectClass.CAR,
        Role.TRAFFIC,
        Line(150.0, -9.0),
        Line(2 * _LANE_M, 0.0),
        math.pi,
    )
    return Storyboard(
        "cut_in", seed, _road(2), _camera(), _look(rng), 24.0, 9.0,
        _vut(speed, (Ramp(brake_s, 2.2, -slower - 0.6),)), (other, oncoming),
    )  # fmt: skip


def _vru_crossing(seed: int, rng: np.random.Generator) -> Storyboard:
    speed = float(rng.uniform(8.8, 9.6))
    step_s = float(rng.uniform(2.3, 2.7))
    brake_s, stop_s = step_s + 1.0, 3.0
    walk = float(rng.uniform(1.3, 1.45))
    # Where the VUT stands in the end, and the pedestrian's path that far ahead of its front.
    stand = 10.0 + speed * brake_s + 0.5 * speed * stop_s
    crossing = stand + DEFAULT_SIZES[ObjectClass.CAR].front_m + 3.5
    kerb = -_LANE_M / 2
    pedestrian = Actor(
        "ot1",
        ObjectClass.PEDESTRIAN,
        Role.OT,
        Line(crossing, 0.0),
        Line(kerb - 0.6, 0.0, (Ramp(step_s, 0.6, walk),)),
        math.pi / 2,
    )
    oncoming = Actor(
        "oncoming_car",
        ObjectClass.CAR,
        Role.TRAFFIC,
        Line(118.0, -10.0),
        Line(2 * _LANE_M, 0.0),
        math.pi,
    )
    return Storyboard(
        "vru_crossing", seed, _road(2), _camera(), _look(rng), 24.0, 9.0,
        _vut(speed, (Ramp(brake_s, stop_s, -speed),)), (pedestrian, oncoming),
    )  # fmt: skip
