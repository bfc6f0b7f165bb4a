"""The frames of a clip that a model is shown, and the annotation beside the clip."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.hashing import sha256_file
from ssp_core.run_file.values import Strict
from ssp_core.video import Video, VideoFrame, VideoInfo
from ssp_scenario_manager.event_spec.fields import LONGEST_CLIP_S

JPEG_QUALITY = 90
# Frames further apart leave intervals of the phases' times that say little.
WIDE_SPACING_S = 1.0


@dataclass(frozen=True)
class Crop:
    """The part of a video that is the clip, and the share of it that is shown.

    Args:
        start_s: source time of the clip's first frame.
        end_s: source time at which the clip ends, None: the video's end.
        frames: how many are shown, fewer where the clip has fewer.
        width_px: wider frames are scaled down to this.
    """

    start_s: float = 0.0
    end_s: float | None = None
    frames: int = 16
    width_px: int = 960


@dataclass(frozen=True)
class Shot:
    """One frame: its number and time in the clip, both from 0 at the crop, and its picture."""

    number: int
    t_s: float
    jpeg: bytes


@dataclass(frozen=True)
class Clip:
    """A source clip, sampled.

    Args:
        rate_hz: frames a second, as the container says.
        first_frame: number of the clip's first frame in the source, from 0.
        start_s: source time of the first frame.
        end_s: source time at which the last frame ends, or the crop.
        shots: what is shown, in order; at least two.
    """

    video: Path
    sha256: str
    rate_hz: float
    first_frame: int
    start_s: float
    end_s: float
    shots: tuple[Shot, ...]

    @property
    def duration_s(self) -> float:
        return self.end_s - self.start_s

    @property
    def spacing_s(self) -> float:
        """The widest gap between two frames that are shown."""
        times = [shot.t_s for shot in self.shots]
        return max(b - a for a, b in pairwise(times))


def sample(video: Path, crop: Crop, advance: Callable[[], None] = lambda: None) -> Clip:
    """Decode the crop and keep the frames that are to be shown.

    Args:
        video: the source clip.
        crop: which part of it, and how many frames of which width.
        advance: called for each frame that is kept.

    Raises:
        InputError: it is no video, ends before it should, the crop lies outside it, is longer than
            any event may be, or holds fewer than two frames.
    """
    with Video(video) as source:
        info = source.info
        end_s = crop.end_s if crop.end_s is not None else _length_s(source, video, crop)
        _check_span(video, crop.start_s, end_s, info)
        shots: list[Shot] = []
        first, last = None, None
        step_s = 0.0
        for frame in source.frames(crop.start_s, end_s, 1):
            if first is None:
                first = frame
                step_s = (end_s - 1.0 / info.fps - first.time_s) / max(1, crop.frames - 1)
            last = frame
            if frame.time_s - first.time_s >= len(shots) * step_s - 0.5 / info.fps:
                shots.append(_shot(frame, first, crop.width_px))
                advance()
        if source.reached_s < end_s - 0.5 / info.fps:
            raise InputError(
                f"ends at {source.reached_s:.3f} s, before {end_s:.3f} s: it is truncated, or the "
                "crop goes beyond it",
                file=video,
                remedy="give an --end that it has, or a whole copy",
            )
    if first is None or last is None or len(shots) < 2:
        raise InputError(
            "has fewer than two frames in the crop", file=video, remedy="give a longer crop"
        )
    if shots[-1].number != last.number - first.number:
        shots[crop.frames - 1 :] = [_shot(last, first, crop.width_px)]
    return Clip(
        video=video,
        sha256=sha256_file(video),
        rate_hz=info.fps,
        first_frame=first.number,
        start_s=first.time_s,
        end_s=end_s,
        shots=tuple(shots),
    )


def _length_s(source: Video, path: Path, crop: Crop) -> float:
    """Return the length that the container states, else the one that decoding finds."""
    if source.info.frames:
        return source.info.frames / source.info.fps
    with Video(path) as again:
        for _ in again.frames(crop.start_s, None, 1_000_000):
            pass
        return again.reached_s


def _check_span(video: Path, start_s: float, end_s: float, info: VideoInfo) -> None:
    length_s = info.frames / info.fps
    if info.frames and max(start_s, end_s) > length_s + 1.0 / info.fps:
        raise InputError(
            f"the crop from {start_s:g} s to {end_s:g} s lies beyond the video",
            file=video,
            remedy=f"the video is {length_s:.3f} s long",
        )
    if start_s >= end_s:
        raise InputError(
            f"the crop from {start_s:g} s to {end_s:g} s is empty",
            file=video,
            remedy="give a --start that lies before its end",
        )
    if end_s - start_s > LONGEST_CLIP_S:
        raise InputError(
            f"the crop is {end_s - start_s:.1f} s long, more than {LONGEST_CLIP_S:g} s",
            file=video,
            remedy="give --start and --end around the event",
        )


def _shot(frame: VideoFrame, first: VideoFrame, width_px: int) -> Shot:
    # Only now, so that `ssp spec check` doesn't pay for OpenCV.
    import cv2

    image: NDArray[np.uint8] = frame.image
    height, width = image.shape[:2]
    if width > width_px:
        size = (width_px, max(1, round(height * width_px / width)))
        image = np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)
    encoded, data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
    if not encoded:
        raise RuntimeError(f"OpenCV could not encode frame {frame.number}")
    number, t_s = frame.number - first.number, round(frame.time_s - first.time_s, 6)
    return Shot(number, t_s, np.asarray(data).tobytes())


Sentence = Annotated[str, Field(min_length=1, max_length=10_000)]


class AnnotatedEvent(Strict):
    """The annotation of one event of a video."""

    description: Sentence
    justification: Sentence


class Annotation(Strict):
    """``{video_id, events: [{description, justification}]}``."""

    video_id: Annotated[str, Field(min_length=1, max_length=200)]
    events: Annotated[list[AnnotatedEvent], Field(min_length=1, max_length=100)]

    @property
    def text(self) -> str:
        """Return the text that a model may be shown: descriptions of what is visible only."""
        return "\n".join(f"- {event.description}" for event in self.events)


def load_annotation(path: Path) -> tuple[Annotation, str]:
    """Read an annotation and the hash of its file.

    Raises:
        InputError: it can't be read, or is no such annotation.
    """
    return load_model(Annotation, path), sha256_file(path)
