"""The transforms of a recording for tf2, compared with its states."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ssp_core.run_file.model import RunSpec
from tests.support.bags.messages import messages

TF = "/tf"


def matrix(transform: Any) -> np.ndarray:
    """Return tf2's matrix of a transform: from the child's coordinates to the parent's."""
    v, q = transform.translation, transform.rotation
    whole = np.eye(4)
    whole[:3, :3] = Rotation.from_quat((q.x, q.y, q.z, q.w)).as_matrix()
    whole[:3, 3] = (v.x, v.y, v.z)
    return whole


def check_frames(bag: Path, spec: RunSpec) -> None:
    """Poses in /tf are those of the states, and the camera looks at the map from where it sits."""
    (fixed,) = messages(bag, "/tf_static")
    pictures, moving = messages(bag, "/ssp/vut/front_camera/image/compressed"), messages(bag, TF)
    poses = {
        (one.child_frame_id, one.header.stamp.sec, one.header.stamp.nanosec): one
        for message in moving
        for one in message.transforms
    }
    assert len(poses) == sum(len(message.transforms) for message in moving), "told once"
    states = {
        object_id: {(s.header.stamp.sec, s.header.stamp.nanosec): s for s in found}
        for object_id in ("vut", "ot1")
        for found in [messages(bag, f"/ssp/{object_id}/state")]
    }
    # One message for each step of the world, in which everybody is whose state wasn't lost.
    steps = [message.transforms[0].header.stamp for message in moving]
    assert len({(stamp.sec, stamp.nanosec) for stamp in steps}) == len(steps)
    assert len(poses) > 1.9 * len(steps)
    camera = np.eye(4)
    for one in fixed.transforms:
        camera = camera @ matrix(one.transform)
    assert fixed.transforms[0].header.frame_id == "vut/base_link"
    assert fixed.transforms[-1].child_frame_id == pictures[-1].header.frame_id
    assert spec.camera is not None
    for (child, *at), one in poses.items():
        object_id = child.removesuffix("/base_link")
        state, pose = states[object_id][(at[0], at[1])], matrix(one.transform)
        assert pose[:2, 3] == pytest.approx((state.x, state.y))
        if object_id == "vut":
            seen, ahead = pose @ camera, spec.camera.forward_m
            x, y = math.cos(state.yaw), math.sin(state.yaw)
            assert seen[:3, 3] == pytest.approx(
                (state.x + ahead * x, state.y + ahead * y, spec.camera.height_m)
            )
            level = math.cos(spec.camera.pitch_down_rad)
            down = math.sin(spec.camera.pitch_down_rad)
            assert seen[:3, 2] == pytest.approx((level * x, level * y, -down))
