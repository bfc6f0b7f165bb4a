"""Live sessions whose objects speak ISO 22133, and are played by ours."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PORT = 19_000
pytestmark = [pytest.mark.ros, pytest.mark.system]


def objects_of(stage: Any) -> tuple[str, ...]:
    port = PORT + 2 * (os.getpid() % 1000)
    return ("--body", f"ot1=iso22133://127.0.0.1:{port}?waive=A. Tester")


def play_objects(stage: Any) -> subprocess.Popen[Any]:
    port = str(PORT + 2 * (os.getpid() % 1000))
    parts = ("--play", "iso", "--first-port", port, "--log", str(stage.log))
    played: subprocess.Popen[Any] = stage.play("objects", *parts)
    return played


@pytest.mark.parametrize("scenario", ["cut_in", "vru_crossing"])
def test_a_session_with_test_objects_is_valid(
    scenario: str, stage: Any, task: Callable[..., Path]
) -> None:
    run = stage.run_live(task(scenario, datum=True), "--no-camera", *objects_of(stage))
    play_objects(stage)
    stage.play("vut", "--play", "vut")
    stage.ask_doctor()
    stage.begin(run)
    result = stage.finish(run)
    print(stage.said("ssp_run"), stage.said("objects"))
    assert (result["verdict"], result["status"]) == ("valid", 0), (result, stage.said("ssp_run"))
