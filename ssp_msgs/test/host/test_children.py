"""Starts of workers: forks only where nothing else runs in the process."""

from __future__ import annotations

import subprocess
import sys

_PROGRAM = """
import threading
from ssp_core.host.children import worker_context

print(worker_context().get_start_method())
go_on = threading.Event()
threading.Thread(target=go_on.wait).start()
print(worker_context().get_start_method())
go_on.set()
"""


def test_workers_are_forked_where_a_process_has_one_thread() -> None:
    """A lock that another thread held at the fork would be held in the worker for ever."""
    command = [sys.executable, "-P", "-c", _PROGRAM]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, check=True)
    assert done.stdout.split() == ["fork", "spawn"]
