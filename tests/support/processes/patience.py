"""Limits of silence that a busy machine doesn't pass, for tests that judge something else.

A machine at a load of 20 keeps a process waiting for two seconds, be it the test's own.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import IO, Any

ROOT = Path(__file__).parents[3]
PATIENT_S = 60.0
# Of sessions that drive, where a stop after so long a silence must end inside the fence, and of
# tests that wait for a silence to be noticed.
SILENCE_S = 2.0
# The limits of a run that pass when a process is kept waiting.
WAITS = (
    "state_age_s",
    "heartbeat_s",
    "ack_s",
    "frozen_s",
    "link_delay_s",
    "trigger_age_s",
    "stop_reaction_s",
)


def patient(run: dict[str, Any], **limits: float) -> dict[str, Any]:
    """Return a run, as its file has it, that waits for a minute but for the limits given."""
    wide = dict.fromkeys(WAITS, PATIENT_S)
    return {**run, "limits": {**run["limits"], **wide, **limits}}


def start_manager(
    env: dict[str, str], out: int | IO[Any] = subprocess.PIPE
) -> subprocess.Popen[Any]:
    """Start a scenario_manager that waits a minute for recorder, camera and world in lockstep."""
    command = [sys.executable, "-m", "tests.support.processes.patient_manager"]
    return subprocess.Popen(
        command, env=env, stdout=out, stderr=subprocess.STDOUT, cwd=ROOT, text=True
    )
