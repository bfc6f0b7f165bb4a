"""The health of one part of a system, as ``/diagnostics`` tells it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class Level(IntEnum):
    """By the numbers of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True, slots=True)
class Status:
    """One part's health.

    Args:
        name: of the part.
        part: what it belongs to: an object's id, or a node's name.
        message: the worst of it, in one sentence.
        values: names with units, and what was measured.
    """

    name: str
    part: str
    level: Level
    message: str
    values: tuple[tuple[str, str], ...] = ()
