"""The messages of a bag that a replay needs, read ahead so that the disk makes none late."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Iterator

from ssp_core.bag.reader import BagReader
from ssp_core.bag.types import BagMessage
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.errors import InputError
from ssp_monitor.replay.plan import PlannedTopic

AHEAD_BYTES = 64 << 20
AHEAD_MESSAGES = 20_000


class MessageSource:
    """A stretch of a bag.

    Args:
        reader: stays open as long as this is used.
        lines: the topics.
        start_s: from the bag's first message.
        end_s: from the bag's first message; None: to the end.

    Raises:
        InputError: the stretch lies outside the bag.
    """

    def __init__(
        self,
        reader: BagReader,
        lines: tuple[PlannedTopic, ...],
        start_s: float = 0.0,
        end_s: float | None = None,
    ) -> None:
        first_ns, last_ns = reader.start_ns, reader.end_ns
        if first_ns is None or last_ns is None:
            raise InputError("holds no message", file=reader.path)
        self._reader = reader
        self._lines = lines
        self.bag_start_ns = first_ns
        self.start_ns = first_ns + seconds_to_ns(start_s)
        self.end_ns = last_ns if end_s is None else min(last_ns, first_ns + seconds_to_ns(end_s))
        if not self.start_ns <= self.end_ns:
            raise InputError(
                "lies behind the end",
                file=reader.path,
                field="--start",
                value=start_s,
                remedy=f"the bag is {ns_to_seconds(last_ns - first_ns):.3f} s long"
                + ("" if end_s is None else f", --end is {end_s:g}"),
            )

    @property
    def length_ns(self) -> int:
        return self.end_ns - self.start_ns

    def kept(self) -> list[BagMessage]:
        """What latched publishers kept from before the start: the newest messages of each, as many
        as it offered, in order of time."""
        if self.start_ns <= self.bag_start_ns:
            return []
        kept = {
            line.recorded: deque[BagMessage](maxlen=line.offer.depth)
            for line in self._lines
            if line.offer.latched
        }
        for message in (
            self._reader.messages(frozenset(kept), self.bag_start_ns, self.start_ns) if kept else ()
        ):
            kept[message.topic].append(message)
        found = [message for messages in kept.values() for message in messages]
        return sorted(found, key=lambda message: message.log_time_ns)

    def messages(self) -> ReadAhead:
        """The stretch from its beginning."""
        topics = frozenset(line.recorded for line in self._lines)
        return ReadAhead(self._reader.messages(topics, self.start_ns, self.end_ns + 1))


class ReadAhead(Iterator[BagMessage]):
    """Messages that a thread of its own takes from an iterator before they are asked for.

    What the iterator raises is raised here in the place of the message that it has instead.

    Args:
        messages: used by that thread alone.
        limit_bytes: message data that may wait.
    """

    def __init__(self, messages: Iterator[BagMessage], limit_bytes: int = AHEAD_BYTES) -> None:
        self._messages = messages
        self._limit_bytes = limit_bytes
        self._waiting: deque[BagMessage] = deque()
        self._bytes = 0
        self._over = False
        self._closed = False
        self._error: BaseException | None = None
        self._changed = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="read-ahead", daemon=True)
        self._thread.start()

    def __next__(self) -> BagMessage:
        with self._changed:
            while not self._waiting:
                if self._error is not None:
                    raise self._error
                if self._over:
                    raise StopIteration
                self._changed.wait()
            message = self._waiting.popleft()
            was_full = self._is_full
            self._bytes -= len(message.data)
            if was_full and not self._is_full:
                self._changed.notify_all()
            return message

    def close(self) -> None:
        """Ends the thread; what wasn't asked for is forgotten."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()
        self._thread.join()

    @property
    def _is_full(self) -> bool:
        # One message is taken however large it is.
        return self._bytes >= self._limit_bytes or len(self._waiting) >= AHEAD_MESSAGES

    def _run(self) -> None:
        try:
            for message in self._messages:
                with self._changed:
                    while self._is_full and not self._closed:
                        self._changed.wait()
                    if self._closed:
                        return
                    self._waiting.append(message)
                    self._bytes += len(message.data)
                    self._changed.notify_all()
        except BaseException as error:  # whatever it is belongs to whoever asks for messages
            self._error = error
        finally:
            with self._changed:
                self._over = True
                self._changed.notify_all()
