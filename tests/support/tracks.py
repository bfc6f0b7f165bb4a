"""Motion of an object and what a sound source makes of it, for tests of the consistency watch."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from ssp_core.safety.window import UNITS

Row = tuple[float, float, float, float, float, float]
SOURCES = {"rtk": 0.02, "float": 0.25, "sbas": 0.5}
RATES_HZ = (5.0, 10.0, 100.0)
MANOEUVRES = ("drive", "walk", "reverse", "stand", "sideways", "dropout")
_FINE_S = 0.01


@dataclass(frozen=True)
class Motion:
    """A true motion, in steps of _FINE_S: rows of t_s, x_m, y_m, yaw_rad, speed_mps."""

    manoeuvre: str
    rows: np.ndarray

    @property
    def walks(self) -> bool:
        return self.manoeuvre == "walk"


def motion(manoeuvre: str, random: np.random.Generator, duration_s: float = 20.0) -> Motion:
    """One sound motion, from standstill to standstill."""
    n = round(duration_s / _FINE_S)
    t = np.arange(n) * _FINE_S
    top = {"walk": 1.6, "stand": 0.0, "reverse": 3.0}.get(manoeuvre, random.uniform(5.0, 20.0))
    pull = random.uniform(1.0, 4.0)
    speed = np.clip(np.minimum((t - 2.0) * pull, (duration_s - 3.0 - t) * pull), 0.0, top)
    # A change of speed on the way, as a driver makes.
    dip = random.uniform(0.2, 1.0)
    speed *= 1.0 - (1.0 - dip) * np.exp(-(((t - 0.5 * duration_s) / 1.5) ** 2))
    bend = random.uniform(0.0, 0.6) * np.sin(random.uniform(0.2, 1.0) * t + random.uniform(0, 6))
    rate = bend if manoeuvre == "walk" else np.clip(bend, -0.6, 0.6) * np.minimum(speed, 4.0) / 4.0
    yaw = random.uniform(-math.pi, math.pi) + np.cumsum(rate) * _FINE_S
    if manoeuvre == "reverse":
        speed = -speed
    course = yaw + (random.uniform(-math.pi, math.pi) if manoeuvre == "sideways" else 0.0)
    x = np.cumsum(speed * np.cos(course)) * _FINE_S + random.uniform(-500.0, 500.0)
    y = np.cumsum(speed * np.sin(course)) * _FINE_S + random.uniform(-500.0, 500.0)
    return Motion(manoeuvre, np.column_stack([t, x, y, yaw, speed]))


def measured(
    true: Motion, std_m: float, rate_hz: float, random: np.random.Generator, *, white: float = 0.4
) -> Iterator[Row]:
    """Yield a source's statement of a motion: t_s, x_m, y_m, yaw_rad, speed_mps, position_std_m.

    Args:
        white: share of the deviation that is new with each fix; the rest goes on for half a
            minute, as errors of satellite positioning do.
    """
    late_s = random.uniform(-0.2, 0.2)
    scale = random.uniform(0.97, 1.03)
    gap_s = random.uniform(5.0, 10.0) if true.manoeuvre == "dropout" else math.inf
    fine = true.rows
    stamps = np.arange(0.5, fine[-1, 0] - 0.5, 1.0 / rate_hz)
    n = len(stamps)
    stamps = stamps + random.uniform(-0.1, 0.1, n) / rate_hz
    keep = math.exp(-1.0 / (rate_hz * 30.0))
    slow = np.empty((n, 2))
    slow[0] = random.normal(size=2)
    steps = math.sqrt(1.0 - keep**2) * random.normal(size=(n, 2))
    for i in range(1, n):
        slow[i] = keep * slow[i - 1] + steps[i]
    off = math.sqrt(1.0 - white**2) * slow + white * random.normal(size=(n, 2))
    at = [np.interp(stamps, fine[:, 0], fine[:, k]) + std_m * off[:, k - 1] for k in (1, 2)]
    yaw, speed = (np.interp(stamps - late_s, fine[:, 0], fine[:, k]) for k in (3, 4))
    yaw = yaw + 0.01 * random.normal(size=n)
    speed = scale * speed + 0.03 * random.normal(size=n)
    for t, x, y, turned, v in zip(*(c.tolist() for c in (stamps, *at, yaw, speed)), strict=True):
        if not gap_s < t < gap_s + 1.5:
            yield t, x, y, turned, v, std_m


def falsified(rows: Sequence[Row], kind: str) -> Iterator[Row]:
    """Yield what a source that is set up wrongly makes of a sound one."""
    for t, x, y, yaw, v, std in rows:
        false = {
            "map axes": (yaw, v * math.cos(yaw)),
            "180": (yaw + math.pi, v),
            "ned": (math.pi / 2.0 - yaw, v),
            "empty": (yaw, 0.0),
            **{unit: (yaw, factor * v) for unit, factor in UNITS.items()},
        }[kind]
        yield t, x, y, math.remainder(false[0], math.tau), false[1], std
