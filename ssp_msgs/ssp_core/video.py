"""Decodes a video file frame by frame, with the times that stand in the file."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

# OpenCV and the FFmpeg inside it write to standard error on their own, and read these when they
# are loaded; our message says what is wrong.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")

import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.closing import Closing
from ssp_core.errors import InputError

MAX_FPS = 1000.0


@dataclass(frozen=True, slots=True)
class VideoInfo:
    """What the container says: size in px, mean frames per second, number of frames."""

    width_px: int
    height_px: int
    fps: float
    frames: int


class VideoFrame(NamedTuple):
    """One decoded frame, BGR; number from 0 and time both count from the file's beginning."""

    number: int
    time_s: float
    image: NDArray[np.uint8]


class Video(Closing):
    """An open video file; a context manager.

    Args:
        path: the file.

    Raises:
        InputError: it isn't there or is no video that can be decoded.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.reached_s = 0.0  # end of the last frame that frames() has come to
        if not path.is_file():
            raise InputError("is not there" if not path.exists() else "is no file", file=path)
        self._capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        fps = self._capture.get(cv2.CAP_PROP_FPS) if self._capture.isOpened() else 0.0
        if not (math.isfinite(fps) and 0.0 < fps <= MAX_FPS):
            self._capture.release()
            raise InputError(
                "is no video that can be decoded",
                file=path,
                remedy="common formats such as MP4 (H.264) or AVI will do",
            )
        self.info = VideoInfo(
            width_px=int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            height_px=int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
            fps=fps,
            frames=max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))),
        )

    def frames(self, start_s: float, end_s: float | None, keep_every: int) -> Iterator[VideoFrame]:
        """Every n-th frame of a span, counted from its first one.

        Args:
            start_s: the first frame is the first one not before this time.
            end_s: frames from this time on are left out, None: no end.
            keep_every: n.

        Raises:
            InputError: the file's frame times don't rise, or a frame can't be decoded.
        """
        slack_s = 0.01 / self.info.fps  # containers round times to their own ticks
        number, previous_s, first = -1, -math.inf, None
        while self._capture.grab():
            number += 1
            time_s = self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
            if time_s <= previous_s:
                raise InputError(
                    f"frame {number} is not later than the one before it ({time_s:.6f} s)",
                    file=self.path,
                    remedy="re-encode the video with a constant frame rate",
                )
            previous_s = time_s
            self.reached_s = time_s + 1.0 / self.info.fps
            if time_s < start_s - slack_s:
                continue
            if end_s is not None and time_s >= end_s - slack_s:
                return
            first = number if first is None else first
            if (number - first) % keep_every == 0:
                decoded, image = self._capture.retrieve()
                if not decoded:
                    raise InputError(f"frame {number} can't be decoded", file=self.path)
                yield VideoFrame(number, time_s, np.asarray(image, dtype=np.uint8))

    def close(self) -> None:
        self._capture.release()
