"""Takes serialised messages from the one side and puts them into a bag on the other."""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from ssp_core.bag import BagMessage, BagWriter
from ssp_core.bag.qos import offered_qos
from ssp_core.errors import SspError
from ssp_monitor.core.topics import Profile, TopicSpec

FLUSH_S = 0.5
POLL_S = 0.02
QUEUE_BYTES = 256 << 20

# Depth and durability that publishers offer, as in ssp_core.ros; that module needs rclpy, and a
# test compares the two.
OFFERED = {
    Profile.STATE: offered_qos(50),
    Profile.COMMAND: offered_qos(50),
    Profile.SENSOR: offered_qos(20),
    Profile.LATCHED: offered_qos(20, transient_local=True),
}


@dataclass(frozen=True, slots=True)
class RecorderState:
    """What is on disk, and what is not.

    Args:
        messages: written.
        bytes: written, message data only.
        dropped: taken but not written, since the queue was full or the disk failed.
        failure: why nothing is written any more, None while all is well.
    """

    messages: int
    bytes: int
    dropped: int
    failure: str | None


class Recorder:
    """A bag with a writer thread of its own, so that a slow disk doesn't stop the reception.

    ``put`` may be called from one thread. The bag is flushed every FLUSH_S seconds: that is the
    most that a SIGKILL can take.

    Args:
        path: bag directory to make.
        topics: what it will hold.
        attachments: (name, media type, data) put in at once.
        queue_bytes: message data that may wait for the disk.

    Raises:
        InputError: the directory exists or can't be made.
        HostError: the file can't be written.
    """

    def __init__(
        self,
        path: Path,
        topics: Iterable[TopicSpec],
        attachments: Iterable[tuple[str, str, bytes]] = (),
        queue_bytes: int = QUEUE_BYTES,
    ) -> None:
        self.path = path
        self._writer = BagWriter(path)
        for name, media_type, data in attachments:
            self._writer.attach(name, data, media_type)
        for topic in topics:
            self._writer.add_topic(topic.name, topic.msgtype, OFFERED[topic.profile])
        self._writer.flush()
        self._queue: deque[BagMessage] = deque()
        self._queue_limit = queue_bytes
        self._bytes_in = 0
        self._bytes_out = 0
        self._dropped_full = 0
        self._dropped_failed = 0
        self.dropped_by_topic: Counter[str] = Counter()
        self._failure: str | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bag-writer", daemon=True)
        self._thread.start()

    def put(self, message: BagMessage) -> None:
        """Hands one message over; it is dropped, and counted, when too much is waiting."""
        size = len(message.data)
        if self._bytes_in - self._bytes_out + size > self._queue_limit:
            self._dropped_full += 1
            self.dropped_by_topic[message.topic] += 1
            return
        self._bytes_in += size
        self._queue.append(message)

    def state(self) -> RecorderState:
        return RecorderState(
            messages=self._writer.messages,
            bytes=self._writer.bytes,
            dropped=self._dropped_full + self._dropped_failed,
            failure=self._failure,
        )

    def stop(self) -> RecorderState:
        """Writes what waits, closes the bag and returns the final state. Never raises for the
        disk's sake: the state says what failed."""
        self._stop.set()
        self._thread.join()
        return self.state()

    def _run(self) -> None:
        try:
            flush_at = time.monotonic() + FLUSH_S
            while not self._stop.wait(POLL_S):
                self._write_waiting()
                if time.monotonic() >= flush_at:
                    self._writer.flush()
                    flush_at = time.monotonic() + FLUSH_S
            self._write_waiting()
            self._writer.close()
        except SspError as error:
            self._failure = str(error)
            self._discard_until_stopped()
        except BaseException as error:
            # A bug here must reach whoever waits for the recorder, not end with its thread.
            self._failure = f"{type(error).__name__}: {error}"
            raise

    def _write_waiting(self) -> None:
        while self._queue:
            message = self._queue.popleft()
            self._bytes_out += len(message.data)
            try:
                self._writer.write(
                    message.topic,
                    message.data,
                    message.log_time_ns,
                    message.publish_time_ns,
                    message.sequence,
                )
            except SspError:
                self._count_dropped(message)
                raise

    def _discard_until_stopped(self) -> None:
        while True:
            stopping = self._stop.wait(POLL_S)
            while self._queue:
                message = self._queue.popleft()
                self._bytes_out += len(message.data)
                self._count_dropped(message)
            if stopping:
                return

    def _count_dropped(self, message: BagMessage) -> None:
        self._dropped_failed += 1
        self.dropped_by_topic[message.topic] += 1
