"""Reads bags by index, with checksums verified and types taken from the bag itself."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Channel, Schema
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from ssp_core.bag.mcap_file import DAMAGE
from ssp_core.bag.message import BagMessage
from ssp_core.bag.metadata import read_metadata
from ssp_core.bag.part import Part
from ssp_core.bag.runs import merged
from ssp_core.bag.stores import Stores
from ssp_core.bag.types import TypeDefinition
from ssp_core.closing import Closing
from ssp_core.errors import InputError


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a bag: full type name, messages, offered QoS as YAML, RIHS01 hash."""

    msgtype: str
    count: int
    offered_qos: str = ""
    type_hash: str = ""


def type_definition(schema: Schema, channel: Channel) -> TypeDefinition:
    """The definition that a file gives for a channel's type.

    Raises:
        ValueError: the definition is not UTF-8.
    """
    return TypeDefinition(
        schema.name,
        schema.encoding,
        schema.data.decode("utf-8"),
        channel.metadata.get("topic_type_hash", ""),
    )


def bag_files(path: Path) -> tuple[Path, ...]:
    """The MCAP files of a bag directory in order, or the one file that was named.

    Raises:
        InputError: it isn't there or is no bag.
    """
    if path.is_dir():
        return read_metadata(path).files
    if not path.exists():
        raise InputError("is not there", file=path, remedy="name a bag directory or a .mcap file")
    if not path.is_file():  # opening a pipe would wait for somebody to write into it
        raise InputError("is no file", file=path, remedy="name a bag directory or a .mcap file")
    return (path,)


class BagReader(Closing):
    """A bag directory or one .mcap file, open for reading; a context manager.

    Args:
        path: directory with metadata.yaml, or the file itself.

    Raises:
        InputError: not there, no bag, not closed, or damaged; the message names the file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self.topics: dict[str, TopicInfo] = {}
        self._definitions: dict[str, TypeDefinition] = {}
        self._stores = Stores(self.path)
        self.files = bag_files(self.path)
        self._parts = [Part(file, later=k > 0) for k, file in enumerate(self.files)]
        for part in self._parts:
            self._add_topics(part)

    def _add_topics(self, part: Part) -> None:
        for channel in part.channels.values():
            schema = part.summary.schemas.get(channel.schema_id)
            if schema is None:
                raise InputError(
                    "has a channel without a type", file=part.path, field=channel.topic
                )
            try:
                written = type_definition(schema, channel)
            except ValueError as error:
                raise InputError(
                    "has a definition that is not UTF-8", file=part.path, field=schema.name
                ) from error
            before = self.topics.get(channel.topic)
            if before is not None and before.msgtype != written.msgtype:
                raise InputError(
                    f"has messages of two types, {before.msgtype} and {written.msgtype}",
                    file=part.path,
                    field=channel.topic,
                )
            known = self._definitions.setdefault(channel.topic, written)
            if (known.encoding, known.text) != (written.encoding, written.text):
                raise InputError(
                    f"has messages of two definitions of {written.msgtype}",
                    file=part.path,
                    field=channel.topic,
                )
            self.topics[channel.topic] = TopicInfo(
                msgtype=written.msgtype,
                count=(before.count if before else 0) + part.counts[channel.id],
                offered_qos=channel.metadata.get("offered_qos_profiles", ""),
                type_hash=written.type_hash,
            )

    @property
    def count(self) -> int:
        """Messages in the bag."""
        return sum(topic.count for topic in self.topics.values())

    @property
    def start_ns(self) -> int | None:
        """Earliest log time, None for an empty bag."""
        return min((first for first, _ in self._times()), default=None)

    @property
    def end_ns(self) -> int | None:
        """Latest log time, None for an empty bag."""
        return max((last for _, last in self._times()), default=None)

    def _times(self) -> list[tuple[int, int]]:
        return [times for part in self._parts if (times := part.times()) is not None]

    @property
    def attachments(self) -> tuple[str, ...]:
        """Names of the attachments, in file order."""
        return tuple(i.name for p in self._parts for i in p.summary.attachment_indexes)

    def messages(
        self,
        topics: Collection[str] | None = None,
        start_ns: int | None = None,
        stop_ns: int | None = None,
    ) -> Iterator[BagMessage]:
        """Messages in order of log time; of equal times, in the order of the file.

        Args:
            topics: only these; names that the bag doesn't have give nothing.
            start_ns: first log time.
            stop_ns: the first log time that is no longer given.

        Raises:
            InputError: a chunk that is needed is damaged.
            ValueError: stop lies before start.
        """
        if start_ns is not None and stop_ns is not None and stop_ns < start_ns:
            raise ValueError(f"stop_ns {stop_ns} lies before start_ns {start_ns}")
        wanted = None if topics is None else frozenset(topics)
        return merged(run for part in self._parts for run in part.runs(wanted, start_ns, stop_ns))

    def definition(self, topic: str) -> TypeDefinition:
        """What the bag says about the type of one of its topics; KeyError for another topic."""
        return self._definitions[topic]

    def store(self, topic: str) -> Typestore:
        """The types of one topic as the bag defines them; KeyError for another topic.

        Raises:
            InputError: the definition can't be used.
        """
        return self._stores.of(topic, self._definitions[topic])

    def decode(self, message: BagMessage) -> Any:
        """The message as an object with the type's fields, numeric arrays as numpy arrays.

        The type is the one that stands in the bag, whatever this installation knows.

        Raises:
            InputError: the bytes don't fit the type, or its definition can't be used.
            KeyError: the topic is not in this bag.
        """
        written = self._definitions[message.topic]
        store = self.store(message.topic)
        try:
            return store.deserialize_cdr(message.data, written.msgtype)
        except (SerdeError, *DAMAGE) as error:
            raise InputError(
                f"holds a message at {message.log_time_ns} ns that is no {written.msgtype}: "
                f"{error}",
                file=self.path,
                field=message.topic,
            ) from error

    def attachment(self, name: str) -> bytes | None:
        """Data of an attachment, None when the bag has none of that name.

        Raises:
            InputError: it is damaged.
        """
        for part in self._parts:
            data = part.attachment(name)
            if data is not None:
                return data
        return None

    def close(self) -> None:
        """Ends the reading; no file stays open between two reads, so there is nothing to free."""
