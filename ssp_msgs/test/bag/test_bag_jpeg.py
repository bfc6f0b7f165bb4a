"""JPEGs as cameras leave them: whole ones are taken, cut ones are found (METHOD 4.3b)."""

from __future__ import annotations

import os

import cv2
import numpy as np
import pytest

from ssp_core.bag.pictures.images import decode_still, is_mosaic, shown_size_px
from ssp_core.bag.pictures.jpeg import JPEG_END, JpegChecker, _libjpeg_warnings, read_header
from ssp_core.cdr.images import ImageMessage, RawLayout

HEIGHT, WIDTH = 88, 120
SAMPLING = [cv2.IMWRITE_JPEG_SAMPLING_FACTOR, cv2.IMWRITE_JPEG_SAMPLING_FACTOR_444]
KINDS = {
    "baseline": [],
    "progressive": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
    "with restarts": [cv2.IMWRITE_JPEG_RST_INTERVAL, 3],
    "own tables": [cv2.IMWRITE_JPEG_OPTIMIZE, 1],
    "4:4:4": SAMPLING,
}


def scene(seed: int) -> np.ndarray:
    """A road with a car on it, and noise as a camera has it."""
    rng = np.random.default_rng(seed)
    picture = np.full((HEIGHT, WIDTH, 3), rng.integers(40, 220, 3), np.uint8)
    picture[HEIGHT // 2 :] = rng.integers(30, 160)
    left = int(rng.integers(5, 60))
    picture[40:70, left : left + 40] = rng.integers(0, 255, 3)
    noise = rng.integers(-9, 10, picture.shape)
    return np.clip(picture.astype(int) + noise, 0, 255).astype(np.uint8)


def jpeg(picture: np.ndarray, options: list[int]) -> bytes:
    return cv2.imencode(".jpg", picture, options)[1].tobytes()


def oriented(data: bytes, orientation: int, order: str = "MM") -> bytes:
    """Insert an EXIF block with an orientation behind the start of a JPEG."""
    ends = {"MM": "big", "II": "little"}
    number = lambda value, size: value.to_bytes(size, ends[order])  # type: ignore[arg-type]  # noqa: E731
    entry = number(0x0112, 2) + number(3, 2) + number(1, 4) + number(orientation, 2) + b"\0\0"
    block = b"Exif\0\0" + order.encode() + number(42, 2) + number(8, 4) + number(1, 2) + entry
    return data[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + data[2:]


def still(data: bytes, form: str = "jpeg", layout: RawLayout | None = None) -> ImageMessage:
    return ImageMessage(0, "cam", form, memoryview(data), layout)


@pytest.mark.parametrize("kind", KINDS)
def test_whole_pictures_are_taken_whatever_lies_behind_them(kind: str) -> None:
    checker = JpegChecker()
    for seed in range(30):
        grey = seed % 5 == 4
        data = jpeg(scene(seed)[:, :, 0] if grey else scene(seed), KINDS[kind])
        rest = [b"", bytes(64), b"\xff" * 9000, data[600:2000], oriented(data, 1)][seed % 5]
        assert checker.small(data + rest).shape == (11, 15)
    for grey in (0, 128, 255):  # missing blocks are shown as 128
        flat = jpeg(np.full((HEIGHT, WIDTH, 3), grey, np.uint8), KINDS[kind])
        assert checker.small(flat).shape == (11, 15)


@pytest.mark.parametrize("kind", KINDS)
def test_cut_pictures_are_found(kind: str) -> None:
    checker = JpegChecker()
    for seed in range(30):
        data = jpeg(scene(seed), KINDS[kind])
        scan = data.rfind(b"\xff\xda")
        kept = scan + 20 + (len(data) - scan - 20) * (seed + 1) // 33
        with pytest.raises(ValueError, match="cut off"):
            checker.small(data[:kept])
        with pytest.raises(ValueError, match="a part is missing or damaged"):
            checker.small(data[:kept] + JPEG_END)
        assert checker.small(data).shape == (11, 15)
        assert checker.patched(data[:kept]).shape == (HEIGHT, WIDTH, 3)


def damaged(data: bytes, kind: str) -> bytes:
    """A JPEG with its head and its end, of which bytes in the middle are others'."""
    scan = data.rfind(b"\xff\xda") + 20
    at = scan + (len(data) - scan) // 3
    broken = bytearray(data)
    if kind == "twice":
        broken[at:at] = broken[at : at + 700]
    elif kind == "left out":
        del broken[at : at + 300]
    else:
        broken[at : at + 512] = bytes(512)
    return bytes(broken)


@pytest.mark.parametrize("kind", ["twice", "left out", "zeros"])
def test_a_damaged_middle_is_found(kind: str, capfd: pytest.CaptureFixture[str]) -> None:
    checker = JpegChecker()
    for seed in range(20):
        with pytest.raises(ValueError, match="a part is missing or damaged"):
            checker.small(damaged(jpeg(scene(seed), []), kind))
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("filling", [bytes(5), bytes(64), b"\xff" * 30, b"\x55\xaa"])
def test_filling_before_the_end_of_a_whole_picture_is_taken(filling: bytes) -> None:
    for seed in range(10):
        data = jpeg(scene(seed), [])
        assert JpegChecker().small(data[:-2] + filling + JPEG_END).shape == (11, 15)


def test_what_others_write_meanwhile_goes_on_to_standard_error(
    capfd: pytest.CaptureFixture[str],
) -> None:
    with _libjpeg_warnings() as found:
        os.write(2, b"before\nCorrupt JPEG data: 9 extraneous bytes\nafter\n")
    assert found == [b"Corrupt JPEG data: 9 extraneous bytes\n"]
    assert capfd.readouterr().err == "before\nafter\n"


@pytest.mark.parametrize("order", ["MM", "II"])
def test_exif_orientation_is_read_and_applied(order: str) -> None:
    data = jpeg(scene(1), [])
    for orientation in range(1, 9):
        image = still(oriented(data, orientation, order))
        assert read_header(image.data).orientation == orientation
        turned = decode_still(image)
        assert (turned.shape[1], turned.shape[0]) == shown_size_px(image)
        assert (turned.shape[0] == WIDTH) == (orientation > 4)
    assert read_header(memoryview(oriented(data, 11))).orientation == 1


def mosaic_of(picture: np.ndarray, pattern: str) -> np.ndarray:
    """Return the values of a sensor behind a Bayer filter; two letters are a row of its pattern."""
    channel = {"b": 0, "g": 1, "r": 2}
    found = np.zeros(picture.shape[:2], np.uint8)
    for place, colour in enumerate(pattern):
        row, column = divmod(place, 2)
        found[row::2, column::2] = picture[row::2, column::2, channel[colour]]
    return found


@pytest.mark.parametrize("pattern", ["rggb", "bggr", "gbrg", "grbg"])
def test_mosaics_are_converted_to_colour(pattern: str) -> None:
    colour = np.array([40, 90, 200], np.uint8)
    mosaic = mosaic_of(np.broadcast_to(colour, (HEIGHT, WIDTH, 3)), pattern)
    form = f"bayer_{pattern}8"
    raw = still(mosaic.tobytes(), form, RawLayout(WIDTH, HEIGHT, WIDTH))
    packed = still(cv2.imencode(".png", mosaic)[1].tobytes(), f"{form}; png compressed mono8")
    lossy = still(jpeg(mosaic, [cv2.IMWRITE_JPEG_QUALITY, 100]), f"{form}; jpeg compressed mono8")
    for image, most in ((raw, 0), (packed, 0), (lossy, 12)):
        assert is_mosaic(image)
        assert np.abs(decode_still(image)[4:-4, 4:-4].astype(int) - colour).max() <= most
    # The transport demosaicked it before it compressed it.
    done = still(jpeg(scene(2), []), f"{form}; jpeg compressed bgr8")
    assert not is_mosaic(done)
    assert not is_mosaic(still(jpeg(scene(2)[:, :, 0], []), "mono8; jpeg compressed mono8"))


def test_values_of_more_than_8_bits_are_refused() -> None:
    deep = cv2.imencode(".png", scene(3).astype(np.uint16) * 16)[1].tobytes()
    with pytest.raises(ValueError, match="16 bits a value, of which no range is stated"):
        decode_still(still(deep, "png"))
    twelve = bytearray(jpeg(scene(3), []))
    twelve[twelve.index(b"\xff\xc0") + 4] = 12
    with pytest.raises(ValueError, match="12 bits a value"):
        decode_still(still(bytes(twelve)))
    assert decode_still(still(cv2.imencode(".png", scene(3))[1].tobytes(), "png")).any()
