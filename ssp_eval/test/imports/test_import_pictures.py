"""The camera's pictures at import: whole, of 8 bits, upright, in colour, and not one for all."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foreign_recordings import (
    INFO,
    JPEG,
    RAW,
    TrackDay,
    camera_info,
    cut_in,
    jpeg,
    number_of,
    picture,
    raw,
    write_bag,
)

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main

IMAGE = "/ssp/vut/front_camera/image/compressed"
OPTIONS = (
    "--vut",
    "/vut/odom",
    "--object",
    "ot1=/ot1/odom:car",
    "--camera",
    "/cam",
    "--domain",
    "simulation",
)
DAY = cut_in(3.0)
Make = Callable[[int, Any], Any]


def bag_of(path: Path, make: Make, kind: str = JPEG, day: TrackDay = DAY) -> Path:
    info = ("/info", INFO, day.zero_ns, camera_info(day.zero_ns, 32.0))
    return write_bag(path, [*day.messages(make, kind), info])


def run_import(bag: Path, out: Path, *options: object) -> tuple[list[Any], dict[str, Any]]:
    """The frames of an import and its import.json."""
    assert main(["import-bag", str(bag), *OPTIONS, *map(str, options), "--out", str(out)]) == 0
    with BagReader(out) as reader:
        shown = [reader.decode(message).data for message in reader.messages([IMAGE])]
        record = json.loads(reader.attachment("import.json") or b"")
    return [cv2.imdecode(np.asarray(one), cv2.IMREAD_COLOR) for one in shown], record


def encoded(change: Callable[[Any], Any], suffix: str, form: str) -> Make:
    """Frames in another encoding; `change` gives the array to encode."""

    def make(ns: int, image: Any) -> Any:
        data = cv2.imencode(suffix, change(image))[1].ravel()
        return replace(jpeg(ns, image), format=form, data=data)

    return make


def mosaic(image: Any) -> Any:
    """A picture of one colour behind an RGGB filter."""
    found = np.full(image.shape[:2], 90, np.uint8)
    found[::2, ::2], found[1::2, 1::2] = 200, 40
    return found


def with_exif(orientation: int) -> Make:
    def make(ns: int, image: Any) -> Any:
        message = jpeg(ns, image)
        data = message.data.tobytes()
        entry = b"\x01\x12\0\x03\0\0\0\x01\0" + bytes([orientation]) + b"\0\0"
        block = b"Exif\0\0MM\0*\0\0\0\x08\0\x01" + entry
        data = data[:2] + b"\xff\xe1" + (len(block) + 2).to_bytes(2, "big") + block + data[2:]
        return replace(message, data=np.frombuffer(data, np.uint8))

    return make


def padded(ns: int, image: Any) -> Any:
    message = jpeg(ns, image)
    return replace(message, data=np.append(message.data, np.zeros(6000, np.uint8)))


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (jpeg, JPEG),
        (padded, JPEG),
        (raw, RAW),
        (with_exif(1), JPEG),
        (encoded(lambda image: image, ".png", "png"), JPEG),
        (encoded(lambda image: image[:, :, 0], ".jpg", "mono8; jpeg compressed mono8"), JPEG),
    ],
)
def test_sound_pictures_are_taken_without_a_word(make: Make, kind: str, tmp_path: Path) -> None:
    frames, record = run_import(bag_of(tmp_path / "day", make, kind), tmp_path / "rec")
    assert [number_of(frame) for frame in frames] == list(range(31))
    assert not [note for note in record["states"]["notes"] if note.startswith("camera")]


def raw_mosaic(ns: int, image: Any) -> Any:
    cells = mosaic(image)
    return replace(raw(ns, image), encoding="bayer_rggb8", step=64, data=cells.ravel())


@pytest.mark.parametrize(
    ("make", "kind"),
    [
        (encoded(mosaic, ".jpg", "bayer_rggb8; jpeg compressed mono8"), JPEG),
        (encoded(mosaic, ".png", "bayer_rggb8; png compressed mono8"), JPEG),
        (raw_mosaic, RAW),
    ],
)
def test_a_bayer_mosaic_becomes_colour_and_that_is_said(
    make: Make, kind: str, tmp_path: Path
) -> None:
    frames, record = run_import(bag_of(tmp_path / "day", make, kind), tmp_path / "rec")
    assert np.abs(frames[0][8:-8, 8:-8].mean(axis=(0, 1)) - [40, 90, 200]).max() < 12
    assert (
        "camera: 31 frames are Bayer mosaics and were converted to colour"
        in record["states"]["notes"]
    )


def test_16_bits_are_refused(tmp_path: Path, refused: Callable[..., str]) -> None:
    make = encoded(lambda image: image[:, :, 0].astype(np.uint16) * 16, ".png", "mono16; png")
    bag = bag_of(tmp_path / "day", make)
    said = refused("import-bag", bag, *OPTIONS, "--out", tmp_path / "rec")
    assert (
        "/cam: holds a frame at 0.000 s of the clip that can't be used: a picture of 16 bits"
        in said
    )
    assert "(30 more such) [unread_pictures]; convert the pictures" in said
    assert "--accept" not in said


def test_pictures_are_turned_as_exif_says_unless_a_camera_info_describes_them(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    bag = bag_of(tmp_path / "day", with_exif(6))
    frames, record = run_import(bag, tmp_path / "rec")
    assert frames[7].shape[:2] == (64, 48)
    assert number_of(np.rot90(frames[7])) == 7
    assert "camera: 31 frames were turned upright: EXIF orientation 6" in record["states"]["notes"]
    with_info = (*OPTIONS, "--camera-info", "/info", "--out", tmp_path / "two")
    said = refused("import-bag", bag, *with_info)
    assert "31 of 31 JPEGs say EXIF orientation 6: the CameraInfo is of the pictures before" in said


def test_pictures_that_are_turned_in_a_part_alone_are_named_as_that(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    turn = with_exif(8)

    def later(ns: int, image: Any) -> Any:
        return turn(ns, image) if ns - DAY.zero_ns >= 2_000_000_000 else jpeg(ns, image)

    bag = bag_of(tmp_path / "day", later)
    said = refused("import-bag", bag, *OPTIONS, "--out", tmp_path / "rec")
    assert "48x64 px by its EXIF orientation 8, not 64x48 as the first" in said


def test_cut_pictures_that_are_accepted_go_as_far_as_they_do(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    def cut(ns: int, image: Any) -> Any:
        message = jpeg(ns, np.random.default_rng(ns).integers(0, 255, image.shape, np.uint8))
        is_cut = (ns - DAY.zero_ns) // 100_000_000 in range(10, 14)
        return replace(message, data=message.data[: len(message.data) // (2 if is_cut else 1)])

    bag = bag_of(tmp_path / "day", cut)
    said = refused("import-bag", bag, *OPTIONS, "--out", tmp_path / "rec")
    assert "/cam: 4 of 31 JPEGs are cut off or damaged, the first at 1.000 s of the clip" in said
    frames, record = run_import(bag, tmp_path / "rec", "--accept", "cut_pictures")
    assert [frame.shape for frame in frames] == [(48, 64, 3)] * 31
    assert [one["name"] for one in record["accepted"]] == ["cut_pictures"]


def frozen(ns: int, image: Any) -> Any:
    """The picture of 1.0 s is shown until 2.0 s."""
    step = (ns - DAY.zero_ns) // 100_000_000
    return jpeg(ns, picture(10) if 10 <= step <= 20 else image)


def test_one_picture_for_long_is_said_while_the_vut_drives(tmp_path: Path) -> None:
    frames, record = run_import(bag_of(tmp_path / "day", frozen), tmp_path / "rec")
    assert len(frames) == 31
    assert (
        "camera: one picture 11 times, from 1.000 to 2.000 s of the clip, while the VUT drives: "
        "did the camera stop?"
    ) in record["states"]["notes"]


def test_one_picture_is_sound_while_the_vut_stands(tmp_path: Path) -> None:
    states = {
        "vut": [replace(s, x_m=20.0, speed_mps=0.0) for s in DAY.states["vut"]],
        "ot1": DAY.states["ot1"],
    }
    bag = bag_of(
        tmp_path / "day", lambda ns, _: jpeg(ns, picture(5)), JPEG, replace(DAY, states=states)
    )
    _, record = run_import(bag, tmp_path / "rec")
    assert not [note for note in record["states"]["notes"] if "one picture" in note]
