"""The time that single parts of one answer take: a backend names them, a driver's process reads it.

Where nothing measures, a part costs nothing.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

# Pictures and request into what is sent; the answer into text, arrays and a trajectory. What is
# left of an answer's time is transport, inference and waits.
ENCODING, PARSING = "encoding", "parsing"

_RUNNING: ContextVar[dict[str, float] | None] = ContextVar("parts", default=None)


@contextmanager
def measuring() -> Iterator[dict[str, float]]:
    """Measure the parts within the block.

    Yields:
        Seconds by part, filled as they end.
    """
    parts: dict[str, float] = {}
    token = _RUNNING.set(parts)
    try:
        yield parts
    finally:
        _RUNNING.reset(token)


@contextmanager
def part(name: str) -> Iterator[None]:
    """Count the block's time as one part, where something measures."""
    parts = _RUNNING.get()
    begin_s = time.perf_counter()
    try:
        yield
    finally:
        if parts is not None:
            parts[name] = parts.get(name, 0.0) + time.perf_counter() - begin_s
