"""Images and video frames as they stand in serialised messages, read without decoding the rest.

The pixels stay where they are: a view of the message's bytes, since a raw frame has megabytes.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass

from ssp_core.cdr.codec import (
    ENCAPSULATION,
    START,
    check_start,
    read,
    read_count,
    text_bytes,
    write,
)

VIDEO_TYPE = "foxglove_msgs/msg/CompressedVideo"

# The fields of the releases for ROS 2; drafts append others, which readers here pass over.
VIDEO_DEFINITION = """\
# One frame of a video; it can be decoded when all frames since the last keyframe are known.
builtin_interfaces/Time timestamp   # of the picture
string frame_id                     # optical frame of the camera: x right, y down, z ahead
uint8[] data                        # H.264, H.265: Annex B, one whole picture, no B-frames;
                                    # each keyframe brings its parameter sets with it
string format                       # h264, h265, vp9 or av1
"""


COMPRESSED_TYPE = "sensor_msgs/msg/CompressedImage"
RAW_TYPE = "sensor_msgs/msg/Image"
JPEG_START = b"\xff\xd8"
IMAGE_TYPES = (COMPRESSED_TYPE, RAW_TYPE, VIDEO_TYPE)


@dataclass(frozen=True, slots=True)
class RawLayout:
    """The layout of a raw image's pixels: size in px, bytes from row to row."""

    width_px: int
    height_px: int
    step_bytes: int


@dataclass(frozen=True, slots=True)
class ImageMessage:
    """One image of any of IMAGE_TYPES.

    Args:
        stamp_ns: when it was taken.
        frame_id: optical frame of the camera.
        format: as the message says: ``jpeg``, ``rgb8; jpeg compressed bgr8``, ``rgb8``, ``h264``.
        data: the compressed picture, the pixels, or the frame of the video.
        layout: of a raw image, else None.
    """

    stamp_ns: int
    frame_id: str
    format: str
    data: memoryview
    layout: RawLayout | None = None


def _blob(cdr: bytes, at: int) -> tuple[memoryview, int]:
    count, at = read_count(cdr, at, 1)
    return memoryview(cdr)[at : at + count], at + count


def _compressed(cdr: bytes) -> ImageMessage:
    head, at = read("stt", cdr, START)
    return ImageMessage(*[*head, _blob(cdr, at)[0]])


def _raw(cdr: bytes) -> ImageMessage:
    # Whether it is big-endian says nothing of 8-bit pixels.
    (stamp_ns, frame_id, height, width, encoding, _, step), at = read("stIItBI", cdr, START)
    data, _ = _blob(cdr, at)
    return ImageMessage(stamp_ns, frame_id, encoding, data, RawLayout(width, height, step))


def _video(cdr: bytes) -> ImageMessage:
    (stamp_ns, frame_id), at = read("st", cdr, START)
    data, at = _blob(cdr, at)
    (form,), _ = read("t", cdr, at)
    return ImageMessage(stamp_ns, frame_id, form, data)


_READERS: dict[str, Callable[[bytes], ImageMessage]] = {
    COMPRESSED_TYPE: _compressed,
    RAW_TYPE: _raw,
    VIDEO_TYPE: _video,
}


def read_image(msgtype: str, cdr: bytes) -> ImageMessage:
    """Return the image in a serialised message; fields behind those that are known are passed over.

    Raises:
        ValueError: the bytes are no such message.
    """
    check_start(cdr)
    try:
        return _READERS[msgtype](cdr)
    except (struct.error, IndexError) as error:
        raise ValueError(f"{len(cdr)} bytes are too few: {error}") from None


def encode_video_message(stamp_ns: int, frame_id: str, data: bytes, form: str) -> bytes:
    """Return a CompressedVideo message of one encoded frame.

    Raises:
        ValueError: a stamp or text that no message can carry.
    """
    head = write("stI", (stamp_ns, frame_id, len(data)))
    return b"".join((ENCAPSULATION, head, data, bytes(-len(data) % 4), text_bytes(form)))
