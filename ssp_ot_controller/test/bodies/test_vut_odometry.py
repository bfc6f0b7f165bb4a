"""The VUT's state of GNSS/INS fixes: lever arm, orientation, acceleration, what is refused."""

import math
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.clock import seconds_to_ns
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass, Role
from ssp_ot_controller.bodies.odometry import Fix, LeverArm, Unusable, VutStates

VUT = ParticipantSpec(
    id="vut", object_class="car", start=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0), approach=None
)


def quaternion(yaw_rad, roll_rad=0.0):
    cy, sy = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    cr, sr = math.cos(roll_rad / 2), math.sin(roll_rad / 2)
    return (cy * sr, sy * sr, sy * cr, cy * cr)


def fix(t_s=1.0, **changes):
    return replace(
        Fix(
            stamp_ns=seconds_to_ns(t_s),
            frame_id="map",
            x_m=10.0,
            y_m=20.0,
            quaternion=quaternion(0.3),
            forward_mps=8.0,
            left_mps=0.0,
            yaw_rate_radps=0.0,
            variance_x_m2=4e-4,
            variance_y_m2=1e-4,
        ),
        **changes,
    )


def states(lever=None):
    return VutStates(VUT, lever or LeverArm(), "map")


def test_a_unit_at_the_reference_point_is_taken_as_it_is():
    state = states().take(fix())
    assert (state.object_id, state.object_class, state.role) == ("vut", ObjectClass.CAR, Role.VUT)
    assert (state.x_m, state.y_m, state.speed_mps) == (10.0, 20.0, 8.0)
    assert state.yaw_rad == pytest.approx(0.3)
    assert state.position_std_m == pytest.approx(0.02)
    assert (state.stamp_ns, state.sequence) == (seconds_to_ns(1.0), 1)


@given(
    yaw=st.floats(-3.1, 3.1),
    turn=st.floats(-0.5, 0.5),
    forward=st.floats(-2.0, 4.0),
    left=st.floats(-1.0, 1.0),
    speed=st.floats(-5.0, 30.0),
    yaw_rate=st.floats(-0.8, 0.8),
)
def test_the_lever_arm_is_taken_out_of_place_and_velocity(
    yaw, turn, forward, left, speed, yaw_rate
):
    """A rigid vehicle's unit, computed forwards, gives the reference point back."""
    c, s = math.cos(yaw), math.sin(yaw)
    # Velocity of the unit in the vehicle's frame: v + w x r.
    along, across = speed - yaw_rate * left, yaw_rate * forward
    seen = fix(
        x_m=3.0 + c * forward - s * left,
        y_m=4.0 + s * forward + c * left,
        quaternion=quaternion(yaw + turn),
        forward_mps=math.cos(turn) * along + math.sin(turn) * across,
        left_mps=-math.sin(turn) * along + math.cos(turn) * across,
        yaw_rate_radps=yaw_rate,
    )
    state = states(LeverArm(forward, left, turn)).take(seen)
    assert state.x_m == pytest.approx(3.0, abs=1e-9)
    assert state.y_m == pytest.approx(4.0, abs=1e-9)
    assert state.speed_mps == pytest.approx(speed, abs=1e-9)
    assert math.cos(state.yaw_rad - yaw) == pytest.approx(1.0, abs=1e-12)


def test_steady_braking_shows_as_its_deceleration():
    adapter, state = states(), None
    for k in range(100):
        state = adapter.take(fix(t_s=0.01 * k, forward_mps=10.0 - 3.0 * 0.01 * k))
    assert state.acceleration_mps2 == pytest.approx(-3.0, abs=0.01)


def test_a_pause_forgets_the_acceleration():
    adapter = states()
    adapter.take(fix(t_s=0.0, forward_mps=10.0))
    adapter.take(fix(t_s=0.1, forward_mps=9.0))
    assert adapter.take(fix(t_s=0.7, forward_mps=0.0)).acceleration_mps2 == 0.0


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"frame_id": "odom"}, "frame is 'odom'"),
        ({"x_m": math.nan}, "isn't finite"),
        ({"yaw_rate_radps": math.inf}, "isn't finite"),
        ({"quaternion": (0.0, 0.0, 0.0, 0.0)}, "norm is 0.000"),
        ({"quaternion": quaternion(0.0, roll_rad=1.0)}, "tilts by 57 degrees"),
    ],
)
def test_what_makes_a_fix_unusable(changes, words):
    with pytest.raises(Unusable, match=words):
        states().take(fix(**changes))


def test_stamps_must_rise_and_a_dropped_fix_has_no_number():
    adapter = states()
    adapter.take(fix(t_s=1.0))
    for t_s in (1.0, 0.9):
        with pytest.raises(Unusable, match="stamp"):
            adapter.take(fix(t_s=t_s))
    assert adapter.take(fix(t_s=1.1)).sequence == 2


@pytest.mark.parametrize("variance", [0.0, -1.0, math.nan, math.inf])
def test_a_unit_that_doesnt_say_how_good_it_is_has_no_limit(variance):
    """Infinite uncertainty passes every limit, so that such a unit can't be armed with."""
    assert states().take(fix(variance_x_m2=variance)).position_std_m == math.inf


def test_a_fix_from_the_future_is_refused_and_the_next_right_one_is_taken():
    one = states()
    with pytest.raises(Unusable, match=r"3600\.000 s ahead"):
        one.take(fix(3601.0), now_ns=seconds_to_ns(1.0))
    assert one.take(fix(1.0), now_ns=seconds_to_ns(1.0)).sequence == 1
