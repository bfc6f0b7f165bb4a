"""Functions for helper processes, which can't import test modules."""

from __future__ import annotations

import os
import time
from pathlib import Path

from tests.support.processes.waiting import DEADLINE_S, until


def meet(own: Path, other: Path) -> int:
    """Wait until the other call runs too; return the number of the process that runs this one."""
    own.touch()
    until(other.exists, other.name)
    return os.getpid()


def stay(began: Path) -> None:
    """Write the number of its process into a file, and go on until the process is ended."""
    part = began.with_suffix(".part")
    part.write_text(str(os.getpid()))
    part.rename(began)
    time.sleep(10 * DEADLINE_S)
