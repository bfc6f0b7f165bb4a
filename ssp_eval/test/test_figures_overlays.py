"""Overlays: stills, and videos of all recorded frames or of those that the campaign keeps."""

from __future__ import annotations

import shutil
import warnings
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from ssp_core.hashing import sha256_file
from ssp_eval.evaluate.campaign import run_campaign
from ssp_eval.evaluate.cell import CellOptions
from ssp_eval.evaluate.model_client import InProcessClients
from ssp_eval.evaluate.models import bridge_spec
from ssp_eval.evaluate.results import load_cells
from ssp_eval.figures.moments import CellOverlay, Recorded, Recordings, overlay_of
from ssp_eval.figures.overlays import (
    CAPTION,
    FOLDER,
    VIDEO,
    Annotation,
    annotated,
    latest,
    wrapped,
    write_overlays,
)
from ssp_eval.figures.phases import MOST_CELLS
from ssp_eval.figures.projection import Ribbon
from ssp_eval.report.cli import WantedFigures, draw_figures


def test_an_annotation_leaves_the_picture_alone_and_draws_where_it_should() -> None:
    picture = np.full((180, 320, 3), 90, np.uint8)
    kept = picture.copy()
    plan = Ribbon(
        ((100.0, 170.0), (150.0, 90.0)), ((220.0, 170.0), (170.0, 90.0)),
        ((160.0, 170.0), (160.0, 90.0)), ((160.0, 130.0),),
    )  # fmt: skip
    far = Ribbon((), (), ((160.0, 175.0), (1e9, -1e9)), ())
    image = annotated(picture, Annotation(plan, None, "1 s", ("a", "b", "c", "d", "e")))
    assert np.array_equal(picture, kept)
    assert image.shape[0] > 180
    assert image.shape[1] == 320
    assert (image[130, 160] > 200).all()  # the dot
    blue, _, red = image[160, 130].astype(int)
    assert blue > red + 30  # the ribbon
    assert np.array_equal(image[60:80, 200:300], kept[60:80, 200:300])
    assert (image[180:] < 100).any()  # words
    plain = annotated(picture, Annotation(None, far, "1 s", ()))
    assert plain.shape == image.shape


def test_words_of_a_model_are_wrapped_and_cut() -> None:
    assert wrapped("", 960, 2) == []
    assert wrapped("one two", 960, 2) == ["one two"]
    lines = wrapped("word " * 200, 960, 2)
    assert len(lines) == 2
    assert lines[1].endswith("…")
    assert len(wrapped("x" * 4000, 320, 2)) <= 2


@pytest.fixture
def campaign(make_bag: Callable[..., Path], tmp_path: Path) -> Path:
    out = tmp_path / "out"
    bags = [make_bag(), make_bag("track", domain="physical")]
    models = [bridge_spec(name) for name in ("constant_velocity", "silent")]
    run_campaign(
        [(bag, None) for bag in bags], models, InProcessClients(), out, CellOptions(), True
    )
    return out


@pytest.fixture
def stories(campaign: Path) -> list[CellOverlay]:
    found = [overlay_of(cell, campaign) for cell in load_cells(campaign)]
    return [story for story in found if story is not None and not story.cell.is_control]


def times_of(video: Path) -> list[float]:
    with av.open(str(video)) as opened:
        return [float(frame.time) for frame in opened.decode(video=0)]


def test_every_model_s_cell_gets_stills_and_a_video_of_all_frames(
    campaign: Path, tmp_path: Path
) -> None:
    out = tmp_path / "figures"
    frames = {path: sha256_file(path) for path in (campaign / "frames").iterdir()}
    seen: list[str] = []
    cells = load_cells(campaign)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = write_overlays(campaign, out, cells, seen.append)
    assert {path: sha256_file(path) for path in frames} == frames
    assert all(path.is_file() for path in done.files)
    models = [cell for cell in cells if not cell.is_control]
    assert {path.name for path in (out / FOLDER).iterdir()} == {cell.id for cell in models}
    assert done.left_out == ()
    for cell in models:
        folder = out / FOLDER / cell.id
        assert f"{FOLDER}/{cell.id}" in seen
        stills = sorted(folder.glob("*.jpg"))
        assert len(stills) == len(cell.labels.labels)
        assert stills[0].name.startswith(f"01_{cell.labels.labels[0].phase}_")
        assert cv2.imread(str(stills[0])).shape[1] == 96
        # Ten frames a second between first and last label, and the last one stays.
        labels = [label.t_s for label in cell.labels.labels]
        count = round((labels[-1] - labels[0]) * 10) + 1
        wanted = [k / 10 for k in range(count)]
        assert times_of(folder / VIDEO) == pytest.approx([*wanted, wanted[-1] + 0.5], abs=0.06)
        told = (folder / CAPTION).read_text("utf-8")
        assert f"All {count} frames of the recording" in told
        assert "(measured; from the recording)" in told
    again = tmp_path / "again"
    write_overlays(campaign, again, cells)
    for path in done.files:
        assert (again / path.relative_to(out)).read_bytes() == path.read_bytes(), path.name


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda bag: shutil.rmtree(bag), "the recording isn't where it was"),
        (
            lambda bag: (shutil.rmtree(bag), shutil.copytree(bag.parent / "track", bag)),
            "another recording lies where it was",
        ),
        (lambda bag: next(bag.glob("*.mcap")).write_bytes(b"x"), "the recording can't be read"),
    ],
)
def test_without_the_recording_the_kept_frames_do_and_the_caption_says_so(
    campaign: Path, tmp_path: Path, change: Callable[[Path], object], told: str
) -> None:
    bag = tmp_path / "bag"
    change(bag)
    (cell,) = [c for c in load_cells(campaign) if not c.is_control and c.domain == "simulation"]
    done = write_overlays(campaign, tmp_path / "figures", [cell])
    folder = tmp_path / "figures" / FOLDER / cell.id
    caption = (folder / CAPTION).read_text("utf-8")
    labels = [label.t_s for label in cell.labels.labels]
    assert f"Only the {len(labels)} frames that the campaign keeps" in caption
    assert f"since {told}" in caption
    assert any(told in why for _, why in done.left_out)
    wanted = [t_s - labels[0] for t_s in labels]
    assert times_of(folder / VIDEO) == pytest.approx([*wanted, wanted[-1] + 0.5], abs=0.06)


def test_a_video_shows_the_latest_answer_until_the_next(stories: list[CellOverlay]) -> None:
    moments = stories[0].moments
    stamps = [moment.stamp_ns for moment in moments]
    assert None not in stamps
    first, second = stamps[0] or 0, stamps[1] or 0
    assert latest(stories[0], first - 1) is None
    assert latest(stories[0], first) is moments[0]
    assert latest(stories[0], second - 1) is moments[0]
    assert latest(stories[0], second) is moments[1]
    assert latest(stories[0], 10**18) is moments[-1]


def test_a_fast_camera_is_thinned_and_the_driven_path_is_that_of_the_bag(
    campaign: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = next(c for c in load_cells(campaign) if not c.is_control)
    start_ns = cell.facts.clip.start_ns
    assert start_ns is not None
    span = start_ns + 2_000_000_000, start_ns + 5_030_000_000
    every = Recordings(campaign).find(cell, *span)
    assert isinstance(every, Recorded)
    assert (len(every.stamps_ns), every.rate_hz) == (31, pytest.approx(10.0))
    assert [p.stamp_ns for p in every.pictures()] == list(every.stamps_ns)
    # The VUT drives at 10 m/s, also beyond the last label.
    for at_ns in span:
        found = every.driven.after(at_ns * 1e-9, 3.0)
        assert found is not None
        assert found.t_s[-1] == pytest.approx(3.0, abs=0.06)
        assert found.x_m == pytest.approx([10.0 * t_s for t_s in found.t_s], abs=1e-5)
        assert found.y_m == pytest.approx([0.0] * len(found.t_s), abs=1e-6)
    monkeypatch.setattr("ssp_eval.figures.moments.MOST_PER_S", 5)
    slow = Recordings(campaign).find(cell, *span)
    assert isinstance(slow, Recorded)
    assert slow.rate_hz == pytest.approx(5.0)
    assert set(slow.stamps_ns) < set(every.stamps_ns)
    assert Recordings(campaign).find(cell, -2, -1) == "the recording has no frames then"


def test_overlays_alone_write_no_other_figure(
    campaign: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cells = [cell for cell in load_cells(campaign) if not cell.is_control][:1]
    out = tmp_path / "figures"
    draw_figures(WantedFigures(out, None, ("overlays",)), [], campaign, cells)
    assert {path.name.split("_")[0] for path in out.iterdir()} == {FOLDER}
    assert f"{out} (" in capsys.readouterr().out
    ((name, why),) = write_overlays(campaign, out, cells * (MOST_CELLS + 1), limit=True).left_out
    assert (name, "--only overlays" in why) == (FOLDER, True)
