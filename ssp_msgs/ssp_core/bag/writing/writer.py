"""Writes a bag directory that rosbag2, Foxglove and rosbags read: MCAP files and metadata.yaml.

This file owns which file is written, and whether the bag is closed: a writer that the disk failed
is closed for good. ``BagTopics`` owns the topics, ``FileTurn`` when the next file begins.
"""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Iterable
from contextlib import suppress
from io import FileIO
from pathlib import Path

from mcap.records import Channel

from ssp_core import __version__
from ssp_core.bag.metadata import (
    FILE_NAME,
    BagFacts,
    FileFacts,
    metadata_yaml,
    serialized_metadata,
)
from ssp_core.bag.types import BagMessage, TypeDefinition
from ssp_core.bag.writing.bag_topics import BagTopics, TooMany, WrittenTopic
from ssp_core.bag.writing.chain import SOURCE_NAME, Chain, Ending, Maker, Source
from ssp_core.bag.writing.file_turn import FileTurn
from ssp_core.bag.writing.latched import LatchedMessage
from ssp_core.bag.writing.mcap_output import CHUNK_BYTES, DiskSync, McapOutput
from ssp_core.bag.writing.split import Split
from ssp_core.closing import Closing
from ssp_core.errors import HostError, InputError
from ssp_core.files.writing import write_text

LIBRARY = f"ssp {__version__}"
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
        packed: its chunks are compressed by zstd, which rosbag2, Foxglove and rosbags read.

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
        packed: bool = False,
    ) -> None:
        self.path = Path(path)
        try:
            self.path.mkdir(parents=True)
        except FileExistsError as error:
            raise InputError(
                "exists already", file=self.path, remedy="name a new directory or remove this one"
            ) from error
        except OSError as error:
            raise InputError(
                f"can't be made: {error.strerror}", file=self.path, remedy="name another folder"
            ) from error
        first = name or self.path.name + "_0"
        self.files: tuple[Path, ...] = (self.path / f"{first}.mcap",)
        self._stem = first.removesuffix("_0")
        self._turn = FileTurn(split)
        self._topics = BagTopics()
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
            self._output = McapOutput(
                opened, self.file, LIBRARY, self._chain, maker=maker, packed=packed
            )
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
        try:
            channel, new_schema = self._topics.add(
                topic, msgtype, offered_qos, written, latched=latched
            )
        except TooMany as error:
            raise InputError(
                f"is one {error} too many",
                file=self.file,
                field=topic,
                remedy="record fewer topics",
            ) from error
        if new_schema is not None:
            self._output.add_schema(new_schema)
        self._output.add_channel(channel)

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
        entry = self._topics.by_name[topic]
        if self.closed:
            raise ValueError(f"{self.path} is closed")
        if entry.latched is not None or self._turn.may_come(self._output):
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
        if self._turn.has_come(self._output, len(cdr), log_time_ns):
            try:
                self._next_file(log_time_ns)
            except OSError as error:
                raise self._broken(error) from error
        if entry.latched is not None:
            entry.latched.keep(LatchedMessage(cdr, publish_time_ns, sequence & 0xFFFFFFFF))

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
        output = McapOutput(
            opened,
            file,
            LIBRARY,
            self._chain,
            number=number,
            maker=self._maker,
            packed=self._chunk.packed,
        )
        self._sync.request(self.file.name, self._output.descriptor)
        self._output.close()
        self.files += (file,)
        self._output = output
        self._chunk = output.chunk
        for schema in self._topics.schemas:
            output.add_schema(schema)
        for topic in self._topics.by_name.values():
            output.add_channel(topic.channel)
            if topic.latched is not None and (messages := list(topic.latched.messages)):
                repeats = self._repeats(topic)
                output.add_channel(repeats)
                for cdr, publish_time_ns, sequence in messages:
                    output.chunk.add(repeats.id, sequence, begin_ns, publish_time_ns, cdr)
                    if output.chunk.size >= CHUNK_BYTES:
                        output.flush()
        self._turn.begin(output, begin_ns)

    def _repeats(self, topic: WrittenTopic) -> Channel:
        try:
            return self._topics.repeats_of(topic)
        except TooMany as error:
            raise InputError(
                f"is one {error} too many",
                file=self.file,
                field=topic.channel.topic,
                remedy="record fewer topics",
            ) from error

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
            return BagFacts(tuple(self._whole), self._topics.facts(self._counts))
        total = self._counts + self._topics.counts(self._output.counts())
        return BagFacts((*self._whole, self._file_facts()), self._topics.facts(total))

    def _file_facts(self) -> FileFacts:
        start_ns, end_ns = self._output.times() or (0, 0)
        return FileFacts(self.file.name, start_ns, end_ns, self._output.counts().total())

    def _finish_file(self, ending: Ending) -> None:
        """Write metadata record and summary of the present file, and remember what it holds."""
        counts = self._topics.counts(self._output.counts())
        facts = BagFacts((self._file_facts(),), self._topics.facts(counts))
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
