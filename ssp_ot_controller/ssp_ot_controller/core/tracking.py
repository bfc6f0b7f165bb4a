"""Tracking controllers: from an object's state and its reference to a command for its body.

Vehicles and two-wheelers: across the path a linear-quadratic regulator with the reference's
curvature fed forward, ahead of the steering's lag; along it a linear-quadratic regulator that sees
the reference's accelerations ahead (core.gains). Pedestrian dummies: the reference's velocity and a
proportional part along and across the path.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ssp_core.geometry import FloatArray, wrap_angle
from ssp_core.motion.reference import Reference, ReferencePoint
from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.core.bodies import LIMITS, BodyLimits, Command
from ssp_ot_controller.core.gains import (
    DEFAULT_GAINS,
    GAIN_STEP_MPS,
    MAX_GAIN_SPEED_MPS,
    MIN_GAIN_SPEED_MPS,
    TrackerGains,
    lag_share,
    lateral_gains,
    preview_gains,
)
from ssp_ot_controller.core.track import Point, Track

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
        track = self.track_of(reference)
        t_s = track.seconds(now_ns)
        point = track.at(t_s)
        error = tracking_error(state, point)
        if (
            point.speed_mps < _STANDSTILL_MPS
            and track.speed_mps(t_s + self._dt_s) < _STANDSTILL_MPS
        ):
            return self._hold(state, track, t_s, point, error), error
        if self._walker:
            return self._walk(state, track, t_s, point, error), error
        return self._drive(state, track, t_s, point, error), error

    def brake(
        self, state: ObjectState, reference: Reference, now_ns: int, deceleration_mps2: float
    ) -> Command:
        """Brakes with the given deceleration (> 0) and stays on the reference's path meanwhile."""
        if self._walker:
            return Command(-deceleration_mps2, 0.0, state.yaw_rad)
        track = self.track_of(reference)
        t_s = track.seconds(now_ns)
        point = track.at(t_s)
        curvature = self._steer(state, track, t_s, point, tracking_error(state, point))
        return Command(-deceleration_mps2, curvature, state.yaw_rad)

    def _hold(
        self, state: ObjectState, track: Track, t_s: float, point: Point, error: TrackingError
    ) -> Command:
        """Standstill: brake out what speed is left, and never creep towards the point."""
        if self._walker:
            return Command(-_HOLD_MPS2, 0.0, point.yaw_rad)
        curvature = self._steer(state, track, t_s, point, error)
        return Command(-_HOLD_MPS2, curvature, state.yaw_rad)

    def _drive(
        self, state: ObjectState, track: Track, t_s: float, point: Point, error: TrackingError
    ) -> Command:
        """A vehicle's command."""
        return Command(
            self._accelerate(state, track, t_s, point, error),
            self._steer(state, track, t_s, point, error),
            point.yaw_rad,
        )

    def _bounded(self, acceleration_mps2: float) -> float:
        least, most = -self._limits.deceleration_mps2, self._limits.acceleration_mps2
        return min(max(acceleration_mps2, least), most)

    def _accelerate(
        self, state: ObjectState, track: Track, t_s: float, point: Point, error: TrackingError
    ) -> float:
        g = self._preview
        along_mps = state.speed_mps * math.cos(error.yaw_rad)
        back = (
            g.position * error.longitudinal_m
            + g.speed * (along_mps - point.speed_mps)
            + g.acceleration * (state.acceleration_mps2 - point.acceleration_mps2)
        )
        return self._bounded(self._feed_forward(track, t_s) - back)

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

    def _beside(
        self, state: ObjectState, track: Track, t_s: float, point: Point, error: TrackingError
    ) -> tuple[float, Point, float]:
        """The point of the path that the object is beside now: when, what, and how far left."""
        # An object that is ahead of or behind its time steers by the place where it is.
        shift_s = error.longitudinal_m / max(point.speed_mps, MIN_GAIN_SPEED_MPS)
        beside_s = t_s + min(max(shift_s, -2.0), 2.0)
        beside = track.at(beside_s)
        c, s = math.cos(beside.yaw_rad), math.sin(beside.yaw_rad)
        return beside_s, beside, c * (state.y_m - beside.y_m) - s * (state.x_m - beside.x_m)

    def _curvature_of(self, state: ObjectState, beside: Point) -> float:
        """Measured curvature; that of the path for an object that is too slow to tell."""
        if state.speed_mps > _MIN_CURVATURE_SPEED_MPS:
            return state.yaw_rate_radps / state.speed_mps
        return beside.curvature_1pm

    def _steer(
        self, state: ObjectState, track: Track, t_s: float, point: Point, error: TrackingError
    ) -> float:
        """Curvature command against the point of the path that the object is beside now."""
        beside_s, beside, lateral_m = self._beside(state, track, t_s, point, error)
        yaw_rad = wrap_angle(state.yaw_rad - beside.yaw_rad)
        here = beside.curvature_1pm
        # The command with which a lag that is at the reference's curvature stays on it.
        change = track.curvature_1pm(beside_s + self._dt_s) - here
        forward = here + change / self._curvature_share
        k_lateral, k_yaw, k_curvature = self._gains_at(state.speed_mps)
        turned = self._curvature_of(state, beside) - here
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

    def _walk(
        self, state: ObjectState, track: Track, t_s: float, point: Point, error: TrackingError
    ) -> Command:
        g = self._gains
        soon = track.at(t_s + self._dt_s)
        along = point.speed_mps - g.walker_position_1ps * error.longitudinal_m
        # Sideways corrections stay small against the walk, or the dummy would turn away from it.
        most = 0.4 * max(point.speed_mps, 0.2)
        across = min(max(-g.walker_position_1ps * error.lateral_m, -most), most)
        change = soon.acceleration_mps2 - point.acceleration_mps2
        forward = point.acceleration_mps2 + change / self._acceleration_share
        heading = wrap_angle(soon.yaw_rad + math.atan2(across, max(along, 0.2)))
        wanted = math.hypot(max(along, 0.0), across) if along > 0.0 else 0.0
        acceleration = forward + g.walker_speed_1ps * (wanted - state.speed_mps)
        return Command(self._bounded(acceleration), 0.0, heading)
