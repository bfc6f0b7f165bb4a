"""Times as integer nanoseconds. Cores take ``now_ns``; nothing here reads a clock."""

from __future__ import annotations

NS_PER_S = 1_000_000_000
# A stamp is 32 bits of seconds; whoever adds a day to one must still be able to send it.
LATEST_S = 2**31 - 100_000


def seconds_to_ns(seconds: float) -> int:
    """Return the nearest nanosecond; raise ValueError or OverflowError where it isn't finite."""
    return round(seconds * NS_PER_S)


def time_ns(seconds: int, nanoseconds: int) -> int:
    """Return a stamp's two numbers in ns.

    Raises:
        ValueError: no clock of a session gives these: before 0, so late that no message could go
            on from there, or a whole second and more of nanoseconds.
    """
    if not (0 <= seconds <= LATEST_S and nanoseconds < NS_PER_S):
        raise ValueError(f"stamp {seconds} s and {nanoseconds} ns is no time of a session")
    return seconds * NS_PER_S + nanoseconds


def ns_to_seconds(ns: int) -> float:
    return ns / NS_PER_S
