"""A file that is no video costs one message of ours, and none of the libraries."""

from __future__ import annotations

from pathlib import Path

import cv2
import pytest

from ssp_core.errors import InputError
from ssp_core.video import Video


def test_opencv_adds_nothing_to_the_message(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "no.mp4"
    file.write_text("not a video")
    with pytest.raises(InputError, match="is no video that can be decoded"):
        Video(file)
    assert capfd.readouterr() == ("", "")
    assert not cv2.VideoCapture(str(tmp_path / "absent.mp4"), cv2.CAP_FFMPEG).isOpened()
    assert capfd.readouterr() == ("", ""), "whatever was imported first"
