"""Images in messages from anywhere: read as they are, or refused with a ValueError."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.bag.pictures.images import (
    MAX_PIXELS,
    decode_still,
    encode,
    encode_jpeg,
    even_sized,
    size_px,
    suffix_of,
)
from ssp_core.bag.types import serialize, typestore
from ssp_core.cdr.images import (
    COMPRESSED_TYPE,
    IMAGE_TYPES,
    RAW_TYPE,
    VIDEO_TYPE,
    ImageMessage,
    RawLayout,
    encode_video_message,
    read_image,
)
from tests.support.bags.messages import header, picture

PICTURE = np.arange(30 * 20 * 3, dtype=np.uint8).reshape(20, 30, 3)


def example(msgtype: str, frame: str = "cam", data: bytes = b"\xff\xd8abc") -> bytes:
    types, pixels = typestore().types, np.frombuffer(data, np.uint8)
    if msgtype == COMPRESSED_TYPE:
        return picture(data, 7 * 10**9 + 8, frame)
    if msgtype == RAW_TYPE:
        return serialize(
            types[msgtype](
                header=header(7 * 10**9 + 8, frame),
                height=2,
                width=3,
                encoding="mono8",
                is_bigendian=0,
                step=4,
                data=pixels,
            )
        )
    stamp = types["builtin_interfaces/msg/Time"](sec=7, nanosec=8)
    return serialize(types[msgtype](timestamp=stamp, frame_id=frame, data=pixels, format="h264"))


@settings(deadline=None)
@given(st.sampled_from(IMAGE_TYPES), st.text(max_size=9), st.binary(max_size=20))
def test_messages_are_read_as_they_were_written(msgtype: str, frame: str, data: bytes) -> None:
    frame = frame.replace("\0", "")
    image = read_image(msgtype, example(msgtype, frame, data))
    assert (image.stamp_ns, image.frame_id, bytes(image.data)) == (7_000_000_008, frame, data)
    if msgtype == RAW_TYPE:
        assert (image.layout, image.format) == (RawLayout(3, 2, 4), "mono8")


@settings(deadline=None)
@given(st.text(max_size=9), st.binary(max_size=20))
def test_video_messages_are_those_of_the_typestore(frame: str, data: bytes) -> None:
    frame = frame.replace("\0", "")
    written = encode_video_message(7_000_000_008, frame, data, "h264")
    assert written == example(VIDEO_TYPE, frame, data)
    # A newer definition has more fields at its end.
    assert bytes(read_image(VIDEO_TYPE, written + b"more fields").data) == data


@settings(deadline=None)
@given(st.sampled_from(IMAGE_TYPES), st.binary(max_size=120), st.integers(0, 60), st.binary())
def test_spoiled_messages_raise_nothing_but_value_errors(
    msgtype: str, noise: bytes, at: int, spoiled: bytes
) -> None:
    whole = example(msgtype)
    for data in (noise, whole[:at], whole[:at] + spoiled + whole[at + len(spoiled) :]):
        try:
            image = read_image(msgtype, data)
        except ValueError:
            continue
        assert len(image.data) <= len(data)
        if msgtype != VIDEO_TYPE:
            try:
                decode_still(image)
            except ValueError:
                continue


def still(data: bytes, layout: RawLayout | None = None, form: str = "jpeg") -> ImageMessage:
    return ImageMessage(0, "cam", form, memoryview(data), layout)


def test_sizes_are_read_without_decoding() -> None:
    for data in (encode_jpeg(PICTURE), encode(PICTURE, ".png")):
        assert size_px(memoryview(data)) == (30, 20)
    progressive = cv2.imencode(".jpg", PICTURE, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])[1].tobytes()
    assert size_px(memoryview(progressive)) == (30, 20)
    assert (suffix_of(encode_jpeg(PICTURE)), suffix_of(encode(PICTURE, ".png"))) == (".jpg", ".png")
    assert suffix_of(b"GIF89a") is None


def test_a_picture_that_claims_too_much_is_not_decoded() -> None:
    """A kilobyte of PNG or JPEG may claim gigabytes."""
    bomb = bytearray(encode(PICTURE, ".png"))
    bomb[16:24] = (40_000).to_bytes(4, "big") * 2
    with pytest.raises(ValueError, match="40000 x 40000 px, more than is read here"):
        decode_still(still(bytes(bomb)))
    with pytest.raises(ValueError, match="rows of"):
        decode_still(still(b"", RawLayout(MAX_PIXELS, 2, MAX_PIXELS), "mono8"))


@pytest.mark.parametrize(
    ("layout", "form", "problem"),
    [
        (RawLayout(3, 2, 3), "16UC1", "pixels as '16UC1'"),
        (RawLayout(3, 2, 2), "mono8", "rows of 2 bytes"),
        (RawLayout(0, 2, 3), "mono8", "0 x 2 px"),
        (RawLayout(3, 3, 3), "mono8", "6 bytes for 3 rows"),
    ],
)
def test_raw_images_that_don_t_fit_are_refused(layout: RawLayout, form: str, problem: str) -> None:
    with pytest.raises(ValueError, match=problem):
        decode_still(still(bytes(6), layout, form))


def test_padded_rows_are_cut() -> None:
    rows = np.zeros((2, 8), np.uint8)
    rows[:, :6] = [[1, 2, 3, 4, 5, 6], [7, 8, 9, 10, 11, 12]]
    found = decode_still(still(rows.tobytes(), RawLayout(2, 2, 8), "rgb8"))
    assert found.tolist() == [[[3, 2, 1], [6, 5, 4]], [[9, 8, 7], [12, 11, 10]]]


def test_even_sizes() -> None:
    assert even_sized(PICTURE[:19, :29]).shape == (18, 28, 3)
    with pytest.raises(ValueError, match="1 x 20 px"):
        even_sized(PICTURE[:, :1])
