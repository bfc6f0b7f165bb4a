"""A serialised message on its way into a bag or out of one."""

from __future__ import annotations

from typing import NamedTuple


class BagMessage(NamedTuple):
    """One serialised message; log time is when it was received, publish time when it was sent."""

    topic: str
    log_time_ns: int
    publish_time_ns: int
    data: bytes
    sequence: int = 0
