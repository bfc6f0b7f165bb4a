"""Motion for synthetic clips: closed formulas of time, without dynamics, control or traffic.

A clip shows the same interaction as a session with its own speeds, distances, timing and look. A
further scenario is one module in ``storyboards`` and a line in ``_PLAYS``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ssp_core.errors import InputError
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.road import Road
from ssp_ot_controller.camera.motion import Actor
from ssp_ot_controller.camera.storyboards import (
    cut_in,
    lead_braking,
    occluded_crossing,
    vru_crossing,
)
from ssp_ot_controller.camera.storyboards.base import LaneCounts, Play

# New ones at the end: a scenario's number is part of its seed.
_PLAYS: dict[str, Callable[[np.random.Generator, LaneCounts], Play]] = {
    "cut_in": cut_in.play,
    "vru_crossing": vru_crossing.play,
    "lead_braking": lead_braking.play,
    "occluded_crossing": occluded_crossing.play,
}
INTERACTIONS = tuple(_PLAYS)
FPS = 24.0
DURATION_S = 9.0
MOST_LANES = 4


@dataclass(frozen=True)
class Storyboard:
    """A whole clip before it is drawn; map and block frame are the same."""

    scenario: str
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


def storyboard(scenario: str, seed: int, lanes: LaneCounts | None = None) -> Storyboard:
    """The clip of a scenario; the seed varies speeds, timing and light a little.

    Args:
        scenario: one of `INTERACTIONS`.
        seed: of speeds, timing and light.
        lanes: of the road, None: two each way. They change nothing else.

    Raises:
        InputError: there is no such scenario, or the road has too few lanes for it.
    """
    if scenario not in INTERACTIONS:
        raise InputError(
            "is no scenario", field="scenario", value=scenario, remedy=f"one of {INTERACTIONS}"
        )
    lanes = lanes or LaneCounts()
    least = 2 if scenario == "cut_in" else 1
    if not least <= lanes.same <= MOST_LANES or not 0 <= lanes.opposite <= MOST_LANES:
        raise InputError(
            f"can't be drawn on a road of {lanes.same}+{lanes.opposite} lanes",
            field="scenario",
            value=scenario,
            remedy=f"{least} to {MOST_LANES} lanes in the VUT's direction and 0 to {MOST_LANES} "
            "oncoming ones",
        )
    rng = np.random.default_rng(np.random.SeedSequence([seed, INTERACTIONS.index(scenario)]))
    play = _PLAYS[scenario](rng, lanes)
    return Storyboard(
        scenario,
        seed,
        play.road,
        play.camera,
        play.look,
        FPS,
        DURATION_S,
        play.vut,
        play.others,
    )
