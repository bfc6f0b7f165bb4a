"""The camera's messages of an imported recording, serialised."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation  # type: ignore[import-untyped]  # scipy has no types

from ssp_core.bag.types import serialize, typestore
from ssp_core.camera import Intrinsics, Mounting, optical_axes
from ssp_core.clock import NS_PER_S

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


def image(stamp_ns: int, jpeg: bytes) -> bytes:
    """A frame as CompressedImage."""
    message = typestore().types[IMAGE_TYPE](
        header=_header(stamp_ns, OPTICAL_FRAME), format="jpeg", data=np.frombuffer(jpeg, np.uint8)
    )
    return serialize(message)


def camera_info(stamp_ns: int, lens: Intrinsics) -> bytes:
    """A pinhole without distortion as CameraInfo."""
    types = typestore().types
    message = types[INFO_TYPE](
        header=_header(stamp_ns, OPTICAL_FRAME),
        height=lens.height_px,
        width=lens.width_px,
        distortion_model="plumb_bob",
        d=np.zeros(5),
        k=np.array(lens.k()),
        r=np.eye(3).ravel(),
        p=np.array(lens.p()),
        binning_x=0,
        binning_y=0,
        roi=types["sensor_msgs/msg/RegionOfInterest"](
            x_offset=0, y_offset=0, height=0, width=0, do_rectify=False
        ),
    )
    return serialize(message)


def mount(stamp_ns: int, mounting: Mounting) -> bytes:
    """Pose of the camera on the vehicle, in base_link."""
    types = typestore().types
    # The rows of optical_axes are the optical axes; as columns they turn them into base_link.
    axes = optical_axes(mounting.pitch_down_rad, mounting.yaw_left_rad, mounting.roll_right_rad)
    x, y, z, w = Rotation.from_matrix(axes.T).as_quat().tolist()
    message = types[MOUNT_TYPE](
        header=_header(stamp_ns, BASE_FRAME),
        child_frame_id=OPTICAL_FRAME,
        transform=types["geometry_msgs/msg/Transform"](
            translation=types["geometry_msgs/msg/Vector3"](
                x=mounting.forward_m, y=mounting.left_m, z=mounting.height_m
            ),
            rotation=types["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w),
        ),
    )
    return serialize(message)
