"""The messages of recorder processes, apart from those that a busy disk causes."""

from __future__ import annotations

import subprocess
import threading
from collections.abc import Iterable

from tests.support.processes.waiting import DEADLINE_S

# Said, correctly, whenever a flush takes longer than the recorder promises.
DISK_IS_BEHIND = "isn't on disk yet"


def without_a_busy_disk(lines: Iterable[str]) -> list[str]:
    """Return all sentences but the one on a disk that is behind."""
    return [line for line in lines if DISK_IS_BEHIND not in line]


def line_with(process: subprocess.Popen[str], *texts: str) -> str:
    """Read the standard error of a process up to a line with one of these texts; return it."""
    assert process.stderr is not None
    in_vain = threading.Timer(DEADLINE_S, process.kill)
    in_vain.start()
    read = []
    try:
        for line in process.stderr:
            if any(text in line for text in texts):
                return line
            read.append(line)
    finally:
        in_vain.cancel()
    raise AssertionError(f"none of {texts} was said, but {read}")
