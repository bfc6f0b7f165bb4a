"""Waiting for what another thread or process does."""

from __future__ import annotations

import time
from collections.abc import Callable

DEADLINE_S = 300.0


def until(condition: Callable[[], bool], what: str = "change") -> None:
    """Returns when a condition holds; fails when it takes too long."""
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        assert time.monotonic() < deadline, f"no {what} in time"
        time.sleep(0.005)
