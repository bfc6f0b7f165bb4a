"""The one conversion between our poses and SUMO's."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Pose2, wrap_angle
from ssp_ot_controller.sil.sumo_world import from_sumo, to_sumo


@pytest.mark.parametrize(
    ("yaw_rad", "angle_deg", "front"),
    [
        (0.0, 90.0, (14.0, 20.0)),
        (math.pi / 2, 0.0, (10.0, 24.0)),
        (math.pi, 270.0, (6.0, 20.0)),
        (-math.pi / 2, 180.0, (10.0, 16.0)),
    ],
)
def test_compass_and_front_bumper(
    yaw_rad: float, angle_deg: float, front: tuple[float, float]
) -> None:
    got = to_sumo(Pose2(10.0, 20.0, yaw_rad), 4.0)
    assert (got.x_m, got.y_m) == pytest.approx(front)
    assert got.angle_deg == pytest.approx(angle_deg)


@given(
    st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-math.pi, math.pi), st.floats(0.0, 10.0)
)
@settings(max_examples=100, deadline=None)
def test_round_trip(x_m: float, y_m: float, yaw_rad: float, front_m: float) -> None:
    at = to_sumo(Pose2(x_m, y_m, yaw_rad), front_m)
    assert 0.0 <= at.angle_deg <= 360.0
    back = from_sumo(at, front_m)
    assert (back.x_m, back.y_m) == pytest.approx((x_m, y_m), abs=1e-9)
    assert abs(wrap_angle(back.yaw_rad - yaw_rad)) < 1e-12
