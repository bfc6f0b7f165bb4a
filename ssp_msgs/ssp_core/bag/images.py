"""Pictures out of JPEG, PNG and raw images, with a bound on what a header may claim."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.cdr.images import JPEG_START, ImageMessage, RawLayout

# More than any camera; a header of ten bytes can claim four thousand million.
MAX_PIXELS = 1 << 26
JPEG_END = b"\xff\xd9"
PNG_START = b"\x89PNG\r\n\x1a\n"
JPEG_QUALITY = 95

_CHANNELS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4}
_TO_BGR = {
    "mono8": cv2.COLOR_GRAY2BGR,
    "8UC1": cv2.COLOR_GRAY2BGR,
    "rgb8": cv2.COLOR_RGB2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
}
# Start of frame, all kinds but the tables and the arithmetic extension that lie between them.
_SIZES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_BARE = frozenset({0x01, *range(0xD0, 0xD9)})

Bgr = NDArray[np.uint8]


def suffix_of(data: bytes | memoryview) -> str | None:
    """``.jpg`` or ``.png`` as the first bytes say, None for anything else."""
    if data[:2] == JPEG_START:
        return ".jpg"
    return ".png" if data[:8] == PNG_START else None


def size_px(data: memoryview) -> tuple[int, int]:
    """Width and height that a JPEG or PNG claims.

    Raises:
        ValueError: it is neither, or says none.
    """
    try:
        if data[:8] == PNG_START:
            width, height = struct.unpack_from(">II", data, 16)
            return width, height
        if data[:2] == JPEG_START:
            return _jpeg_size(data)
    except (struct.error, IndexError):
        raise ValueError(f"a picture cut off after {len(data)} bytes") from None
    raise ValueError(f"{len(data)} bytes that are neither JPEG nor PNG")


def _jpeg_size(data: memoryview) -> tuple[int, int]:
    at = 2
    while True:
        if data[at] != 0xFF:
            raise ValueError("a JPEG without a size")
        kind = data[at + 1]
        if kind == 0xFF:  # a fill byte
            at += 1
        elif kind in _BARE:
            at += 2
        elif kind in _SIZES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        else:
            at += 2 + struct.unpack_from(">H", data, at + 2)[0]


def decode_still(image: ImageMessage) -> Bgr:
    """The picture of a compressed or raw image, BGR.

    Raises:
        ValueError: it is damaged, cut off, too large, or in a format that isn't read here.
    """
    if image.layout is not None:
        return _raw(image.format, image.layout, image.data)
    width, height = size_px(image.data)
    if width * height > MAX_PIXELS:
        raise ValueError(f"a picture of {width} x {height} px, more than is read here")
    # A JPEG that is cut off decodes all the same, with a grey rest.
    if image.data[:2] == JPEG_START and JPEG_END not in bytes(image.data[-4096:]):
        raise ValueError(f"a JPEG cut off after {len(image.data)} bytes")
    try:
        picture = cv2.imdecode(np.frombuffer(image.data, np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        picture = None
    if picture is None:
        raise ValueError(f"{len(image.data)} bytes that can't be decoded")
    return np.asarray(picture, np.uint8)


def _raw(encoding: str, layout: RawLayout, data: memoryview) -> Bgr:
    channels = _CHANNELS.get(encoding)
    if channels is None:
        raise ValueError(f"pixels as {encoding!r}; {', '.join(_CHANNELS)} are read here")
    row_bytes = layout.width_px * channels
    pixels = layout.width_px * layout.height_px
    if not 0 < pixels <= MAX_PIXELS or layout.step_bytes < row_bytes:
        raise ValueError(
            f"{layout.width_px} x {layout.height_px} px in rows of {layout.step_bytes} bytes"
        )
    if layout.height_px * layout.step_bytes > len(data):
        raise ValueError(f"{len(data)} bytes for {layout.height_px} rows of {layout.step_bytes}")
    rows = np.frombuffer(data, np.uint8, layout.height_px * layout.step_bytes)
    rows = rows.reshape(layout.height_px, layout.step_bytes)[:, :row_bytes]
    picture = rows.reshape(layout.height_px, layout.width_px, channels)
    code = _TO_BGR.get(encoding)
    return np.asarray(picture if code is None else cv2.cvtColor(picture, code), np.uint8)


def even_sized(picture: Bgr) -> Bgr:
    """The picture without the last column or row where it has an odd number of them: 4:2:0, in
    which video is played everywhere, can't hold them.

    Raises:
        ValueError: nothing is left.
    """
    height, width = picture.shape[0] & ~1, picture.shape[1] & ~1
    if not height or not width:
        raise ValueError(f"a picture of {picture.shape[1]} x {picture.shape[0]} px")
    return np.ascontiguousarray(picture[:height, :width])


def encode(picture: Bgr, suffix: str, quality: int = JPEG_QUALITY) -> bytes:
    """A picture as a file's bytes.

    Args:
        picture: BGR.
        suffix: ``.png`` or ``.jpg``.
        quality: of a JPEG, 0 to 100.
    """
    options = [cv2.IMWRITE_JPEG_QUALITY, quality] if suffix == ".jpg" else []
    encoded, data = cv2.imencode(suffix, picture, options)
    if not encoded:
        raise RuntimeError(f"OpenCV could not encode a picture as {suffix}")
    return np.asarray(data, dtype=np.uint8).tobytes()


def encode_jpeg(picture: Bgr, quality: int = JPEG_QUALITY) -> bytes:
    """A picture as JPEG."""
    return encode(picture, ".jpg", quality)
