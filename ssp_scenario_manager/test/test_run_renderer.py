"""``ssp run --renderer``: what excludes it, and what it says where there is no OpenGL."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from ssp_core.errors import HostError
from ssp_core.offscreen import REMEDY
from ssp_scenario_manager.runner import cli


def test_no_camera_and_a_renderer_exclude_each_other() -> None:
    done = CliRunner().invoke(cli.run, ["cut_in", "--no-camera", "--renderer", "gl"])
    assert done.exit_code == 2
    assert "--no-camera and --renderer exclude each other" in done.output


def test_without_opengl_no_session_begins(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    def missing() -> None:
        raise HostError(f"renderer gl: there is no EGL here; {REMEDY}")

    monkeypatch.setattr(cli, "check_gl", missing)
    out = tmp_path / "run"
    done = CliRunner().invoke(cli.run, ["cut_in", "--renderer", "gl", "--out", str(out)])
    assert isinstance(done.exception, HostError)
    assert "pip install 'ssp[gl]'" in str(done.exception)
    assert not (out / "bag").exists()
    assert not (out / "run.yaml").exists()
