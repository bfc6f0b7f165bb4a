"""A session recorded as H.264 is evaluated like one recorded as JPEG."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import cast

import av
import cv2
import numpy as np
import pytest

from ssp_core.bag.pictures.images import decode_still
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.images import COMPRESSED_TYPE, VIDEO_TYPE, encode_video_message, read_image
from ssp_core.errors import InputError
from ssp_eval.labels.sheet import pictures
from ssp_eval.recordings.clip import Clip, Question

IMAGE = "/ssp/vut/front_camera/image/compressed"
BagMaker = Callable[..., Path]


def video_copy(source: Path, target: Path) -> Path:
    """The same session with its frames as H.264; a keyframe every 12 frames."""
    codec = cast(av.VideoCodecContext, av.CodecContext.create("libx264", "w"))
    codec.width, codec.height, codec.gop_size = 96, 54, 12
    codec.pix_fmt, codec.time_base = "yuv420p", Fraction(1, 10)
    codec.options = {"tune": "zerolatency", "crf": "12", "bf": "0"}
    with BagReader(source) as bag, BagWriter(target) as writer:
        for name in bag.attachments:
            writer.attach(name, bag.attachment(name) or b"", "text/plain")
        for topic, info in bag.topics.items():
            writer.add_topic(topic, VIDEO_TYPE if topic == IMAGE else info.msgtype)
        for number, message in enumerate(bag.messages()):
            data = message.data
            if message.topic == IMAGE:
                image = read_image(COMPRESSED_TYPE, data)
                picture = decode_still(image)
                frame = av.VideoFrame.from_ndarray(picture, format="bgr24")
                frame.pts = number
                (packet,) = codec.encode(frame)
                data = encode_video_message(image.stamp_ns, image.frame_id, bytes(packet), "h264")
            writer.write(message.topic, data, message.log_time_ns, message.publish_time_ns)
    shutil.copy(source / "verdict.json", target)
    return target


def test_requests_hold_the_same_frames(make_bag: BagMaker, tmp_path: Path) -> None:
    source = make_bag()
    with Clip(source) as one, Clip(video_copy(source, tmp_path / "video")) as other:
        for t_s in (0.0, 1.27, 8.5):
            asked, again = one.question(t_s), other.question(t_s)
            assert isinstance(asked, Question)
            assert isinstance(again, Question)
            assert asked.t_s == again.t_s
            frames = list(zip(asked.request.frames, again.request.frames, strict=True))
            assert [a.stamp_ns for a, _ in frames] == [b.stamp_ns for _, b in frames]
            for a, b in frames:
                shown = [
                    cv2.imdecode(np.frombuffer(f.jpeg, np.uint8), cv2.IMREAD_COLOR) for f in (a, b)
                ]
                assert cv2.PSNR(*shown) > 28.0
            # The frames differ from each other, so that the right one was decoded.
            last, first = frames[-1][1].jpeg, frames[0][1].jpeg
            assert len(frames) == 1 or last != first


def test_pictures_for_labels_come_from_video(make_bag: BagMaker, tmp_path: Path) -> None:
    source = make_bag()
    wanted = pictures(source, [0.5, 4.0])
    found = pictures(video_copy(source, tmp_path / "video"), [0.5, 4.0])
    for one, other in zip(wanted, found, strict=True):
        assert one is not None
        assert other is not None
        assert one.t_s == other.t_s
        assert cv2.PSNR(one.image, other.image) > 28.0


def test_a_video_that_can_t_be_decoded_is_named(make_bag: BagMaker, tmp_path: Path) -> None:
    video = video_copy(make_bag(), tmp_path / "video")
    with BagReader(video) as bag, BagWriter(tmp_path / "vp9") as writer:
        for name in bag.attachments:
            writer.attach(name, bag.attachment(name) or b"", "text/plain")
        for topic, info in bag.topics.items():
            writer.add_topic(topic, info.msgtype)
        for m in bag.messages():
            data = m.data
            if m.topic == IMAGE:
                data = encode_video_message(read_image(VIDEO_TYPE, data).stamp_ns, "c", b"x", "vp9")
            writer.write(m.topic, data, m.log_time_ns, m.publish_time_ns)
    with (
        Clip(tmp_path / "vp9") as clip,
        pytest.raises(InputError, match=f"{IMAGE}: .* video as 'vp9'; h264 and h265 are read"),
    ):
        clip.question(2.0)
