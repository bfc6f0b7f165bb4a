"""JPEG as cameras write it: what its header says, where its picture ends, whether it is whole."""

from __future__ import annotations

import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.cdr.images import JPEG_START

JPEG_END = b"\xff\xd9"
UPRIGHT = 1
_SCAN, _EXIF, _ADOBE, _PROGRESSIVE = 0xDA, 0xE1, 0xEE, 0xC2
# Start of frame, all kinds but the tables and the arithmetic extension that lie between them.
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
# Segments that say nothing of the pixels.
_REMARKS = frozenset({*range(0xE0, 0xF0), 0xFE}) - {_ADOBE}
_BARE = frozenset({0x01, *range(0xD0, 0xD9)})


@dataclass(frozen=True, slots=True)
class JpegHeader:
    """The header of a JPEG.

    Args:
        channels: 1 is grey.
        bits: of a value.
        orientation: of EXIF, 1 to 8; 1 is upright.
    """

    width_px: int
    height_px: int
    channels: int
    bits: int
    orientation: int


def _segments(data: memoryview) -> Iterator[tuple[int, int, int]]:
    """Yield kind, begin and end of each segment up to the first scan; it begins at its marker."""
    at = 2
    while True:
        if data[at] != 0xFF:
            raise ValueError("a JPEG without a size")
        kind = data[at + 1]
        if kind == 0xFF:  # a fill byte
            at += 1
            continue
        end = at + 2
        if kind not in _BARE:
            end += struct.unpack_from(">H", data, at + 2)[0]
        yield kind, at, end
        if kind == _SCAN:
            return
        at = end


def read_header(data: memoryview) -> JpegHeader:
    """Read the header of a JPEG.

    Raises:
        ValueError: it says no size, or ends before it does.
    """
    orientation = UPRIGHT
    try:
        for kind, begin, end in _segments(data):
            if kind == _EXIF:
                orientation = _orientation(data[begin + 4 : end])
            elif kind in _FRAMES:
                bits, height, width, channels = struct.unpack_from(">BHHB", data, begin + 4)
                return JpegHeader(width, height, channels, bits, orientation)
    except (struct.error, IndexError):
        raise ValueError(f"a picture cut off after {len(data)} bytes") from None
    raise ValueError("a JPEG without a size")


def _orientation(exif: memoryview) -> int:
    """Return the orientation of an EXIF block; upright where it says none."""
    head, tiff = bytes(exif[:8]), exif[6:]
    if head[:6] != b"Exif\0\0":
        return UPRIGHT
    order = "<" if head[6:] == b"II" else ">"
    try:
        (at,) = struct.unpack_from(f"{order}I", tiff, 4)
        (count,) = struct.unpack_from(f"{order}H", tiff, at)
        for entry in range(at + 2, at + 2 + 12 * count, 12):
            tag, _, _, value = struct.unpack_from(f"{order}HHIH", tiff, entry)
            if tag == 0x0112:
                return value if UPRIGHT <= value <= 8 else UPRIGHT
    except struct.error:
        pass
    return UPRIGHT


def whole_picture(data: memoryview) -> bytes:
    """Return a JPEG without what lies behind its picture and without remarks such as EXIF.

    Raises:
        ValueError: it ends before its picture does.
    """
    parts = [JPEG_START]
    try:
        for kind, begin, end in _segments(data):
            if kind == _SCAN:
                rest = bytes(data[begin:])
                at = rest.find(JPEG_END, end - begin)
                if at >= 0:
                    return b"".join((*parts, rest[: at + 2]))
            elif kind not in _REMARKS:
                parts.append(bytes(data[begin:end]))
    except (struct.error, IndexError):
        pass
    raise ValueError(f"a JPEG cut off after {len(data)} bytes")


_SMALL = cv2.IMREAD_REDUCED_GRAYSCALE_8 | cv2.IMREAD_IGNORE_ORIENTATION
# What libjpeg says of a picture that it patches up, on standard error.
_WARNING = re.compile(rb"(?:Corrupt JPEG data|Premature end of JPEG)[^\n]*\n")
_EXTRA = re.compile(rb"(\d+) extraneous bytes before marker 0xd9")
# Webcams leave a few bytes behind a whole picture's last block; more of them are blocks too many,
# unless they are filling.
_MOST_EXTRA = 8


@contextmanager
def _libjpeg_warnings() -> Iterator[list[bytes]]:
    """Take what libjpeg writes to standard error; what others write there goes on to it.

    OpenCV hands its warnings on in no other way.

    Raises:
        OSError: there is no standard error.
    """
    warnings: list[bytes] = []
    before = os.dup(2)
    caught = os.memfd_create("libjpeg")
    try:
        os.dup2(caught, 2)
        try:
            yield warnings
        finally:
            os.dup2(before, 2)
        if size := os.lseek(caught, 0, os.SEEK_END):
            output = os.pread(caught, size, 0)
            warnings += _WARNING.findall(output)
            os.write(2, _WARNING.sub(b"", output))
    finally:
        os.close(before)
        os.close(caught)


class JpegChecker:
    """A decoder of JPEGs that reports what other decoders patch up.

    OpenCV decodes a JPEG of which a part is missing or damaged, and libjpeg, which it uses, says
    so. Of a progressive one in which a scan is missing it says nothing: FFmpeg does, and takes
    twice the time.
    """

    def __init__(self) -> None:
        self._fresh()

    def _fresh(self, strict: bool = True) -> None:
        self._codec = av.CodecContext.create("mjpeg", "r")
        self._codec.thread_count = 1
        if strict:
            self._codec.options = {"err_detect": "explode"}

    def small(self, data: bytes) -> NDArray[np.uint8]:
        """Decode a JPEG to grey at an eighth of its size.

        Args:
            data: a JPEG, with whatever a camera leaves behind its end.

        Raises:
            ValueError: a part of the picture is missing or damaged.
        """
        view = memoryview(data)
        is_progressive, scan = _scan(view)
        # In the scan itself these bytes can't stand.
        end = data.rfind(JPEG_END, scan)
        if end < 0:
            raise ValueError(f"a JPEG cut off after {len(data)} bytes")
        is_heard = True
        warnings: list[bytes] = []
        try:
            with _libjpeg_warnings() as warnings:
                picture = _decoded(data)
        except OSError:
            is_heard, picture = False, _decoded(data)
        damage = [w for w in warnings if not _is_left_over(w, data, scan)]
        if damage:
            warning = damage[0].decode(errors="replace").strip()
            raise ValueError(f"a JPEG of which a part is missing or damaged ({warning})")
        if picture is None or is_progressive or not is_heard:
            self._strict(data, is_known=picture is not None)
        if picture is None:
            raise ValueError(f"a JPEG of {len(data)} bytes that can't be decoded")
        return picture

    def _strict(self, data: bytes, *, is_known: bool) -> None:
        """Decode a JPEG by a decoder that reports errors.

        Args:
            data: content of the JPEG file.
            is_known: OpenCV can decode it; FFmpeg doesn't know all kinds.
        """
        try:
            frames = self._codec.decode(av.Packet(whole_picture(memoryview(data))))
        except (av.error.FFmpegError, NotImplementedError) as error:
            self._fresh()
            if is_known and not isinstance(error, av.error.InvalidDataError):
                return
            frames = []
        if not frames:
            raise ValueError("a JPEG of which a part is missing or damaged")

    def patched(self, data: bytes) -> NDArray[np.uint8]:
        """Return the picture of a damaged JPEG, BGR, as far as it goes.

        Raises:
            ValueError: nothing of it can be decoded.
        """
        self._fresh(strict=False)
        try:
            frames = self._codec.decode(av.Packet(data))
        except (av.error.FFmpegError, NotImplementedError):
            frames = []
        self._fresh()
        if not frames:
            raise ValueError(f"a JPEG of {len(data)} bytes that can't be decoded")
        return np.asarray(frames[0].to_ndarray(format="bgr24"), np.uint8)


def _decoded(data: bytes) -> NDArray[np.uint8] | None:
    """Decode a JPEG to grey at an eighth of its size, as far as it goes."""
    try:
        picture = cv2.imdecode(np.frombuffer(data, np.uint8), _SMALL)
    except cv2.error:
        return None
    return None if picture is None else np.asarray(picture, np.uint8)


def _is_left_over(warning: bytes, data: bytes, scan: int) -> bool:
    """Tell whether a warning is of bytes that a camera leaves behind a whole picture."""
    extra = _EXTRA.search(warning)
    if extra is None:
        return False
    count, end = int(extra[1]), data.find(JPEG_END, scan)
    return count <= _MOST_EXTRA or not data[max(scan, end - count) : end].strip(b"\0\xff")


def _scan(data: memoryview) -> tuple[bool, int]:
    """Tell whether a JPEG is progressive, and find the start of its first scan."""
    is_progressive = False
    try:
        for kind, _, end in _segments(data):
            is_progressive |= kind == _PROGRESSIVE
            scan = end
    except (struct.error, IndexError):
        raise ValueError(f"a JPEG cut off after {len(data)} bytes") from None
    return is_progressive, scan
