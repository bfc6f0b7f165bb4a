"""Decodes the frames of a video topic, and tells keyframes apart without decoding."""

from __future__ import annotations

from collections.abc import Iterator
from typing import cast

import av
import numpy as np

from ssp_core.bag.still_images import MAX_PIXELS, Bgr

# By the format of the message; what FFmpeg calls it.
CODECS = {"h264": "h264", "h265": "hevc"}
_START_CODE = b"\x00\x00\x01"
# Parameter sets and access unit delimiters come before a picture; nothing else needs a look.
_HEAD_BYTES = 4096
_MOST_WAITING = 64

# A picture, with the number of the frame it came from.
Decoded = tuple[int, av.VideoFrame]


def _nal_types(data: memoryview, form: str) -> Iterator[int]:
    head = bytes(data[:_HEAD_BYTES])
    at = head.find(_START_CODE)
    while 0 <= at < len(head) - 3:
        byte = head[at + 3]
        yield byte & 0x1F if form == "h264" else byte >> 1 & 0x3F
        at = head.find(_START_CODE, at + 3)


def is_keyframe(data: memoryview, form: str) -> bool:
    """Whether decoding can begin with this frame: it brings its parameter sets, or is an IDR.

    Args:
        data: one frame, Annex B.
        form: ``h264`` or ``h265``.
    """
    if form == "h264":
        for kind in _nal_types(data, form):
            if kind in (5, 7):
                return True
            if 1 <= kind <= 4:
                return False
        return False
    for kind in _nal_types(data, form):
        if 16 <= kind <= 23 or kind == 33:
            return True
        if kind <= 31:
            return False
    return False


class VideoDecoder:
    """Turns frames of one video into pictures; frames before the first keyframe give none.

    Args:
        form: ``h264`` or ``h265``.

    Raises:
        ValueError: another format.
    """

    def __init__(self, form: str) -> None:
        if form not in CODECS:
            raise ValueError(f"video as {form!r}; {' and '.join(CODECS)} are read here")
        self.form = form
        self._fresh()

    def _fresh(self) -> None:
        self._codec = cast(av.VideoCodecContext, av.CodecContext.create(CODECS[self.form], "r"))
        self._codec.thread_count = 1
        # Without it a decoder waits for frames that might come in between.
        self._codec.flags |= av.codec.context.Flags.low_delay
        # What a decoder patches up by itself looks like a picture and isn't the camera's.
        self._codec.options = {"err_detect": "explode", "max_pixels": str(MAX_PIXELS)}
        self._started = False
        self._waiting: set[int] = set()

    def decode(self, number: int, data: memoryview) -> list[Decoded]:
        """The pictures that are ready now.

        Args:
            number: of this frame, rising.
            data: one frame, Annex B.

        Raises:
            ValueError: the frame is damaged; pictures come again from the next keyframe on.
        """
        if not self._started and not is_keyframe(data, self.form):
            return []
        self._started = True
        packet = av.Packet(bytes(data))
        packet.pts = packet.dts = number
        self._waiting.add(number)
        try:
            ready = self._known(self._codec.decode(packet))
            if any(frame.is_corrupt for _, frame in ready):
                raise ValueError("a frame that is damaged, or frames before it are missing")
            if len(self._waiting) > _MOST_WAITING:
                raise ValueError(f"{_MOST_WAITING} frames gave no picture")
        except (av.error.FFmpegError, MemoryError) as error:
            self._fresh()
            raise ValueError(f"a frame that can't be decoded: {error}") from error
        except ValueError:
            self._fresh()
            raise
        return ready

    def finish(self) -> list[Decoded]:
        """The pictures that were held back; the next frame must be a keyframe."""
        try:
            ready = self._known(self._codec.decode(None)) if self._started else []
        except (av.error.FFmpegError, MemoryError):
            ready = []
        self._fresh()
        return ready

    def _known(self, frames: list[av.VideoFrame]) -> list[Decoded]:
        ready = []
        for frame in frames:
            if frame.pts in self._waiting:
                self._waiting.discard(frame.pts)
                ready.append((frame.pts, frame))
        return ready


def to_bgr(frame: av.VideoFrame) -> Bgr:
    """The pixels of a decoded frame."""
    return np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)
