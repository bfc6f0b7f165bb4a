"""The messages of an imported video, serialised."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ssp_core.bag.types import serialize, typestore
from ssp_core.clock import NS_PER_S, ns_to_seconds
from ssp_core.names import MAP_FRAME, VUT_ID
from ssp_core.state import DEFAULT_SIZES
from ssp_core.vocab import ObjectClass, Role

IMAGE_TYPE = "sensor_msgs/msg/CompressedImage"
INFO_TYPE = "sensor_msgs/msg/CameraInfo"
MOUNT_TYPE = "geometry_msgs/msg/TransformStamped"
STATE_TYPE = "ssp_msgs/msg/ObjectState"
OPTICAL_FRAME = "vut/front_camera_optical"
BASE_FRAME = "vut/base_link"


def _header(stamp_ns: int, frame_id: str) -> Any:
    types = typestore().types
    stamp = types["builtin_interfaces/msg/Time"](
        sec=stamp_ns // NS_PER_S, nanosec=stamp_ns % NS_PER_S
    )
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def image(stamp_ns: int, jpeg: NDArray[np.uint8]) -> bytes:
    """A frame as CompressedImage."""
    message = typestore().types[IMAGE_TYPE](
        header=_header(stamp_ns, OPTICAL_FRAME), format="jpeg", data=jpeg
    )
    return serialize(message)


def camera_info(stamp_ns: int, width_px: int, height_px: int, hfov_deg: float) -> bytes:
    """A pinhole without distortion: fx = fy = (w / 2) / tan(hfov / 2), centre of the image."""
    focal_px = width_px / 2 / math.tan(math.radians(hfov_deg) / 2)
    cx_px, cy_px = width_px / 2, height_px / 2
    k = [focal_px, 0.0, cx_px, 0.0, focal_px, cy_px, 0.0, 0.0, 1.0]
    p = [*k[:3], 0.0, *k[3:6], 0.0, *k[6:], 0.0]
    types = typestore().types
    message = types[INFO_TYPE](
        header=_header(stamp_ns, OPTICAL_FRAME),
        height=height_px,
        width=width_px,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array(k),
        r=np.eye(3).ravel(),
        p=np.array(p),
        binning_x=0,
        binning_y=0,
        roi=types["sensor_msgs/msg/RegionOfInterest"](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        ),
    )
    return serialize(message)


def mount_quaternion(pitch_down_rad: float) -> tuple[float, float, float, float]:
    """Rotation (x, y, z, w) from the optical frame (z forward, x right, y down) to base_link.

    The level camera's rotation, then a turn about base_link's y axis that takes x towards -z.
    """
    half = pitch_down_rad / 2
    c, s = 0.5 * math.cos(half), 0.5 * math.sin(half)
    return -c - s, c + s, s - c, c - s


def mount(stamp_ns: int, height_m: float, pitch_down_rad: float) -> bytes:
    """Pose of the camera on the vehicle, straight above its reference point."""
    types = typestore().types
    x, y, z, w = mount_quaternion(pitch_down_rad)
    message = types[MOUNT_TYPE](
        header=_header(stamp_ns, BASE_FRAME),
        child_frame_id=OPTICAL_FRAME,
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=height_m),
            rotation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        ),
    )
    return serialize(message)


def vut_state(stamp_ns: int, sequence: int, speed_mps: float) -> bytes:
    """State of the camera's vehicle that drives straight along the map's x axis from its origin.

    Args:
        stamp_ns: clip time.
        sequence: from 1.
        speed_mps: declared, constant.
    """
    size = DEFAULT_SIZES[ObjectClass.CAR]
    message = typestore().types[STATE_TYPE](
        header=_header(stamp_ns, MAP_FRAME),
        object_id=VUT_ID,
        object_class=ObjectClass.CAR.value,
        role=Role.VUT.value,
        control_state=0,
        sequence=sequence,
        x=speed_mps * ns_to_seconds(stamp_ns),
        y=0.0,
        yaw=0.0,
        speed=speed_mps,
        acceleration=0.0,
        yaw_rate=0.0,
        front=size.front_m,
        rear=size.rear_m,
        width=size.width_m,
        height=size.height_m,
        position_std=0.0,
        reference_id="",
        error_longitudinal=0.0,
        error_lateral=0.0,
        error_yaw=0.0,
    )
    return serialize(message)
