"""The demonstration empties what it made itself, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.errors import InputError
from ssp_core.files.writing import write_json
from ssp_eval.demo import MARKER, own_folder
from ssp_eval.demo_plan import Step

PLAN = "sha256:of a plan"
STEP = Step("clip", "make a clip", ("spec", "clip", "cut_in"))


def test_an_earlier_demonstration_is_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    with own_folder(folder, PLAN) as first:
        (first.folder / "runs").mkdir()
        (first.folder / "runs" / "x").write_text("old")
        (first.folder / "index.html").write_text("old")
        first.finish(STEP)
        first.complete = True
        first.write()
    with own_folder(folder, PLAN) as second:
        assert second.folder == folder
        assert [p.name for p in folder.iterdir()] == [MARKER]
    assert [p.name for p in tmp_path.iterdir()] == ["demo"]


@pytest.mark.parametrize("plan", [PLAN, "another"])
def test_an_incomplete_demonstration_of_the_same_plan_goes_on(tmp_path: Path, plan: str) -> None:
    """A bridge that came up late cost a quarter of an hour."""
    with own_folder(tmp_path / "demo", PLAN) as first:
        (first.folder / "runs").mkdir()
        first.finish(STEP)
    with own_folder(tmp_path / "demo", plan) as second:
        same = plan == PLAN
        assert second.finished_steps([STEP]) == ({"clip"} if same else set())
        assert (second.folder / "runs").is_dir() is same


@pytest.mark.parametrize("marker", [None, {"mine": 1}, {"schema": "ssp.demo/1"}])
def test_a_foreign_folder_stays_as_it_is(tmp_path: Path, marker: object) -> None:
    (tmp_path / "precious.txt").write_text("keep")
    if marker is not None:
        write_json(tmp_path / MARKER, marker)
    with pytest.raises(InputError, match="holds something"), own_folder(tmp_path, PLAN):
        pass
    assert (tmp_path / "precious.txt").read_text() == "keep"


def test_our_names_without_our_marker_are_foreign(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    with pytest.raises(InputError), own_folder(tmp_path, PLAN):
        pass
    assert (tmp_path / "runs").is_dir()


def test_a_second_demonstration_goes_beside_the_first(tmp_path: Path) -> None:
    with own_folder(tmp_path / "demo", PLAN), own_folder(tmp_path / "demo", PLAN) as second:
        assert second.folder == tmp_path / "demo-2"


def test_a_folder_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with (
        pytest.raises(InputError, match="can't be made"),
        own_folder(tmp_path / "file" / "d", PLAN),
    ):
        pass
