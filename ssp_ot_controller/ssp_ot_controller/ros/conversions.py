"""Facts of the simulated world and frames of its camera as messages."""

from __future__ import annotations

from array import array

from builtin_interfaces.msg import Time
from sensor_msgs.msg import CameraInfo, CompressedImage

from ssp_core.world.camera import Intrinsics
from ssp_core.world.transforms import OPTICAL_FRAME


def image_message(stamp: Time, jpeg: bytes) -> CompressedImage:
    """A frame; ``array`` takes the bytes at once, a list would take them one by one."""
    msg = CompressedImage()
    msg.header.stamp = stamp
    msg.header.frame_id = OPTICAL_FRAME
    msg.format = "jpeg"
    msg.data = array("B", jpeg)
    return msg


def info_message(stamp: Time, lens: Intrinsics) -> CameraInfo:
    """Size and pinhole numbers, without distortion."""
    msg = CameraInfo()
    msg.header.stamp = stamp
    msg.header.frame_id = OPTICAL_FRAME
    msg.width, msg.height = lens.width_px, lens.height_px
    msg.distortion_model = "plumb_bob"
    msg.d = [0.0] * 5
    msg.k = lens.k()
    msg.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    msg.p = lens.p()
    return msg
