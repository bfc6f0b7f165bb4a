"""Writes a bag directory that rosbag2, Foxglove and rosbags read: one MCAP and metadata.yaml."""

from __future__ import annotations

import os
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from mcap.writer import CompressionType, Writer

from ssp_core import __version__
from ssp_core.bag.metadata import (
    FILE_NAME,
    ROOT_KEY,
    BagFacts,
    TopicFacts,
    bag_information,
    to_yaml,
)
from ssp_core.bag.qos import parse_offered_qos
from ssp_core.bag.types import TypeDefinition, definition
from ssp_core.errors import HostError, InputError
from ssp_core.files import write_text

CHUNK_BYTES = 1 << 20
LIBRARY = f"ssp {__version__}"


@dataclass(slots=True)
class _Topic:
    channel_id: int
    msgtype: str
    offered_qos: str
    type_hash: str
    count: int = 0


class BagWriter:
    """A bag being written; a context manager that closes it, also after an exception.

    Messages are taken serialised and never looked into. What was written before the last
    ``flush`` survives a SIGKILL (``recover`` makes a closed bag of it).

    Args:
        path: the bag directory; it is made, and must not exist.
        name: stem of the MCAP file inside, ``<directory>_0`` by default as in rosbag2.

    Raises:
        InputError: the directory exists or can't be made.
    """

    def __init__(self, path: str | Path, *, name: str | None = None) -> None:
        self.path = Path(path)
        try:
            self.path.mkdir(parents=True)
        except FileExistsError as error:
            raise InputError(
                "exists already", file=self.path, remedy="name a new directory or remove this one"
            ) from error
        except OSError as error:
            raise InputError(f"can't be made: {error.strerror}", file=self.path) from error
        self.file = self.path / f"{name or self.path.name + '_0'}.mcap"
        self._topics: dict[str, _Topic] = {}
        self._schemas: dict[TypeDefinition, int] = {}
        self._start_ns: int | None = None
        self._end_ns = 0
        self.bytes = 0
        self.closed = False
        try:
            self._stream = open(self.file, "wb")  # noqa: SIM115 - closed by close() or _broken()
        except OSError as error:
            raise HostError(f"{self.file}: can't be opened: {error.strerror}") from error
        self._mcap = Writer(
            self._stream,
            chunk_size=CHUNK_BYTES,
            compression=CompressionType.NONE,
            enable_crcs=True,
            enable_data_crcs=True,
        )
        try:
            self._mcap.start(profile="ros2", library=LIBRARY)
        except OSError as error:
            raise self._broken(error) from error

    @property
    def messages(self) -> int:
        """Messages written so far."""
        return sum(topic.count for topic in self._topics.values())

    def add_topic(
        self,
        topic: str,
        msgtype: str,
        offered_qos: str = "",
        *,
        written: TypeDefinition | None = None,
    ) -> None:
        """Announces a topic; needed before its first message.

        Args:
            topic: absolute name.
            msgtype: full type name, ``package/msg/Name``.
            offered_qos: YAML from ``qos.offered_qos``, or empty.
            written: the definition to put into the file; by default the one that this project
                knows for the type.

        Raises:
            InputError: the type is not known and no definition was given.
            ValueError: the topic was added before, or the QoS is no complete YAML list.
        """
        if topic in self._topics:
            raise ValueError(f"topic {topic} was added before")
        parse_offered_qos(offered_qos)
        written = written or definition(msgtype)
        try:
            if written not in self._schemas:
                self._schemas[written] = self._mcap.register_schema(
                    msgtype, written.encoding, written.text.encode()
                )
            channel_id = self._mcap.register_channel(
                topic,
                "cdr",
                self._schemas[written],
                {"offered_qos_profiles": offered_qos, "topic_type_hash": written.type_hash},
            )
        except OSError as error:
            raise self._broken(error) from error
        self._topics[topic] = _Topic(channel_id, msgtype, offered_qos, written.type_hash)

    def write(
        self, topic: str, cdr: bytes, log_time_ns: int, publish_time_ns: int, sequence: int = 0
    ) -> None:
        """Appends one serialised message.

        Args:
            topic: as in add_topic.
            cdr: the message with its encapsulation.
            log_time_ns: when it was received; readers order by it.
            publish_time_ns: when it was sent.
            sequence: the publisher's number for it, 0 when there is none.

        Raises:
            HostError: the disk didn't take it; the writer is closed then.
            KeyError: the topic was not added.
            ValueError: a time is negative.
        """
        if log_time_ns < 0 or publish_time_ns < 0:
            raise ValueError(f"times must not be negative, got {log_time_ns}, {publish_time_ns}")
        entry = self._topics[topic]
        try:
            self._mcap.add_message(
                entry.channel_id, log_time_ns, cdr, publish_time_ns, sequence & 0xFFFFFFFF
            )
        except OSError as error:
            raise self._broken(error) from error
        entry.count += 1
        self.bytes += len(cdr)
        if self._start_ns is None:
            self._start_ns = self._end_ns = log_time_ns
        elif log_time_ns < self._start_ns:
            self._start_ns = log_time_ns
        elif log_time_ns > self._end_ns:
            self._end_ns = log_time_ns

    def attach(self, name: str, data: bytes, media_type: str) -> None:
        """Puts a file into the bag, whole, at once."""
        try:
            self._mcap.add_attachment(0, self._end_ns, name, media_type, data)
        except OSError as error:
            raise self._broken(error) from error

    def flush(self) -> None:
        """Finishes the chunk and hands it to the system: a SIGKILL takes nothing before this.

        Raises:
            HostError: the disk didn't take it, or the bag was removed meanwhile.
        """
        try:
            self._mcap.flush()  # type: ignore[no-untyped-call]  # mcap leaves it bare
            on_disk, ours = os.stat(self.file), os.fstat(self._stream.fileno())
        except OSError as error:
            raise self._broken(error) from error
        if (on_disk.st_dev, on_disk.st_ino) != (ours.st_dev, ours.st_ino):
            raise self._broken(OSError(0, "it was replaced while it was being written"))

    def facts(self) -> BagFacts:
        """What was written so far."""
        return BagFacts(
            file_name=self.file.name,
            start_ns=self._start_ns or 0,
            end_ns=self._end_ns,
            topics=tuple(
                TopicFacts(name, t.msgtype, t.offered_qos, t.type_hash, t.count)
                for name, t in self._topics.items()
            ),
        )

    def close(self) -> None:
        """Writes indexes, the metadata record and metadata.yaml. A second call does nothing.

        Raises:
            HostError: the disk didn't take it; `ssp bag recover` gets what was flushed.
        """
        if self.closed:
            return
        self.flush()
        information = bag_information(self.facts())
        try:
            self._mcap.add_metadata("rosbag2", {"serialized_metadata": to_yaml(information)})
            self._mcap.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare
            self._stream.flush()
            os.fsync(self._stream.fileno())
            self._stream.close()
            write_text(self.path / FILE_NAME, to_yaml({ROOT_KEY: information}))
        except OSError as error:
            raise self._broken(error) from error
        self.closed = True

    def _broken(self, error: OSError) -> HostError:
        """Closes the file as it is and makes the error that says so."""
        self.closed = True
        with suppress(OSError):  # closing tries to write once more what just failed
            self._stream.close()
        return HostError(f"{self.file}: writing failed: {error.strerror or error}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()
