"""Turns the images of a camera into H.264 or H.265 while they are recorded.

One message in, one message out, at the same times and with the same stamp, so that a bag with
video answers the same questions as one with JPEG. Nothing looks ahead, and a keyframe that brings
its parameter sets comes every second, so that a player and a reader can begin at any of them.
"""

from __future__ import annotations

from fractions import Fraction
from typing import cast

import av
from av.video.frame import PictureType
from av.video.reformatter import ColorRange, Colorspace

from ssp_core.bag.pictures.images import Bgr, decode_still, even_sized
from ssp_core.bag.types import BagMessage
from ssp_core.cdr.images import VIDEO_TYPE, ImageMessage, encode_video_message, read_image
from ssp_core.clock import NS_PER_S

CRF = 23  # about an eighth of a JPEG of quality 90 (docs/bag-tools.md)
KEYFRAME_NS = NS_PER_S  # longest time between keyframes

_COMMON = {"preset": "ultrafast", "tune": "zerolatency", "forced-idr": "1", "crf": str(CRF)}
# Keyframes come when we say so; one thread, so that the same pictures give the same bytes.
_X264 = "scenecut=0:keyint=infinite:bframes=0:threads=1"
_X265 = "scenecut=0:keyint=-1:bframes=0:repeat-headers=1:pools=none:frame-threads=1:log-level=none"


class VideoEncoder:
    """Encodes the images of one topic.

    When the size changes, the video goes on at the new size from a keyframe. Pictures with an odd
    width or height lose their last column or row, which 4:2:0 can't hold.

    Args:
        source_type: full name of the type that comes in, an image's.
        codec: ``h264``, which everything plays, or ``h265``, which is smaller and takes four times
            the CPU; the ``format`` of the message.
    """

    msgtype = VIDEO_TYPE

    def __init__(self, source_type: str, codec: str = "h264") -> None:
        self._source_type, self._codec = source_type, codec
        self._context: av.VideoCodecContext | None = None
        self._key_at_ns: int | None = None
        self._number = 0
        self._waiting: dict[int, tuple[BagMessage, ImageMessage]] = {}
        self._done: list[BagMessage] = []

    def encode(self, message: BagMessage) -> list[BagMessage]:
        """Return the frame as a CompressedVideo message.

        Raises:
            ValueError: it is damaged, or can't be encoded; the video goes on without it.
        """
        image = read_image(self._source_type, message.data)
        picture = even_sized(decode_still(image))
        height, width = picture.shape[:2]
        context = self._context
        if context is not None and (context.width, context.height) != (width, height):
            self._done = self.finish()
        try:
            self._done += self._encode(message, image, picture)
        except (av.error.FFmpegError, MemoryError) as error:
            self._waiting.pop(self._number - 1, None)
            self._context = None  # its state is unknown; the next frame is a keyframe
            raise ValueError(f"{width} x {height} px can't be encoded: {error}") from error
        messages, self._done = self._done, []
        return messages

    def finish(self) -> list[BagMessage]:
        """Return the messages that the encoder held back.

        Afterwards it begins anew with a keyframe.

        Raises:
            FFmpegError: it can't give that out.
        """
        context, self._context = self._context, None
        messages, self._done = self._done, []
        try:
            return messages if context is None else messages + self._messages(context.encode(None))
        finally:
            self._waiting.clear()

    def _encode(self, message: BagMessage, image: ImageMessage, picture: Bgr) -> list[BagMessage]:
        fresh = self._context is None
        if self._context is None:
            self._context = self._open(picture.shape[1], picture.shape[0])
        frame = av.VideoFrame.from_ndarray(picture, format="bgr24").reformat(
            format="yuv420p",
            dst_colorspace=Colorspace.SMPTE170M,
            dst_color_range=ColorRange.JPEG,
        )
        frame.pts = self._number
        since_ns = message.log_time_ns - (self._key_at_ns or 0)
        # A clock that was set back must not put the next keyframe off.
        if fresh or self._key_at_ns is None or not 0 <= since_ns < KEYFRAME_NS:
            frame.pict_type = PictureType.I
            self._key_at_ns = message.log_time_ns
        else:
            frame.pict_type = PictureType.NONE
        self._waiting[self._number] = (message, image)
        self._number += 1
        return self._messages(self._context.encode(frame))

    def _open(self, width_px: int, height_px: int) -> av.VideoCodecContext:
        name, private = {
            "h264": ("libx264", {"x264-params": _X264}),
            "h265": ("libx265", {"x265-params": _X265}),
        }[self._codec]
        context = cast(av.VideoCodecContext, av.CodecContext.create(name, "w"))
        context.width, context.height, context.pix_fmt = width_px, height_px, "yuv420p"
        context.time_base = Fraction(1, 1000)  # frames are numbered; their times are the messages'
        context.color_range, context.colorspace = ColorRange.JPEG, Colorspace.SMPTE170M
        context.thread_count = 1
        context.options = _COMMON | private
        context.open()
        return context

    def _messages(self, packets: list[av.Packet[av.VideoStream]]) -> list[BagMessage]:
        messages = []
        for packet in packets:
            waiting_frame = self._waiting.pop(packet.pts if packet.pts is not None else -1, None)
            if waiting_frame is None:
                continue
            message, image = waiting_frame
            data = encode_video_message(image.stamp_ns, image.frame_id, bytes(packet), self._codec)
            messages.append(message._replace(data=data))
        return messages
