"""Projection and mount against values computed by hand."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Pose2
from ssp_core.run_spec import Camera
from ssp_core.state import DEFAULT_SIZES, ObjectState
from ssp_core.vocab import ObjectClass, Role
from ssp_ot_controller.camera.model import (
    image_box,
    intrinsics,
    mount,
    object_corners,
    optical_axes,
    project,
    view_from,
)

# 90 degrees over 640 px: focal length 320 px, principal point (319.5, 239.5).
LEVEL = Camera(
    width_px=640, height_px=480, hfov_deg=90.0, forward_m=2.0, height_m=1.5, pitch_down_rad=0.0
)


def car(x_m: float, y_m: float) -> ObjectState:
    size = DEFAULT_SIZES[ObjectClass.CAR]
    return ObjectState("a", ObjectClass.CAR, Role.OT, 0, x_m, y_m, 0.0, 0.0, 0.0, 0.0, size)


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


def test_what_lies_behind_is_marked() -> None:
    seen = project(view_from(Pose2(0.0, 0.0, 0.0), LEVEL), [(1.0, 0.0, 1.5), (2.05, 0.0, 1.5)])
    assert not seen.in_front.any()
    assert np.isnan(seen.u_px).all()
    assert np.isnan(seen.v_px).all()


def test_box_of_a_car() -> None:
    view = view_from(Pose2(0.0, 0.0, 0.0), LEVEL)
    box = image_box(view, car(12.9, 0.0))  # rear end 10 m ahead of the camera
    assert box == pytest.approx(
        (319.5 - 28.8, 239.5, 319.5 + 28.8, 239.5 + 48.0)  # as high as the camera
    )
    assert image_box(view, car(0.0, 0.0)) is None


def test_object_corners_reach_from_the_ground_to_the_top() -> None:
    corners = object_corners(car(0.0, 0.0))
    assert sorted({*corners[:, 2]}) == [0.0, 1.5]
    assert (corners[:, 0].min(), corners[:, 0].max()) == (-0.9, 3.6)


def test_camera_info_numbers() -> None:
    lens = intrinsics(LEVEL)
    assert lens.k() == pytest.approx([320, 0, 319.5, 0, 320, 239.5, 0, 0, 1])
    assert lens.p() == pytest.approx([320, 0, 319.5, 0, 0, 320, 239.5, 0, 0, 0, 1, 0])


@given(pitch=st.floats(-1.5, 1.5))
@settings(max_examples=50)
def test_mount_is_the_rotation_of_the_optical_axes(pitch: float) -> None:
    mounting = mount(LEVEL.model_copy(update={"pitch_down_rad": pitch}))
    x, y, z, w = mounting.quaternion_xyzw
    assert x * x + y * y + z * z + w * w == pytest.approx(1.0)
    turned = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    assert turned == pytest.approx(optical_axes(pitch).T, abs=1e-12)
    assert mounting.translation_m == (2.0, 0.0, 1.5)
    # The optical z axis looks forward and, pitched, down.
    assert turned[:, 2] == pytest.approx([math.cos(pitch), 0.0, -math.sin(pitch)], abs=1e-12)
