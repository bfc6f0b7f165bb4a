"""Machine code is kept per state of the sources."""

from __future__ import annotations

from pathlib import Path

from ssp_ot_controller.camera.kernels.jit import cache_folder, digest


def test_any_source_changes_the_digest(tmp_path: Path) -> None:
    (tmp_path / "a.py").write_text("x = 1\n")
    (tmp_path / "b.py").write_text("y = 1\n")
    before = digest(tmp_path)
    assert digest(tmp_path) == before
    (tmp_path / "notes.txt").write_text("no source")
    assert digest(tmp_path) == before
    (tmp_path / "b.py").write_text("y = 2\n")
    assert digest(tmp_path) != before


def test_folders_of_earlier_sources_are_removed(tmp_path: Path) -> None:
    source, place = tmp_path / "source", tmp_path / "cache"
    source.mkdir()
    (source / "a.py").write_text("x = 1\n")
    first = cache_folder(source, [place])
    (place / "other").mkdir()
    (source / "a.py").write_text("x = 2\n")
    second = cache_folder(source, [place])
    assert first is not None
    assert second is not None
    assert first.parent == second.parent == place
    assert sorted(p.name for p in place.iterdir()) == sorted([second.name, "other"])


def test_a_place_that_cannot_be_written_is_passed_over(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("not a folder")
    assert cache_folder(tmp_path, [blocked]) is None
    chosen = cache_folder(tmp_path, [blocked, tmp_path / "cache"])
    assert chosen is not None
    assert chosen.parent == tmp_path / "cache"
