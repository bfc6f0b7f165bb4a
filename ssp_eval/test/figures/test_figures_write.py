"""Files of figures: three kinds and a caption each, the same bytes for the same rows."""

from __future__ import annotations

import random
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import cv2
import pytest
from click.testing import CliRunner

from ssp_core.errors import InputError
from ssp_eval.figures import write
from ssp_eval.figures.write import DPI, write_figures
from ssp_eval.report.cli import report
from ssp_eval.score.cli import DISCLAIMER
from ssp_eval.statistics.csv_rows import COLUMNS
from tests.support.score_rows import rows_of

HEAD = ",".join(COLUMNS)
LINES = (
    "cut_in,physical,a,1,0.8,0.5,0.7,0.6,0.4,S@1.50",
    "cut_in,physical,b,1,0.4,,0.7,0.2,0.4,F",
)


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("figures")
    write_figures(rows_of(), folder)
    return folder


def test_every_figure_has_its_files_and_a_caption_with_the_disclaimer(written: Path) -> None:
    names = {path.stem for path in written.iterdir()}
    assert len(names) == 12
    for name in names:
        kinds = {path.suffix for path in written.glob(f"{name}.*")}
        assert kinds == {".svg", ".pdf", ".png", ".txt"}
        text = (written / f"{name}.txt").read_text()
        assert text.endswith(DISCLAIMER + "\n")
        assert re.search(r"\d", text)


def test_a_figure_is_one_picture_with_a_title_for_screen_readers(written: Path) -> None:
    drawings = sorted(written.glob("*.svg"))
    titles = set()
    for path in drawings:
        root = ElementTree.parse(path).getroot()
        assert root.get("role") == "img"
        title = root.find(".//{http://purl.org/dc/elements/1.1/}title")
        assert title is not None
        titles.add(title.text)
    assert None not in titles
    assert len(titles) == len(drawings)


def test_text_is_text_and_fonts_are_embedded(written: Path) -> None:
    for path in written.glob("*.svg"):
        svg = path.read_text()
        assert "<text" in svg
        assert "<dc:date>" not in svg
    assert ">impromptu_vla<" in (written / "matrix.svg").read_text()
    for path in written.glob("*.pdf"):
        pdf = path.read_bytes()
        assert b"/FontFile2" in pdf
        assert b"/Type3" not in pdf
        assert b"CreationDate" not in pdf


def test_bitmaps_are_as_wide_as_a_column_or_a_page(written: Path) -> None:
    for path in written.glob("*.png"):
        image = cv2.imread(str(path))
        assert image.shape[1] <= 7.0 * DPI + 1
        assert image.shape[0] <= 9.0 * DPI + 1
        assert image.std() > 1.0


def test_the_same_rows_in_another_order_give_the_same_bytes(
    written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = rows_of()
    random.Random(5).shuffle(rows)
    # Of a figure the other kinds are made alike: one figure has them all.
    monkeypatch.setattr(write, "_METADATA", {"svg": write._METADATA["svg"]})
    write_figures(rows, tmp_path)
    monkeypatch.undo()
    write_figures(rows, tmp_path, only=("matrix",))
    names = {path.name for path in tmp_path.iterdir()}
    assert {"matrix.pdf", "matrix.png"} <= names
    assert names >= {p.name for p in written.iterdir() if p.suffix in (".svg", ".txt")}
    for name in names:
        assert (tmp_path / name).read_bytes() == (written / name).read_bytes(), name


def test_every_caption_says_that_no_vehicle_is_in_a_stand_in(
    written: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(write, "_METADATA", {})  # no picture: the captions alone
    told = "Physical is a software stand-in here, not a vehicle: cut_in / physical."
    rows = [
        replace(row, stand_in=(row.scenario, row.domain) == ("cut_in", "physical"))
        for row in rows_of()
    ]
    write_figures(rows, tmp_path, only=("matrix", "domains"))
    for folder, stands_in in ((written, False), (tmp_path, True)):
        captions = [path.read_text("utf-8") for path in folder.glob("*.txt")]
        assert len(captions) > 3
        assert {told in caption for caption in captions} == {stands_in}


def test_only_some_and_a_reference_that_is_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(write, "_METADATA", {"svg": write._METADATA["svg"]})
    done = write_figures(rows_of(), tmp_path, "openemma", ("domains",))
    assert {path.stem for path in done.files} == {
        "domains_components",
        "domains_ranks",
        "domains_contributions",
    }
    with pytest.raises(InputError, match="nobody"):
        write_figures(rows_of(), tmp_path / "none", "nobody")
    assert not (tmp_path / "none").exists()


def test_the_command_draws_from_component_scores(tmp_path: Path) -> None:
    cells, out = tmp_path / "cells.csv", tmp_path / "figures"
    cells.write_text("\n".join([HEAD, *LINES, ""]))
    run, given = CliRunner().invoke, ["--from-cells", str(cells), "--figures", str(out)]
    done = run(report, [*given, "--only", "matrix"])
    assert done.exit_code == 0, done.output
    assert "(4 files)" in done.output
    assert sorted(path.name for path in out.iterdir()) == [
        "matrix.pdf",
        "matrix.png",
        "matrix.svg",
        "matrix.txt",
    ]
    wrong = [
        [*given, "--only", "phases"],
        ["--from-cells", str(cells)],
        ["--from-cells", str(cells), "--only", "matrix", "--out", str(out)],
    ]
    for options in wrong:
        assert run(report, options).exit_code == 2


def test_the_command_alone_doesn_t_load_the_plotting() -> None:
    code = "import ssp_eval.report.cli, sys; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], timeout=600).returncode == 0
