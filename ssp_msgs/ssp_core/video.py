"""Decodes a video file frame by frame, with the times in the file; lays frames out as a sheet."""

from __future__ import annotations

import math
import os
import statistics
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import av
import cv2
import numpy as np
from numpy.typing import NDArray

from ssp_core.closing import Closing
from ssp_core.errors import InputError

# OpenCV and the FFmpeg inside it write to standard error on their own; our message says what is
# wrong. FFmpeg's level is read when a file is opened.
os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)


MAX_FPS = 1000.0
# So many packets in a row that can't be decoded are passed over.
_MOST_LOST = 100
# Two statements of a file about its rate or its length may differ by this share, and lengths by as
# many frames.
_SLACK, _SLACK_FRAMES = 0.02, 3
# A step this many times the median one, or this small a part of it, is no frame that was dropped.
_STEP = 10.0
# A box of that size describes more frames than anybody imports.
_MOST_MOOV = 1 << 28
# Errors that a decoder would otherwise patch up.
_STRICT = {"err_detect": "crccheck+bitstream+buffer+explode"}


@dataclass(frozen=True, slots=True)
class VideoInfo:
    """The container's statements: size in px, mean frames per second, number of frames.

    Args:
        width_px: of the picture as it is shown, with square pixels.
        stored_px: width and height in the file, where pixels aren't square; None: they are.
        offset_s: time of the first frame on the container's time line.
    """

    width_px: int
    height_px: int
    fps: float
    frames: int
    stored_px: tuple[int, int] | None = None
    offset_s: float = 0.0


class VideoFrame(NamedTuple):
    """One decoded frame, BGR, upright and with square pixels.

    The number counts from 0; the time is that of the container, of which a first frame may be late.
    """

    number: int
    time_s: float
    image: NDArray[np.uint8]


class Video(Closing):
    """An open video file; a context manager.

    Raises:
        InputError: it isn't there, is no video that can be decoded, or has several tracks.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.reached_s = 0.0  # end of the last frame that frames() has come to
        if not path.is_file():
            problem = "is no file" if path.exists() else "is not there"
            raise InputError(problem, file=path, remedy="name a video file, such as a .mp4")
        self._capture = cv2.VideoCapture(str(path), cv2.CAP_FFMPEG)
        fps = self._capture.get(cv2.CAP_PROP_FPS) if self._capture.isOpened() else 0.0
        if not (math.isfinite(fps) and 0.0 < fps <= MAX_FPS):
            self._capture.release()
            raise InputError(
                "is no video that can be decoded",
                file=path,
                remedy="common formats such as MP4 (H.264) or AVI will do",
            )
        try:
            offset_s = _first_time_s(path)
        except InputError:
            self._capture.release()
            raise
        stored_px = (
            int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH)),
            int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT)),
        )
        shown_px = _square(stored_px, self._pixel_aspect())
        self.info = VideoInfo(
            *shown_px,
            fps=fps,
            frames=max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT))),
            stored_px=None if shown_px == stored_px else stored_px,
            offset_s=offset_s,
        )

    def _pixel_aspect(self) -> float:
        """Return the width of a shown pixel over its height; 1 where the file doesn't say."""
        width = self._capture.get(cv2.CAP_PROP_SAR_NUM)
        height = self._capture.get(cv2.CAP_PROP_SAR_DEN)
        if not (width > 0 and height > 0):
            return 1.0
        is_turned = self._capture.get(cv2.CAP_PROP_ORIENTATION_META) % 180 == 90
        return height / width if is_turned else width / height

    def frames(
        self, start_s: float, end_s: float | None, keep: int | Callable[[float], bool] = 1
    ) -> Iterator[VideoFrame]:
        """Yield the frames of a span.

        Args:
            keep: every n-th one, counted from the first; or whether the one at a time, s, is kept.
            start_s: the first frame is the first one not before this time.
            end_s: frames from this time on are left out, None: no end.

        Raises:
            InputError: the file's frame times don't rise, or a frame can't be decoded.
        """
        slack_s = 0.01 / self.info.fps  # containers round times to their own ticks
        number, previous_s, first = -1, -math.inf, None
        while self._goes_on(self.info.frames - number - 1):
            number += 1
            time_s = self.info.offset_s + self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1000.0
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
            if (number - first) % keep == 0 if isinstance(keep, int) else keep(time_s):
                decoded, image = self._capture.retrieve()
                if not decoded:
                    raise InputError(
                        f"frame {number} can't be decoded",
                        file=self.path,
                        remedy="give a whole copy of the video",
                    )
                if self.info.stored_px is not None:
                    size_px = self.info.width_px, self.info.height_px
                    image = cv2.resize(image, size_px, interpolation=cv2.INTER_CUBIC)
                yield VideoFrame(number, time_s, np.asarray(image, dtype=np.uint8))

    def _goes_on(self, missing: int) -> bool:
        """Go to the next frame, past damaged packets while frames of the file are missing."""
        grab = self._capture.grab
        return grab() or any(grab() for _ in range(min(missing, _MOST_LOST)))

    def close(self) -> None:
        self._capture.release()


# Pixels whose sides differ by less are square: encoders round.
_SQUARE = 0.005
# Their time line begins anywhere; the first stamp of all is its zero.
_STREAMED = ("mpegts", "mpeg", "rtsp", "flv")


def _square(stored_px: tuple[int, int], aspect: float) -> tuple[int, int]:
    """Return the size of a picture with square pixels, none of which is lost."""
    width_px, height_px = stored_px
    if abs(aspect - 1.0) < _SQUARE or not 0.1 < aspect < 10.0:
        return stored_px
    if aspect > 1.0:
        return round(width_px * aspect), height_px
    return width_px, round(height_px / aspect)


def _zero_s(container: av.container.InputContainer) -> float:
    """Find where the time line of a container begins, on the clock of its stamps."""
    if container.format.name in _STREAMED and container.start_time is not None:
        return container.start_time / 1e6
    return 0.0


def _first_time_s(path: Path) -> float:
    """Return the time of a video's first frame on the container's time line.

    Raises:
        InputError: it has several video tracks.
    """
    try:
        with av.open(str(path)) as container:
            cover = av.stream.Disposition.attached_pic
            tracks = [one for one in container.streams.video if not one.disposition & cover]
            if len(tracks) > 1:
                default = av.stream.Disposition.default
                listed = ", ".join(
                    f"{one.index} of {one.width}x{one.height} px"
                    + (" (default)" if one.disposition & default else "")
                    for one in tracks
                )
                raise InputError(
                    f"has {len(tracks)} video tracks: {listed}",
                    file=path,
                    remedy=f"make a file of the one that is meant: ffmpeg -i {path.name} "
                    "-map 0:NUMBER -c copy one.mp4",
                )
            if not tracks or tracks[0].start_time is None or tracks[0].time_base is None:
                return 0.0
            first_s = float(tracks[0].start_time * tracks[0].time_base)
            return max(0.0, first_s - _zero_s(container))
    except (av.error.FFmpegError, ValueError, OverflowError):
        return 0.0  # whoever decodes it says what is wrong


@dataclass(frozen=True, slots=True)
class Soundness:
    """The findings of strict decoding.

    They are the times of frames, and errors of packets or frames among them.
    """

    times_s: tuple[float, ...]
    damaged: int

    @property
    def frames(self) -> int:
        return len(self.times_s)


def sound_video(path: Path, end_s: float | None = None) -> Soundness:
    """Decode a video strictly, count the decoder's errors and check its time axis.

    Args:
        path: of the video.
        end_s: frames after this time aren't looked at, None: all are.

    Raises:
        InputError: it can't be decoded at all, or its time axis can't be: times that don't rise or
            leap, or a rate or length that its frames or another part of its header contradict.
    """
    damaged, times_s, is_whole = 0, list[float](), True
    try:
        with av.open(str(path)) as container:
            stream = container.streams.video[0]
            if not stream.codec_context:  # of a codec that nobody knows
                raise ValueError("its codec isn't known")
            stream.codec_context.thread_count = 1
            stream.codec_context.options = _STRICT
            rate, scale = float(stream.average_rate or 0), stream.time_base
            if not (scale and scale > 0 and 0.0 < rate <= MAX_FPS):
                raise _no_axis(path, f"it says {rate:g} frames per second in units of {scale} s")
            for packet in container.demux(stream):
                damaged += packet.is_corrupt
                try:
                    for frame in packet.decode():
                        damaged += frame.is_corrupt
                        if frame.time is None:
                            raise _no_axis(path, f"frame {len(times_s)} has no time")
                        times_s.append(frame.time - _zero_s(container))
                except av.error.FFmpegError:
                    damaged += 1
                if end_s is not None and times_s and times_s[-1] > end_s:
                    is_whole = False
                    break
            lengths_s = [
                float(one.duration * one.time_base)
                for one in container.streams
                if one.duration is not None and one.time_base
            ]
            length_s = None if container.duration is None else container.duration / 1e6
            own_s = length_s if len(container.streams) == 1 else None
            if stream.duration is not None:
                own_s = float(stream.duration * scale)
            told_frames = stream.frames  # a closed container says nothing
    except (av.error.FFmpegError, IndexError, ValueError, OverflowError) as error:
        raise InputError(
            f"is no video that can be decoded: {error}",
            file=path,
            remedy="common formats such as MP4 (H.264) or AVI will do",
        ) from error
    slack_s = (_SLACK_FRAMES + damaged) / rate
    if not times_s:
        raise InputError(
            "has no frame that can be decoded",
            file=path,
            remedy="give a video that ffmpeg can decode",
        )
    if is_whole and 2 * (len(times_s) + damaged) < told_frames:
        raise _no_axis(path, f"of {told_frames} frames it shows {len(times_s)}")
    if why := _against_times(times_s, rate, slack_s):
        raise _no_axis(path, why)
    shown_s = times_s[-1] - times_s[0] + 1.0 / rate if is_whole else None
    longest_s = max(lengths_s, default=None)
    why = _against_length(shown_s, own_s, times_s[0], slack_s, "its frames")
    why = why or _against_length(longest_s, length_s, times_s[0], slack_s, "its streams")
    if why:
        raise _no_axis(path, why)
    avi_fps = _avi_rate(path)
    if avi_fps is not None and abs(avi_fps / rate - 1.0) > _SLACK:
        raise _no_axis(path, f"it says {avi_fps:g} and {rate:g} frames per second")
    if why := _against_moov(path, slack_s):
        raise _no_axis(path, why)
    return Soundness(tuple(times_s), damaged)


def _against_length(
    found_s: float | None, told_s: float | None, first_s: float, slack_s: float, what: str
) -> str:
    """Say how a length contradicts the one that is stated; empty: it doesn't, or isn't known."""
    if found_s is None or told_s is None:
        return ""
    # Some count from the first frame, some from the beginning of the time line.
    off_s = min(abs(found_s - told_s), abs(found_s + first_s - told_s))
    if off_s <= max(slack_s, _SLACK * max(found_s, told_s)):
        return ""
    return f"it says {told_s:.3f} s, and {what} last {found_s:.3f} s"


def _against_times(times_s: Sequence[float], rate: float, slack_s: float) -> str:
    """Say which of the frames' times can't be; empty: none."""
    steps_s = [b - a for a, b in pairwise(times_s)]
    if not steps_s:
        return ""
    least_s, median_s, most_s = min(steps_s), statistics.median(steps_s), max(steps_s)
    if least_s <= 0.0:
        number = steps_s.index(least_s) + 1
        return f"frame {number} is not later than the one before it ({times_s[number]:.6f} s)"
    if most_s > max(_STEP * median_s, slack_s) or least_s < median_s / _STEP:
        return f"its frames are {least_s:.6f} to {most_s:.6f} s apart"
    span_s = times_s[-1] - times_s[0]
    if abs(span_s - len(steps_s) / rate) > max(slack_s, _SLACK * span_s):
        return f"it says {rate:g} frames per second, its frames come at {len(steps_s) / span_s:g}"
    return ""


def _avi_rate(path: Path) -> float | None:
    """Return the rate in an AVI's main header, which FFmpeg doesn't read, in frames per second.

    None: it has none.
    """
    with open(path, "rb") as stream:
        head = stream.read(4096)
    at = head.find(b"avih")
    if head[:4] != b"RIFF" or not 0 < at <= len(head) - 12:
        return None
    period_us = int(struct.unpack_from("<I", head, at + 8)[0])
    return 1e6 / period_us if period_us else None


def _boxes(data: bytes) -> dict[bytes, list[bytes]]:
    """Return the boxes of an MP4 or of one of its boxes by name, but for what is cut off."""
    boxes: dict[bytes, list[bytes]] = {}
    at = 0
    while at + 8 <= len(data):
        size, name = struct.unpack_from(">I4s", data, at)
        if size < 8 or at + size > len(data):
            break
        boxes.setdefault(name, []).append(data[at + 8 : at + size])
        at += size
    return boxes


def _moov(path: Path) -> bytes:
    """Return the box of an MP4 that describes its tracks; empty where there is none."""
    with open(path, "rb") as stream:
        while len(head := stream.read(16)) >= 8:
            size, name = struct.unpack_from(">I4s", head)
            if size == 1 and len(head) == 16:
                size = struct.unpack_from(">Q", head, 8)[0]
            if size < 8 or (name == b"moov" and size > _MOST_MOOV):
                break
            if name == b"moov":
                return (head[8:] + stream.read(size - 16))[: size - 8]
            stream.seek(size - len(head), os.SEEK_CUR)
    return b""


def _against_moov(path: Path, slack_s: float) -> str:
    """Say where an MP4 states its lengths in units that contradict each other; empty: nowhere.

    FFmpeg works with some of them and lets the others be.
    """

    def length_s(box: bytes) -> float | None:
        """Read the length that mvhd or mdhd states; None: it states none."""
        scale, length = struct.unpack_from(*((">IQ", box, 20) if box[0] else (">II", box, 12)))
        if scale == 0:
            raise ZeroDivisionError
        return length / scale if 0 < length < 2**32 - 1 else None

    def agree(a_s: float | None, b_s: float | None) -> bool:
        return a_s is None or b_s is None or abs(a_s - b_s) <= max(slack_s, _SLACK * max(a_s, b_s))

    try:
        movie = _boxes(_moov(path))
        if b"mvhd" not in movie or b"mvex" in movie:
            return ""
        (head,) = movie[b"mvhd"]
        whole_s, scale = length_s(head), struct.unpack_from(">I", head, 20 if head[0] else 12)[0]
        tracks_s = []
        for track in map(_boxes, movie[b"trak"]):
            media = _boxes(track[b"mdia"][0])
            (track_head,), (media_head,) = track[b"tkhd"], media[b"mdhd"]
            form, at = (">Q", 28) if track_head[0] else (">I", 20)
            tracks_s.append(struct.unpack_from(form, track_head, at)[0] / scale)
            if media[b"hdlr"][0][8:12] != b"vide":
                continue
            media_s = length_s(media_head)
            steps = _boxes(_boxes(media[b"minf"][0])[b"stbl"][0])[b"stts"][0]
            units = sum(a * b for a, b in struct.iter_unpack(">II", steps[8:]))
            of_frames_s = (
                units / struct.unpack_from(">I", media_head, 20 if media_head[0] else 12)[0]
            )
            if not agree(media_s, of_frames_s):
                return f"its header says {media_s:.3f} s, and its frames last {of_frames_s:.3f} s"
            if b"edts" not in track and not agree(media_s, tracks_s[-1]):
                return f"its track says {tracks_s[-1]:.3f} s, and its frames last {media_s:.3f} s"
            for one in track.get(b"edts", []):
                edits = _boxes(one)[b"elst"][0]
                if why := _against_edits(edits, scale, of_frames_s, units, slack_s):
                    return why
        if not agree(whole_s, max(tracks_s)):
            return f"it says {whole_s:.3f} s, and its tracks {max(tracks_s):.3f} s"
    except ZeroDivisionError:
        return "it has a time scale of 0"
    except (struct.error, KeyError, IndexError, ValueError):
        return "its header can't be read"
    return ""


def _against_edits(edits: bytes, scale: int, media_s: float, units: int, slack_s: float) -> str:
    """Say whether an MP4's edit list shows more than there is or, where it shows all, less."""
    form = ">QqI" if edits[0] else ">IiI"
    segments = [
        (a / scale, start) for a, start, _ in struct.iter_unpack(form, edits[8:]) if start >= 0
    ]
    total_s = sum(length_s for length_s, _ in segments)
    slack_s = max(slack_s, _SLACK * media_s)
    is_all = len(segments) == 1 and segments[0][1] * media_s <= slack_s * units
    if total_s > media_s + slack_s or (is_all and total_s < media_s - slack_s):
        return f"its edit list shows {total_s:.3f} s of {media_s:.3f} s"
    return ""


def _no_axis(path: Path, why: str) -> InputError:
    return InputError(
        f"has a time axis that can't be: {why}",
        file=path,
        remedy="get the file again from its source, or re-encode it with a constant frame rate",
    )


Image = NDArray[np.uint8]

_MARGIN_PX = 8
_LINE_PX = 22
_BACKGROUND = 250
_FONT = cv2.FONT_HERSHEY_SIMPLEX


@dataclass(frozen=True)
class Tile:
    """One frame, BGR, and the lines of text above it (ASCII; other characters become ?)."""

    image: Image
    lines: tuple[str, ...]


def contact_sheet(tiles: Sequence[Tile], columns: int, tile_width_px: int) -> Image:
    """Draw all tiles in rows, scaled to one width with their aspect ratio kept.

    Args:
        tiles: at least one; a row is as high as its highest tile.
        columns: tiles in a row.
        tile_width_px: of each frame.

    Raises:
        ValueError: there is no tile.
    """
    if not tiles:
        raise ValueError("a contact sheet needs a frame")
    thumbnails = [_draw(tile, tile_width_px) for tile in tiles]
    columns = min(columns, len(thumbnails))
    rows = [thumbnails[i : i + columns] for i in range(0, len(thumbnails), columns)]
    width = columns * (tile_width_px + _MARGIN_PX) + _MARGIN_PX
    height = sum(max(t.shape[0] for t in row) + _MARGIN_PX for row in rows) + _MARGIN_PX
    sheet = np.full((height, width, 3), _BACKGROUND, np.uint8)
    top = _MARGIN_PX
    for row in rows:
        for i, tile in enumerate(row):
            left = _MARGIN_PX + i * (tile_width_px + _MARGIN_PX)
            sheet[top : top + tile.shape[0], left : left + tile_width_px] = tile
        top += max(t.shape[0] for t in row) + _MARGIN_PX
    return sheet


def _draw(tile: Tile, width_px: int) -> Image:
    height, width = tile.image.shape[:2]
    size = (width_px, max(1, round(height * width_px / width)))
    grows = width_px > width
    how = cv2.INTER_CUBIC if grows else cv2.INTER_AREA
    frame = np.asarray(cv2.resize(tile.image, size, interpolation=how), dtype=np.uint8)
    head = np.full((_LINE_PX * len(tile.lines), width_px, 3), _BACKGROUND, np.uint8)
    for i, line in enumerate(tile.lines):
        text = line.encode("ascii", "replace").decode()
        at = (2, _LINE_PX * i + _LINE_PX - 6)
        cv2.putText(head, text, at, _FONT, _scale(text, width_px), (20, 20, 20), 1, cv2.LINE_AA)
    return np.vstack([head, frame])


def _scale(text: str, width_px: int) -> float:
    """Return the usual size, or as much smaller as the line needs to fit."""
    (needed, _), _ = cv2.getTextSize(text, _FONT, 0.55, 1)
    return 0.55 if needed <= width_px - 4 else 0.55 * (width_px - 4) / needed
