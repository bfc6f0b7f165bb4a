"""Seeded disturbances of localisation and links, counted in steps so that they repeat exactly."""

from __future__ import annotations

import zlib
from collections import deque
from dataclasses import dataclass, replace

import numpy as np

from ssp_core.run_spec import LinkDisturbance
from ssp_core.state import ObjectState


def _generator(seed: int, name: str, purpose: str) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(f"{name}/{purpose}".encode())])


class Localisation:
    """What an object's localisation makes of its true state.

    Args:
        disturbance: sizes of the noise, one sigma.
        seed: of the run.
        object_id: gives each object noise of its own.
    """

    def __init__(self, disturbance: LinkDisturbance, seed: int, object_id: str) -> None:
        self._noise = disturbance
        self._random = _generator(seed, object_id, "localisation")

    def measure(self, truth: ObjectState) -> ObjectState:
        """The measured state; one draw per call, whatever the sizes are."""
        dx, dy, dv = self._random.standard_normal(3)
        sigma, sigma_v = self._noise.position_noise_m, self._noise.speed_noise_mps
        if sigma == 0.0 and sigma_v == 0.0:
            return truth
        # A standing object knows that it stands: its wheel sensors say so.
        speed = truth.speed_mps + sigma_v * float(dv) if truth.speed_mps > 0.1 else truth.speed_mps
        return replace(
            truth,
            x_m=truth.x_m + sigma * float(dx),
            y_m=truth.y_m + sigma * float(dy),
            speed_mps=speed,
            position_std_m=sigma,
        )


@dataclass
class Link:
    """A one-way link that delays and loses states.

    Args:
        delay_steps: each state arrives that many steps later.
        loss: probability of losing one.
        random: seeded generator.
    """

    delay_steps: int
    loss: float
    random: np.random.Generator

    def __post_init__(self) -> None:
        self._line: deque[ObjectState | None] = deque([None] * self.delay_steps)

    def pass_on(self, state: ObjectState) -> ObjectState | None:
        """Takes the state of this step in, and gives what arrives at this step, if anything."""
        lost = float(self.random.random()) < self.loss
        self._line.append(None if lost else state)
        return self._line.popleft()


def make_link(disturbance: LinkDisturbance, seed: int, object_id: str, step_s: float) -> Link:
    """The state link of one object in one run."""
    return Link(
        round(disturbance.state_delay_s / step_s),
        disturbance.state_loss,
        _generator(seed, object_id, "link"),
    )
