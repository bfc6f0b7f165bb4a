"""Every verb that writes says in one message that it can't, where its output can't be."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_eval.importers import target
from ssp_eval.statistics.csv_rows import COLUMNS
from tests.support.bags.full_disk import largest_file


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 25.0, (64, 48))
    for _ in range(30):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    return path


@pytest.mark.parametrize("depth", [("out",), ("deeper", "out")])
@pytest.mark.parametrize(
    "arguments",
    [
        ("demo", "--out", "{out}"),
        ("import-video", "{video}", "--ego-unknown", "--out", "{out}"),
        ("labels", "new", "{bag}", "--out", "{out}"),
        ("evaluate", "{bag}", "--propose-labels", "--bridge", "silent", "--out", "{out}"),
        ("report", "{out}"),
        ("run", "cut_in", "--out", "{out}"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_an_output_below_a_file_is_one_message(
    arguments: tuple[str, ...],
    depth: tuple[str, ...],
    make_bag: Callable[..., Path],
    video: Path,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    file = tmp_path / "file"
    file.write_text("mine")
    places = {"out": file.joinpath(*depth), "video": video, "bag": make_bag()}
    assert main([word.format(**places) for word in arguments]) == 1
    error = capfd.readouterr().err
    assert error.count("error:") == 1
    assert str(file) in error
    assert "Traceback" not in error
    assert file.read_text() == "mine"


def test_a_labels_file_onto_a_folder_is_refused_even_with_force(
    make_bag: Callable[..., Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "folder"
    folder.mkdir()
    assert main(["labels", "new", str(make_bag()), "--out", str(folder), "--force"]) == 1
    assert "is a folder" in capfd.readouterr().err


def test_a_folder_is_made_with_its_parents(tmp_path: Path) -> None:
    path = tmp_path / "a" / "b"
    assert make_folder(path) == path
    assert make_folder(path).is_dir()


CELLS = """\
cut_in,physical,a,1,0.8,0.5,0.7,0.6,0.4,S@1.50
cut_in,physical,b,1,0.4,,0.7,0.2,0.4,F
"""


@pytest.mark.parametrize(
    ("options", "size", "beyond"),
    [
        (("--out", "{out}"), 4000, "statistics.json"),
        (("--out", "{out}", "--tables", "{out}"), 4000, "statistics.json"),
        (("--figures", "{out}", "--only", "matrix"), 30_000, "matrix.png"),
    ],
    ids=("tables", "tables beside the statistics", "figures"),
)
def test_of_files_that_belong_together_all_are_written_or_none(
    options: tuple[str, ...],
    size: int,
    beyond: str,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "cells.csv").write_text(f"{','.join(COLUMNS)}\n{CELLS}")
    out = tmp_path / "out"
    words = ["report", "--from-cells", str(tmp_path / "cells.csv")]
    words += [option.format(out=out) for option in options]
    with largest_file(size):
        assert main(words) == 1
    assert f"error: {out / beyond}: can't be written: File too large" in capfd.readouterr().err
    assert [file.name for file in tmp_path.iterdir()] == ["cells.csv"]
    assert main(words) == 0
    sizes = [file.stat().st_size for file in out.rglob("*.*")]
    assert min(sizes) <= size < max(sizes)


def test_what_stands_in_the_way_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("")
    for path in (tmp_path / "file", tmp_path / "file" / "a" / "b"):
        with pytest.raises(InputError, match="file is no folder; name another") as caught:
            make_folder(path)
        assert caught.value.file == str(path)
    # Root may write anywhere, so the system's answer stands in for a missing permission.
    monkeypatch.setattr("ssp_core.files.folders.os.access", lambda path, mode: False)
    with pytest.raises(InputError, match="can't be written to; name another"):
        make_folder(tmp_path)


def test_an_import_whose_folder_another_one_made_meanwhile_is_refused(tmp_path: Path) -> None:
    out = tmp_path / "bag"
    with pytest.raises(InputError, match="exists already"):
        target.make_bag(out, lambda _: target.make_bag(out, lambda _: None))
    assert [path.name for path in tmp_path.iterdir()] == ["bag"]
