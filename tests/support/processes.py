"""Ends what a test started."""

from __future__ import annotations

import subprocess

_ORDERLY_S = 10.0


def end(process: subprocess.Popen[str]) -> None:
    """Ends a node in order, and only one that doesn't heed it by force.

    A killed participant may leave the shared memory that others read, the test's own process
    among them, in the middle of a change, and Fast DDS has crashed on that (its issue 6501).
    """
    process.terminate()
    try:
        process.communicate(timeout=_ORDERLY_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.communicate()
