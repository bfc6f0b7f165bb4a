"""Fixtures shared by tests of ssp spec extract: a video, a server, and the command with both."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest

from ssp_core.chat.client import OpenAIChat
from ssp_scenario_manager.cli import spec_extract as extract_cli
from tests.support.models.extraction import Extraction, Server, make_video


@pytest.fixture
def video(tmp_path: Path) -> Path:
    return make_video(tmp_path / "merge clip.avi")


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch) -> Iterator[Server]:
    for name in ("HTTP_PROXY", "HTTPS_PROXY", "ALL_PROXY"):
        monkeypatch.delenv(name, raising=False)
        monkeypatch.delenv(name.lower(), raising=False)
    monkeypatch.setenv("OPENAI_API_KEY", "not for this server")
    with Server() as found:
        threading.Thread(target=found.serve_forever, args=(0.01,), daemon=True).start()
        yield found
        found.shutdown()


@pytest.fixture
def waits(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    """Waits between tries are noted and not waited for."""
    found: list[float] = []
    monkeypatch.setattr(extract_cli, "OpenAIChat", partial(OpenAIChat, sleep=found.append))
    return found


@pytest.fixture
def extraction(
    server: Server, video: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Extraction:
    return Extraction(server, video, tmp_path, capsys)
