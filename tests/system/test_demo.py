"""The demonstration, as the README starts it: interrupted, and taken up to its end."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

pytestmark = [pytest.mark.ros, pytest.mark.system]
# Long, since nothing is judged by time.
START_DEADLINE_S = 300.0


@pytest.mark.timeout(1800)  # two starts of a command of two minutes, on a busy machine
def test_an_interrupted_demo_ends_its_session_and_is_taken_up_to_its_end(
    tmp_path: Path, live_processes: Any
) -> None:
    folder = tmp_path / "demo"
    run = folder / "runs" / "cut_in-simulation"
    command = [sys.executable, "-m", "ssp_core.cli", "demo", "--out", str(folder)]
    # One event goes through every step; those of two are planned in test_demo_plan.py.
    command += ["--scenario", "cut_in"]
    demo = subprocess.Popen(
        command,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + START_DEADLINE_S
        manager_log = run / "logs" / "scenario_manager.log"
        while not (manager_log.is_file() and "-> RUNNING" in manager_log.read_text()):
            assert demo.poll() is None, "the demonstration ended before its first session ran"
            assert time.monotonic() < deadline, "the first session doesn't run"
            time.sleep(0.1)
        demo.send_signal(signal.SIGINT)
        _, err = demo.communicate(timeout=START_DEADLINE_S)
    finally:
        if demo.poll() is None:
            demo.kill()
            demo.communicate()
    assert demo.returncode == 1
    assert "interrupted" in err
    result = json.loads((run / "result.json").read_text())
    assert result["verdict"] == "aborted"
    assert (run / "bag" / "metadata.yaml").is_file()
    assert live_processes(folder) == {}

    again = subprocess.run(command, capture_output=True, text=True, timeout=1500, check=False)
    assert again.returncode == 0, again.stderr  # every control "perfect" scores 1
    summary = json.loads((run / "result.json").read_text())
    assert summary["verdict"] == "valid"
    assert "cut_in" in (folder / "index.html").read_text()
    assert (folder / "package" / "package.json").is_file()
    assert live_processes(folder) == {}
