"""Times as integer nanoseconds. Cores take ``now_ns``; nothing here reads a clock."""

from __future__ import annotations

NS_PER_S = 1_000_000_000


def seconds_to_ns(seconds: float) -> int:
    """Nearest nanosecond. Raises ValueError or OverflowError for a value that isn't finite."""
    return round(seconds * NS_PER_S)


def ns_to_seconds(ns: int) -> float:
    return ns / NS_PER_S
