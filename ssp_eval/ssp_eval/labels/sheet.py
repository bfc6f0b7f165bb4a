"""Contact sheets to label from: the frame at each label's time, from a bag or a video file."""

from __future__ import annotations

import json
from base64 import b64encode
from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field

from ssp_core.bag.pictures.images import encode
from ssp_core.clock import ns_to_seconds
from ssp_core.errors import InputError
from ssp_core.run_file.values import Finite
from ssp_core.templates import templates
from ssp_core.video import Video
from ssp_eval.data.labels import LABEL_KEYS
from ssp_eval.labels.truth import is_bag, video_times
from ssp_eval.recordings.clip import Clip, NoQuestion
from ssp_eval.score.thresholds import DEFAULT
from ssp_vla_bridge.window import Preprocessing

_TOLERANCE_S = 1e-6


@dataclass(frozen=True)
class Picture:
    """The newest frame at or before a clip time, BGR, and its own clip time."""

    t_s: float
    image: NDArray[np.uint8]


def pictures(path: Path, times_s: Sequence[float], start_s: float = 0.0) -> list[Picture | None]:
    """Return the frame at each clip time, None where there is none at or shortly before it.

    Args:
        path: a bag or a video.
        times_s: clip times, s.
        start_s: of a video, where its clip begins.

    Raises:
        InputError: it is neither, or a frame can't be decoded.
    """
    if is_bag(path):
        return _of_bag(path, times_s)
    return _of_video(path, times_s, start_s)


def _of_bag(path: Path, times_s: Sequence[float]) -> list[Picture | None]:
    frames: list[Picture | None] = []
    with Clip(path) as clip:
        for t_s in times_s:
            question = clip.question(t_s, Preprocessing(frames=1))
            if isinstance(question, NoQuestion):
                frames.append(None)
                continue
            frame = question.request.frames[-1]
            image = cv2.imdecode(np.frombuffer(frame.jpeg, np.uint8), cv2.IMREAD_COLOR)
            if image is None:
                raise InputError(
                    f"has an invalid frame at {question.t_s:.3f} s",
                    file=path,
                    remedy="give a recording whose frames can be decoded",
                )
            at_s = ns_to_seconds(frame.stamp_ns - clip.start_ns)
            frames.append(Picture(at_s, np.asarray(image, dtype=np.uint8)))
    return frames


def _of_video(path: Path, times_s: Sequence[float], start_s: float) -> list[Picture | None]:
    frames_s = video_times(path, start_s)
    first_s = frames_s[0]
    # Which of the clip's frames is wanted for each time, -1: none is recent enough.
    newest = [bisect_right(frames_s, first_s + t_s + _TOLERANCE_S) - 1 for t_s in times_s]
    indices = [
        i if DEFAULT.at_most(first_s + t_s - frames_s[i], DEFAULT.match_window_s) else -1
        for i, t_s in zip(newest, times_s, strict=True)
    ]
    images: dict[int, Picture] = {}
    with Video(path) as video:
        for i, frame in enumerate(video.frames(start_s, None, 1)):
            if i in indices:
                images[i] = Picture(frame.time_s - first_s, frame.image.copy())
    return [images.get(i) for i in indices]


LEAST_WIDTH_PX = 640
_SLOTS = tuple(key for key in LABEL_KEYS if key != "t_s")
_QUALITY = 90
_HERE = Path(__file__).parent


class Row(BaseModel):
    """One label: its time, and whatever else stands there."""

    model_config = ConfigDict(extra="allow")

    t_s: Finite

    @property
    def slots(self) -> dict[str, str]:
        """Its slots as text, "" where it says nothing."""
        return {slot: _text((self.model_extra or {}).get(slot)) for slot in _SLOTS}


class Rows(BaseModel):
    """A labels file, a template, or one that is half filled in, as far as a sheet needs it."""

    scenario: Any = None
    domain: Any = None
    event_version: Any = None
    labels: Annotated[list[Row], Field(min_length=1)]


def html_sheet(rows: Rows, pictures: Sequence[Picture | None], source: str) -> str:
    """Return a page with the frames side by side and their slots; a pressed frame fills the window.

    Args:
        rows: the labels, of one recording.
        pictures: one for each row, None where the clip has none.
        source: name of bag or video.
    """
    items = [
        {"t_s": row.t_s, "slots": row.slots, "picture": _picture_facts(picture)}
        for row, picture in zip(rows.labels, pictures, strict=True)
    ]
    return (
        templates(_HERE)
        .get_template("sheet.html.j2")
        .render(
            title=f"{_text(rows.scenario)}, {_text(rows.domain)}",
            version=_text(rows.event_version),
            source=source,
            items=items,
        )
    )


def _picture_facts(picture: Picture | None) -> dict[str, Any] | None:
    if picture is None:
        return None
    data = b64encode(encode(picture.image, ".jpg", _QUALITY)).decode()
    return {
        "uri": f"data:image/jpeg;base64,{data}",
        "t_s": picture.t_s,
        "width_px": max(LEAST_WIDTH_PX, picture.image.shape[1]),
    }


def _text(value: Any) -> str:
    if value is None or value == []:
        return ""
    if isinstance(value, list):
        return ", ".join(_text(item) for item in value)
    return value if isinstance(value, str) else json.dumps(value)
