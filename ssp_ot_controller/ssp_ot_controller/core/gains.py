"""Gains of the linear-quadratic regulators, computed once per body and step.

Lateral: states are lateral error, heading error and curvature error; per step, with speed v,
e_y' = v e_yaw, e_yaw' = v e_k, e_k' = (u - e_k) / lag.

Longitudinal, with preview: states are position, speed and acceleration error; the command is the
reference's next acceleration plus u, and the reference's change of acceleration, which the lag
delays, is a disturbance that is known ahead. The optimal law answers each future change with a
gain of its own (linear-quadratic preview control), so that the object begins to brake or to
accelerate before its reference does, as late as its lag allows.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_discrete_are  # type: ignore[import-untyped] # has no types

from ssp_core.geometry import FloatArray

# Below this speed the gains stay those of this speed, so that they don't grow without bound.
MIN_GAIN_SPEED_MPS = 2.0
MAX_GAIN_SPEED_MPS = 40.0
_GAIN_SPEEDS = 39
GAIN_STEP_MPS = (MAX_GAIN_SPEED_MPS - MIN_GAIN_SPEED_MPS) / (_GAIN_SPEEDS - 1)
# How far ahead accelerations are looked at.
PREVIEW_S = 0.6


@dataclass(frozen=True, slots=True)
class TrackerGains:
    """Weights and gains; the defaults meet the accuracy that the tests state.

    Args:
        lateral_weight: cost of 1 m lateral error, squared.
        yaw_weight: cost of 1 rad heading error, squared.
        curvature_weight: cost of 1 1/m of commanded curvature beside the feed-forward, squared.
        position_weight: cost of 1 m longitudinal error, squared.
        speed_weight: cost of 1 m/s speed error, squared.
        acceleration_weight: cost of 1 m/s^2 commanded for an error, squared.
        preview_weight: cost of 1 m/s^2 commanded for a change of the reference that is ahead,
            squared; the reference has no noise, so that it may be followed more closely.
        walker_position_1ps: velocity correction of a walker per m of error.
        walker_speed_1ps: acceleration correction of a walker per m/s of speed error.
    """

    lateral_weight: float = 1.0
    yaw_weight: float = 4.0
    curvature_weight: float = 200.0
    position_weight: float = 4.0
    speed_weight: float = 2.0
    acceleration_weight: float = 1.0
    preview_weight: float = 0.02
    walker_position_1ps: float = 1.2
    walker_speed_1ps: float = 5.0


DEFAULT_GAINS = TrackerGains()


def lag_share(lag_s: float, dt_s: float) -> float:
    """The part of its way to a held command that a first-order lag goes in one step."""
    return 1.0 if lag_s <= 0.0 else -math.expm1(-dt_s / lag_s)


@lru_cache(maxsize=16)
def lateral_gains(
    lag_s: float, dt_s: float, gains: TrackerGains = DEFAULT_GAINS
) -> tuple[FloatArray, FloatArray]:
    """Speeds in m/s, shape (n,), and LQR gains on (e_y, e_yaw, e_curvature), shape (n, 3)."""
    speeds = np.linspace(MIN_GAIN_SPEED_MPS, MAX_GAIN_SPEED_MPS, _GAIN_SPEEDS)
    share = lag_share(lag_s, dt_s)
    table = np.empty((len(speeds), 3))
    cost = np.diag([gains.lateral_weight, gains.yaw_weight, 0.0])
    effort = np.array([[gains.curvature_weight]])
    for i, v in enumerate(speeds):
        step = v * dt_s
        a = np.array([[1.0, step, 0.5 * step**2], [0.0, 1.0, step], [0.0, 0.0, 1.0 - share]])
        b = np.array([[0.0], [0.0], [share]])
        p = solve_discrete_are(a, b, cost, effort)
        table[i] = np.linalg.solve(effort + b.T @ p @ b, b.T @ p @ a)[0]
    return speeds, _rounded(table)


def _rounded(values: FloatArray) -> FloatArray:
    """To ten digits: linear algebra differs in the last ones from machine to machine."""
    return np.array([float(f"{v:.10g}") for v in values.ravel()]).reshape(values.shape)


@dataclass(frozen=True, slots=True)
class PreviewGains:
    """Gains of the longitudinal loop.

    Args:
        position: on the position error, 1/s^2.
        speed: on the speed error, 1/s.
        acceleration: on the acceleration error.
        ahead: on the accelerations of the reference now, one step ahead, and so on; they sum to 1,
            so that a steady acceleration is commanded as it is.
    """

    position: float
    speed: float
    acceleration: float
    ahead: tuple[float, ...]


@lru_cache(maxsize=16)
def preview_gains(lag_s: float, dt_s: float, gains: TrackerGains = DEFAULT_GAINS) -> PreviewGains:
    """Gains of the longitudinal loop for a lag and a step."""
    share = lag_share(lag_s, dt_s)
    # Errors after a step by what acceleration error it ends with: mean value of the step.
    into = np.array([[0.5 * dt_s**2], [dt_s], [1.0]])
    a = np.array([[1.0, dt_s, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    a += into @ np.array([[0.0, 0.0, 1.0 - share]])
    b = share * into
    e = (1.0 - share) * into
    cost = np.diag([gains.position_weight, gains.speed_weight, 0.0])

    def optimal(weight: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        effort = np.array([[weight]])
        p = solve_discrete_are(a, b, cost, effort)
        inverse = np.linalg.inv(effort + b.T @ p @ b)
        return p, inverse, inverse @ b.T @ p @ a

    _, _, back = optimal(gains.acceleration_weight)
    p, inverse, k = optimal(gains.preview_weight)
    closed = (a - b @ k).T
    # The disturbance of a step is the fall of the reference's acceleration over it.
    weights = []
    carried = p @ e
    for _ in range(round(PREVIEW_S / dt_s)):
        weights.append((inverse @ b.T @ carried).item())
        carried = closed @ carried
    ahead = np.zeros(len(weights) + 1)
    ahead[1] = 1.0
    ahead[:-1] -= weights
    ahead[1:] += weights
    position, speed, acceleration = _rounded(back[0]).tolist()
    return PreviewGains(position, speed, acceleration, tuple(_rounded(ahead).tolist()))
