"""Frames for tf2: places, directions, and the messages, against independent decoders."""

from __future__ import annotations

import json
import math
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ssp_core.bag.types import definition, typestore
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import Camera
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.camera import Mounting, optical_axes
from ssp_core.world.transforms import (
    TF_TYPE,
    Transform,
    TransformFilter,
    decode_transforms,
    encode_transform,
    encode_transforms,
    mount,
    of_camera,
    of_state,
)

LEVEL = Camera(
    width_px=640, height_px=480, hfov_deg=90.0, forward_m=2.0, height_m=1.5, pitch_down_rad=0.0
)


@given(
    pitch=st.floats(-1.5, 1.5),
    yaw=st.floats(-3.0, 3.0),
    roll=st.floats(-3.0, 3.0),
    left=st.floats(-1.0, 1.0),
)
@settings(max_examples=50)
def test_the_transform_gives_the_mounting_back(
    pitch: float, yaw: float, roll: float, left: float
) -> None:
    camera = LEVEL.model_copy(
        update={
            "pitch_down_rad": pitch,
            "yaw_left_rad": yaw,
            "roll_right_rad": roll,
            "left_m": left,
        }
    )
    sent = mount(camera)
    x, y, z, w = sent.quaternion_xyzw
    column = [2 * (x * z + y * w), 2 * (y * z - x * w), 1 - 2 * (x * x + y * y)]
    assert column == pytest.approx(optical_axes(pitch, yaw, roll)[2], abs=1e-12)
    found = Mounting.of_transform(sent.translation_m, sent.quaternion_xyzw)
    assert (found.forward_m, found.left_m, found.height_m) == (2.0, left, 1.5)
    angles = (found.pitch_down_rad, found.yaw_left_rad, found.roll_right_rad)
    assert angles == pytest.approx((pitch, yaw, roll), abs=1e-9)


STATE = ObjectState(
    "ot1",
    ObjectClass.CAR,
    Role.OT,
    1_500_000_000,
    3.0,
    -2.0,
    0.5,
    0.0,
    0.0,
    0.0,
    DEFAULT_SIZES[ObjectClass.CAR],
)


@given(yaw=st.floats(-7.0, 7.0), ahead=st.floats(-50.0, 50.0), left=st.floats(-50.0, 50.0))
def test_a_body_stands_where_its_state_says(yaw: float, ahead: float, left: float) -> None:
    """A point seen from base_link lies on the map where yaw and position put it."""
    found = of_state(replace(STATE, yaw_rad=yaw))
    assert (found.parent, found.child, found.stamp_ns) == ("map", "ot1/base_link", 1_500_000_000)
    point = Rotation.from_quat(found.quaternion_xyzw).apply((ahead, left, 1.0))
    on_map = point + np.array(found.translation_m)
    x = 3.0 + ahead * math.cos(yaw) - left * math.sin(yaw)
    y = -2.0 + ahead * math.sin(yaw) + left * math.cos(yaw)
    assert on_map == pytest.approx((x, y, 1.0), abs=1e-9)


@given(pitch=st.floats(-1.5, 1.5), yaw=st.floats(-3.0, 3.0), roll=st.floats(-3.0, 3.0))
def test_the_two_camera_frames_make_the_mount(pitch: float, yaw: float, roll: float) -> None:
    mounting = Mounting(2.0, 1.5, pitch, 0.1, yaw, roll)
    body, optical = of_camera(mounting)
    assert (body.parent, body.child) == ("vut/base_link", "vut/front_camera")
    assert (optical.parent, optical.child) == ("vut/front_camera", "vut/front_camera_optical")
    both = Rotation.from_quat(body.quaternion_xyzw) * Rotation.from_quat(optical.quaternion_xyzw)
    whole = mount(mounting)
    assert both.as_matrix() == pytest.approx(optical_axes(pitch, yaw, roll).T, abs=1e-12)
    assert Rotation.from_quat(whole.quaternion_xyzw).approx_equal(both, atol=1e-9)
    assert body.translation_m == whole.translation_m == (2.0, 0.1, 1.5)
    # REP 103: in the camera's body frame x is the direction of view.
    ahead = Rotation.from_quat(body.quaternion_xyzw).apply((1.0, 0.0, 0.0))
    assert ahead == pytest.approx(optical_axes(pitch, yaw, roll)[2], abs=1e-12)


def test_only_what_is_later_and_can_be_carried_is_told() -> None:
    poses = TransformFilter()
    assert [one.child for one in poses.news([STATE, replace(STATE, object_id="vut")])] == [
        "ot1/base_link",
        "vut/base_link",
    ]
    later = replace(STATE, stamp_ns=STATE.stamp_ns + 1)
    for refused in (
        STATE,
        replace(STATE, stamp_ns=-1),
        replace(later, x_m=math.nan),
        replace(later, yaw_rad=math.inf),
        replace(later, stamp_ns=2**31 * 1_000_000_000),
    ):
        assert poses.news([refused]) == []
    assert poses.news([later]) == [of_state(later)]


TEXTS = st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=9)
NUMBERS = st.floats(allow_nan=False)
TRANSFORMS = st.builds(
    Transform,
    TEXTS,
    TEXTS,
    st.integers(0, 2**31 * 10**9 - 1),
    st.tuples(*[NUMBERS] * 3),
    st.tuples(*[NUMBERS] * 4),
)


@given(st.lists(TRANSFORMS, max_size=5))
def test_others_read_the_messages(transforms: list[Transform]) -> None:
    """The rosbags library decodes the messages, whatever the names do to the alignment."""
    found = typestore().deserialize_cdr(encode_transforms(transforms), TF_TYPE).transforms
    single = [
        typestore().deserialize_cdr(encode_transform(one), "geometry_msgs/msg/TransformStamped")
        for one in transforms
    ]
    for some in (found, single):
        assert len(some) == len(transforms)
        for message, one in zip(some, transforms, strict=True):
            stamp, moved = message.header.stamp, message.transform
            assert (message.header.frame_id, message.child_frame_id) == (one.parent, one.child)
            assert stamp.sec * 10**9 + stamp.nanosec == one.stamp_ns
            v, q = moved.translation, moved.rotation
            assert (v.x, v.y, v.z) == one.translation_m
            assert (q.x, q.y, q.z, q.w) == one.quaternion_xyzw


# Later stamps, near the end of 32 bits of seconds, are no time of a session.
@given(st.lists(TRANSFORMS.map(lambda one: replace(one, stamp_ns=one.stamp_ns // 2)), max_size=5))
def test_what_is_written_is_read_again(transforms: list[Transform]) -> None:
    assert decode_transforms(encode_transforms(transforms)) == tuple(transforms)


def test_the_installed_type_is_ros_own() -> None:
    """tf2_msgs of the pip environment is built here; rosbags knows the type of Jazzy."""
    from tf2_msgs.msg import TFMessage

    prefixes = os.environ["AMENT_PREFIX_PATH"].split(os.pathsep)
    told = next(
        path
        for p in prefixes
        if (path := Path(p, "share", "tf2_msgs", "msg", "TFMessage.json")).is_file()
    )
    hashes = {t["type_name"]: t["hash_string"] for t in json.loads(told.read_text())["type_hashes"]}
    assert hashes[TF_TYPE] == definition(TF_TYPE).type_hash
    assert TFMessage.get_fields_and_field_types() == {
        "transforms": "sequence<geometry_msgs/TransformStamped>"
    }
