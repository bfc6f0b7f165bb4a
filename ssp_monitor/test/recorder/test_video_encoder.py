"""Frames as H.264 and H.265: what goes in comes out, at the same times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest

from ssp_core.bag.pictures.frames import Frames, Picture, image_topics, is_keyframe, keyframe_before
from ssp_core.bag.pictures.images import Bgr
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage, serialize
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.images import COMPRESSED_TYPE, RAW_TYPE, VIDEO_TYPE, read_image
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_monitor.recorder.video_encoder import VideoEncoder
from tests.support.bags.messages import header, message, picture

TOPIC = "/ssp/vut/front_camera/image/compressed"
FRAME_NS = NS_PER_S // 25
START_NS = 1_700_000_000 * NS_PER_S


def scene(number: int, width: int = 320, height: int = 180) -> Bgr:
    """A road-like picture in which everything moves."""
    image = np.full((height, width, 3), (190, 150, 110), np.uint8)
    image[height // 2 :] = (70, 75, 80)
    x = (number * 5) % width
    cv2.rectangle(image, (x, height // 3), (x + 40, height * 2 // 3), (20, 30, 200), -1)
    cv2.circle(image, (width - x, height // 4), 14, (40, 220, 90), -1)
    return image


def jpeg_message(number: int, image: Bgr | None = None, data: bytes | None = None) -> BagMessage:
    stamp_ns = START_NS + number * FRAME_NS
    if data is None:
        data = cv2.imencode(".jpg", scene(number) if image is None else image)[1].tobytes()
    cdr = picture(data, stamp_ns, "camera_optical")
    return BagMessage(TOPIC, stamp_ns + 4_000_000, stamp_ns + 900, cdr, number + 7)


def raw_message(number: int, encoding: str) -> BagMessage:
    stamp_ns = START_NS + number * FRAME_NS
    image = scene(number)
    if encoding == "rgb8":
        image = cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    if encoding == "mono8":
        image = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY)
    height, width = image.shape[:2]
    cdr = serialize(
        message(
            RAW_TYPE,
            header=header(stamp_ns, "camera_optical"),
            height=height,
            width=width,
            encoding=encoding,
            is_bigendian=0,
            step=image.strides[0],
            data=image.reshape(-1),
        )
    )
    return BagMessage(TOPIC, stamp_ns, stamp_ns, cdr, number)


def encoded(
    encoder: VideoEncoder, messages: Sequence[BagMessage], problems: Sequence[str] = ()
) -> list[BagMessage]:
    """The video, without the pictures that can't be encoded."""
    found, said = [], []
    for given in messages:
        try:
            found += encoder.encode(given)
        except ValueError as error:
            said.append(str(error))
    assert len(said) == len(problems)
    assert all(problem in text for problem, text in zip(problems, said, strict=True))
    return found + encoder.finish()


def video_bag(path: Path, messages: Sequence[BagMessage]) -> Path:
    with BagWriter(path) as writer:
        writer.add_topic(TOPIC, VIDEO_TYPE)
        for m in messages:
            writer.write(m.topic, m.data, m.log_time_ns, m.publish_time_ns, m.sequence)
    return path


def pictures_of(
    path: Path, start_ns: int | None = None, stop_ns: int | None = None
) -> list[Picture]:
    with BagReader(path) as bag:
        return list(Frames(bag, TOPIC).pictures(start_ns, stop_ns))


def keyframes(messages: Sequence[BagMessage]) -> list[int]:
    images = [read_image(VIDEO_TYPE, m.data) for m in messages]
    return [i for i, image in enumerate(images) if is_keyframe(image.data, image.format)]


@pytest.mark.parametrize("codec", ["h264", "h265"])
def test_frames_keep_their_times_and_look_alike(tmp_path, codec):
    source = [jpeg_message(i) for i in range(70)]
    video = encoded(VideoEncoder(COMPRESSED_TYPE, codec), source)
    assert [m._replace(data=b"") for m in video] == [m._replace(data=b"") for m in source]
    assert sum(len(m.data) for m in video) < sum(len(m.data) for m in source) / 3
    assert keyframes(video) == [0, 25, 50]
    path = video_bag(tmp_path / "bag", video)
    with BagReader(path) as bag:
        assert image_topics(bag) == [TOPIC]
        first = bag.decode(next(iter(bag.messages([TOPIC]))))
        assert (first.frame_id, first.format) == ("camera_optical", codec)
        assert first.timestamp.sec == 1_700_000_000
    pictures = pictures_of(path)
    assert [p.stamp_ns for p in pictures] == [START_NS + i * FRAME_NS for i in range(70)]
    for i, shown_one in enumerate(pictures):
        assert cv2.PSNR(shown_one.image, scene(i)) > 32.0


def test_reading_begins_at_any_frame(tmp_path):
    video = encoded(VideoEncoder(COMPRESSED_TYPE), [jpeg_message(i) for i in range(80)])
    path = video_bag(tmp_path / "bag", video)
    whole = pictures_of(path)
    start_ns, stop_ns = video[47].log_time_ns, video[50].log_time_ns
    part = pictures_of(path, start_ns, stop_ns)
    assert [p.stamp_ns for p in part] == [p.stamp_ns for p in whole[47:50]]
    for one, other in zip(part, whole[47:50], strict=True):
        assert np.array_equal(one.image, other.image)
    with BagReader(path) as bag:
        assert keyframe_before(bag, TOPIC, start_ns) == video[25].log_time_ns
        assert keyframe_before(bag, TOPIC, video[25].log_time_ns) == video[25].log_time_ns
        assert keyframe_before(bag, TOPIC, video[0].log_time_ns - 1) is None
        jpegs = list(Frames(bag, TOPIC).jpegs(stamps={whole[3].stamp_ns}))
    assert [j.stamp_ns for j in jpegs] == [whole[3].stamp_ns]
    assert jpegs[0].data.startswith(b"\xff\xd8")


def test_a_keyframe_far_back_is_found(tmp_path, monkeypatch):
    monkeypatch.setattr("ssp_monitor.recorder.video_encoder.KEYFRAME_NS", 1000 * NS_PER_S)
    encoder = VideoEncoder(COMPRESSED_TYPE)
    video = encoded(encoder, [jpeg_message(i) for i in range(200)])
    assert keyframes(video) == [0]
    path = video_bag(tmp_path / "bag", video)
    assert [p.stamp_ns for p in pictures_of(path, video[199].log_time_ns)] == [
        START_NS + 199 * FRAME_NS
    ]


@pytest.mark.parametrize("encoding", ["rgb8", "bgr8", "mono8"])
def test_raw_images_keep_their_colours(tmp_path, encoding):
    encoder = VideoEncoder(RAW_TYPE)
    video = encoded(encoder, [raw_message(i, encoding) for i in range(3)])
    last = pictures_of(video_bag(tmp_path / "bag", video))[-1].image
    wanted = scene(2)
    if encoding == "mono8":
        wanted = cv2.cvtColor(cv2.cvtColor(wanted, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2BGR)
    assert cv2.PSNR(last, wanted) > 32.0
    # Flat parts show that no colours are exchanged and no range is mistaken.
    assert np.abs(last[5, 5].astype(int) - wanted[5, 5]).max() <= 3


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"", "neither JPEG nor PNG"),
        (b"GIF89a", "neither JPEG nor PNG"),
        (cv2.imencode(".jpg", scene(0))[1].tobytes()[:-200], "cut off"),
        (b"\xff\xd8\xff\xc0\x00\x11\x08\xff\xff\xff\xff\x03" + bytes(20), "65535 x 65535"),
        (b"\x89PNG\r\n\x1a\n", "cut off"),
        (b"\xff\xd8\xff\xc0\x00\x11\x08\x00\x10\x00\x10\x03\xff\xd9", "cut off"),
    ],
)
def test_a_damaged_frame_is_said_and_the_video_goes_on(tmp_path, data, problem):
    encoder = VideoEncoder(COMPRESSED_TYPE)
    source = [jpeg_message(0), jpeg_message(1, data=data), jpeg_message(2)]
    video = encoded(encoder, source, [problem])
    assert [m.sequence for m in video] == [7, 9]
    pictures = pictures_of(video_bag(tmp_path / "bag", video))
    assert [p.stamp_ns for p in pictures] == [START_NS, START_NS + 2 * FRAME_NS]
    assert cv2.PSNR(pictures[1].image, scene(2)) > 32.0


@pytest.mark.parametrize("cut", [0, 3, 20, 40])
def test_bytes_that_are_no_message_are_refused(cut):
    message = jpeg_message(0)
    with pytest.raises(ValueError, match=r"."):
        VideoEncoder(COMPRESSED_TYPE).encode(message._replace(data=message.data[:cut]))


def test_a_new_size_begins_with_a_keyframe(tmp_path):
    encoder = VideoEncoder(COMPRESSED_TYPE)
    sizes = [(320, 180)] * 3 + [(201, 99)] * 3 + [(320, 180)] * 3
    source = [jpeg_message(i, scene(i, *size)) for i, size in enumerate(sizes)]
    video = encoded(encoder, source)
    assert keyframes(video) == [0, 3, 6]
    pictures = pictures_of(video_bag(tmp_path / "bag", video))
    assert [p.image.shape[1::-1] for p in pictures] == [
        (w & ~1, h & ~1) for w, h in sizes
    ]  # the odd row and column are gone


def test_a_clock_that_is_set_back_gets_a_keyframe():
    times = [0, 1, 2, -50, -49, 3]
    source = [
        jpeg_message(i)._replace(log_time_ns=START_NS + t * FRAME_NS) for i, t in enumerate(times)
    ]
    assert keyframes(encoded(VideoEncoder(COMPRESSED_TYPE), source)) == [0, 3, 5]


def test_the_same_pictures_give_the_same_bytes():
    source = [jpeg_message(i) for i in range(5)]
    assert encoded(VideoEncoder(COMPRESSED_TYPE), source) == encoded(
        VideoEncoder(COMPRESSED_TYPE), source
    )


def test_frames_before_the_first_keyframe_are_left_out(tmp_path):
    video = encoded(VideoEncoder(COMPRESSED_TYPE), [jpeg_message(i) for i in range(40)])
    assert len(pictures_of(video_bag(tmp_path / "bag", video[10:]))) == 15


def test_a_damaged_video_frame_is_an_error_or_reported(tmp_path):
    video = encoded(VideoEncoder(COMPRESSED_TYPE), [jpeg_message(i) for i in range(40)])
    video[5] = video[5]._replace(data=video[5].data[:20])
    path = video_bag(tmp_path / "bag", video)
    with BagReader(path) as bag:
        with pytest.raises(
            InputError, match=f"{TOPIC}: has an invalid frame at {video[5].log_time_ns}"
        ):
            list(Frames(bag, TOPIC).pictures())
        told: list[int] = []
        frames = Frames(bag, TOPIC, lambda log_time_ns, _: told.append(log_time_ns))
        stamps = {p.stamp_ns for p in frames.pictures()}
    assert told == [video[5].log_time_ns]
    assert {START_NS + i * FRAME_NS for i in (4, 25, 39)} <= stamps
