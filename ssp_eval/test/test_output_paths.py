"""An output path that can't be made: one message, exit status 1, no traceback."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from ssp_core.cli import main


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "clip.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 64))
    for _ in range(12):
        writer.write(np.full((64, 64, 3), 90, np.uint8))
    writer.release()
    return path


@pytest.mark.parametrize("verb", ["import-video", "labels", "evaluate", "demo", "run"])
def test_below_a_file(
    verb: str, tmp_path: Path, video: Path, make_bag: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_text("mine")
    out = str(tmp_path / "file" / "below")
    arguments = {
        "import-video": [str(video), "--ego-unknown"],
        "labels": ["new", str(make_bag())],
        "evaluate": [str(make_bag("other")), "--bridge", "silent"],
        "demo": [],
        "run": ["cut_in"],
    }[verb]
    assert main([verb, *arguments, "--out", out]) == 1
    text = capsys.readouterr()
    assert "error:" in text.err
    assert "Traceback" not in text.err
    assert (tmp_path / "file").read_text() == "mine"
