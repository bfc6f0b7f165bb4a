"""Fixtures shared by the importers' tests; foreign_recordings makes the recordings themselves."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from foreign_recordings import TrackDay, cut_in

from ssp_core.cli import main


@pytest.fixture(scope="session")
def day() -> TrackDay:
    return cut_in()


@pytest.fixture
def refused(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> Callable[..., str]:
    """Runs a command that must fail and leave nothing behind; gives its message."""

    def run(*args: object, status: int = 1) -> str:
        before = sorted(tmp_path.rglob("*"))
        assert main([str(a) for a in args]) == status
        assert sorted(tmp_path.rglob("*")) == before
        return " ".join(capsys.readouterr().err.split())

    return run
