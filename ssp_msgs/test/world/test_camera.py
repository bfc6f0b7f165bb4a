"""Projection against values computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ssp_core.geometry import Pose2
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Camera
from ssp_core.world.camera import (
    intrinsics,
    object_corners,
    project,
    shown_box,
    view_from,
)
from tests.support.states import object_state

# 90 degrees over 640 px: focal length 320 px, principal point (319.5, 239.5).
LEVEL = Camera(
    width_px=640, height_px=480, hfov_deg=90.0, forward_m=2.0, height_m=1.5, pitch_down_rad=0.0
)


def car(x_m: float, y_m: float) -> ObjectState:
    return object_state(x_m=x_m, y_m=y_m)


def test_points_straight_ahead_beside_and_on_the_ground() -> None:
    view = view_from(Pose2(10.0, 5.0, 0.0), LEVEL)
    seen = project(view, [(22.0, 5.0, 1.5), (22.0, 3.0, 1.5), (32.0, 5.0, 0.0)])
    assert seen.u_px == pytest.approx([319.5, 319.5 + 320 * 2 / 10, 319.5])
    assert seen.v_px == pytest.approx([239.5, 239.5, 239.5 + 320 * 1.5 / 20])
    assert seen.depth_m == pytest.approx([10.0, 10.0, 20.0])


def test_heading_turns_the_view() -> None:
    view = view_from(Pose2(1.0, -3.0, math.pi / 2), LEVEL)  # looks north
    seen = project(view, [(1.0, 9.0, 1.5), (2.0, 9.0, 1.5)])
    assert seen.u_px == pytest.approx([319.5, 319.5 + 32.0])


def test_pitch_down_moves_the_horizon_up() -> None:
    camera = LEVEL.model_copy(update={"pitch_down_rad": 0.1})
    far = project(view_from(Pose2(0.0, 0.0, 0.0), camera), [(1e7, 0.0, 1.5)])
    assert far.v_px[0] == pytest.approx(239.5 - 320 * math.tan(0.1), abs=1e-3)


def test_yaw_left_moves_what_is_ahead_to_the_right() -> None:
    camera = LEVEL.model_copy(update={"yaw_left_rad": 0.1})
    seen = project(view_from(Pose2(0.0, 0.0, 0.0), camera), [(12.0, 0.0, 1.5)])
    assert seen.u_px[0] == pytest.approx(319.5 + 320 * math.tan(0.1))
    assert seen.v_px[0] == pytest.approx(239.5)


def test_roll_right_lifts_what_is_on_the_right() -> None:
    camera = LEVEL.model_copy(update={"roll_right_rad": 0.1, "pitch_down_rad": 0.02})
    straight = LEVEL.model_copy(update={"pitch_down_rad": 0.02})
    point = [(12.0, -2.0, 1.5)]
    seen = project(view_from(Pose2(0.0, 0.0, 0.0), camera), point)
    level = project(view_from(Pose2(0.0, 0.0, 0.0), straight), point)
    x, y = level.u_px[0] - 319.5, level.v_px[0] - 239.5
    assert seen.u_px[0] - 319.5 == pytest.approx(math.cos(0.1) * x + math.sin(0.1) * y)
    assert seen.v_px[0] - 239.5 == pytest.approx(math.cos(0.1) * y - math.sin(0.1) * x)
    assert seen.v_px[0] < level.v_px[0]


def test_a_camera_beside_the_middle_sees_from_there() -> None:
    camera = LEVEL.model_copy(update={"left_m": 0.5})
    seen = project(view_from(Pose2(0.0, 0.0, math.pi / 2), camera), [(-0.5, 12.0, 1.5)])
    assert (seen.u_px[0], seen.depth_m[0]) == pytest.approx((319.5, 10.0))


def test_what_lies_behind_is_marked() -> None:
    seen = project(view_from(Pose2(0.0, 0.0, 0.0), LEVEL), [(1.0, 0.0, 1.5), (2.05, 0.0, 1.5)])
    assert not seen.in_front.any()
    assert np.isnan(seen.u_px).all()
    assert np.isnan(seen.v_px).all()


def test_box_of_a_car() -> None:
    view = view_from(Pose2(0.0, 0.0, 0.0), LEVEL)
    box = shown_box(view, car(12.9, 0.0))  # rear end 10 m ahead of the camera
    assert box == pytest.approx(
        (319.5 - 28.8, 239.5, 319.5 + 28.8, 239.5 + 48.0)  # as high as the camera
    )


def test_shown_box_is_cut_at_the_image_and_before_the_camera() -> None:
    view = view_from(Pose2(0.0, 0.0, 0.0), LEVEL)
    beside = car(2.5, 4.0)  # from 0.4 m behind the camera to 4.1 m ahead, 3.1 m to its left
    box = shown_box(view, beside)
    assert box is not None
    # Its right front corner is nearest to the middle: 3.1 m aside at 4.1 m.
    assert box[2] == pytest.approx(319.5 - 320 * 3.1 / 4.1)
    assert (box[0], box[3]) == (-0.5, 479.5)
    assert shown_box(view, car(-20.0, 0.0)) is None
    assert shown_box(view, car(3.0, 30.0)) is None


def test_object_corners_reach_from_the_ground_to_the_top() -> None:
    corners = object_corners(car(0.0, 0.0))
    assert sorted({*corners[:, 2]}) == [0.0, 1.5]
    assert (corners[:, 0].min(), corners[:, 0].max()) == (-0.9, 3.6)


def test_camera_info_numbers() -> None:
    lens = intrinsics(LEVEL)
    assert lens.k() == pytest.approx([320, 0, 319.5, 0, 320, 239.5, 0, 0, 1])
    assert lens.p() == pytest.approx([320, 0, 319.5, 0, 0, 320, 239.5, 0, 0, 0, 1, 0])
