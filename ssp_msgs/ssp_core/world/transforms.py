"""Coordinate frames (REP 103, REP 105) and the transforms between them, as tf2 hears them.

``map`` (ENU) → ``<object>/base_link`` for everybody, at the reference point on the ground: x
forward, y left, z up. ``vut/base_link`` → ``vut/front_camera`` is the camera's place on the VUT,
with axes of the same meaning; ``vut/front_camera`` → ``vut/front_camera_optical``, the frame of
pictures and CameraInfo, has x right, y down, z forward.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from ssp_core.cdr.codec import (
    ENCAPSULATION,
    START,
    decoder,
    read,
    read_count,
    u32_bytes,
    write,
)
from ssp_core.clock import NS_PER_S
from ssp_core.motion.state import ObjectState
from ssp_core.names import MAP_FRAME, VUT_ID
from ssp_core.run_file.model import Camera
from ssp_core.world.camera import Mounting

Quaternion = tuple[float, float, float, float]

TF_TYPE = "tf2_msgs/msg/TFMessage"
CAMERA_FRAME = f"{VUT_ID}/front_camera"
OPTICAL_FRAME = f"{CAMERA_FRAME}_optical"
# Turns x forward, z up into z forward, y down (REP 103): yaw, then roll, by -90 degrees each.
_OPTICAL: Quaternion = (-0.5, 0.5, -0.5, 0.5)
_LAYOUT = "sttddddddd"
# What a transform takes at the least.
_LEAST_BYTES = 8 + 4 + 4 + 7 * 8
_LATEST_NS = 2**31 * NS_PER_S


@dataclass(frozen=True, slots=True)
class Transform:
    """Pose of a frame in its parent.

    Args:
        parent: frame id.
        child: frame id.
        stamp_ns: session time; 0 for a transform that never changes.
        translation_m: x, y, z of the child's origin.
        quaternion_xyzw: turns the child's axes into the parent's.
    """

    parent: str
    child: str
    stamp_ns: int
    translation_m: tuple[float, float, float]
    quaternion_xyzw: Quaternion


def base_frame(object_id: str) -> str:
    """Return the frame of an object's body."""
    return f"{object_id}/base_link"


BASE_FRAME = base_frame(VUT_ID)


def of_state(state: ObjectState) -> Transform:
    """Return the transform map → base_link at the stamp of a state; the ground is at z = 0."""
    half = state.yaw_rad / 2
    turn = (0.0, 0.0, math.sin(half), math.cos(half))
    child = base_frame(state.object_id)
    return Transform(MAP_FRAME, child, state.stamp_ns, (state.x_m, state.y_m, 0.0), turn)


def mount(camera: Camera | Mounting, stamp_ns: int = 0) -> Transform:
    """Return the transform vut/base_link → vut/front_camera_optical, as topic ``mount`` states it.

    The rotation turns base_link's axes into the optical ones: the mounting's yaw, then yaw by -90
    degrees and roll by -90 degrees (REP 103), then the pitch about the optical x axis and the roll
    about the optical z axis.
    """
    # The pitch down multiplies _OPTICAL from the right with (-sin(half), 0, 0, cos(half)).
    half = camera.pitch_down_rad / 2
    c, s = math.cos(half) / 2, math.sin(half) / 2
    pitched = (-c - s, c + s, s - c, c - s)
    half = camera.yaw_left_rad / 2
    turned = _product((0.0, 0.0, math.sin(half), math.cos(half)), pitched)
    half = camera.roll_right_rad / 2
    turn = _product(turned, (0.0, 0.0, math.sin(half), math.cos(half)))
    place = (camera.forward_m, camera.left_m, camera.height_m)
    return Transform(BASE_FRAME, OPTICAL_FRAME, stamp_ns, place, turn)


def of_camera(camera: Camera | Mounting) -> tuple[Transform, Transform]:
    """Return the static transforms: vut/base_link → vut/front_camera → vut/front_camera_optical."""
    optical = mount(camera)
    x, y, z, w = _OPTICAL
    body = _product(optical.quaternion_xyzw, (-x, -y, -z, w))
    return (
        Transform(BASE_FRAME, CAMERA_FRAME, 0, optical.translation_m, body),
        Transform(CAMERA_FRAME, OPTICAL_FRAME, 0, (0.0, 0.0, 0.0), _OPTICAL),
    )


def _product(a: Quaternion, b: Quaternion) -> Quaternion:
    """Return the rotation that turns by b and then by a, (x, y, z, w)."""
    ax, ay, az, aw = a
    bx, by, bz, bw = b
    return (
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
        aw * bw - ax * bx - ay * by - az * bz,
    )


class TransformFilter:
    """The choice of states that are news for tf2.

    tf2 complains of a stamp that it has heard before.
    """

    def __init__(self) -> None:
        self._sent_stamps_ns: dict[str, int] = {}

    def news(self, states: Iterable[ObjectState]) -> list[Transform]:
        """Return transforms of the states that are later than those sent of their objects.

        What is no pose, or has a stamp that no message can carry, is left out.
        """
        transforms = []
        for state in states:
            known_ns = self._sent_stamps_ns.get(state.object_id, -1)
            pose = state.x_m + state.y_m + state.yaw_rad
            if known_ns < state.stamp_ns < _LATEST_NS and math.isfinite(pose):
                self._sent_stamps_ns[state.object_id] = state.stamp_ns
                transforms.append(of_state(state))
        return transforms


def _write(one: Transform, at: int) -> bytes:
    """Return a geometry_msgs/TransformStamped at an offset that is a multiple of 4."""
    numbers = (*one.translation_m, *one.quaternion_xyzw)
    return write(_LAYOUT, (one.stamp_ns, one.parent, one.child, *numbers), at)


def encode_transform(one: Transform) -> bytes:
    """Encode a geometry_msgs/TransformStamped.

    It raises ValueError for a stamp beyond 32 bits of seconds.
    """
    return ENCAPSULATION + _write(one, START)


def encode_transforms(transforms: Iterable[Transform]) -> bytes:
    """Encode a tf2_msgs/TFMessage; raise ValueError as encode_transform."""
    several = list(transforms)
    parts = [ENCAPSULATION, u32_bytes(len(several))]
    at = START + 4
    for one in several:
        parts.append(_write(one, at))
        at += len(parts[-1])
    return b"".join(parts)


@decoder
def decode_transforms(data: bytes, at: int) -> tuple[tuple[Transform, ...], int]:
    """Return the transforms of a tf2_msgs/TFMessage."""
    count, at = read_count(data, at, _LEAST_BYTES)
    transforms = []
    for _ in range(count):
        (stamp_ns, parent, child, x, y, z, *turn), at = read(_LAYOUT, data, at)
        quaternion = (turn[0], turn[1], turn[2], turn[3])
        transforms.append(Transform(parent, child, stamp_ns, (x, y, z), quaternion))
    return tuple(transforms), at
