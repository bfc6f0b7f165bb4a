"""Rules by which a bag that is being written goes on in its next file.

This file owns what the present file began with: its first log time, and the size that it had then.
"""

from __future__ import annotations

from ssp_core.bag.writing.mcap_output import McapOutput
from ssp_core.bag.writing.split import Split

# A file's index is read as a whole, so it must stay far below mcap_file.MAX_SUMMARY_BYTES: when the
# chunk indexes reach this, the bag goes on in another file. With ten active topics and two chunks
# a second that takes a day.
INDEX_BYTES = 32 << 20


class FileTurn:
    """The limits of the present file.

    Args:
        split: None: only the size of its index.
    """

    def __init__(self, split: Split | None) -> None:
        self._split = split
        self._start_ns: int | None = None
        self._repeated_bytes = 0
        self._index_limit = INDEX_BYTES

    def begin(self, output: McapOutput, begin_ns: int) -> None:
        """Take a new file, in which the repeated messages stand already."""
        self._start_ns = begin_ns
        self._repeated_bytes = output.size
        self._index_limit = output.index_bytes + INDEX_BYTES

    def may_come(self, output: McapOutput) -> bool:
        """Tell whether ``has_come`` must be asked before the next message."""
        return self._split is not None or output.index_bytes >= self._index_limit

    def has_come(self, output: McapOutput, message_bytes: int, log_time_ns: int) -> bool:
        """Tell whether a message belongs into the next file; the first one never does.

        Args:
            output: the present file.
            message_bytes: size of the message.
            log_time_ns: of the message.
        """
        if self._start_ns is None:
            self._start_ns = log_time_ns
            return False
        if output.index_bytes >= self._index_limit:
            return True
        span_ns = log_time_ns - self._start_ns
        return self._split is not None and self._split.due(
            output.size, message_bytes, span_ns, self._repeated_bytes
        )
