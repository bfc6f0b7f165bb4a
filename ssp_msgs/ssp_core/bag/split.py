"""When a bag goes on in a new file, and which messages that file begins with."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from ssp_core.bag.metadata import parse_offered_qos, stated_depth
from ssp_core.errors import InputError

MIN_BYTES = 1024  # as rosbag2
SET_BACK_BYTES = 1 << 20
# Of a latched topic: what a claimed depth may make us remember, and what is kept without one.
MOST_KEPT = 1000
UNTOLD_DEPTH = 100
KEPT_BYTES = 16 << 20
# Metadata of the channels of repeated messages, see LatchedTopic.
REPEATED_KEY = "ssp_repeated"
REPEATED = {REPEATED_KEY: "true"}


@dataclass(frozen=True, slots=True)
class Split:
    """When to begin a new file; None is never.

    Args:
        max_bytes: before a message that would make the file larger, indexes not counted.
        max_s: before a message whose log time is that far from the file's first one.

    Raises:
        InputError: a limit is too small to hold a message.
    """

    max_bytes: int | None = None
    max_s: float | None = None

    def __post_init__(self) -> None:
        if self.max_bytes is not None and self.max_bytes < MIN_BYTES:
            raise InputError(
                "is too small a file",
                field="max_bytes",
                value=self.max_bytes,
                remedy=f"at least {MIN_BYTES} bytes",
            )
        if self.max_s is not None and not self.max_s > 0:
            raise InputError("must be positive", field="max_s", value=self.max_s)

    def due(self, file_bytes: int, message_bytes: int, span_ns: int, repeated_bytes: int) -> bool:
        """Whether a message belongs into a new file.

        Args:
            span_ns: from the file's first log time to the message's; a clock that was set back
                makes it negative, and is as good a reason as one that runs on, but not in a small
                file: two clocks taking turns would make one of every message.
            repeated_bytes: of the file, what it began with. It takes as much that is new, however
                small the limit: a large latched message would else fill the disk.
        """
        if self.max_bytes is not None:
            limit = max(self.max_bytes, 2 * repeated_bytes)
            if file_bytes + message_bytes > limit:
                return True
        if span_ns < 0 and file_bytes < SET_BACK_BYTES:
            return False
        return self.max_s is not None and abs(span_ns) >= self.max_s * 1e9


class Kept(NamedTuple):
    """A latched message that later files repeat."""

    cdr: bytes
    publish_time_ns: int
    sequence: int


class LatchedTopic:
    """The newest messages of a latched topic, as many as its publishers offer to late joiners.

    A later file begins with them: with the publish time that they had and the log time at which
    that file begins, so that the order by log time holds. They stand in a channel of their own,
    of the same topic, which carries ``ssp_repeated: "true"`` in its metadata: a reader of the
    whole bag skips these channels in all files but the first, a reader of one file takes them.

    Where the publishers don't say how many they offer, which is what a graph tells of another
    process's publishers, there are UNTOLD_DEPTH: one message per publisher may be valid, and more
    publishers may have come later. In any case they are bounded by KEPT_BYTES, beyond which only
    one for each publisher is kept.

    Args:
        offered_qos: the topic's publishers, as YAML.
    """

    def __init__(self, offered_qos: str) -> None:
        self._most = stated_depth(offered_qos, MOST_KEPT) or UNTOLD_DEPTH
        self._least = min(max(1, len(parse_offered_qos(offered_qos))), self._most)
        self._bytes = 0
        self.kept: deque[Kept] = deque()

    def keep(self, message: Kept) -> None:
        """Adds the newest message and lets those go that are too many or too large."""
        self.kept.append(message)
        self._bytes += len(message.cdr)
        while len(self.kept) > self._most or (
            self._bytes > KEPT_BYTES and len(self.kept) > self._least
        ):
            self._bytes -= len(self.kept.popleft().cdr)
