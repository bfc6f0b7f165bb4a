"""The conditions under which a bag goes on in a new file."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.errors import InputError

MIN_BYTES = 1024  # as rosbag2
SET_BACK_BYTES = 1 << 20
# Metadata of the channels of repeated messages, see latched.LatchedTopic.
REPEATED_KEY = "ssp_repeated"
REPEATED = {REPEATED_KEY: "true"}


@dataclass(frozen=True, slots=True)
class Split:
    """The limits at which a new file begins; None is never.

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
            raise InputError(
                "must be positive",
                field="max_s",
                value=self.max_s,
                remedy="give a number of seconds above 0",
            )

    def due(self, file_bytes: int, message_bytes: int, span_ns: int, repeated_bytes: int) -> bool:
        """Tell whether a message belongs into a new file.

        Args:
            file_bytes: size of the present file so far.
            message_bytes: size of the message.
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
