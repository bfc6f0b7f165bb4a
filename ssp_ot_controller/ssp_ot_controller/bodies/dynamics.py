"""Bodies: how objects move when they are commanded. Plants of the SIL world, stepped at fixed dt.

A vehicle or two-wheeler is a kinematic bicycle at its rear axle; acceleration and curvature follow
their commands with a first-order lag, a rate limit and a range. A pedestrian dummy stands on a
carrier that turns towards the commanded heading. Nothing here reads a clock or has a state.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Protocol

from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.run_file.model import Limits
from ssp_core.value_class import value_class
from ssp_core.vocabulary import ObjectClass

# Below this speed yaw rate over speed says nothing about the curvature.
_MIN_CURVATURE_SPEED_MPS = 0.5


@value_class(frozen=True, slots=True)
class BodyState:
    """State of the reference point in frame map.

    Args:
        x_m: m, east.
        y_m: m, north.
        yaw_rad: rad, counter-clockwise from east, in (-pi, pi].
        speed_mps: m/s along the heading, >= 0.
        acceleration_mps2: m/s^2 along the heading.
        curvature_1pm: 1/m, + is left; 0 for a walker.
        yaw_rate_radps: rad/s, counter-clockwise positive.
    """

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float = 0.0
    acceleration_mps2: float = 0.0
    curvature_1pm: float = 0.0
    yaw_rate_radps: float = 0.0

    @classmethod
    def at_rest(cls, pose: Pose2) -> BodyState:
        """Return a body that stands."""
        return cls(pose.x_m, pose.y_m, wrap_angle(pose.yaw_rad))


@dataclass(frozen=True, slots=True)
class BodyLimits:
    """The limits of a body's motion, and how quickly it follows.

    Args:
        deceleration_mps2: hardest service braking, > 0.
        emergency_deceleration_mps2: braking of an emergency stop, > 0.
        acceleration_rate_mps3: how quickly acceleration may change.
        acceleration_lag_s: time constant of drive and brakes.
        curvature_1pm: tightest turn; unused by walkers.
        curvature_rate_1pmps: 1/(m s), how quickly curvature may change; unused by walkers.
        curvature_lag_s: time constant of the steering; unused by walkers.
        lateral_acceleration_mps2: grip; bounds curvature by speed; unused by walkers.
        turn_rate_radps: how quickly a walker turns; unused by vehicles.
    """

    speed_mps: float
    acceleration_mps2: float
    deceleration_mps2: float
    emergency_deceleration_mps2: float
    acceleration_rate_mps3: float
    acceleration_lag_s: float
    curvature_1pm: float
    curvature_rate_1pmps: float
    curvature_lag_s: float
    lateral_acceleration_mps2: float
    turn_rate_radps: float


@value_class(frozen=True, slots=True)
class Command:
    """A controller's request to a body until the next command (ActuatorCommand.msg).

    Args:
        acceleration_mps2: along the heading, braking is negative.
        curvature_1pm: + turns left; ignored by walkers.
        heading_rad: map; walkers only.
        emergency_stop: brake as hard as the body may, ignore acceleration.
    """

    acceleration_mps2: float
    curvature_1pm: float
    heading_rad: float
    emergency_stop: bool = False

    @property
    def is_finite(self) -> bool:
        # Not their sum: large numbers add up to infinity.
        return (
            math.isfinite(self.acceleration_mps2)
            and math.isfinite(self.curvature_1pm)
            and math.isfinite(self.heading_rad)
        )


class Moving(Protocol):
    """The motion that braking needs to know; BodyState and ObjectState both have it."""

    @property
    def yaw_rad(self) -> float: ...
    @property
    def speed_mps(self) -> float: ...
    @property
    def yaw_rate_radps(self) -> float: ...


LIMITS: dict[ObjectClass, BodyLimits] = {
    ObjectClass.CAR: BodyLimits(45.0, 4.0, 7.0, 8.5, 25.0, 0.20, 0.20, 0.25, 0.12, 7.0, 0.0),
    ObjectClass.TRUCK: BodyLimits(28.0, 1.8, 5.0, 6.5, 12.0, 0.35, 0.14, 0.15, 0.20, 4.0, 0.0),
    ObjectClass.BUS: BodyLimits(28.0, 1.8, 5.0, 6.5, 12.0, 0.35, 0.10, 0.15, 0.20, 4.0, 0.0),
    ObjectClass.MOTORCYCLE: BodyLimits(50.0, 6.0, 7.0, 8.5, 25.0, 0.15, 0.30, 0.30, 0.20, 7.0, 0.0),
    ObjectClass.CYCLIST: BodyLimits(12.0, 1.8, 3.5, 5.0, 12.0, 0.20, 0.50, 0.60, 0.15, 3.5, 0.0),
    ObjectClass.PEDESTRIAN: BodyLimits(3.5, 2.5, 3.0, 5.0, 30.0, 0.08, 0.0, 0.0, 0.0, 0.0, 3.0),
}


def tightened(body: BodyLimits, site: Limits) -> BodyLimits:
    """Return the body's limits cut down to what the site allows, but for an emergency stop."""
    return replace(
        body,
        speed_mps=min(body.speed_mps, site.speed_mps),
        acceleration_mps2=min(body.acceleration_mps2, site.acceleration_mps2),
        deceleration_mps2=min(body.deceleration_mps2, site.acceleration_mps2),
    )


def brake_command(state: Moving, deceleration_mps2: float) -> Command:
    """Brake with the given deceleration (> 0) and keep steering as it is."""
    curvature = 0.0
    if state.speed_mps > _MIN_CURVATURE_SPEED_MPS:
        curvature = state.yaw_rate_radps / state.speed_mps
    return Command(-deceleration_mps2, curvature, state.yaw_rad)


def _follow(value: float, target: float, lag_s: float, rate: float, dt_s: float) -> float:
    """Follow a command by a first-order lag, solved exactly over the step, then the rate limit."""
    share = 1.0 if lag_s <= 0.0 else -math.expm1(-dt_s / lag_s)
    change = share * (target - value)
    return value + min(max(change, -rate * dt_s), rate * dt_s)


def _advance(
    state: BodyState, command: Command, limits: BodyLimits, dt_s: float, lag_scale: float
) -> tuple[float, float, float]:
    """Return the distance, speed and acceleration after the step; braking ends at zero speed."""
    if command.emergency_stop:
        target = -limits.emergency_deceleration_mps2
    else:
        target = min(
            max(command.acceleration_mps2, -limits.deceleration_mps2), limits.acceleration_mps2
        )
    v0 = state.speed_mps
    a = _follow(
        state.acceleration_mps2,
        target,
        limits.acceleration_lag_s * lag_scale,
        limits.acceleration_rate_mps3,
        dt_s,
    )
    v1 = v0 + a * dt_s
    if v1 <= 0.0:
        return (v0 * v0 / (-2.0 * a) if v0 > 0.0 else 0.0), 0.0, 0.0
    if v1 > limits.speed_mps and a > 0.0:
        v1 = max(v0, limits.speed_mps)
        a = (v1 - v0) / dt_s
    return 0.5 * (v0 + v1) * dt_s, v1, a


def _check(command: Command, dt_s: float, lag_scale: float) -> None:
    if not command.is_finite:
        raise ValueError(f"a body can't follow a command that isn't finite: {command}")
    if not (dt_s > 0.0 and lag_scale > 0.0):
        raise ValueError(f"dt_s and lag_scale must be positive, got {dt_s} and {lag_scale}")


def step_vehicle(
    state: BodyState, command: Command, limits: BodyLimits, dt_s: float, lag_scale: float = 1.0
) -> BodyState:
    """Return the vehicle's state one step later.

    x' = v cos yaw, y' = v sin yaw, yaw' = v curvature.

    Args:
        state: at the step's begin.
        command: held over the step.
        limits: of the vehicle.
        dt_s: of the step, > 0.
        lag_scale: factor on both lags (1 is a healthy actuator).

    Raises:
        ValueError: a command that isn't finite, or a step that isn't positive.
    """
    _check(command, dt_s, lag_scale)
    distance, speed, acceleration = _advance(state, command, limits, dt_s, lag_scale)
    bound = limits.curvature_1pm
    # The square of a tiny speed is zero.
    square = state.speed_mps * state.speed_mps
    if square > 0.0:
        bound = min(bound, limits.lateral_acceleration_mps2 / square)
    curvature = _follow(
        state.curvature_1pm,
        min(max(command.curvature_1pm, -bound), bound),
        limits.curvature_lag_s * lag_scale,
        limits.curvature_rate_1pmps,
        dt_s,
    )
    turn = distance * 0.5 * (state.curvature_1pm + curvature)
    # The chord of the arc: exact for a constant curvature, and well-behaved for none.
    chord = distance * (math.sin(turn / 2.0) / (turn / 2.0) if abs(turn) > 1e-9 else 1.0)
    middle = state.yaw_rad + turn / 2.0
    return BodyState(
        x_m=state.x_m + chord * math.cos(middle),
        y_m=state.y_m + chord * math.sin(middle),
        yaw_rad=wrap_angle(state.yaw_rad + turn),
        speed_mps=speed,
        acceleration_mps2=acceleration,
        curvature_1pm=curvature,
        yaw_rate_radps=speed * curvature,
    )


def step_walker(
    state: BodyState, command: Command, limits: BodyLimits, dt_s: float, lag_scale: float = 1.0
) -> BodyState:
    """Return the walker's state one step later.

    It turns towards the commanded heading and walks along it.

    Arguments and errors as for ``step_vehicle``; the command's curvature is ignored.
    """
    _check(command, dt_s, lag_scale)
    distance, speed, acceleration = _advance(state, command, limits, dt_s, lag_scale)
    reach = limits.turn_rate_radps * dt_s
    turn = 0.0
    if not command.emergency_stop:
        turn = min(max(wrap_angle(command.heading_rad - state.yaw_rad), -reach), reach)
    middle = state.yaw_rad + turn / 2.0
    return BodyState(
        x_m=state.x_m + distance * math.cos(middle),
        y_m=state.y_m + distance * math.sin(middle),
        yaw_rad=wrap_angle(state.yaw_rad + turn),
        speed_mps=speed,
        acceleration_mps2=acceleration,
        curvature_1pm=0.0,
        yaw_rate_radps=turn / dt_s,
    )


def step_body(
    object_class: ObjectClass,
    state: BodyState,
    command: Command,
    dt_s: float,
    *,
    limits: BodyLimits | None = None,
    lag_scale: float = 1.0,
) -> BodyState:
    """Return the state one step later of a body of a class, with its plant and limits.

    See ``step_vehicle``.

    Raises:
        KeyError: a class without a body (UNKNOWN).
        ValueError: as ``step_vehicle``.
    """
    body_limits = LIMITS[object_class] if limits is None else limits
    if object_class is ObjectClass.PEDESTRIAN:
        return step_walker(state, command, body_limits, dt_s, lag_scale)
    return step_vehicle(state, command, body_limits, dt_s, lag_scale)
