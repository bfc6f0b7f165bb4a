"""Writes pictures as an MP4 that plays at the recorded times."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import av
from av.video.reformatter import ColorRange, Colorspace

from ssp_core.bag.frames import Picture

# Of an MP4; fine enough for any camera, and what players reckon with.
_TICKS_PER_S = 90_000
_CRF = "18"


class VideoFile:
    """An MP4 (H.264) whose frames are shown at the times at which they were taken.

    Args:
        path: of the file.
        width_px: even.
        height_px: even.
    """

    def __init__(self, path: Path, width_px: int, height_px: int) -> None:
        self.size_px = (width_px, height_px)
        self._container = av.open(str(path), "w", format="mp4")
        self._stream = self._container.add_stream("libx264", options={"crf": _CRF})
        self._stream.width, self._stream.height = self.size_px
        self._stream.pix_fmt = "yuv420p"
        codec = self._stream.codec_context
        codec.time_base = self._stream.time_base = Fraction(1, _TICKS_PER_S)
        codec.color_range, codec.colorspace = ColorRange.MPEG, Colorspace.ITU709
        codec.thread_count = 2
        self._last: tuple[int, int] | None = None
        self._ticks = 0

    def add(self, picture: Picture) -> None:
        """Appends a frame of this size.

        Where a stamp does not rise, since the camera's clock was set or it has none, the time that
        passed for the recorder counts.
        """
        frame = av.VideoFrame.from_ndarray(picture.image, format="bgr24").reformat(
            format="yuv420p", dst_colorspace=Colorspace.ITU709, dst_color_range=ColorRange.MPEG
        )
        if self._last is not None:
            stamp_ns, log_ns = self._last
            passed_ns = picture.stamp_ns - stamp_ns
            if passed_ns <= 0:
                passed_ns = picture.log_time_ns - log_ns
            self._ticks += max(1, round(passed_ns * _TICKS_PER_S / 1e9))
        self._last = (picture.stamp_ns, picture.log_time_ns)
        frame.pts, frame.time_base = self._ticks, Fraction(1, _TICKS_PER_S)
        self._container.mux(self._stream.encode(frame))

    def close(self) -> None:
        """Writes what was held back, and the index."""
        self._container.mux(self._stream.encode(None))
        self._container.close()
