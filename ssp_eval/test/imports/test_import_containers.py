"""Videos as other tools write them: tracks, pixels, rates and first frames (METHOD 4.3b)."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest
from foreign_recordings import HEADER, picture

from ssp_core.bag.pictures.frames import Frames
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.messages import object_state
from ssp_core.cli import main
from ssp_core.clock import NS_PER_S

IMAGE = "/ssp/vut/front_camera/image/compressed"
CLOCK = Fraction(1, 90000)


def write_film(
    path: Path,
    times_s: Sequence[float],
    sizes: Sequence[tuple[int, int]] = ((64, 48),),
    aspect: Fraction | None = None,
    default: int = 0,
    show: Callable[[int], int] = lambda number: number,
) -> Path:
    """A film of numbered pictures at these times, one track a size."""
    rate = Fraction((len(times_s) - 1) / (times_s[-1] - times_s[0])).limit_denominator(100)
    with av.open(str(path), "w") as container:
        streams = []
        for place, (width, height) in enumerate(sizes):
            stream = container.add_stream("libx264", rate=rate)
            stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
            stream.codec_context.time_base = stream.time_base = CLOCK
            stream.options = {"crf": "10", "bf": "0", "preset": "ultrafast"}
            if aspect is not None:
                stream.codec_context.sample_aspect_ratio = aspect
            on = av.stream.Disposition.default if place == default else 0
            stream.disposition = av.stream.Disposition(on)
            streams.append(stream)
        for number, time_s in enumerate(times_s):
            for stream in streams:
                image = picture(show(number) % 256, (stream.width, stream.height))
                frame = av.VideoFrame.from_ndarray(image, format="bgr24").reformat(format="yuv420p")
                frame.pts, frame.time_base = round(time_s / CLOCK), CLOCK
                container.mux(stream.encode(frame))
        for stream in streams:
            container.mux(stream.encode())
    return path


def write_table(path: Path) -> Path:
    rows = [",".join(HEADER)]
    for step in range(301):
        t_s = step / 50
        rows.append(f"{t_s},vut,car,{10 * t_s},0,0,10,4.5,1.8")
        rows.append(f"{t_s},ot1,car,{20 + 10 * t_s},0,0,10,4.5,1.8")
    path.write_text("\n".join(rows) + "\n")
    return path


def run_import(video: Path, *options: object) -> tuple[list[Any], dict[str, Any]]:
    """The frames and import.json of an import."""
    out = video.with_name("rec")
    given = options or ("--ego-unknown",)
    assert main(["import-video", str(video), *map(str, given), "--out", str(out)]) == 0
    with BagReader(out) as reader:
        frames = list(Frames(reader, IMAGE).pictures())
        record = json.loads(reader.attachment("import.json") or b"")
    return frames, record


def steady(fps: float, seconds: float = 3.0, begin_s: float = 0.0) -> list[float]:
    return [begin_s + k / fps for k in range(round(seconds * fps))]


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
@pytest.mark.parametrize("fps", [10, 12.5, 24, 25, 30, 50, 60])
def test_sound_films_are_taken_without_a_word(suffix: str, fps: float, tmp_path: Path) -> None:
    aspect = None if fps < 30 else Fraction(1, 1)
    frames, record = run_import(
        write_film(tmp_path / f"film{suffix}", steady(fps, 2), aspect=aspect)
    )
    assert record["notes"] == []
    steps_s = np.diff([one.stamp_ns for one in frames]) / NS_PER_S
    assert steps_s.max() < 0.101
    assert np.ptp(steps_s) < 0.002
    assert fps < 20 or len(frames) < 2 * fps
    assert frames[0].image.shape == (48, 64, 3)
    assert (record["crop"]["start_s"], frames[0].stamp_ns) == (0.0, 0)


def test_several_tracks_are_refused_with_a_list(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    film = write_film(tmp_path / "film.mp4", steady(10), ((64, 48), (128, 96)), default=1)
    said = refused("import-video", film, "--ego-unknown", "--out", tmp_path / "rec")
    assert "has 2 video tracks: 0 of 64x48 px, 1 of 128x96 px (default)" in said
    assert "ffmpeg -i film.mp4 -map 0:NUMBER -c copy one.mp4" in said


@pytest.mark.parametrize(
    ("aspect", "size_px"),
    [(Fraction(4, 3), (85, 48)), (Fraction(3, 4), (64, 64)), (Fraction(2, 1), (128, 48))],
)
def test_pixels_that_are_not_square_are_stretched(
    aspect: Fraction, size_px: tuple[int, int], tmp_path: Path
) -> None:
    film = write_film(tmp_path / "film.mp4", steady(10), aspect=aspect)
    frames, record = run_import(film, "--ego-unknown", "--hfov-deg", 90)
    width, height = size_px
    assert frames[3].image.shape == (height, width, 3)
    assert (
        np.abs(frames[3].image.astype(int) - cv2.resize(picture(3), size_px).astype(int)).mean()
        < 25
    )
    assert record["notes"] == [
        f"camera: pixels aren't square; pictures of 64x48 px were stretched to {width}x{height}"
    ]


def test_times_of_a_transport_stream_count_from_its_first_stamp(tmp_path: Path) -> None:
    film = write_film(tmp_path / "film.ts", steady(30, 4, begin_s=1.4))
    frames, record = run_import(film, "--ego-unknown", "--start", 1, "--end", 3)
    assert record["notes"] == []
    assert record["crop"]["start_s"] == pytest.approx(1.0, abs=0.04)
    assert frames[-1].stamp_ns / NS_PER_S == pytest.approx(1.9, abs=0.04)


@pytest.mark.parametrize("suffix", [".mp4", ".mkv"])
@pytest.mark.parametrize("begin_s", [0.5, 1.2])
def test_a_first_frame_that_is_late_keeps_the_files_time(
    suffix: str, begin_s: float, tmp_path: Path
) -> None:
    film = write_film(tmp_path / f"film{suffix}", steady(20, begin_s=begin_s))
    _, record = run_import(film, "--states", write_table(tmp_path / "states.csv"))
    assert record["crop"]["start_s"] == pytest.approx(begin_s, abs=1e-3)
    assert record["notes"] == [
        f"camera: the video's first frame is at {begin_s:.3f} s of the file; times of tables and "
        "of --start and --end are those of the file"
    ]
    with BagReader(tmp_path / "rec") as reader:
        (first, *_) = reader.messages(["/ssp/vut/state"])
        # Its rear axle lies behind the centre, which the table gives.
        ahead_m = object_state(reader.decode(first)).x_m - 10 * begin_s
    assert -2.0 < ahead_m < -1.0


def test_a_rate_that_varies_is_thinned_by_time(tmp_path: Path) -> None:
    times_s = [*steady(60, 2), *steady(15, 2, 2.0)]
    frames, record = run_import(write_film(tmp_path / "film.mp4", times_s))
    assert np.diff([one.stamp_ns for one in frames]).max() < 0.11 * NS_PER_S
    assert "its rate varies" in record["notes"][0]
    assert len(frames) < 80


def test_one_picture_for_long_is_said_where_the_vut_drives(tmp_path: Path) -> None:
    film = write_film(
        tmp_path / "film.mp4", steady(10), show=lambda number: 10 if 10 <= number < 20 else number
    )
    _, record = run_import(film, "--states", write_table(tmp_path / "states.csv"))
    (said,) = record["notes"]
    assert said.startswith("camera: one picture ")
    assert "while the VUT drives: did the camera stop?" in said


def test_errors_of_the_decoder_can_be_accepted_by_name(
    tmp_path: Path, refused: Callable[..., str]
) -> None:
    film = write_film(tmp_path / "film.mp4", steady(10))
    data = bytearray(film.read_bytes())
    at = data.index(b"mdat") + len(data) // 3
    data[at : at + 40] = bytes(40)
    film.write_bytes(data)
    said = refused("import-video", film, "--ego-unknown", "--out", tmp_path / "rec")
    assert "frames [damaged_video]" in said
    assert "--accept damaged_video takes it as it is" in said
    _, record = run_import(film, "--ego-unknown", "--accept", "damaged_video")
    assert [one["name"] for one in record["accepted"]] == ["damaged_video"]
