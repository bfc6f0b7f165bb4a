"""What a recorder knows of itself: per topic, and as a whole."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(slots=True)
class TopicRecord:
    """What was written of one topic.

    Args:
        name: in the bag.
        msgtype: in the bag.
        messages: written.
        bytes: written, message data only.
        first_ns: earliest log time, None before the first message.
        last_ns: latest log time.
    """

    name: str
    msgtype: str
    messages: int = 0
    bytes: int = 0
    first_ns: int | None = None
    last_ns: int | None = None

    def note(self, log_time_ns: int, size: int) -> None:
        self.messages += 1
        self.bytes += size
        if self.first_ns is None or log_time_ns < self.first_ns:
            self.first_ns = log_time_ns
        if self.last_ns is None or log_time_ns > self.last_ns:
            self.last_ns = log_time_ns


@dataclass(frozen=True, slots=True)
class RecorderState:
    """What is on disk, and what is not.

    Args:
        messages: written.
        bytes: written, message data only.
        dropped: taken but not written, since the queue was full or the disk failed.
        failure: why nothing is written any more, None while all is well.
        files: of the bag so far.
        queue_bytes: taken, and neither written nor dropped.
        queue_limit_bytes: above this something is dropped.
        flush_age_s: since all that was taken was handed to the disk.
        warnings: sentences for people.
    """

    messages: int
    bytes: int
    dropped: int
    failure: str | None
    files: int = 1
    queue_bytes: int = 0
    queue_limit_bytes: int = 0
    flush_age_s: float = 0.0
    warnings: tuple[str, ...] = ()
