"""The pictures of a bag by time (JPEG, raw or video), and pictures as an MP4 file."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import numpy as np
from av.video.reformatter import ColorRange, Colorspace

from ssp_core.bag.pictures.images import MAX_PIXELS, Bgr, decode_still, encode_jpeg
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage
from ssp_core.cdr.images import IMAGE_TYPES, JPEG_START, VIDEO_TYPE, ImageMessage, read_image
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError

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
    """Tell whether decoding can begin with this frame: it brings its parameter sets, or is an IDR.

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
        """Return the pictures that are ready now.

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
            ready = self._select_waiting(self._codec.decode(packet))
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
        """Return the pictures that were held back; the next frame must be a keyframe."""
        try:
            ready = self._select_waiting(self._codec.decode(None)) if self._started else []
        except (av.error.FFmpegError, MemoryError):
            ready = []
        self._fresh()
        return ready

    def _select_waiting(self, frames: list[av.VideoFrame]) -> list[Decoded]:
        ready = []
        for frame in frames:
            if frame.pts in self._waiting:
                self._waiting.discard(frame.pts)
                ready.append((frame.pts, frame))
        return ready


def to_bgr(frame: av.VideoFrame) -> Bgr:
    """Return the pixels of a decoded frame."""
    return np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)


# Called with the log time of a frame that is no picture, and what is wrong with it.
Damaged = Callable[[int, str], None]


@dataclass(frozen=True, slots=True)
class Picture:
    """One decoded frame, BGR; the stamp is the camera's, the log time the recorder's."""

    stamp_ns: int
    log_time_ns: int
    image: Bgr


@dataclass(frozen=True, slots=True)
class Jpeg:
    """One frame as JPEG: the recorded bytes where it was recorded so, else encoded anew."""

    stamp_ns: int
    log_time_ns: int
    data: bytes


def image_topics(bag: BagReader) -> list[str]:
    """Return the topics of a bag whose messages are images or frames of a video."""
    return [name for name, info in bag.topics.items() if info.msgtype in IMAGE_TYPES]


def keyframe_before(bag: BagReader, topic: str, time_ns: int) -> int | None:
    """Log time of the last keyframe of a video topic at or before a time, None without one.

    Looks back over twice the time again and again, so that a keyframe nearby costs little.
    """
    begin_ns = bag.start_ns
    if begin_ns is None:
        return None
    stop_ns, span_ns = time_ns + 1, NS_PER_S
    while stop_ns > begin_ns:
        start_ns = max(begin_ns, stop_ns - span_ns)
        keyframe_ns = None
        for message in bag.messages([topic], start_ns, stop_ns):
            image = _image(bag, VIDEO_TYPE, message, lambda _, __: None)
            if image is not None and is_keyframe(image.data, image.format):
                keyframe_ns = message.log_time_ns
        if keyframe_ns is not None:
            return keyframe_ns
        stop_ns, span_ns = start_ns, 2 * span_ns
    return None


class Frames:
    """The frames of one image topic of an open bag.

    Args:
        topic: its messages are CompressedImage, Image or CompressedVideo.
        damaged: called for what is no picture, which is then left out; by default it is an error.

    Raises:
        InputError: the bag has no such topic, or it holds something else.
    """

    def __init__(self, bag: BagReader, topic: str, damaged: Damaged | None = None) -> None:
        info = bag.topics.get(topic)
        if info is None:
            raise InputError(
                "is no topic of this bag",
                file=bag.path,
                field=topic,
                remedy="`ssp bag info` lists them",
            )
        if info.msgtype not in IMAGE_TYPES:
            raise InputError(
                "holds no images",
                file=bag.path,
                field=topic,
                value=info.msgtype,
                remedy=f"{', '.join(IMAGE_TYPES)} are read",
            )
        self.bag, self.topic, self.msgtype = bag, topic, info.msgtype
        self._damaged = damaged or self._refuse

    @property
    def is_video(self) -> bool:
        """Tell whether a frame needs those before it."""
        return self.msgtype == VIDEO_TYPE

    def messages(
        self, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[tuple[BagMessage, ImageMessage]]:
        """Yield the recorded images of a span of log times, nothing decoded."""
        for message in self.bag.messages([self.topic], start_ns, stop_ns):
            image = _image(self.bag, self.msgtype, message, self._damaged)
            if image is not None:
                yield message, image

    def pictures(
        self,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        stamps: Collection[int] | None = None,
    ) -> Iterator[Picture]:
        """Yield the pictures of a span, in the order of the bag.

        Of a video the frames from the keyframe before the span on are decoded too; those before
        the first keyframe of a bag can't be, and are left out.

        Args:
            start_ns: first log time; None: the beginning of the bag.
            stop_ns: the first log time that is no longer given.
            stamps: only pictures with these stamps.

        Raises:
            InputError: a frame is damaged, unless ``damaged`` was given.
        """
        if self.is_video:
            yield from self._video(start_ns, stop_ns, stamps)
            return
        for message, image in self.messages(start_ns, stop_ns):
            if stamps is None or image.stamp_ns in stamps:
                try:
                    yield Picture(image.stamp_ns, message.log_time_ns, decode_still(image))
                except ValueError as error:
                    self._damaged(message.log_time_ns, str(error))

    def jpegs(
        self,
        start_ns: int | None = None,
        stop_ns: int | None = None,
        stamps: Collection[int] | None = None,
    ) -> Iterator[Jpeg]:
        """Yield the pictures as JPEG; one recorded as JPEG is neither decoded nor changed."""
        if self.is_video:
            for picture in self._video(start_ns, stop_ns, stamps):
                yield Jpeg(picture.stamp_ns, picture.log_time_ns, encode_jpeg(picture.image))
            return
        for message, image in self.messages(start_ns, stop_ns):
            if stamps is not None and image.stamp_ns not in stamps:
                continue
            data = bytes(image.data)
            if image.layout is not None or not data.startswith(JPEG_START):
                try:
                    data = encode_jpeg(decode_still(image))
                except ValueError as error:
                    self._damaged(message.log_time_ns, str(error))
                    continue
            yield Jpeg(image.stamp_ns, message.log_time_ns, data)

    def _video(
        self, start_ns: int | None, stop_ns: int | None, stamps: Collection[int] | None
    ) -> Iterator[Picture]:
        key_ns = None if start_ns is None else keyframe_before(self.bag, self.topic, start_ns)
        decoder: VideoDecoder | None = None
        waiting: dict[int, tuple[int, int]] = {}
        first_ns = start_ns if key_ns is None else key_ns
        for number, (message, image) in enumerate(self.messages(first_ns, stop_ns)):
            if decoder is None or decoder.form != image.format:
                try:
                    decoder = VideoDecoder(image.format)
                except ValueError as error:
                    self._damaged(message.log_time_ns, str(error))
                    continue
            inside = start_ns is None or message.log_time_ns >= start_ns
            if inside and (stamps is None or image.stamp_ns in stamps):
                waiting[number] = (image.stamp_ns, message.log_time_ns)
            try:
                ready = decoder.decode(number, image.data)
            except ValueError as error:
                waiting.clear()
                self._damaged(message.log_time_ns, str(error))
                continue
            yield from self._decoded_pictures(ready, waiting)
        if decoder is not None:
            yield from self._decoded_pictures(decoder.finish(), waiting)

    @staticmethod
    def _decoded_pictures(
        ready: Iterable[Decoded], waiting: dict[int, tuple[int, int]]
    ) -> Iterator[Picture]:
        for number, frame in ready:
            if number in waiting:
                stamp_ns, log_time_ns = waiting.pop(number)
                yield Picture(stamp_ns, log_time_ns, to_bgr(frame))

    def _refuse(self, log_time_ns: int, problem: str) -> None:
        raise InputError(
            f"has an invalid frame at {log_time_ns} ns: {problem}",
            file=self.bag.path,
            field=self.topic,
            remedy="record the bag again",
        )


def _image(
    _bag: BagReader, msgtype: str, message: BagMessage, damaged: Damaged
) -> ImageMessage | None:
    try:
        return read_image(msgtype, message.data)
    except ValueError as error:
        damaged(message.log_time_ns, str(error))
        return None


# Of an MP4; fine enough for any camera, and what players reckon with.
_TICKS_PER_S = 90_000
# In a quarter of the time that x264's default preset takes, files are half as large again.
_X264 = {"crf": "18", "preset": "superfast"}


class VideoFile:
    """An MP4 (H.264) whose frames are shown at the times at which they were taken.

    Args:
        width_px: even.
        height_px: even.
    """

    def __init__(self, path: Path, width_px: int, height_px: int) -> None:
        self.size_px = (width_px, height_px)
        self._container = av.open(str(path), "w", format="mp4")
        self._stream = self._container.add_stream("libx264", options=_X264)
        self._stream.width, self._stream.height = self.size_px
        self._stream.pix_fmt = "yuv420p"
        codec = self._stream.codec_context
        codec.time_base = self._stream.time_base = Fraction(1, _TICKS_PER_S)
        codec.color_range, codec.colorspace = ColorRange.MPEG, Colorspace.ITU709
        codec.thread_count = 2
        self._last: tuple[int, int] | None = None
        self._ticks = 0

    def add(self, picture: Picture) -> None:
        """Append a frame of this size.

        Where a stamp does not rise, since the camera has none, the time that passed for the
        recorder counts.
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
        """Write what was held back, and the index."""
        self._container.mux(self._stream.encode(None))
        self._container.close()
