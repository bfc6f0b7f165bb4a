"""The observer's page: frames of a recording beside a form, in one file that needs no network."""

from __future__ import annotations

import math
from base64 import b64encode
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ssp_core.bag.pictures.frames import Frames
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import peek_stamp_ns
from ssp_core.errors import InputError
from ssp_core.names import CAMERA_IMAGE, absolute
from ssp_eval.forms import form_page
from ssp_eval.observations.files import Footage
from ssp_eval.observations.questions import Card

QUALITY = 82
MOST_FRAMES = 600
WIDTH_PX = 960
_TOPIC = absolute(CAMERA_IMAGE)


@dataclass(frozen=True)
class PageFrame:
    """A frame of the page: its index in the recording, its clip time, and a JPEG."""

    index: int
    t_s: float
    jpeg: bytes


def select_frames(
    footage: Footage, rate_hz: float, start_s: float | None = None, end_s: float | None = None
) -> list[int]:
    """Return indices of the frames to show, rising; 600 at most.

    Args:
        footage: frames of the recording.
        rate_hz: every n-th frame, n as large as leaves at least so many a second.
        start_s: from this clip time; None: from the clip's start.
        end_s: to this clip time; None: to the last frame.

    Raises:
        InputError: no frame lies in the span.
    """
    start_s = 0.0 if start_s is None else start_s
    end_s = math.inf if end_s is None else end_s
    inside = [i for i, t_s in enumerate(footage.frames_s) if start_s <= t_s <= end_s]
    if not inside:
        raise InputError(
            f"has no frame from {start_s:g} to {end_s:g} s",
            remedy=f"its frames run from {footage.frames_s[0]:.3f} to {footage.frames_s[-1]:.3f} s",
        )
    every = 1
    if footage.period_s > 0.0:
        every = max(1, math.floor(1.0 / (footage.period_s * rate_hz) + 0.01))
    return inside[:: max(every, math.ceil(len(inside) / MOST_FRAMES))]


def page_frames(
    bag: Path,
    indices: list[int],
    footage: Footage,
    on_frame: Callable[[], None] = lambda: None,
) -> list[PageFrame]:
    """Return the frames as JPEG, at most WIDTH_PX wide.

    Args:
        bag: folder or MCAP file of the recording.
        indices: of the frames, rising.
        footage: the recording's frames, for their times.
        on_frame: called after each frame.

    Raises:
        InputError: one of them is no picture.
    """
    frames: dict[int, PageFrame] = {}
    with BagReader(bag) as reader:
        stamps = sorted(peek_stamp_ns(m.data) for m in reader.messages([_TOPIC]))
        index_of = {stamps[i]: i for i in indices}
        for picture in Frames(reader, _TOPIC).pictures(stamps=set(index_of)):
            i = index_of[picture.stamp_ns]
            if i in frames:
                continue
            image = picture.image
            height, width = image.shape[:2]
            if width > WIDTH_PX:
                size = WIDTH_PX, max(1, round(height * WIDTH_PX / width))
                image = np.asarray(
                    cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8
                )
            data = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1]
            frames[i] = PageFrame(i, footage.frames_s[i], data.tobytes())
            on_frame()
    return [frames[i] for i in indices if i in frames]


_TEMPLATE = Path(__file__).with_name("page.html.j2")


def render(
    draft: dict[str, Any], questions: Sequence[Card], frames: Sequence[PageFrame], bag: str
) -> str:
    """Return the page as HTML.

    Args:
        draft: an observation without answers.
        questions: cards in their order.
        frames: rising.
        bag: as it is named on the command line.
    """
    data = {
        "draft": draft,
        "cards": [card.model_dump(mode="json") for card in questions],
        "bag": bag,
        "frames": [
            {
                "n": frame.index,
                "t": round(frame.t_s, 6),
                "src": f"data:image/jpeg;base64,{b64encode(frame.jpeg).decode()}",
            }
            for frame in frames
        ],
    }
    return form_page(_TEMPLATE, data, recording=draft["recording"], digest=draft["bag_sha256"])
