"""Frames of a topic as one image file each, or as a video that plays at the recorded times."""

from __future__ import annotations

import csv
from collections.abc import Callable
from pathlib import Path

from ssp_core.bag.frames import Frames, Picture, VideoFile
from ssp_core.bag.images import decode_still, encode_jpeg, encode_png, even_sized, suffix_of
from ssp_core.bag.reader import BagReader
from ssp_core.cdr.images import ImageMessage


class Losses:
    """Counts frames that are no pictures, and keeps what was wrong with the first."""

    def __init__(self) -> None:
        self.count = 0
        self.first = ""

    def __call__(self, log_time_ns: int, problem: str) -> None:
        self.count += 1
        self.first = self.first or f"at {log_time_ns} ns: {problem}"


def write_images(
    bag: BagReader,
    topic: str,
    folder: Path,
    suffix: str,
    span: tuple[int | None, int | None],
    losses: Losses,
    advance: Callable[[int], None],
) -> int:
    """Writes each frame as ``<number>_<stamp in ns>.<suffix>``, and ``index.csv`` beside them.

    What was recorded in the wanted format is copied byte for byte.

    Args:
        bag: open for reading.
        topic: of images.
        folder: to make.
        suffix: ``.jpg`` or ``.png``.
        span: first log time, and the first that no longer belongs.
        losses: is told what is no picture.
        advance: called with the number of frames written.

    Returns:
        Frames written.
    """
    folder.mkdir()
    frames = Frames(bag, topic, losses)
    count = 0
    with (folder / "index.csv").open("w", encoding="utf-8", newline="") as stream:
        index = csv.writer(stream, lineterminator="\n")
        index.writerow(["file", "stamp_ns", "log_time_ns"])

        def keep(stamp_ns: int, log_time_ns: int, data: bytes) -> None:
            nonlocal count
            name = f"{count:06d}_{stamp_ns}{suffix}"
            (folder / name).write_bytes(data)
            index.writerow([name, stamp_ns, log_time_ns])
            count += 1
            advance(1)

        if frames.is_video:
            for picture in frames.pictures(*span):
                keep(picture.stamp_ns, picture.log_time_ns, _encoded(picture, suffix))
            return count
        for message, image in frames.messages(*span):
            try:
                data = _file_bytes(image, message.log_time_ns, suffix)
            except ValueError as error:
                losses(message.log_time_ns, str(error))
                continue
            keep(image.stamp_ns, message.log_time_ns, data)
    return count


def _encoded(picture: Picture, suffix: str) -> bytes:
    return encode_jpeg(picture.image) if suffix == ".jpg" else encode_png(picture.image)


def _file_bytes(image: ImageMessage, log_time_ns: int, suffix: str) -> bytes:
    if image.layout is None and suffix_of(image.data) == suffix:
        return bytes(image.data)
    return _encoded(Picture(image.stamp_ns, log_time_ns, decode_still(image)), suffix)


def write_video(
    bag: BagReader,
    topic: str,
    stem: Path,
    span: tuple[int | None, int | None],
    losses: Losses,
    advance: Callable[[int], None],
) -> tuple[list[Path], int]:
    """Writes ``<stem>.mp4``, and ``<stem>.2.mp4`` and so on where the size of the frames changes.

    Args:
        bag: open for reading.
        topic: of images.
        stem: path without suffix.
        span: as in write_images.
        losses: is told what is no picture.
        advance: called with the number of frames written.

    Returns:
        The files, and the number of frames in them.
    """
    files: list[Path] = []
    video: VideoFile | None = None
    count = 0
    try:
        for picture in Frames(bag, topic, losses).pictures(*span):
            try:
                image = even_sized(picture.image)
            except ValueError as error:
                losses(picture.log_time_ns, str(error))
                continue
            size_px = (image.shape[1], image.shape[0])
            if video is None or video.size_px != size_px:
                if video is not None:
                    video.close()
                number = f".{len(files) + 1}" if files else ""
                files.append(stem.with_name(f"{stem.name}{number}.mp4"))
                video = VideoFile(files[-1], *size_px)
            video.add(Picture(picture.stamp_ns, picture.log_time_ns, image))
            count += 1
            advance(1)
    finally:
        if video is not None:
            video.close()
    return files, count
