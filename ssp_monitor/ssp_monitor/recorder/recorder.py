"""Takes serialised messages, queues them within bounds, and writes them into a bag.

This file owns what waits for the disk, the names that are given away, and why writing has ended:
``DropQueue`` the first, ``TopicNames`` the second, ``Recorder`` the third. After a failure of the
disk nothing is written any more, and what comes is counted as dropped. ``BagWriter`` owns the file.
"""

from __future__ import annotations

import threading
import time
from collections import Counter, deque
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from ssp_core.bag.metadata import offered_qos, parse_offered_qos
from ssp_core.bag.types import BagMessage, definition
from ssp_core.bag.writing.chain import Maker
from ssp_core.bag.writing.split import Split
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import InputError, SspError
from ssp_core.node_interface import QOS
from ssp_monitor.recorder.encoding import ORIGINAL, Encoding
from ssp_monitor.recorder.plan import Attachment
from ssp_monitor.recorder.topics import Importance, Profile, TopicSpec, importance

if TYPE_CHECKING:
    from ssp_monitor.recorder.video_encoder import VideoEncoder


@dataclass(slots=True)
class TopicRecord:
    """The written messages of one topic.

    Args:
        first_ns: earliest log time, None before the first message.
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
    """The messages that are on disk, and those that are not.

    Args:
        dropped: taken but not written, since the queue was full or the disk failed.
        failure: why nothing is written any more, None while all is well.
        queue_bytes: taken, and neither written nor dropped.
        queue_limit_bytes: above this something is dropped.
        flush_age_s: since all that was taken was handed to the disk.
        seal: digest of the whole bag; empty until it is closed.
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
    seal: str = ""


# What a waiting message takes beside its data: objects, a place in the queue.
OVERHEAD_BYTES = 256
BATCH_MESSAGES = 256


class DropQueue:
    """The queue between the one thread that receives and the one that writes.

    Args:
        limit_bytes: what may wait.
    """

    def __init__(self, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes
        self._dropped: Counter[str] = Counter()
        self._importance: dict[str, int] = {}
        self._waiting: tuple[deque[tuple[int, BagMessage]], ...] = tuple(
            deque() for _ in Importance
        )
        self._bytes_of = [0] * len(Importance)
        self._bytes = 0
        self._writing = 0
        self._number = 0
        self._lock = threading.Lock()

    def announce(self, topics: Mapping[str, Importance]) -> None:
        """Set how important topics are; one that is not announced counts as OTHER."""
        self._importance = {**self._importance, **topics}

    def dropped(self) -> Counter[str]:
        """Count by topic the messages that came in and don't come out."""
        with self._lock:
            return Counter(self._dropped)

    def give_up(self, messages: Iterable[BagMessage]) -> None:
        """Count messages as dropped that were taken and can't be written."""
        with self._lock:
            self._dropped.update(message.topic for message in messages)

    @property
    def bytes(self) -> int:
        """Count the bytes that wait or are being written."""
        return self._bytes

    def __len__(self) -> int:
        return sum(map(len, self._waiting))

    def put_all(self, messages: Iterable[BagMessage]) -> None:
        """Take messages in their order, or drop them or less important ones."""
        ranks, waiting, bytes_of = self._importance, self._waiting, self._bytes_of
        with self._lock:
            for message in messages:
                rank = ranks.get(message.topic, Importance.OTHER)
                size = len(message.data) + OVERHEAD_BYTES
                if self._bytes + size > self.limit_bytes and not self._make_room(rank, size):
                    self._dropped[message.topic] += 1
                    continue
                self._bytes += size
                bytes_of[rank] += size
                self._number += 1
                waiting[rank].append((self._number, message))

    def _make_room(self, rank: int, size: int) -> bool:
        """Drop less important messages, least important first, as many as needed, or none."""
        needed = self._bytes + size - self.limit_bytes
        if sum(self._bytes_of[:rank]) < needed:
            return False
        for lower in range(rank):
            queue = self._waiting[lower]
            while needed > 0 and queue:
                _, victim = queue.pop()
                freed = len(victim.data) + OVERHEAD_BYTES
                self._dropped[victim.topic] += 1
                self._bytes_of[lower] -= freed
                self._bytes -= freed
                needed -= freed
        return True

    def take(self, most_bytes: int) -> list[BagMessage]:
        """Return the oldest messages, in order of arrival; those taken before are done with.

        Args:
            most_bytes: no more are taken once they hold this much.
        """
        messages: list[BagMessage] = []
        size = 0
        with self._lock:
            self._bytes -= self._writing
            ranks = [rank for rank, queue in enumerate(self._waiting) if queue]
            while ranks and size < most_bytes and len(messages) < BATCH_MESSAGES:
                rank = min(ranks, key=self._first_number) if len(ranks) > 1 else ranks[0]
                queue = self._waiting[rank]
                message = queue.popleft()[1]
                messages.append(message)
                own = len(message.data) + OVERHEAD_BYTES
                self._bytes_of[rank] -= own
                size += own
                if not queue:
                    ranks.remove(rank)
            self._writing = size
        return messages

    def _first_number(self, rank: int) -> int:
        return self._waiting[rank][0][0]


FLUSH_S = 0.5
POLL_S = 0.02
# People are told when this much of what was written is not on the disk yet.
BEHIND_S = 1.0
QUEUE_BYTES = 256 << 20
# Taken out of the queue at once; what is still in it can be dropped for something important.
BATCH_BYTES = 8 << 20

# Of the run's own topics.
OFFERED: dict[Profile, str] = {
    profile: offered_qos(QOS[profile.name].depth, transient_local=QOS[profile.name].latched)
    for profile in Profile
    if profile is not Profile.ADAPTED
}
LATCHED = (Profile.LATCHED, Profile.TF_STATIC)


@dataclass(frozen=True, slots=True)
class _AddedTopic:
    topic: TopicSpec
    offered: str
    latched: bool
    encoder: VideoEncoder | None


class TopicNames:
    """The names of a bag's topics that are given away.

    One thread claims topics, and another one places for pictures that could not be encoded.
    """

    def __init__(self) -> None:
        self._claimed: set[str] = set()
        self._originals: dict[str, str] = {}
        self._lock = threading.Lock()

    def claim(self, topic: str) -> None:
        """Claim a topic's own name.

        Raises:
            InputError: pictures of another topic are under it.
        """
        with self._lock:
            if topic in self._originals.values():
                raise InputError(
                    "holds pictures of another topic that could not be encoded",
                    remedy="give the topic another name, or leave it out",
                )
            self._claimed.add(topic)

    def claim_originals(self, topic: str) -> str:
        """Claim and return a name for a topic's pictures; not a real topic's."""
        with self._lock:
            name, number = topic + ORIGINAL, 1
            while name in self._claimed:
                number += 1
                name = f"{topic}{ORIGINAL}_{number}"
            self._claimed.add(name)
            self._originals[topic] = name
        return name

    def originals(self) -> dict[str, str]:
        """Return by topic where its pictures are."""
        with self._lock:
            return dict(self._originals)


class Recorder:
    """A bag with a writer thread of its own, so that a slow disk doesn't stop the reception.

    ``put_all`` may be called from one thread, and ``add`` from another. The bag is
    flushed every FLUSH_S seconds: that, and what waits, is the most that a SIGKILL can take.

    Args:
        topics: what it will hold from its beginning.
        attachments: (name, media type, data) put in at once.
        queue_bytes: what may wait for the disk.
        split: when to go on in a new file.
        encoder: gives a topic's encoder by name and type, or None.

    Raises:
        InputError: the directory exists or can't be made, or a type is not known.
        HostError: the file can't be written.
    """

    def __init__(
        self,
        path: Path,
        topics: Iterable[TopicSpec],
        attachments: Iterable[Attachment] = (),
        queue_bytes: int = QUEUE_BYTES,
        split: Split | None = None,
        encoder: Callable[[str, str], VideoEncoder | None] = lambda _topic, _msgtype: None,
    ) -> None:
        self.path = path
        self._encoder = encoder
        self._queue = DropQueue(queue_bytes)
        self._records: dict[str, TopicRecord] = {}
        self._encodings: dict[str, Encoding] = {}
        self._to_add: deque[_AddedTopic] = deque()
        self._names = TopicNames()
        self._failure: str | None = None
        self._flushed_at = time.monotonic()
        self._writer = BagWriter(path, split=split, maker=Maker.RECORDER)
        for name, media_type, data in attachments:
            self._writer.attach(name, data, media_type)
        for topic in topics:
            self.add(topic, OFFERED[topic.profile], topic.profile in LATCHED)
        self._add_waiting()
        self._writer.flush()
        self._seal: Callable[[], Attachment] | None = None
        self._writing = True
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="bag-writer", daemon=True)
        self._thread.start()

    def add(self, topic: TopicSpec, offered: str, latched: bool) -> None:
        """Announce a topic; needed before its first message.

        Args:
            topic: not announced yet.
            offered: YAML of the profiles of its publishers; left out where no bag can hold it.
            latched: its newest messages stay valid.

        Raises:
            InputError: its type is not known, or pictures of another topic are under its name.
        """
        definition(topic.msgtype)
        try:
            parse_offered_qos(offered)
        except ValueError:
            offered = ""
        self._names.claim(topic.name)
        self._queue.announce({topic.name: importance(topic)})
        encoder = self._encoder(topic.name, topic.msgtype)
        self._to_add.append(_AddedTopic(topic, offered, latched, encoder))

    def put_all(self, messages: Iterable[BagMessage]) -> None:
        """Hand messages over; when too much is waiting, the least important is dropped."""
        self._queue.put_all(messages)

    @property
    def dropped_by_topic(self) -> Counter[str]:
        return self._queue.dropped()

    @property
    def originals(self) -> dict[str, str]:
        """Return by topic where its pictures are that could not be encoded."""
        return self._names.originals()

    def records(self) -> list[TopicRecord]:
        """List the written messages of each topic, in the order of the bag."""
        return list(self._records.values())

    def state(self) -> RecorderState:
        queued = self._queue.bytes
        flush_age_s = time.monotonic() - self._flushed_at
        warnings = [
            f"{topic}: {encoding.failed} pictures could not be encoded and are recorded as "
            f"they came on {encoding.originals}: {encoding.problem}"
            for topic, encoding in list(self._encodings.items())
            if encoding.failed
        ]
        if self._writing and self._failure is None:
            flush_age_s = max(flush_age_s, self._writer.sync_age_s)
            if flush_age_s > BEHIND_S:
                warnings.append(
                    f"the last {flush_age_s:.1f} s isn't on disk yet; a power cut would lose it"
                )
        return RecorderState(
            messages=self._writer.messages,
            bytes=self._writer.bytes,
            dropped=self.dropped_by_topic.total(),
            failure=self._failure,
            files=len(self._writer.files),
            queue_bytes=queued,
            queue_limit_bytes=self._queue.limit_bytes,
            flush_age_s=flush_age_s,
            warnings=tuple(warnings),
            seal=self._writer.seal_end if self._writer.closed and self._failure is None else "",
        )

    def stop(self, seal: Callable[[], Attachment] | None = None) -> RecorderState:
        """Write what waits, close the bag and return the final state.

        Never raises for the disk's sake: the state says what failed.

        Args:
            seal: gives a last attachment, once all messages are written.
        """
        self._seal = seal
        self._stop.set()
        self._thread.join()
        return self.state()

    def _run(self) -> None:
        try:
            while not self._stop.wait(POLL_S):
                self._write_waiting()
                self._flush_when_due()
            self._write_waiting()
            for encoding in list(self._encodings.values()):
                self._write(encoding.finish())
            if self._seal is not None:
                name, media_type, data = self._seal()
                self._writer.attach(name, data, media_type)
            self._writing = False
            self._writer.close()
        except SspError as error:
            self._failure = str(error)
            self._discard_until_stopped()
        except BaseException as error:
            # A bug here must reach whoever waits for the recorder, not end with its thread; and
            # what comes meanwhile is counted.
            self._failure = f"{type(error).__name__}: {error}"
            self._discard_until_stopped()
            raise

    def _flush_when_due(self) -> None:
        if time.monotonic() - self._flushed_at >= FLUSH_S:
            self._writer.flush()
            self._flushed_at = time.monotonic()

    def _write_waiting(self) -> None:
        while True:
            batch = self._queue.take(BATCH_BYTES)
            written_count = 0
            try:
                # After the messages were taken: each was announced before it was put.
                self._add_waiting()
                if not batch:
                    return
                for message in batch:
                    encoding = self._encodings.get(message.topic)
                    self._write([message] if encoding is None else encoding.encode(message))
                    written_count += 1
                    # A batch of pictures may take an encoder many seconds.
                    if encoding is not None:
                        self._flush_when_due()
            except BaseException:
                self._queue.give_up(batch[written_count:])
                raise
            self._flush_when_due()

    def _write(self, messages: Iterable[BagMessage]) -> None:
        for topic, log_time_ns, publish_time_ns, data, sequence in messages:
            self._writer.write(topic, data, log_time_ns, publish_time_ns, sequence)
            self._records[topic].note(log_time_ns, len(data))

    def _add_waiting(self) -> None:
        while self._to_add:
            added = self._to_add.popleft()
            name, msgtype = added.topic.name, added.topic.msgtype
            if added.encoder is not None:
                add_original = partial(self._add_originals, name, msgtype, added)
                self._encodings[name] = Encoding(added.encoder, add_original)
                msgtype = added.encoder.msgtype
            self._announce(name, msgtype, added)

    def _add_originals(self, topic: str, msgtype: str, added: _AddedTopic) -> str:
        """Announce where a topic's pictures go that can't be encoded; not a real topic's name."""
        name = self._names.claim_originals(topic)
        self._announce(name, msgtype, added)
        return name

    def _announce(self, name: str, msgtype: str, added: _AddedTopic) -> None:
        self._writer.add_topic(name, msgtype, added.offered, latched=added.latched)
        # A new dictionary: other threads go through the old one.
        self._records = {**self._records, name: TopicRecord(name, msgtype)}

    def _discard_until_stopped(self) -> None:
        while True:
            stopping = self._stop.wait(POLL_S)
            while batch := self._queue.take(BATCH_BYTES):
                self._queue.give_up(batch)
            if stopping:
                return
