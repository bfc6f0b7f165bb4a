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

The curvature of a driver's plan jumps at each of its points, as the second derivative of a
shape-preserving cubic does, and most where it begins. What is fed forward is there a mean of it, by
the reference's yaw, over twice the steering's lag.

A ``Track`` is a reference made ready for being driven: plain numbers, so that a step costs
microseconds. ``sample`` of ssp_core.motion.reference says what a reference means; a track gives the
same values.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import FloatArray, Pose2, wrap_angle
from ssp_core.motion.reference import PLAN, Reference, ReferencePoint
from ssp_core.motion.state import ObjectState
from ssp_core.value_class import value_class
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import LIMITS, BodyLimits, Command
from ssp_ot_controller.control.riccati import cost_to_go

# Rows of a track, and steps of feed-forward, that are made ready at once; a power of two.
_PIECE_BITS = 6
_PIECE = 1 << _PIECE_BITS
# On a shorter way the change of yaw says nothing about the curvature.
_LEAST_WAY_M = 0.05


class Point(NamedTuple):
    """The place of an object and its speed at one time; fields as in ReferencePoint."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float
    curvature_1pm: float


class Track:
    """One accepted reference. Reads no clock, and what it gives depends on its arguments only.

    A stream of adapted references replaces each after a few steps, so that points are made ready
    in pieces, when they are first asked for.
    """

    def __init__(self, reference: Reference) -> None:
        _, x, y, yaw, speed, acceleration, curvature = reference.columns
        steps_m = np.hypot(np.diff(x), np.diff(y))
        stations_m = np.concatenate(([0.0], np.cumsum(steps_m)))
        # Velocities are the tangents of the Hermite curve.
        vx, vy = speed * np.cos(yaw), speed * np.sin(yaw)
        self.reference = reference
        self.length_m = float(stations_m[-1])
        self._execute_at_ns = reference.execute_at_ns
        self._times_s = reference.times_s
        self._table = np.column_stack(
            (x, y, yaw, speed, acceleration, curvature, vx, vy, stations_m)
        )
        self._pieces: dict[int, list[list[float]]] = {}

    def _rows(self, i: int) -> list[list[float]]:
        """Return a row and the one behind it, the last one alone."""
        piece = self._pieces.get(i >> _PIECE_BITS)
        if piece is None:
            first = i >> _PIECE_BITS << _PIECE_BITS
            piece = self._table[first : first + _PIECE + 1].tolist()
            self._pieces[i >> _PIECE_BITS] = piece
        place = i & _PIECE - 1
        return piece[place : place + 2]

    def _value(self, t_s: float, column: int) -> float:
        """Return a column of the table at a time, linear; its ends before and after."""
        times = self._times_s
        if t_s < times[0]:
            return self._rows(0)[0][column]
        if t_s >= times[-1]:
            return self._rows(len(times) - 1)[0][column]
        i = bisect_right(times, t_s)
        before, after = self._rows(i - 1)
        a, b = before[column], after[column]
        return a + (t_s - times[i - 1]) / (times[i] - times[i - 1]) * (b - a)

    @property
    def end(self) -> Pose2:
        """Return the end of the path."""
        return Pose2(*self._rows(len(self._times_s) - 1)[0][:3])

    def accelerations(self, times_s: FloatArray) -> FloatArray:
        """Return accelerations at times after execute_at.

        They are 0 before the first point and from the last on.
        """
        t = self.reference.columns[0]
        inside = (times_s >= t[0]) & (times_s < t[-1])
        return np.where(inside, np.interp(times_s, t, self._table[:, 4]), 0.0)

    def curvatures(self, times_s: FloatArray) -> FloatArray:
        """Return curvatures at times after execute_at; those of both ends before and after."""
        curvatures_1pm: FloatArray = np.interp(
            times_s, self.reference.columns[0], self._table[:, 5]
        )
        return curvatures_1pm

    def seconds(self, t_ns: int) -> float:
        """Return a session time in s after execute_at."""
        return ns_to_seconds(t_ns - self._execute_at_ns)

    def at(self, t_s: float) -> Point:
        """Interpolate by a cubic Hermite in position, else linearly; at rest before and after."""
        times = self._times_s
        if t_s < times[0]:
            x, y, yaw, v, _, k, _, _, _ = self._rows(0)[0]
            return Point(x, y, yaw, v, 0.0, k)
        if t_s >= times[-1]:
            x, y, yaw, _, _, k, _, _, _ = self._rows(len(times) - 1)[0]
            return Point(x, y, yaw, 0.0, 0.0, k)
        i = bisect_right(times, t_s)
        before, after = self._rows(i - 1)
        xa, ya, yaw_a, va, aa, ka, vxa, vya, _ = before
        xb, yb, yaw_b, vb, ab, kb, vxb, vyb, _ = after
        start_s = times[i - 1]
        span_s = times[i] - start_s
        u = (t_s - start_s) / span_s
        w = 1.0 - u
        h_a, h_b = (1.0 + 2.0 * u) * w * w, u * u * (3.0 - 2.0 * u)
        g_a, g_b = u * w * w * span_s, u * u * (u - 1.0) * span_s
        return Point(
            h_a * xa + h_b * xb + g_a * vxa + g_b * vxb,
            h_a * ya + h_b * yb + g_a * vya + g_b * vyb,
            yaw_a if yaw_a == yaw_b else wrap_angle(yaw_a + u * wrap_angle(yaw_b - yaw_a)),
            va + u * (vb - va),
            aa + u * (ab - aa),
            ka + u * (kb - ka),
        )

    def curvature_1pm(self, t_s: float) -> float:
        """Evaluate ``at`` for the curvature only."""
        return self._value(t_s, 5)

    def mean_curvature_1pm(self, from_s: float, to_s: float) -> float:
        """Return the change of yaw over the way between two times; at the former without a way."""
        way_m = self._value(to_s, 8) - self._value(from_s, 8)
        if way_m < _LEAST_WAY_M:
            return self.curvature_1pm(from_s)
        return wrap_angle(self.at(to_s).yaw_rad - self.at(from_s).yaw_rad) / way_m

    def speed_mps(self, t_s: float) -> float:
        """Evaluate ``at`` for the speed only."""
        return 0.0 if t_s >= self._times_s[-1] else self._value(t_s, 3)

    def left_m(self, t_s: float, ahead_m: float) -> float:
        """Return the length of path ahead of an object, m; negative past its end.

        Args:
            t_s: after execute_at.
            ahead_m: how far the object is ahead of its time.
        """
        return self.length_m - self._value(t_s, 8) - ahead_m


# Below this speed the gains stay those of this speed, so that they don't grow without bound.
MIN_GAIN_SPEED_MPS = 2.0
MAX_GAIN_SPEED_MPS = 40.0
_GAIN_SPEEDS = 39
GAIN_STEP_MPS = (MAX_GAIN_SPEED_MPS - MIN_GAIN_SPEED_MPS) / (_GAIN_SPEEDS - 1)
# How far ahead accelerations are looked at.
PREVIEW_S = 0.6


# Costs of the regulators, which meet the accuracy that the tests state: of 1 m lateral error, 1 rad
# heading error, and 1 1/m of curvature beside the feed-forward, all squared;
_LATERAL_WEIGHT, _YAW_WEIGHT, _CURVATURE_WEIGHT = 1.0, 4.0, 200.0
# of 1 m longitudinal error, 1 m/s speed error, and 1 m/s^2 commanded for an error, squared;
_POSITION_WEIGHT, _SPEED_WEIGHT, _ACCELERATION_WEIGHT = 4.0, 2.0, 1.0
# of 1 m/s^2 commanded for a change of the reference that is ahead, squared: the reference has no
# noise, so that it may be followed more closely.
_PREVIEW_WEIGHT = 0.02
# A walker's velocity correction per m of error, and acceleration per m/s of speed error.
_WALKER_POSITION_1PS, _WALKER_SPEED_1PS = 1.2, 5.0


def lag_share(lag_s: float, dt_s: float) -> float:
    """Return the part of its way to a held command that a first-order lag goes in one step."""
    return 1.0 if lag_s <= 0.0 else -math.expm1(-dt_s / lag_s)


@lru_cache(maxsize=16)
def lateral_gains(lag_s: float, dt_s: float) -> tuple[FloatArray, FloatArray]:
    """Return speeds in m/s, shape (n,), and LQR gains for them, shape (n, 3).

    The gains are on e_y, e_yaw and e_curvature.
    """
    speeds = np.linspace(MIN_GAIN_SPEED_MPS, MAX_GAIN_SPEED_MPS, _GAIN_SPEEDS)
    share = lag_share(lag_s, dt_s)
    table = np.empty((len(speeds), 3))
    cost = np.diag([_LATERAL_WEIGHT, _YAW_WEIGHT, 0.0])
    effort = np.array([[_CURVATURE_WEIGHT]])
    for i, v in enumerate(speeds):
        step = v * dt_s
        a = np.array([[1.0, step, 0.5 * step**2], [0.0, 1.0, step], [0.0, 0.0, 1.0 - share]])
        b = np.array([[0.0], [0.0], [share]])
        p = cost_to_go(a, b, cost, effort)
        table[i] = np.linalg.solve(effort + b.T @ p @ b, b.T @ p @ a)[0]
    return speeds, _rounded(table)


def _rounded(values: FloatArray) -> FloatArray:
    """Round to ten digits: linear algebra differs in the last ones from machine to machine."""
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
def preview_gains(lag_s: float, dt_s: float) -> PreviewGains:
    """Return the gains of the longitudinal loop for a lag and a step."""
    share = lag_share(lag_s, dt_s)
    # Errors after a step by what acceleration error it ends with: mean value of the step.
    into = np.array([[0.5 * dt_s**2], [dt_s], [1.0]])
    a = np.array([[1.0, dt_s, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 0.0]])
    a += into @ np.array([[0.0, 0.0, 1.0 - share]])
    b = share * into
    e = (1.0 - share) * into
    cost = np.diag([_POSITION_WEIGHT, _SPEED_WEIGHT, 0.0])

    def optimal(weight: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        effort = np.array([[weight]])
        p = cost_to_go(a, b, cost, effort)
        inverse = np.asarray(np.linalg.inv(effort + b.T @ p @ b), np.float64)
        return p, inverse, inverse @ b.T @ p @ a

    _, _, back = optimal(_ACCELERATION_WEIGHT)
    p, inverse, k = optimal(_PREVIEW_WEIGHT)
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


@value_class(frozen=True, slots=True)
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
    """Return the state minus the reference in the reference's frame."""
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
    ) -> None:
        self._walker = object_class is ObjectClass.PEDESTRIAN
        self._limits = LIMITS[object_class] if limits is None else limits
        self._dt_s = dt_s
        _, table = lateral_gains(self._limits.curvature_lag_s, dt_s)
        self._table: list[list[float]] = table.tolist()
        self._preview = preview_gains(self._limits.acceleration_lag_s, dt_s)
        self._acceleration_share = lag_share(self._limits.acceleration_lag_s, dt_s)
        self._curvature_share = lag_share(self._limits.curvature_lag_s, dt_s)
        self._driven: Track | None = None
        self._forward: dict[int, list[float]] = {}

    def track_of(self, reference: Reference) -> Track:
        """Return the reference made ready; keep that of the last one."""
        driven = self._driven
        if driven is None or driven.reference is not reference:
            driven = self._driven = Track(reference)
            self._forward = {}
        return driven

    def track(
        self, state: ObjectState, reference: Reference, now_ns: int
    ) -> tuple[Command, TrackingError]:
        """Return the command for the next step, and the error at ``now_ns``.

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
            hold_command = Command(-_HOLD_MPS2, 0.0, now.point.yaw_rad)
            return hold_command if stands else self._walk(now), now.error
        if stands:
            return Command(-_HOLD_MPS2, self._steer(now), state.yaw_rad), now.error
        return Command(self._accelerate(now), self._steer(now), now.point.yaw_rad), now.error

    def brake(
        self, state: ObjectState, reference: Reference, now_ns: int, deceleration_mps2: float
    ) -> Command:
        """Brake with the given deceleration (> 0) and stay on the reference's path meanwhile."""
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
        """Compute the command for the reference's accelerations from now on.

        It is linear between two steps.
        """
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
        """Return the curvature command against the path's point that the object is beside now."""
        state, track = now.state, now.track
        # An object that is ahead of or behind its time steers by the place where it is.
        shift_s = now.error.longitudinal_m / max(now.point.speed_mps, MIN_GAIN_SPEED_MPS)
        beside_s = now.t_s + min(max(shift_s, -2.0), 2.0)
        beside = track.at(beside_s)
        c, s = math.cos(beside.yaw_rad), math.sin(beside.yaw_rad)
        lateral_m = c * (state.y_m - beside.y_m) - s * (state.x_m - beside.x_m)
        yaw_rad = wrap_angle(state.yaw_rad - beside.yaw_rad)
        here, forward = self._curvatures(track, beside_s, beside.curvature_1pm)
        k_lateral, k_yaw, k_curvature = self._gains_at(state.speed_mps)
        # An object that is too slow to tell is taken to turn as the path does.
        fast = state.speed_mps > _MIN_CURVATURE_SPEED_MPS
        turned = (state.yaw_rate_radps / state.speed_mps if fast else here) - here
        back = k_lateral * lateral_m + k_yaw * yaw_rad + k_curvature * turned
        bound = self._limits.curvature_1pm
        return min(max(forward - back, -bound), bound)

    def _curvatures(self, track: Track, t_s: float, here_1pm: float) -> tuple[float, float]:
        """Return the reference's curvature, and the command with which a lag stays on it, 1/m.

        Args:
            track: of the reference.
            t_s: after execute_at.
            here_1pm: the reference's curvature at that time.
        """
        if track.reference.purpose != PLAN:
            change = track.curvature_1pm(t_s + self._dt_s) - here_1pm
            return here_1pm, here_1pm + change / self._curvature_share
        lag_s, begun_s = self._limits.curvature_lag_s, max(t_s, 0.0)
        around = track.mean_curvature_1pm(max(begun_s - lag_s, 0.0), begun_s + lag_s)
        return around, track.mean_curvature_1pm(begun_s, begun_s + 2.0 * lag_s)

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
        point, error = now.point, now.error
        soon = now.track.at(now.t_s + self._dt_s)
        along = point.speed_mps - _WALKER_POSITION_1PS * error.longitudinal_m
        # Sideways corrections stay small against the walk, or the dummy would turn away from it.
        most = 0.4 * max(point.speed_mps, 0.2)
        across = min(max(-_WALKER_POSITION_1PS * error.lateral_m, -most), most)
        change = soon.acceleration_mps2 - point.acceleration_mps2
        forward = point.acceleration_mps2 + change / self._acceleration_share
        heading = wrap_angle(soon.yaw_rad + math.atan2(across, max(along, 0.2)))
        target_mps = math.hypot(max(along, 0.0), across) if along > 0.0 else 0.0
        acceleration = forward + _WALKER_SPEED_1PS * (target_mps - now.state.speed_mps)
        return Command(self._bounded(acceleration), 0.0, heading)
