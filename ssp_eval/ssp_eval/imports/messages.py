"""The camera's messages of an imported recording, serialised."""

from __future__ import annotations

from typing import Any

import numpy as np

from ssp_core.bag.types import serialize, typestore
from ssp_core.clock import NS_PER_S
from ssp_core.world.camera import Intrinsics
from ssp_core.world.transforms import OPTICAL_FRAME

IMAGE_TYPE = "sensor_msgs/msg/CompressedImage"
INFO_TYPE = "sensor_msgs/msg/CameraInfo"
MOUNT_TYPE = "geometry_msgs/msg/TransformStamped"
STATE_TYPE = "ssp_msgs/msg/ObjectState"


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
