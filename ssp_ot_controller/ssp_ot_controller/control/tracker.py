"""Tracking controllers: from an object's state and its reference to a command for its body.

Vehicles and two-wheelers: across the path a linear-quadratic regulator with the reference's
curvature fed forward, ahead of the steering's lag; along it a linear-quadratic regulator that sees
the reference's accelerations ahead. Pedestrian dummies: the reference's velocity and a proportional
part along and across the path. Gains are computed once per body and step.

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
from typing import NamedTuple

import numpy as np
from scipy.linalg import solve_discrete_are  # type: ignore[import-untyped] # has no types

from ssp_core.geometry import FloatArray, wrap_angle
from ssp_core.motion.reference import Reference, ReferencePoint
from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import LIMITS, BodyLimits, Command
from ssp_ot_controller.control.track import Point, Track

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


# Below this speed yaw rate over speed says nothing about the curvature.
_MIN_CURVATURE_SPEED_MPS = 0.5
# An object that should stand is held with this deceleration.
_HOLD_MPS2 = 2.0
_STANDSTILL_MPS = 1e-3
# Feed-forward is computed for so many steps at once.
_PIECE = 64


@dataclass(frozen=True, slots=True)
class TrackingError:
    """State minus reference, as in ObjectState.msg.

    Args:
        longitudinal_m: m along the reference heading, + is ahead.
        lateral_m: m, + is left of the reference.
        yaw_rad: rad, in (-pi, pi].
    """

    longitudinal_m: float
    lateral_m: float
    yaw_rad: float


def tracking_error(state: ObjectState, point: Point | ReferencePoint) -> TrackingError:
    """State minus reference in the reference's frame."""
    c, s = math.cos(point.yaw_rad), math.sin(point.yaw_rad)
    dx, dy = state.x_m - point.x_m, state.y_m - point.y_m
    return TrackingError(
        c * dx + s * dy, -s * dx + c * dy, wrap_angle(state.yaw_rad - point.yaw_rad)
    )


class _Now(NamedTuple):
    """An object on its reference at one step."""

    state: ObjectState
    track: Track
    t_s: float
    point: Point
    error: TrackingError


class Tracker:
    """Tracks references with one object. It holds tables only: the same input, the same command.

    Args:
        limits: of the body; those of the class when None.

    Raises:
        KeyError: a class without a body (UNKNOWN).
    """

    def __init__(
        self,
        object_class: ObjectClass,
        limits: BodyLimits | None = None,
        dt_s: float = 0.02,
        gains: TrackerGains = DEFAULT_GAINS,
    ) -> None:
        self._walker = object_class is ObjectClass.PEDESTRIAN
        self._limits = LIMITS[object_class] if limits is None else limits
        self._dt_s = dt_s
        self._gains = gains
        _, table = lateral_gains(self._limits.curvature_lag_s, dt_s, gains)
        self._table: list[list[float]] = table.tolist()
        self._preview = preview_gains(self._limits.acceleration_lag_s, dt_s, gains)
        self._acceleration_share = lag_share(self._limits.acceleration_lag_s, dt_s)
        self._curvature_share = lag_share(self._limits.curvature_lag_s, dt_s)
        self._driven: Track | None = None
        self._forward: dict[int, list[float]] = {}

    def track_of(self, reference: Reference) -> Track:
        """The reference made ready; that of the last one is kept."""
        driven = self._driven
        if driven is None or driven.reference is not reference:
            driven = self._driven = Track(reference)
            self._forward = {}
        return driven

    def track(
        self, state: ObjectState, reference: Reference, now_ns: int
    ) -> tuple[Command, TrackingError]:
        """The command for the next step, and the error at ``now_ns``.

        Args:
            state: of the object at ``now_ns``.
            reference: accepted, with execute_at at or before ``now_ns``.
            now_ns: session time, ns.
        """
        now = self._now(state, reference, now_ns)
        soon_mps = now.track.speed_mps(now.t_s + self._dt_s)
        stands = now.point.speed_mps < _STANDSTILL_MPS and soon_mps < _STANDSTILL_MPS
        if self._walker:
            # Standstill: brake out what speed is left, and never creep towards the point.
            held = Command(-_HOLD_MPS2, 0.0, now.point.yaw_rad)
            return held if stands else self._walk(now), now.error
        if stands:
            return Command(-_HOLD_MPS2, self._steer(now), state.yaw_rad), now.error
        return Command(self._accelerate(now), self._steer(now), now.point.yaw_rad), now.error

    def brake(
        self, state: ObjectState, reference: Reference, now_ns: int, deceleration_mps2: float
    ) -> Command:
        """Brakes with the given deceleration (> 0) and stays on the reference's path meanwhile."""
        if self._walker:
            return Command(-deceleration_mps2, 0.0, state.yaw_rad)
        now = self._now(state, reference, now_ns)
        return Command(-deceleration_mps2, self._steer(now), state.yaw_rad)

    def _now(self, state: ObjectState, reference: Reference, now_ns: int) -> _Now:
        track = self.track_of(reference)
        t_s = track.seconds(now_ns)
        point = track.at(t_s)
        return _Now(state, track, t_s, point, tracking_error(state, point))

    def _bounded(self, acceleration_mps2: float) -> float:
        least, most = -self._limits.deceleration_mps2, self._limits.acceleration_mps2
        return min(max(acceleration_mps2, least), most)

    def _accelerate(self, now: _Now) -> float:
        g, state, point = self._preview, now.state, now.point
        along_mps = state.speed_mps * math.cos(now.error.yaw_rad)
        back = (
            g.position * now.error.longitudinal_m
            + g.speed * (along_mps - point.speed_mps)
            + g.acceleration * (state.acceleration_mps2 - point.acceleration_mps2)
        )
        return self._bounded(self._feed_forward(now.track, now.t_s) - back)

    def _feed_forward(self, track: Track, t_s: float) -> float:
        """What the reference's accelerations from now on ask for, linear between two steps."""
        steps = t_s / self._dt_s
        k = math.floor(steps)
        share = steps - k
        here = self._forward_at(track, k)
        if share < 1e-6:
            return here
        return here + share * (self._forward_at(track, k + 1) - here)

    def _forward_at(self, track: Track, k: int) -> float:
        first = k // _PIECE
        piece = self._forward.get(first)
        if piece is None:
            weights = self._preview.ahead
            steps: FloatArray = first * _PIECE + np.arange(_PIECE + len(weights) - 1.0)
            ahead = track.accelerations(steps * self._dt_s)
            # Term by term: a library's own sum of products has another order on another machine.
            total = np.zeros(_PIECE)
            for i, weight in enumerate(weights):
                total += weight * ahead[i : i + _PIECE]
            piece = total.tolist()
            self._forward[first] = piece
        return piece[k - first * _PIECE]

    def _steer(self, now: _Now) -> float:
        """Curvature command against the point of the path that the object is beside now."""
        state, track = now.state, now.track
        # An object that is ahead of or behind its time steers by the place where it is.
        shift_s = now.error.longitudinal_m / max(now.point.speed_mps, MIN_GAIN_SPEED_MPS)
        beside_s = now.t_s + min(max(shift_s, -2.0), 2.0)
        beside = track.at(beside_s)
        c, s = math.cos(beside.yaw_rad), math.sin(beside.yaw_rad)
        lateral_m = c * (state.y_m - beside.y_m) - s * (state.x_m - beside.x_m)
        yaw_rad = wrap_angle(state.yaw_rad - beside.yaw_rad)
        here = beside.curvature_1pm
        # The command with which a lag that is at the reference's curvature stays on it.
        change = track.curvature_1pm(beside_s + self._dt_s) - here
        forward = here + change / self._curvature_share
        k_lateral, k_yaw, k_curvature = self._gains_at(state.speed_mps)
        # An object that is too slow to tell is taken to turn as the path does.
        fast = state.speed_mps > _MIN_CURVATURE_SPEED_MPS
        turned = (state.yaw_rate_radps / state.speed_mps if fast else here) - here
        back = k_lateral * lateral_m + k_yaw * yaw_rad + k_curvature * turned
        bound = self._limits.curvature_1pm
        return min(max(forward - back, -bound), bound)

    def _gains_at(self, speed_mps: float) -> tuple[float, float, float]:
        bounded = min(max(speed_mps, MIN_GAIN_SPEED_MPS), MAX_GAIN_SPEED_MPS)
        place = (bounded - MIN_GAIN_SPEED_MPS) / GAIN_STEP_MPS
        i = min(int(place), len(self._table) - 2)
        share = place - i
        a, b = self._table[i], self._table[i + 1]
        return (
            a[0] + share * (b[0] - a[0]),
            a[1] + share * (b[1] - a[1]),
            a[2] + share * (b[2] - a[2]),
        )

    def _walk(self, now: _Now) -> Command:
        g, point, error = self._gains, now.point, now.error
        soon = now.track.at(now.t_s + self._dt_s)
        along = point.speed_mps - g.walker_position_1ps * error.longitudinal_m
        # Sideways corrections stay small against the walk, or the dummy would turn away from it.
        most = 0.4 * max(point.speed_mps, 0.2)
        across = min(max(-g.walker_position_1ps * error.lateral_m, -most), most)
        change = soon.acceleration_mps2 - point.acceleration_mps2
        forward = point.acceleration_mps2 + change / self._acceleration_share
        heading = wrap_angle(soon.yaw_rad + math.atan2(across, max(along, 0.2)))
        wanted = math.hypot(max(along, 0.0), across) if along > 0.0 else 0.0
        acceleration = forward + g.walker_speed_1ps * (wanted - now.state.speed_mps)
        return Command(self._bounded(acceleration), 0.0, heading)
