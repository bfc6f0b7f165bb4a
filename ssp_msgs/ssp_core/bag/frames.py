"""The pictures of a bag by time, whether they were recorded as JPEG, raw or as video."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator
from dataclasses import dataclass

from ssp_core.bag.image_messages import IMAGE_TYPES, ImageMessage, read_image
from ssp_core.bag.message import BagMessage
from ssp_core.bag.reader import BagReader
from ssp_core.bag.still_images import JPEG_START, Bgr, decode_still, encode_jpeg
from ssp_core.bag.video_stream import Decoded, VideoDecoder, is_keyframe, to_bgr
from ssp_core.bag.video_type import VIDEO_TYPE
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError

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
    """Topics of a bag whose messages are images or frames of a video."""
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
        found = None
        for message in bag.messages([topic], start_ns, stop_ns):
            image = _image(bag, VIDEO_TYPE, message, lambda _, __: None)
            if image is not None and is_keyframe(image.data, image.format):
                found = message.log_time_ns
        if found is not None:
            return found
        stop_ns, span_ns = start_ns, 2 * span_ns
    return None


class Frames:
    """The frames of one image topic of an open bag.

    Args:
        bag: open for reading.
        topic: its messages are CompressedImage, Image or CompressedVideo.
        damaged: called for what is no picture, which is then left out; by default it is an error.

    Raises:
        InputError: the bag has no such topic, or it holds something else.
    """

    def __init__(self, bag: BagReader, topic: str, damaged: Damaged | None = None) -> None:
        info = bag.topics.get(topic)
        if info is None:
            raise InputError("is no topic of this bag", file=bag.path, field=topic)
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
        """Whether a frame needs those before it."""
        return self.msgtype == VIDEO_TYPE

    def messages(
        self, start_ns: int | None = None, stop_ns: int | None = None
    ) -> Iterator[tuple[BagMessage, ImageMessage]]:
        """The recorded images of a span of log times, nothing decoded."""
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
        """The pictures of a span, in the order of the bag.

        Of a video the frames from the keyframe before the span on are decoded too; those before
        the first keyframe of a bag can't be, and are left out.

        Args:
            start_ns: first log time.
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
        """As pictures, each as JPEG; what was recorded as JPEG is neither decoded nor changed."""
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
            yield from self._shown(ready, waiting)
        if decoder is not None:
            yield from self._shown(decoder.finish(), waiting)

    @staticmethod
    def _shown(ready: Iterable[Decoded], waiting: dict[int, tuple[int, int]]) -> Iterator[Picture]:
        for number, frame in ready:
            if number in waiting:
                stamp_ns, log_time_ns = waiting.pop(number)
                yield Picture(stamp_ns, log_time_ns, to_bgr(frame))

    def _refuse(self, log_time_ns: int, problem: str) -> None:
        raise InputError(
            f"holds a frame at {log_time_ns} ns that is none: {problem}",
            file=self.bag.path,
            field=self.topic,
        )


def _image(
    bag: BagReader, msgtype: str, message: BagMessage, damaged: Damaged
) -> ImageMessage | None:
    try:
        return read_image(msgtype, message.data)
    except ValueError as error:
        damaged(message.log_time_ns, str(error))
        return None
