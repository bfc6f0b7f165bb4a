"""Contact sheets of the evidence frames, for the person who decides."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files import make_folder, write_bytes
from ssp_core.hashing import sha256_file
from ssp_scenario_manager.event_spec.log import Record
from ssp_scenario_manager.event_spec.model import Event

COLUMNS = 3
TILE_PX = 640
MOST = 9


class Evidence:
    """Makes contact sheets on demand; without a video it makes none.

    Args:
        video: the source video, None: there is none at hand.
        first_frame: number of the clip's first frame in the video.
        start_s: its time.
    """

    def __init__(
        self, folder: Path, video: Path | None, first_frame: int = 0, start_s: float = 0.0
    ) -> None:
        self._folder = folder
        self._video = video
        self._first_frame = first_frame
        self._start_s = start_s
        self._frames: dict[int, tuple[float, Any]] = {}

    def prepare(self, wanted: Iterable[tuple[int, ...]]) -> None:
        """Decodes all frames that sheets will need, in one pass.

        Raises:
            InputError: the video can't be read.
        """
        if self._video is None:
            return
        from ssp_core.video import Video

        numbers = {n for frames in wanted for n in spread(frames)}
        last = max(numbers, default=-1)
        with Video(self._video) as video:
            for frame in video.frames(0.0, None, 1):
                number = frame.number - self._first_frame
                if number in numbers:
                    self._frames[number] = (frame.time_s - self._start_s, frame.image)
                if number >= last:
                    break

    def sheet(self, frames: tuple[int, ...]) -> Path | None:
        """The contact sheet of some frames; None without video or frames."""
        from ssp_core.bag.images import encode
        from ssp_core.video import Tile, contact_sheet

        tiles = [
            Tile(self._frames[n][1], (f"frame {n}, t = {self._frames[n][0]:.3f} s",))
            for n in spread(frames)
            if n in self._frames
        ]
        if not tiles:
            return None
        numbers = spread(frames)
        path = self._folder / f"frames-{numbers[0]:06d}-{numbers[-1]:06d}-{len(numbers)}.jpg"
        if not path.is_file():
            make_folder(self._folder)
            write_bytes(path, encode(contact_sheet(tiles, COLUMNS, TILE_PX), ".jpg", 90))
        return path


def spread(frames: tuple[int, ...]) -> tuple[int, ...]:
    """The frames to show: the evidence, with more between two ends of a span, at most nine."""
    if len(frames) == 2:
        first, last = frames
        count = min(6, last - first + 1)
        frames = tuple(
            sorted({round(first + k * (last - first) / max(1, count - 1)) for k in range(count)})
        )
    step = max(1.0, len(frames) / MOST)
    return tuple(frames[int(k * step)] for k in range(min(MOST, len(frames))))


def open_evidence(
    event: Event, log: Iterable[Record], video: Path | None, folder: Path
) -> Evidence:
    """Evidence of an event's clip.

    Raises:
        InputError: the video is another one.
    """
    if video is None:
        return Evidence(folder, None)
    if not video.is_file():
        raise InputError("is not there", file=video)
    digest = sha256_file(video)
    if event.source.sha256 not in (None, digest):
        raise InputError(
            "is not the video that the event was taken from",
            file=video,
            value=digest,
            remedy=f"give the file whose hash is {event.source.sha256}",
        )
    crop: Mapping[str, Any] = {}
    for record in log:
        if record.kind == "source" and record.subject == event.name:
            crop = record.details.get("crop") or {}
    try:
        first_frame, start_s = int(crop.get("first_frame", 0)), float(crop.get("start_s", 0.0))
    except (TypeError, ValueError) as error:
        raise InputError(f"the log's crop {crop!r} has no numbers in it") from error
    return Evidence(folder, video, first_frame, start_s)
