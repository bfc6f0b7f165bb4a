"""The demonstration empties what it made itself, and nothing else."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.errors import InputError
from ssp_core.files import write_json
from ssp_eval.demo import MARKER, own_folder


def test_an_earlier_demonstration_is_replaced(tmp_path: Path) -> None:
    folder = tmp_path / "demo"
    with own_folder(folder) as first:
        (first / "runs").mkdir()
        (first / "runs" / "x").write_text("old")
        (first / "index.html").write_text("old")
    with own_folder(folder) as second:
        assert second == folder
        assert [p.name for p in second.iterdir()] == [MARKER]
    assert [p.name for p in tmp_path.iterdir()] == ["demo"]


@pytest.mark.parametrize("marker", [None, {"mine": 1}, {"schema": "ssp.demo/1"}])
def test_a_foreign_folder_stays_as_it_is(tmp_path: Path, marker: object) -> None:
    (tmp_path / "precious.txt").write_text("keep")
    if marker is not None:
        write_json(tmp_path / MARKER, marker)
    with pytest.raises(InputError, match="holds something"), own_folder(tmp_path):
        pass
    assert (tmp_path / "precious.txt").read_text() == "keep"


def test_our_names_without_our_marker_are_foreign(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    with pytest.raises(InputError), own_folder(tmp_path):
        pass
    assert (tmp_path / "runs").is_dir()


def test_a_second_demonstration_goes_beside_the_first(tmp_path: Path) -> None:
    with own_folder(tmp_path / "demo"), own_folder(tmp_path / "demo") as second:
        assert second == tmp_path / "demo-2"


def test_a_folder_below_a_file_is_refused(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="can't be made"), own_folder(tmp_path / "file" / "d"):
        pass
