"""A session that can't be run here is refused before anything is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.cli import main
from ssp_core.errors import HostError
from ssp_core.host import locks
from ssp_scenario_manager.cli import run as run_module
from tests.support.bags.full_disk import largest_file


def test_a_host_without_shared_memory_keeps_the_folder_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def refuse() -> None:
        raise HostError("/dev/shm must be writable")

    monkeypatch.setattr(run_module, "check_shared_memory", refuse)
    assert main(["run", "cut_in", "--out", str(tmp_path / "run")]) == 1
    assert "/dev/shm must be writable" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_host_on_which_no_domain_can_be_held_keeps_the_folder_free(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """A read-only /tmp is such a case; run.yaml and the task used to be left there."""
    (tmp_path / "file").write_text("")
    monkeypatch.setattr(locks, "LOCKS", tmp_path / "file")
    assert main(["run", "cut_in", "--out", str(tmp_path / "run")]) == 1
    assert "every user may make files, or use --in-process" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_a_body_on_a_host_that_cannot_be_reached_keeps_the_folder_free(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """It used to begin a session and to record, and the object's process died in it."""
    run = ["run", "cut_in", "--site", "north_track", "--mode", "live"]
    assert main([*run, "--out", str(tmp_path / "run"), "--body", "ot1=udp://a..b:9"]) == 1
    told = " ".join(capsys.readouterr().err.split())
    assert "--body: 'a..b' is no name of a host (got 'ot1=udp://a..b:9'); correct the" in told
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("options", "beyond"),
    [((), "states.npz"), (("--record", "--no-camera"), "bag/bag_0.mcap")],
    ids=("its states", "its bag"),
)
def test_a_full_disk_keeps_nothing_of_a_run_without_result_and_recording(
    options: tuple[str, ...], beyond: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    with largest_file(30_000):
        assert main(["run", "cut_in", "--in-process", *options, "--out", str(run)]) == 1
    assert f"error: {run / beyond}: " in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_a_recording_that_a_full_disk_cut_off_is_kept(tmp_path: Path) -> None:
    run = tmp_path / "run"
    words = ["run", "cut_in", "--in-process", "--record", "--no-camera", "--out", str(run)]
    with largest_file(200_000):
        assert main(words) == 1
    assert {file.name for file in run.iterdir()} == {"bag", "run.yaml", "task"}
