"""Frame and CameraInfo of a camera without distortion, as bytes."""

from __future__ import annotations

from ssp_core.cdr.codec import ENCAPSULATION, write
from ssp_core.world.camera import Intrinsics
from ssp_core.world.transforms import OPTICAL_FRAME

INFO_TYPE = "sensor_msgs/msg/CameraInfo"
MOUNT_TYPE = "geometry_msgs/msg/TransformStamped"

_UNDISTORTED = (0.0,) * 5
_UNTURNED = (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0)
# Neither binning nor a region of interest.
_WHOLE_PICTURE = (0, 0, 0, 0, 0, 0, False)
_INFO = "stIItI" + "d" * (len(_UNDISTORTED) + 9 + len(_UNTURNED) + 12) + "IIIIII?"


def encode_frame(stamp_ns: int, jpeg: bytes) -> bytes:
    """Encode the CompressedImage.msg of a JPEG picture.

    It raises ValueError for a stamp beyond its field.
    """
    return ENCAPSULATION + write("sttI", (stamp_ns, OPTICAL_FRAME, "jpeg", len(jpeg))) + jpeg


def encode_camera_info(stamp_ns: int, lens: Intrinsics) -> bytes:
    """Encode a CameraInfo.msg; raise ValueError for what its fields can't hold."""
    values = [stamp_ns, OPTICAL_FRAME, lens.height_px, lens.width_px, "plumb_bob"]
    values += [len(_UNDISTORTED), *_UNDISTORTED, *lens.k(), *_UNTURNED, *lens.p()]
    return ENCAPSULATION + write(_INFO, [*values, *_WHOLE_PICTURE])
