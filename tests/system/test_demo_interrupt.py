"""Ctrl-C during the demonstration ends the running session in order."""

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


def test_interrupted_demo_aborts_its_session(tmp_path: Path, live_processes: Any) -> None:
    folder = tmp_path / "demo"
    run = folder / "runs" / "cut_in-simulation"
    demo = subprocess.Popen(
        [sys.executable, "-m", "ssp_core.cli", "demo", "--out", str(folder)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        deadline = time.monotonic() + 120.0
        manager_log = run / "logs" / "scenario_manager.log"
        while not (manager_log.is_file() and "-> RUNNING" in manager_log.read_text()):
            assert demo.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.1)
        demo.send_signal(signal.SIGINT)
        _, err = demo.communicate(timeout=120)
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
