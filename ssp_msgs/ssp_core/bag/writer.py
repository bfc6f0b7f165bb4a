"""Writes a bag directory that rosbag2, Foxglove and rosbags read: MCAP files and metadata.yaml."""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

from mcap.records import Channel, Schema

from ssp_core import __version__
from ssp_core.bag.chain import SOURCE_NAME, Chain, Ending, Maker, Source
from ssp_core.bag.latched import Kept, LateJoiner, late_joiner
from ssp_core.bag.mcap_output import CHUNK_BYTES, DiskSync, McapOutput
from ssp_core.bag.metadata import (
    FILE_NAME,
    BagFacts,
    FileFacts,
    TopicFacts,
    metadata_yaml,
    parse_offered_qos,
    serialized_metadata,
)
from ssp_core.bag.split import REPEATED, Split
from ssp_core.bag.types import BagMessage, TypeDefinition, definition
from ssp_core.errors import HostError, InputError
from ssp_core.files import Closing, write_text

_MAX_IDS = (1 << 16) - 1


@dataclass(slots=True)
class WrittenTopic:
    """One topic.

    Args:
        latched: what later files repeat, None where nothing is.
        repeats: where later files put the repeated messages; made with the first of them.
    """

    channel: Channel
    schema: Schema
    latched: LateJoiner | None
    repeats: Channel | None = None


LIBRARY = f"ssp {__version__}"
# A file's index is read as a whole, so it must stay far below mcap_file.MAX_SUMMARY_BYTES: when the
# chunk indexes reach this, the bag goes on in another file. With ten active topics and two chunks
# a second that takes a day.
INDEX_BYTES = 32 << 20
_MAX_TIME = (1 << 64) - 1


class BagWriter(Closing):
    """A bag being written; a context manager that closes it, also after an exception.

    Messages are taken serialised and never looked into. What was written before the last
    ``flush`` survives a SIGKILL at once and a power failure within a second (``recover`` makes a
    closed bag of it).

    Args:
        path: the bag directory; it is made, and must not exist.
        name: stem of the first MCAP file inside, ``<directory>_0`` by default as in rosbag2.
        split: when to go on in a new file, None for never: then only when the index of a file
            has become too large to be read.
        maker: what writes it, for its seal.

    Raises:
        InputError: the directory exists or can't be made.
        HostError: the file can't be made.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        name: str | None = None,
        split: Split | None = None,
        maker: Maker = Maker.WRITER,
    ) -> None:
        self.path = Path(path)
        try:
            self.path.mkdir(parents=True)
        except FileExistsError as error:
            raise InputError(
                "exists already", file=self.path, remedy="name a new directory or remove this one"
            ) from error
        except OSError as error:
            raise InputError(f"can't be made: {error.strerror}", file=self.path) from error
        first = name or self.path.name + "_0"
        self.files: tuple[Path, ...] = (self.path / f"{first}.mcap",)
        self._stem = first.removesuffix("_0")
        self._split = split
        self._begun_ns: int | None = None
        self._repeated_bytes = 0
        self._index_limit = INDEX_BYTES
        # All topics of the bag, the same in each of its files.
        self._topics: dict[str, WrittenTopic] = {}
        self._schemas: dict[TypeDefinition, Schema] = {}
        self._channels = 0
        self._whole: list[FileFacts] = []
        self._counts: Counter[str] = Counter()
        self.messages = 0
        self.bytes = 0
        self.closed = False
        self._sync = DiskSync()
        self._chain = Chain()
        self._maker = maker
        try:
            opened = FileIO(self.file, "xb")
            self._output = McapOutput(opened, self.file, LIBRARY, self._chain, maker=maker)
        except OSError as error:
            raise HostError(f"{self.file}: can't be opened: {error.strerror}") from error
        self._chunk = self._output.chunk
        try:
            self._output.flush()
        except OSError as error:
            raise self._broken(error) from error

    @property
    def file(self) -> Path:
        """The file that is being written, or was the last."""
        return self.files[-1]

    def add_topic(
        self,
        topic: str,
        msgtype: str,
        offered_qos: str = "",
        *,
        written: TypeDefinition | None = None,
        latched: bool = False,
    ) -> None:
        """Announce a topic; needed before its first message.

        Args:
            topic: full name.
            msgtype: full type name, ``package/msg/Name``.
            offered_qos: YAML from ``offered_qos``, or empty.
            written: the definition to put into the file; by default the one that this project
                knows for the type.
            latched: its newest messages stay valid, so each new file begins with them; static
                transforms always do.

        Raises:
            InputError: the type is not known and no definition was given, or there are more
                topics or types than a file has numbers for.
            ValueError: the topic was added before, or the QoS is no complete YAML list.
        """
        parse_offered_qos(offered_qos)
        written = written or definition(msgtype)
        if topic in self._topics:
            raise ValueError(f"topic {topic} was added before")
        known = self._schemas.get(written)
        if not written.msgtype:
            known = Schema(0, b"", "", "")  # MCAP's way to say that a topic has no type
        if known is None and len(self._schemas) == _MAX_IDS:
            raise InputError("is one type too many", file=self.file, field=topic)
        schema = known or Schema(len(self._schemas) + 1, written.data, written.encoding, msgtype)
        metadata = {"offered_qos_profiles": offered_qos, "topic_type_hash": written.type_hash}
        channel = self._channel(topic, metadata, schema, written.message_encoding)
        if known is None:
            self._schemas[written] = schema
            self._output.add_schema(schema)
        self._output.add_channel(channel)
        kept = late_joiner(topic, msgtype, offered_qos, latched=latched)
        self._topics[topic] = WrittenTopic(channel, schema, kept)

    def _channel(
        self, topic: str, metadata: dict[str, str], schema: Schema, encoding: str
    ) -> Channel:
        if self._channels == _MAX_IDS:
            raise InputError("is one topic too many", file=self.file, field=topic)
        self._channels += 1
        return Channel(self._channels, topic, encoding, metadata, schema.id)

    def write(
        self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int, sequence: int = 0
    ) -> None:
        """Append one serialised message.

        Args:
            topic: one that was added.
            cdr: the message with its encapsulation; it must not change afterwards.
            log_time_ns: when it was received; readers order by it.
            publish_time_ns: when it was sent.
            sequence: the publisher's number for it, 0 when there is none.

        Raises:
            HostError: the disk didn't take it; the writer is closed then.
            KeyError: the topic was not added.
            ValueError: a time is negative or has more than 64 bits, or the writer is closed.
        """
        entry = self._topics[topic]
        if self.closed:
            raise ValueError(f"{self.path} is closed")
        full = self._output.index_bytes >= self._index_limit
        if full or self._split is not None or entry.latched is not None:
            self._before_message(entry, cdr, log_time_ns, publish_time_ns, sequence)
        chunk = self._chunk
        try:
            chunk.add(entry.channel.id, sequence & 0xFFFFFFFF, log_time_ns, publish_time_ns, cdr)
        except struct.error as error:
            raise ValueError(
                "times must not be negative nor exceed 64 bits, "
                f"got {log_time_ns}, {publish_time_ns}"
            ) from error
        if chunk.size >= CHUNK_BYTES:
            try:
                self._output.flush()
            except OSError as error:
                raise self._broken(error) from error
        self.messages += 1
        self.bytes += len(cdr)

    def write_all(self, messages: Iterable[BagMessage]) -> None:
        """Append messages in order; as write, of which the first that fails ends the call."""
        for topic, log_time_ns, publish_time_ns, data, sequence in messages:
            self.write(topic, data, log_time_ns, publish_time_ns, sequence)

    def _before_message(
        self, entry: WrittenTopic, cdr: bytes, log_time_ns: int, publish_time_ns: int, sequence: int
    ) -> None:
        """Begin a new file when it is time for one, and keep what later files repeat."""
        if min(log_time_ns, publish_time_ns) < 0 or max(log_time_ns, publish_time_ns) > _MAX_TIME:
            return  # write refuses it; nothing may have happened before
        if self._begun_ns is None:
            self._begun_ns = log_time_ns
        elif self._output.index_bytes >= self._index_limit or (
            self._split is not None
            and self._split.due(
                self._output.size, len(cdr), log_time_ns - self._begun_ns, self._repeated_bytes
            )
        ):
            try:
                self._next_file(log_time_ns)
            except OSError as error:
                raise self._broken(error) from error
        if entry.latched is not None:
            entry.latched.keep(Kept(cdr, publish_time_ns, sequence & 0xFFFFFFFF))

    def _next_file(self, begin_ns: int) -> None:
        number = len(self.files)
        file = self.path / f"{self._stem}_{number}.mcap"
        self._output.flush()  # whether there can be another file or not
        # Before the present one ends: after a kill between the two the next would seem taken away.
        opened = FileIO(file, "xb")
        try:
            self._finish_file(Ending.FILE)
            # Only now: a folder that was replaced before has taken the new file without a word.
            self._hand_over()
        except (HostError, OSError):
            opened.close()
            file.unlink(missing_ok=True)
            raise
        output = McapOutput(opened, file, LIBRARY, self._chain, number=number, maker=self._maker)
        self._sync.request(self.file.name, self._output.descriptor)
        self._output.close()
        self.files += (file,)
        self._output = output
        self._chunk = output.chunk
        self._begun_ns = begin_ns
        for schema in self._schemas.values():
            output.add_schema(schema)
        for name, topic in self._topics.items():
            output.add_channel(topic.channel)
            if topic.latched is not None and (kept := list(topic.latched.kept)):
                if topic.repeats is None:
                    metadata = topic.channel.metadata | REPEATED
                    encoding = topic.channel.message_encoding
                    topic.repeats = self._channel(name, metadata, topic.schema, encoding)
                repeats = topic.repeats
                output.add_channel(repeats)
                for cdr, publish_time_ns, sequence in kept:
                    output.chunk.add(repeats.id, sequence, begin_ns, publish_time_ns, cdr)
                    if output.chunk.size >= CHUNK_BYTES:
                        output.flush()
        self._repeated_bytes = output.size
        self._index_limit = output.index_bytes + INDEX_BYTES

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """Put a file into the bag, whole, at once."""
        _, end_ns = self._output.times() or (0, 0)
        try:
            self._output.attach(name, media_type, data, end_ns)
        except OSError as error:
            raise self._broken(error) from error

    def add_sources(self, sources: Iterable[Source]) -> None:
        """Say of which bags this one is made."""
        try:
            for source in sources:
                self._output.add_metadata(SOURCE_NAME, source.values())
        except OSError as error:
            raise self._broken(error) from error

    def flush(self) -> None:
        """Finish the chunk and hand it to the system: a SIGKILL takes nothing before this.

        The disk is asked to take it too, without waiting for that while it keeps up: an error of
        the disk comes with this or the next flush. For a disk that is more than a second behind
        this waits, some seconds at most.

        Raises:
            HostError: the disk didn't take it, or the bag was removed meanwhile.
        """
        self._hand_over()
        try:
            self._sync.request(self.file.name, self._output.descriptor)
            self._sync.wait_for_overdue()
        except OSError as error:
            raise self._broken(error) from error

    @property
    def sync_age_s(self) -> float:
        """Seconds since all that was flushed is known to be on the disk; 0.0 when nothing waits.

        Any thread may ask.
        """
        return self._sync.age_s

    def _hand_over(self) -> None:
        try:
            self._output.flush()
            on_disk, ours = os.stat(self.file), os.fstat(self._output.descriptor)
        except OSError as error:
            raise self._broken(error) from error
        if (on_disk.st_dev, on_disk.st_ino) != (ours.st_dev, ours.st_ino):
            raise self._broken(OSError(0, "it was replaced while it was being written"))

    def facts(self) -> BagFacts:
        """Return the facts of the files written so far."""
        if len(self._whole) == len(self.files):
            return BagFacts(tuple(self._whole), self._topic_facts(self._counts))
        total = self._counts + self._topic_counts()
        return BagFacts((*self._whole, self._file_facts()), self._topic_facts(total))

    def _topic_counts(self) -> Counter[str]:
        """Count the messages of the present file by topic, those that were repeated included."""
        by_channel = self._output.counts()
        return Counter(
            {
                name: by_channel[topic.channel.id]
                + (by_channel[topic.repeats.id] if topic.repeats is not None else 0)
                for name, topic in self._topics.items()
            }
        )

    def _topic_facts(self, counts: Mapping[str, int]) -> tuple[TopicFacts, ...]:
        return tuple(
            TopicFacts(
                name,
                topic.schema.name,
                topic.channel.metadata["offered_qos_profiles"],
                topic.channel.metadata["topic_type_hash"],
                counts.get(name, 0),
                topic.channel.message_encoding,
            )
            for name, topic in self._topics.items()
        )

    def _file_facts(self) -> FileFacts:
        start_ns, end_ns = self._output.times() or (0, 0)
        return FileFacts(self.file.name, start_ns, end_ns, self._output.counts().total())

    def _finish_file(self, ending: Ending) -> None:
        """Write metadata record and summary of the present file, and remember what it holds."""
        counts = self._topic_counts()
        facts = BagFacts((self._file_facts(),), self._topic_facts(counts))
        self._output.add_metadata("rosbag2", {"serialized_metadata": serialized_metadata(facts)})
        self._output.finish(ending)
        self._whole += facts.files
        self._counts += counts

    @property
    def seal_end(self) -> str:
        """Digest of the chain up to the last seal; of the whole bag once it is closed."""
        return self._chain.end.hex()

    def close(self) -> None:
        """Write indexes, the metadata record and metadata.yaml. A second call does nothing.

        Raises:
            HostError: the disk didn't take it; `ssp bag recover` gets what was flushed.
        """
        if self.closed:
            return
        self._hand_over()
        try:
            self._finish_file(Ending.BAG)
            os.fsync(self._output.descriptor)
            self._sync.finish()
            self._output.close()
            self.closed = True
            write_text(self.path / FILE_NAME, metadata_yaml(self.facts()))
        except OSError as error:
            raise self._broken(error) from error

    def _broken(self, error: OSError) -> HostError:
        """Close the file as it is and make the error that says so."""
        self.closed = True
        self._sync.abandon()
        with suppress(OSError):  # closed before, or the disk's error comes once more
            self._output.close()
        file = error.filename or self.file
        return HostError(f"{file}: writing failed: {error.strerror or error}")
