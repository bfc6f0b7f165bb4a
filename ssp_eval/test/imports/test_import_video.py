"""ssp import-video: frames, times and declared facts get into the bag, and nothing else does."""

from __future__ import annotations

import json
import math
import random
import re
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from ssp_core import RULES_VERSION
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_core.hashing import sha256_file
from ssp_eval.importers.target import keep_every
from ssp_scenario_manager.event_spec.log import read_log
from ssp_vla_bridge.window import mounting_of

IMAGE = "/ssp/vut/front_camera/image/compressed"
INFO = "/ssp/vut/front_camera/camera_info"
MOUNT = "/ssp/vut/front_camera/mount"
STATE = "/ssp/vut/state"


def make_video(path: Path, fps: float, frames: int, size: tuple[int, int] = (64, 48)) -> Path:
    """A video whose frame k shows k in binary, as eight black or white columns."""
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), fps, size)
    assert writer.isOpened()
    for k in range(frames):
        columns = [255 * (k >> bit & 1) for bit in range(8)]
        row = np.repeat(np.array(columns, dtype=np.uint8), size[0] // 8)
        writer.write(np.broadcast_to(row[None, :, None], (size[1], size[0], 3)).copy())
    writer.release()
    return path


@pytest.fixture
def video(tmp_path: Path) -> Path:
    """Four seconds at 25 frames per second."""
    return make_video(tmp_path / "source.avi", 25.0, 100)


def run(*args: object) -> int:
    return main(["import-video", *map(str, args)])


def source_frames(bag: Path) -> list[int]:
    """Numbers of the source frames in the bag, read from their pictures."""
    numbers = []
    with BagReader(bag) as reader:
        for message in reader.messages([IMAGE]):
            picture = cv2.imdecode(reader.decode(message).data, cv2.IMREAD_COLOR)
            assert picture is not None
            levels = picture.reshape(picture.shape[0], 8, -1).mean(axis=(0, 2))
            numbers.append(sum(1 << bit for bit in range(8) if levels[bit] > 128))
    return numbers


def test_the_crop_gets_into_the_bag_with_times_from_zero(
    video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bag"
    assert run(video, "--start", 1, "--end", 3, "--ego-unknown", "--out", out, "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["frames"], shown["keep_every"], shown["rate_hz"]) == (25, 2, 12.5)
    assert source_frames(out) == list(range(25, 75, 2))
    with BagReader(out) as reader:
        frames = list(reader.messages([IMAGE]))
        expected = [k * 80_000_000 for k in range(25)]
        assert [m.log_time_ns for m in frames] == expected
        headers = [reader.decode(m).header.stamp for m in frames]
        assert [h.sec * 10**9 + h.nanosec for h in headers] == expected
        assert reader.decode(frames[0]).format == "jpeg"
        assert set(reader.topics) == {IMAGE}
    with AnyReader([out]) as reader:
        assert reader.message_count == 25


def test_import_json_says_what_is_known_and_what_is_not(video: Path, tmp_path: Path) -> None:
    out = tmp_path / "bag"
    assert run(video, "--start", 1, "--end", 3, "--ego-unknown", "--out", out) == 0
    with BagReader(out) as reader:
        data = reader.attachment("import.json")
    assert data is not None
    assert json.loads(data) == {
        "schema": "ssp.import/2",
        "rules_version": RULES_VERSION,
        "source": {
            "name": "source.avi",
            "sha256": sha256_file(video),
            "kind": "video",
            "width_px": 64,
            "height_px": 48,
            "fps": 25.0,
            "frames": 100,
        },
        "crop": {"start_s": 1.0, "end_s": 3.0},
        "generator": "unknown",
        "domain": "synthetic",
        "scenario": None,
        "event_version": None,
        "ego": {"provenance": "unknown", "speed_mps": None},
        "camera": {
            "provenance": "unknown",
            "hfov_deg": None,
            "height_m": None,
            "pitch_down_rad": None,
        },
        "declaration": None,
        "log": None,
        "states": None,
        "site": None,
        "accepted": [],
        "notes": [],
    }


def test_the_source_is_entered_into_the_log(video: Path, tmp_path: Path) -> None:
    version = "sha256:" + "1" * 64
    facts = ("--scenario", "cut_in", "--event-version", version, "--generator", "some/1")
    for name in ("bag", "bag.2"):
        crop = ("--start", 1, "--end", 3)
        assert run(video, *crop, "--ego-unknown", *facts, "--out", tmp_path / name) == 0
        (record,) = read_log(tmp_path / f"{name}.log.jsonl")
        assert (record.kind, record.subject, record.version) == ("source", "cut_in", version)
        assert record.details == {
            "generator": "some/1",
            "original": "source.avi",
            "sha256": sha256_file(video),
            "crop": {"start_s": 1.0, "end_s": 3.0},
        }


def test_a_declared_speed_becomes_a_straight_motion(video: Path, tmp_path: Path) -> None:
    out = tmp_path / "bag"
    assert run(video, "--start", 0, "--end", 2, "--ego-speed", 12.5, "--out", out) == 0
    with BagReader(out) as reader:
        states = [reader.decode(m) for m in reader.messages([STATE])]
        times = [m.log_time_ns for m in reader.messages([STATE])]
        record = json.loads(reader.attachment("import.json") or b"")
    assert record["ego"] == {"provenance": "declared", "speed_mps": 12.5}
    assert times == [k * 20_000_000 for k in range(97)]
    assert [s.sequence for s in states] == list(range(1, 98))
    for state, time_ns in zip(states, times, strict=True):
        assert state.x == pytest.approx(12.5 * time_ns / 1e9, abs=1e-9)
        assert (state.y, state.yaw, state.speed, state.object_id) == (0.0, 0.0, 12.5, "vut")


def test_declared_geometry_becomes_camera_info_and_mount(video: Path, tmp_path: Path) -> None:
    out = tmp_path / "bag"
    camera = ["--hfov-deg", 90, "--camera-height", 1.5, "--camera-pitch-deg", 3]
    facts = ["--scenario", "cut_in", "--generator", "model x", "--event-version"]
    facts += ["sha256:" + "0" * 64]
    assert run(video, "--start", 0, "--end", 1, "--ego-unknown", "--out", out, *camera, *facts) == 0
    with BagReader(out) as reader:
        info = reader.decode(next(iter(reader.messages([INFO]))))
        mount = reader.decode(next(iter(reader.messages([MOUNT]))))
        record = json.loads(reader.attachment("import.json") or b"")
    assert info.k.tolist() == pytest.approx([32, 0, 32, 0, 32, 24, 0, 0, 1])
    assert (info.width, info.height) == (64, 48)
    assert mount.transform.translation.z == 1.5
    assert (mount.header.frame_id, mount.child_frame_id) == (
        "vut/base_link",
        "vut/front_camera_optical",
    )
    assert record["camera"]["provenance"] == "declared"
    assert record["camera"]["pitch_down_rad"] == pytest.approx(math.radians(3))
    assert mounting_of(mount.transform).pitch_down_rad == pytest.approx(math.radians(3))
    assert (record["scenario"], record["generator"]) == ("cut_in", "model x")


def test_a_guessed_geometry_is_marked(video: Path, tmp_path: Path) -> None:
    out = tmp_path / "bag"
    args = ["--hfov-deg", 60, "--camera-assumed", "--ego-unknown", "--out", out]
    assert run(video, "--start", 0, "--end", 1, *args) == 0
    with BagReader(out) as reader:
        record = json.loads(reader.attachment("import.json") or b"")
        assert set(reader.topics) == {IMAGE, INFO}
    assert record["camera"]["provenance"] == "assumed"


def test_the_same_video_gives_the_same_bytes(video: Path, tmp_path: Path) -> None:
    for folder in ("a", "b"):
        out = tmp_path / folder / "bag"
        assert run(video, "--start", 0, "--end", 1, "--ego-speed", 3, "--out", out) == 0
    one, other = ((tmp_path / f / "bag" / "bag_0.mcap").read_bytes() for f in ("a", "b"))
    assert one == other


def test_without_a_crop_the_whole_video_is_taken(video: Path, tmp_path: Path) -> None:
    out = tmp_path / "bag"
    assert run(video, "--ego-unknown", "--out", out) == 0
    assert source_frames(out) == list(range(0, 100, 2))
    with BagReader(out) as reader:
        record = json.loads(reader.attachment("import.json") or b"")
    assert record["crop"] == {"start_s": 0.0, "end_s": pytest.approx(4.0)}


@pytest.mark.parametrize(
    ("args", "status", "match"),
    [
        (["--start", 0, "--end", 1], 2, "exactly one of --states FILE.csv, --ego-speed"),
        (["--start", 0, "--end", 1, "--ego-unknown", "--ego-speed", 1], 2, "exactly one of"),
        (["--start", 1, "--end", 1, "--ego-unknown"], 2, "must lie before"),
        (["--start", -1, "--end", 1, "--ego-unknown"], 2, "no number from 0"),
        (["--start", "nan", "--end", 1, "--ego-unknown"], 2, "no number from 0"),
        (["--start", 0, "--end", 1, "--ego-speed", "inf"], 2, "no number from 0 up to 100"),
        (["--start", 0, "--end", 1, "--ego-unknown", "--rate", 0], 2, "no number above 0"),
        (["--start", 0, "--end", 1, "--ego-unknown", "--scenario", "a/b"], 2, "no name of"),
        (["--start", 0, "--end", 1, "--ego-unknown", "--event-version", "1"], 2, "64 hex"),
        (["--start", 0, "--end", 1, "--ego-unknown", "--camera-height", 1], 2, "belong together"),
        (["--start", 0, "--end", 1, "--ego-unknown", "--camera-assumed"], 2, "without --hfov-deg"),
        (["--start", 0, "--end", 1, "--ego-unknown", "--rate", 60], 1, "25 frames per second"),
        (["--start", 3, "--end", 5, "--ego-unknown"], 1, "the video is 4.000 s long"),
        (["--start", 7, "--end", 9, "--ego-unknown"], 1, "the video is 4.000 s long"),
        (["--start", 7, "--ego-unknown"], 1, "the crop from 7 s on lies beyond"),
        (["--start", 4, "--ego-unknown"], 1, "the crop from 4 s on lies beyond"),
    ],
)
def test_wrong_use_is_explained_and_leaves_nothing(
    video: Path,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    args: list[object],
    status: int,
    match: str,
) -> None:
    assert run(video, *args, "--out", tmp_path / "bag") == status
    assert match in " ".join(capsys.readouterr().err.split())
    assert [p.name for p in tmp_path.iterdir()] == ["source.avi"]


def test_what_is_no_video_is_one_message(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    text = tmp_path / "text.mp4"
    text.write_text("not a video")
    rest = ["--start", 0, "--end", 1, "--ego-unknown", "--out", tmp_path / "bag"]
    for path, match in (
        (text, "text.mp4: is no video"),
        (tmp_path / "nowhere.mp4", "nowhere.mp4: is not there; name a video file"),
        (tmp_path, "is no file; name a video file"),
    ):
        assert run(path, *rest) == 1
        assert match in capfd.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == ["text.mp4"]


def test_a_bag_that_exists_is_not_touched(
    video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "bag"
    out.mkdir()
    assert run(video, "--start", 0, "--end", 1, "--ego-unknown", "--out", out) == 1
    assert f"{out}: exists already" in capsys.readouterr().err
    assert list(out.iterdir()) == []


def test_a_video_that_ends_early_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = make_video(tmp_path / "whole.avi", 10.0, 40)
    cut = tmp_path / "cut.avi"
    cut.write_bytes(whole.read_bytes()[: whole.stat().st_size // 2])
    assert run(cut, "--start", 0, "--end", 4, "--ego-unknown", "--out", tmp_path / "bag") == 1
    assert "cut.avi: " in capsys.readouterr().err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cut.avi", "whole.avi"]


@given(fps=st.floats(1, 240), rate=st.floats(0.5, 240))
def test_every_nth_frame_keeps_at_least_the_wanted_rate(fps: float, rate: float) -> None:
    if rate > fps * 1.001:
        with pytest.raises(ValueError, match="frames per second"):
            keep_every(fps, rate)
        return
    n = keep_every(fps, rate)
    assert n >= 1
    assert fps / n >= rate * 0.995
    assert fps / (n + 1) < rate * 1.001


@pytest.mark.parametrize(
    ("fps", "n"), [(5, 1), (10, 1), (15, 1), (24, 2), (25, 2), (29.97, 2), (30, 3), (60, 6)]
)
def test_ten_hertz_at_least_by_default(fps: float, n: int) -> None:
    assert keep_every(fps, None) == n


def moving(path: Path, fourcc: str) -> Path:
    """Three seconds of a block that moves over a picture, 25 frames per second."""
    ground = np.random.default_rng(0).integers(0, 255, (120, 260, 3), dtype=np.uint8)
    ground = np.asarray(cv2.GaussianBlur(ground, (9, 9), 0), dtype=np.uint8)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*fourcc), 25.0, (160, 120))
    for k in range(75):
        picture = ground[:, k : k + 160].copy()
        picture[40:80, 20 + k : 50 + k] = (0, 0, 255)
        writer.write(picture)
    writer.release()
    return path


def flipped(data: bytes, seed: int) -> bytes:
    """Twenty bits of the frames are turned over."""
    found, rng = bytearray(data), random.Random(seed)
    first = max(data.find(b"mdat"), data.find(b"movi")) + 8
    last = max(data.find(b"moov"), data.find(b"idx1"))
    for _ in range(20):
        found[rng.randrange(first, last)] ^= 1 << rng.randrange(8)
    return bytes(found)


@pytest.mark.parametrize(("name", "fourcc"), [("clip.mp4", "mp4v"), ("clip.avi", "MJPG")])
def test_errors_of_the_decoder_are_counted_and_refused_unless_they_are_accepted(
    name: str, fourcc: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    whole = moving(tmp_path / name, fourcc)
    assert run(whole, "--ego-unknown", "--out", tmp_path / "whole") == 0
    data = whole.read_bytes()
    for seed in range(6):
        whole.write_bytes(flipped(data, seed))
        out = tmp_path / f"bag_{seed}"
        capfd.readouterr()
        assert run(whole, "--ego-unknown", "--out", out) == 1
        error = " ".join(capfd.readouterr().err.split())
        told = re.search(r"the decoder reports (\d+) errors beside \d+ frames", error)
        assert told, error
        assert not out.exists()
        accepted = ("--accept-damaged", told[1])
        assert run(whole, "--ego-unknown", "--out", out, *accepted) == 0
        assert f"the decoder reported {told[1]} errors" in capfd.readouterr().err
        with BagReader(out) as reader:
            record = json.loads(reader.attachment("import.json") or b"")
        assert record["source"]["decoder_errors"] == int(told[1])


@pytest.fixture
def damaged(tmp_path: Path) -> Path:
    """Four seconds at 10 frames per second, of which three frames lost their tables."""
    path = make_video(tmp_path / "damaged.avi", 10.0, 40)
    data = bytearray(path.read_bytes())
    frames = re.compile(b"00dc").finditer(data, data.index(b"movi"))
    begins = [match.start() + 8 for match in frames]
    for lost in (10, 20, 30):
        data[begins[lost] + 20 : begins[lost] + 220] = bytes(200)
    path.write_bytes(data)
    return path


ACCEPTED = ("--ego-unknown", "--accept-damaged", "3")


def test_frames_behind_damaged_ones_are_written(damaged: Path, tmp_path: Path) -> None:
    assert run(damaged, *ACCEPTED, "--out", tmp_path / "bag") == 0
    sound = [k for k in range(40) if k not in (10, 20, 30)]
    assert source_frames(tmp_path / "bag") == sound
    with BagReader(tmp_path / "bag") as reader:
        stamps_ns = [message.log_time_ns for message in reader.messages([IMAGE])]
    assert stamps_ns == [k * 100_000_000 for k in sound]


def test_fewer_frames_than_planned_are_refused(
    damaged: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("ssp_core.video._MOST_LOST", 0)
    assert run(damaged, *ACCEPTED, "--out", tmp_path / "bag") == 1
    error = " ".join(capfd.readouterr().err.split())
    assert re.search(r"gave \d+ frames, 37 were planned: decoding ended at \d\.\d00 s", error)
    assert "--start and --end" in error
    assert not (tmp_path / "bag").exists()


def patched(path: Path, box: bytes, at: int, value: int, form: str = ">I") -> None:
    data = bytearray(path.read_bytes())
    struct.pack_into(form, data, data.index(box) + at, value)
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("box", "at", "value"),
    [
        # Units per second of the track and of the movie, and units from frame to frame.
        (b"mdhd", 16, 0),
        (b"mdhd", 16, 25600),
        (b"mdhd", 16, 12800 ^ 1 << 10),
        (b"mvhd", 16, 0),
        (b"mvhd", 16, 2000),
        (b"stts", 16, 0),
        (b"stts", 16, 1024),
        (b"mdhd", 20, 2**31),
        (b"mvhd", 20, 1),
    ],
)
def test_a_time_axis_that_cannot_be_is_refused(
    box: bytes, at: int, value: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    video = moving(tmp_path / "clip.mp4", "mp4v")
    patched(video, box, at, value)
    assert run(video, "--ego-unknown", "--out", tmp_path / "bag") == 1
    assert "time axis that can't be" in " ".join(capfd.readouterr().err.split())
    assert not (tmp_path / "bag").exists()


@pytest.mark.parametrize(("box", "at", "value"), [(b"avih", 8, 80_000), (b"strh", 32, 50)])
def test_an_avi_of_two_rates_is_refused(
    box: bytes, at: int, value: int, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    video = moving(tmp_path / "clip.avi", "MJPG")
    patched(video, box, at, value, "<I")
    assert run(video, "--ego-unknown", "--out", tmp_path / "bag") == 1
    assert "time axis that can't be" in " ".join(capfd.readouterr().err.split())
