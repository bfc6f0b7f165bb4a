"""Plants: limits, lag, no driving backwards."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.run_file.model import Limits
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import (
    LIMITS,
    BodyState,
    Command,
    brake_command,
    step_body,
    tightened,
)

DT = 0.02
CAR = ObjectClass.CAR
CLASSES = [c for c in ObjectClass if c is not ObjectClass.UNKNOWN]


def stepped(
    cls: ObjectClass, state: BodyState, command: Command, seconds: float, lag_scale: float = 1.0
) -> BodyState:
    for _ in range(round(seconds / DT)):
        state = step_body(cls, state, command, DT, lag_scale=lag_scale)
    return state


@given(
    st.sampled_from(CLASSES),
    st.lists(
        st.builds(
            Command,
            st.floats(-30.0, 30.0),
            st.floats(-2.0, 2.0),
            st.floats(-7.0, 7.0),
            st.booleans(),
        ),
        min_size=1,
        max_size=60,
    ),
)
@settings(max_examples=60, deadline=None)
def test_no_command_takes_a_body_over_its_limits_or_backwards(
    cls: ObjectClass, commands: list[Command]
) -> None:
    limits = LIMITS[cls]
    state = BodyState(0.0, 0.0, 0.0, speed_mps=0.5 * limits.speed_mps)
    for command in commands:
        new = step_body(cls, state, command, 0.1)
        assert 0.0 <= new.speed_mps <= limits.speed_mps + 1e-9
        assert new.acceleration_mps2 <= limits.acceleration_mps2 + 1e-9
        assert new.acceleration_mps2 >= -limits.emergency_deceleration_mps2 - 1e-9
        assert abs(new.curvature_1pm) <= limits.curvature_1pm + 1e-12
        heading = wrap_angle(0.5 * (state.yaw_rad + new.yaw_rad))
        if abs(wrap_angle(new.yaw_rad - state.yaw_rad)) < 1.0:
            middle = state.yaw_rad + 0.5 * wrap_angle(new.yaw_rad - state.yaw_rad)
            moved = math.cos(middle) * (new.x_m - state.x_m)
            moved += math.sin(middle) * (new.y_m - state.y_m)
            assert moved >= -1e-9, heading
        state = new


@pytest.mark.parametrize("cls", CLASSES, ids=lambda c: c.name)
def test_braking_ends_in_a_standstill_that_holds(cls: ObjectClass) -> None:
    start = BodyState(0.0, 0.0, 0.3, speed_mps=0.5 * LIMITS[cls].speed_mps)
    stopped = stepped(cls, start, brake_command(start, 3.0), 15.0)
    assert (stopped.speed_mps, stopped.acceleration_mps2) == (0.0, 0.0)
    later = stepped(cls, stopped, brake_command(stopped, 3.0), 1.0)
    assert (later.x_m, later.y_m, later.yaw_rad) == (stopped.x_m, stopped.y_m, stopped.yaw_rad)


@pytest.mark.parametrize("cls", CLASSES, ids=lambda c: c.name)
def test_the_last_braking_step_ends_where_the_speed_does(cls: ObjectClass) -> None:
    moving = BodyState(0.0, 0.0, 0.0, speed_mps=0.02, acceleration_mps2=-2.0)
    stopped = step_body(cls, moving, Command(-2.0, 0.0, 0.0), DT)
    assert (stopped.speed_mps, stopped.acceleration_mps2) == (0.0, 0.0)
    assert stopped.x_m == pytest.approx(0.02**2 / (2.0 * 2.0))


def test_stopping_distance_is_that_of_the_deceleration_plus_the_lag() -> None:
    start = BodyState(0.0, 0.0, 0.0, speed_mps=14.0)
    stopped = stepped(CAR, start, Command(-4.0, 0.0, 0.0), 6.0)
    ideal = 14.0**2 / (2.0 * 4.0)
    # A first-order lag costs about its time constant times the speed.
    assert ideal + 14.0 * 0.15 < stopped.x_m < ideal + 14.0 * 0.30


def test_an_emergency_stop_ignores_the_acceleration_and_is_harder() -> None:
    start = BodyState(0.0, 0.0, 0.0, speed_mps=14.0)
    emergency = stepped(CAR, start, Command(3.0, 0.0, 0.0, emergency_stop=True), 4.0)
    service = stepped(CAR, start, Command(-99.0, 0.0, 0.0), 4.0)
    assert emergency.speed_mps == service.speed_mps == 0.0
    assert emergency.x_m < service.x_m - 0.5


@pytest.mark.parametrize("scale", [1.0, 3.0])
def test_acceleration_follows_with_its_lag(scale: float) -> None:
    lag = LIMITS[CAR].acceleration_lag_s * scale
    after = stepped(CAR, BodyState(0.0, 0.0, 0.0, 5.0), Command(2.0, 0.0, 0.0), lag, scale)
    assert after.acceleration_mps2 == pytest.approx(2.0 * (1.0 - math.exp(-1.0)), abs=0.02)


def test_a_held_curvature_is_a_circle() -> None:
    radius = 25.0
    state = BodyState(0.0, 0.0, 0.0, 5.0, 0.0, 1.0 / radius, 5.0 / radius)
    command = Command(0.0, 1.0 / radius, 0.0)
    for _ in range(300):
        state = step_body(CAR, state, command, DT)
        assert math.hypot(state.x_m, state.y_m - radius) == pytest.approx(radius, abs=1e-9)
    assert state.yaw_rad == pytest.approx(300 * DT * 5.0 / radius)
    assert state.yaw_rate_radps == pytest.approx(5.0 / radius)


def test_grip_bounds_curvature_by_speed() -> None:
    fast = BodyState(0.0, 0.0, 0.0, speed_mps=20.0)
    turned = stepped(CAR, fast, Command(0.0, 0.2, 0.0), 3.0)
    assert turned.curvature_1pm * turned.speed_mps**2 <= LIMITS[CAR].lateral_acceleration_mps2


def test_a_walker_turns_on_the_spot_and_walks_where_it_looks() -> None:
    state = BodyState.at_rest(Pose2(1.0, 2.0, 0.0))
    turned = stepped(ObjectClass.PEDESTRIAN, state, Command(0.0, 0.0, math.pi / 2), 1.0)
    assert (turned.x_m, turned.y_m) == (1.0, 2.0)
    assert turned.yaw_rad == pytest.approx(math.pi / 2)
    walked = stepped(ObjectClass.PEDESTRIAN, turned, Command(1.0, 0.0, math.pi / 2), 1.0)
    assert walked.x_m == pytest.approx(1.0)
    assert walked.y_m > 2.3


def test_a_walker_turns_the_short_way_at_its_rate() -> None:
    state = BodyState.at_rest(Pose2(0.0, 0.0, 3.0))
    new = step_body(ObjectClass.PEDESTRIAN, state, Command(0.0, 0.0, -3.0), DT)
    assert new.yaw_rate_radps == pytest.approx(LIMITS[ObjectClass.PEDESTRIAN].turn_rate_radps)


@pytest.mark.parametrize(
    "command", [Command(math.nan, 0.0, 0.0), Command(0.0, math.inf, 0.0), Command(0, 0, math.nan)]
)
@pytest.mark.parametrize("cls", [CAR, ObjectClass.PEDESTRIAN])
def test_a_command_that_is_not_finite_is_refused(cls: ObjectClass, command: Command) -> None:
    with pytest.raises(ValueError, match="finite"):
        step_body(cls, BodyState(0.0, 0.0, 0.0), command, DT)


def test_steps_and_classes_that_make_no_sense_are_refused() -> None:
    state, command = BodyState(0.0, 0.0, 0.0), Command(0.0, 0.0, 0.0)
    with pytest.raises(ValueError, match="positive"):
        step_body(CAR, state, command, 0.0)
    with pytest.raises(KeyError):
        step_body(ObjectClass.UNKNOWN, state, command, DT)


def test_brake_command_keeps_the_turn() -> None:
    turning = BodyState(0.0, 0.0, 0.4, speed_mps=10.0, yaw_rate_radps=0.2)
    assert brake_command(turning, 3.0) == Command(-3.0, 0.02, 0.4, False)
    assert brake_command(BodyState(0.0, 0.0, 0.4), 3.0).curvature_1pm == 0.0


def test_tightened_takes_the_smaller_limit() -> None:
    body = tightened(LIMITS[CAR], Limits(speed_mps=15.0, acceleration_mps2=3.0))
    assert (body.speed_mps, body.acceleration_mps2, body.deceleration_mps2) == (15.0, 3.0, 3.0)
    assert body.emergency_deceleration_mps2 == LIMITS[CAR].emergency_deceleration_mps2
    wide = tightened(LIMITS[CAR], Limits(speed_mps=99.0, acceleration_mps2=99.0))
    assert wide == LIMITS[CAR]


tiny = st.sampled_from([0.0, 5e-324, 2.3e-308, 1e-170, 1e-160, 1.5e-154])
speeds = tiny | st.floats(0.0, 60.0)


@pytest.mark.parametrize("cls", CLASSES)
@given(
    speeds,
    st.floats(-10.0, 10.0),
    st.lists(
        st.builds(
            Command,
            tiny | st.floats(allow_nan=False, allow_infinity=False),
            tiny | st.floats(allow_nan=False, allow_infinity=False),
            st.floats(allow_nan=False, allow_infinity=False),
            st.booleans(),
        ),
        min_size=1,
        max_size=4,
    ),
    st.floats(1e-3, 0.1),
)
@settings(max_examples=100, deadline=None)
def test_every_finite_command_moves_a_body_to_a_finite_state(
    cls: ObjectClass,
    speed_mps: float,
    acceleration_mps2: float,
    commands: list[Command],
    dt_s: float,
) -> None:
    state = BodyState(1.0, 2.0, 3.0, speed_mps, acceleration_mps2)
    for command in commands:
        state = step_body(cls, state, command, dt_s)
        values = (state.x_m, state.y_m, state.yaw_rad, state.speed_mps, state.acceleration_mps2)
        assert all(map(math.isfinite, (*values, state.curvature_1pm, state.yaw_rate_radps)))
        assert state.speed_mps >= 0.0


def test_a_tiny_command_moves_a_body_a_tiny_way() -> None:
    state = BodyState.at_rest(Pose2(0.0, 0.0, 0.0))
    state = stepped(CAR, state, Command(1e-170, 0.1, 0.0), 1.0)
    assert 0.0 < state.speed_mps < 1e-169
