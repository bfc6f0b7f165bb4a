"""Tracking controllers: from an object's state and its reference to a command for its body.

Vehicles: a linear-quadratic regulator on lateral error, heading error and curvature error, its
gains tabulated over speed, with the reference's curvature fed forward; along the path feed-forward
acceleration and a proportional loop on position and speed. Both feed-forwards invert the actuator's
first-order lag over one step. Pedestrian dummies: the reference's velocity and a proportional part
along and across the path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import solve_discrete_are  # type: ignore[import-untyped] # has no types

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import FloatArray, wrap_angle
from ssp_core.reference import Reference, ReferencePoint, sample
from ssp_core.state import ObjectState
from ssp_core.vocab import ObjectClass
from ssp_ot_controller.core.bodies import LIMITS, BodyLimits, Command

# Below this speed the gains stay those of this speed, so that they don't grow without bound.
_MIN_GAIN_SPEED_MPS = 2.0
_MAX_GAIN_SPEED_MPS = 40.0
_GAIN_SPEEDS = 39
# Below this speed yaw rate over speed says nothing about the curvature.
_MIN_CURVATURE_SPEED_MPS = 0.5
# An object that should stand is held with this deceleration.
_HOLD_MPS2 = 2.0
_STANDSTILL_MPS = 1e-3


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


@dataclass(frozen=True, slots=True)
class TrackerGains:
    """Weights and gains; the defaults meet the accuracy that the tests state.

    Args:
        lateral_weight: cost of 1 m lateral error, squared.
        yaw_weight: cost of 1 rad heading error, squared.
        curvature_weight: cost of 1 1/m of commanded curvature beside the feed-forward, squared.
        position_1ps: speed correction per m of longitudinal error.
        speed_1ps: acceleration correction per m/s of speed error.
        walker_position_1ps: velocity correction of a walker per m of error.
        walker_speed_1ps: acceleration correction of a walker per m/s of speed error.
    """

    lateral_weight: float = 1.0
    yaw_weight: float = 4.0
    curvature_weight: float = 200.0
    position_1ps: float = 0.9
    speed_1ps: float = 2.0
    walker_position_1ps: float = 1.2
    walker_speed_1ps: float = 5.0


DEFAULT_GAINS = TrackerGains()


def tracking_error(state: ObjectState, point: ReferencePoint) -> TrackingError:
    """State minus reference in the reference's frame."""
    c, s = math.cos(point.yaw_rad), math.sin(point.yaw_rad)
    dx, dy = state.x_m - point.x_m, state.y_m - point.y_m
    return TrackingError(
        c * dx + s * dy, -s * dx + c * dy, wrap_angle(state.yaw_rad - point.yaw_rad)
    )


@lru_cache(maxsize=16)
def lateral_gains(
    lag_s: float, dt_s: float, gains: TrackerGains = DEFAULT_GAINS
) -> tuple[FloatArray, FloatArray]:
    """Speeds in m/s, shape (n,), and LQR gains on (e_y, e_yaw, e_curvature), shape (n, 3).

    Model per step: e_y' = v e_yaw, e_yaw' = v e_k, e_k' = (u - e_k) / lag.
    """
    speeds = np.linspace(_MIN_GAIN_SPEED_MPS, _MAX_GAIN_SPEED_MPS, _GAIN_SPEEDS)
    share = 1.0 if lag_s <= 0.0 else -math.expm1(-dt_s / lag_s)
    table = np.empty((len(speeds), 3))
    cost = np.diag([gains.lateral_weight, gains.yaw_weight, 0.0])
    effort = np.array([[gains.curvature_weight]])
    for i, v in enumerate(speeds):
        step = v * dt_s
        a = np.array([[1.0, step, 0.5 * step**2], [0.0, 1.0, step], [0.0, 0.0, 1.0 - share]])
        b = np.array([[0.0], [0.0], [share]])
        p = solve_discrete_are(a, b, cost, effort)
        table[i] = np.linalg.solve(effort + b.T @ p @ b, b.T @ p @ a)[0]
    return speeds, table


def _ahead_of_lag(now: float, soon: float, lag_s: float, dt_s: float) -> float:
    """The command with which a first-order lag that is at ``now`` reaches ``soon`` in one step."""
    if lag_s <= 0.0:
        return soon
    return now + (soon - now) / -math.expm1(-dt_s / lag_s)


class Tracker:
    """Tracks references with one object. It holds tables only: the same input, the same command.

    Args:
        object_class: decides the law.
        limits: of the body; those of the class when None.
        dt_s: time for which a command is held.
        gains: weights and gains.

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
        self._speeds, self._table = lateral_gains(self._limits.curvature_lag_s, dt_s, gains)

    def track(
        self, state: ObjectState, reference: Reference, now_ns: int
    ) -> tuple[Command, TrackingError]:
        """The command for the next step, and the error at ``now_ns``.

        Args:
            state: of the object at ``now_ns``.
            reference: accepted, with execute_at at or before ``now_ns``.
            now_ns: session time, ns.
        """
        point = sample(reference, now_ns)
        soon = sample(reference, now_ns + seconds_to_ns(self._dt_s))
        error = tracking_error(state, point)
        if max(point.speed_mps, soon.speed_mps) < _STANDSTILL_MPS:
            return self._hold(state, reference, now_ns, error), error
        if self._walker:
            return self._walk(state, point, soon, error), error
        acceleration = self._longitudinal(state, point, soon, error)
        curvature = self._lateral(state, reference, now_ns, error, point)
        return Command(acceleration, curvature, point.yaw_rad), error

    def brake(
        self, state: ObjectState, reference: Reference, now_ns: int, deceleration_mps2: float
    ) -> Command:
        """Brakes with the given deceleration (> 0) and stays on the reference's path meanwhile."""
        point = sample(reference, now_ns)
        error = tracking_error(state, point)
        if self._walker:
            return Command(-deceleration_mps2, 0.0, state.yaw_rad)
        curvature = self._lateral(state, reference, now_ns, error, point)
        return Command(-deceleration_mps2, curvature, state.yaw_rad)

    def _hold(
        self, state: ObjectState, reference: Reference, now_ns: int, error: TrackingError
    ) -> Command:
        """Standstill: brake out what speed is left, and never creep towards the point."""
        point = sample(reference, now_ns)
        curvature = 0.0 if self._walker else self._lateral(state, reference, now_ns, error, point)
        heading = point.yaw_rad if self._walker else state.yaw_rad
        return Command(-_HOLD_MPS2, curvature, heading)

    def _longitudinal(
        self, state: ObjectState, point: ReferencePoint, soon: ReferencePoint, error: TrackingError
    ) -> float:
        g = self._gains
        forward = _ahead_of_lag(
            point.acceleration_mps2,
            soon.acceleration_mps2,
            self._limits.acceleration_lag_s,
            self._dt_s,
        )
        wanted_mps = point.speed_mps - g.position_1ps * error.longitudinal_m
        along_mps = state.speed_mps * math.cos(error.yaw_rad)
        command = forward + g.speed_1ps * (wanted_mps - along_mps)
        return min(max(command, -self._limits.deceleration_mps2), self._limits.acceleration_mps2)

    def _lateral(
        self,
        state: ObjectState,
        reference: Reference,
        now_ns: int,
        error: TrackingError,
        point: ReferencePoint,
    ) -> float:
        """Curvature command against the point of the path that the object is beside now."""
        # An object that is ahead of or behind its time steers by the place where it is.
        shift_s = error.longitudinal_m / max(point.speed_mps, _MIN_GAIN_SPEED_MPS)
        beside_ns = now_ns + seconds_to_ns(min(max(shift_s, -2.0), 2.0))
        beside = sample(reference, beside_ns)
        soon = sample(reference, beside_ns + seconds_to_ns(self._dt_s))
        e = tracking_error(state, beside)
        measured = beside.curvature_1pm
        if state.speed_mps > _MIN_CURVATURE_SPEED_MPS:
            measured = state.yaw_rate_radps / state.speed_mps
        speed = min(max(state.speed_mps, _MIN_GAIN_SPEED_MPS), _MAX_GAIN_SPEED_MPS)
        forward = _ahead_of_lag(
            beside.curvature_1pm, soon.curvature_1pm, self._limits.curvature_lag_s, self._dt_s
        )
        k = [float(np.interp(speed, self._speeds, self._table[:, j])) for j in range(3)]
        feedback = k[0] * e.lateral_m + k[1] * e.yaw_rad + k[2] * (measured - beside.curvature_1pm)
        bound = self._limits.curvature_1pm
        return min(max(forward - feedback, -bound), bound)

    def _walk(
        self, state: ObjectState, point: ReferencePoint, soon: ReferencePoint, error: TrackingError
    ) -> Command:
        g = self._gains
        along = point.speed_mps - g.walker_position_1ps * error.longitudinal_m
        # Sideways corrections stay small against the walk, or the dummy would turn away from it.
        most = 0.4 * max(point.speed_mps, 0.2)
        across = min(max(-g.walker_position_1ps * error.lateral_m, -most), most)
        forward = _ahead_of_lag(
            point.acceleration_mps2,
            soon.acceleration_mps2,
            self._limits.acceleration_lag_s,
            self._dt_s,
        )
        heading = wrap_angle(soon.yaw_rad + math.atan2(across, max(along, 0.2)))
        wanted = math.hypot(max(along, 0.0), across) if along > 0.0 else 0.0
        acceleration = forward + g.walker_speed_1ps * (wanted - state.speed_mps)
        return Command(
            min(max(acceleration, -self._limits.deceleration_mps2), self._limits.acceleration_mps2),
            0.0,
            heading,
        )
