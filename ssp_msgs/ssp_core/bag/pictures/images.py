"""Pictures out of JPEG, PNG and raw images, with a bound on what a header may claim."""

from __future__ import annotations

import struct

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.bag.pictures.jpeg import UPRIGHT, read_header, whole_picture
from ssp_core.cdr.images import JPEG_START, ImageMessage, RawLayout

# More than any camera; a header of ten bytes can claim four thousand million.
MAX_PIXELS = 1 << 26
PNG_START = b"\x89PNG\r\n\x1a\n"
# Where a PNG says how many bits a value has; its kind of colour comes next, 0 is grey.
_PNG_BITS = 24
# EXIF's orientations above it exchange width and height.
_LAST_UNTURNED = 4
JPEG_QUALITY = 95

_CHANNELS = {"mono8": 1, "8UC1": 1, "rgb8": 3, "bgr8": 3, "8UC3": 3, "rgba8": 4, "bgra8": 4}
_TO_BGR = {
    "mono8": cv2.COLOR_GRAY2BGR,
    "8UC1": cv2.COLOR_GRAY2BGR,
    "rgb8": cv2.COLOR_RGB2BGR,
    "rgba8": cv2.COLOR_RGBA2BGR,
    "bgra8": cv2.COLOR_BGRA2BGR,
}
# Values of 8 bits as a Bayer mosaic; demosaicked to colour.
_BAYER = {
    "bayer_rggb8": cv2.COLOR_BayerRGGB2BGR,
    "bayer_bggr8": cv2.COLOR_BayerBGGR2BGR,
    "bayer_gbrg8": cv2.COLOR_BayerGBRG2BGR,
    "bayer_grbg8": cv2.COLOR_BayerGRBG2BGR,
}

Bgr = NDArray[np.uint8]


def suffix_of(data: bytes | memoryview) -> str | None:
    """Return ``.jpg`` or ``.png`` as the first bytes say, None for anything else."""
    if data[:2] == JPEG_START:
        return ".jpg"
    return ".png" if data[:8] == PNG_START else None


def size_px(data: memoryview) -> tuple[int, int]:
    """Return the width and height that a JPEG or PNG claims.

    Raises:
        ValueError: it is neither, or says none.
    """
    try:
        if data[:8] == PNG_START:
            width, height, _, _ = struct.unpack_from(">IIBB", data, 16)
            return width, height
        if data[:2] == JPEG_START:
            header = read_header(data)
            return header.width_px, header.height_px
    except (struct.error, IndexError):
        raise ValueError(f"a picture cut off after {len(data)} bytes") from None
    raise ValueError(f"{len(data)} bytes that are neither JPEG nor PNG")


def shown_size_px(image: ImageMessage) -> tuple[int, int]:
    """Return the width and height of an image as it is shown: turned as EXIF says.

    Raises:
        ValueError: it is neither JPEG nor PNG nor raw, or says no size.
    """
    if image.layout is not None:
        return image.layout.width_px, image.layout.height_px
    width, height = size_px(image.data)
    return (height, width) if orientation_of(image) > _LAST_UNTURNED else (width, height)


def orientation_of(image: ImageMessage) -> int:
    """Return the orientation that EXIF states, 1 to 8; 1, upright, where it states none.

    Raises:
        ValueError: a JPEG whose header can't be read.
    """
    if image.layout is not None or image.data[:2] != JPEG_START:
        return UPRIGHT
    return read_header(image.data).orientation


def is_mosaic(image: ImageMessage) -> bool:
    """Tell whether an image holds a Bayer mosaic, raw or compressed as grey.

    Raises:
        ValueError: a JPEG whose header can't be read.
    """
    encoding = image.format.partition(";")[0].strip()
    if encoding not in _BAYER or image.layout is not None:
        return encoding in _BAYER
    if image.data[:2] == JPEG_START:
        return read_header(image.data).channels == 1
    return image.data[:8] == PNG_START and image.data[_PNG_BITS + 1] == 0


def check_depth(image: ImageMessage) -> None:
    """Check that a compressed picture has 8 bits a value: nothing states the range of more.

    Raises:
        ValueError: it has more, or it is neither JPEG nor PNG.
    """
    size_px(image.data)
    is_jpeg = image.data[:2] == JPEG_START
    bits = read_header(image.data).bits if is_jpeg else image.data[_PNG_BITS]
    if bits > 8:
        raise ValueError(
            f"a picture of {bits} bits a value, of which no range is stated; 8 are read here"
        )


def decode_still(image: ImageMessage) -> Bgr:
    """Return the picture of a compressed or raw image, BGR, upright.

    Raises:
        ValueError: it is damaged, cut off, too large, or in a format that isn't read here.
    """
    if image.layout is not None:
        return _raw(image.format, image.layout, image.data)
    width, height = size_px(image.data)
    if width * height > MAX_PIXELS:
        raise ValueError(f"a picture of {width} x {height} px, more than is read here")
    check_depth(image)
    data = image.data
    if data[:2] == JPEG_START:
        whole_picture(data)
    is_grey = is_mosaic(image)
    try:
        how = cv2.IMREAD_GRAYSCALE if is_grey else cv2.IMREAD_COLOR
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), how)
    except cv2.error:
        picture = None
    if picture is None:
        raise ValueError(f"{len(data)} bytes that can't be decoded")
    if is_grey:
        picture = _demosaicked(np.asarray(picture), image.format.partition(";")[0].strip())
    return np.asarray(picture, np.uint8)


def _demosaicked(mosaic: NDArray[np.uint8], encoding: str) -> Bgr:
    """Return the colours of a Bayer mosaic."""
    if min(mosaic.shape[:2]) < 4:
        raise ValueError(f"a Bayer mosaic of {mosaic.shape[1]} x {mosaic.shape[0]} px")
    return np.asarray(cv2.cvtColor(mosaic, _BAYER[encoding]), np.uint8)


def _raw(encoding: str, layout: RawLayout, data: memoryview) -> Bgr:
    channels = 1 if encoding in _BAYER else _CHANNELS.get(encoding)
    if channels is None:
        encodings = ", ".join((*_CHANNELS, *_BAYER))
        raise ValueError(f"pixels as {encoding!r}; {encodings} are read here")
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
    if encoding in _BAYER:
        return _demosaicked(picture[:, :, 0], encoding)
    code = _TO_BGR.get(encoding)
    return np.asarray(picture if code is None else cv2.cvtColor(picture, code), np.uint8)


def even_sized(picture: Bgr) -> Bgr:
    """Return the picture without the last column or row where it has an odd number of them.

    4:2:0, in which video is played everywhere, can't hold an odd number.

    Raises:
        ValueError: nothing is left.
    """
    height, width = picture.shape[0] & ~1, picture.shape[1] & ~1
    if not height or not width:
        raise ValueError(f"a picture of {picture.shape[1]} x {picture.shape[0]} px")
    return np.ascontiguousarray(picture[:height, :width])


def encode(picture: Bgr, suffix: str, quality: int = JPEG_QUALITY) -> bytes:
    """Return a picture as a file's bytes.

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
    """Return a picture as JPEG."""
    return encode(picture, ".jpg", quality)
