"""The mount topic's transform against the optical axes of the projection."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.camera import Mounting, optical_axes
from ssp_core.run_spec import Camera
from ssp_ot_controller.camera.mounting import mount

LEVEL = Camera(
    width_px=640, height_px=480, hfov_deg=90.0, forward_m=2.0, height_m=1.5, pitch_down_rad=0.0
)


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


@given(
    pitch=st.floats(-1.5, 1.5), yaw=st.floats(-3.0, 3.0), roll=st.floats(-3.0, 3.0),
    left=st.floats(-1.0, 1.0),
)  # fmt: skip
@settings(max_examples=50)
def test_the_transform_gives_the_mounting_back(
    pitch: float, yaw: float, roll: float, left: float
) -> None:
    camera = LEVEL.model_copy(
        update={
            "pitch_down_rad": pitch, "yaw_left_rad": yaw, "roll_right_rad": roll, "left_m": left
        }
    )  # fmt: skip
    sent = mount(camera)
    x, y, z, w = sent.quaternion_xyzw
    column = [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)]
    assert column == pytest.approx(optical_axes(pitch, yaw, roll)[2], abs=1e-12)
    found = Mounting.of_transform(sent.translation_m, sent.quaternion_xyzw)
    assert (found.forward_m, found.left_m, found.height_m) == (2.0, left, 1.5)
    angles = (found.pitch_down_rad, found.yaw_left_rad, found.roll_right_rad)
    assert angles == pytest.approx((pitch, yaw, roll), abs=1e-9)
