"""Reads bags by index, with checksums verified and types taken from the bag itself."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.records import Channel, Schema
from rosbags.serde import SerdeError
from rosbags.typesys.store import Typestore

from ssp_core.bag.metadata import read_metadata
from ssp_core.bag.reading.index import ChunkRun, ContentCache, Run, Selection, merged
from ssp_core.bag.reading.mcap_file import (
    DAMAGE,
    MAX_REREADS,
    McapFile,
    UnpackBudget,
    damage_of,
    open_bounded,
)
from ssp_core.bag.reading.scan import Loose, LooseRun, is_indexed, scan
from ssp_core.bag.types import BagMessage, TypeDefinition, store_from
from ssp_core.bag.writing.split import REPEATED_KEY
from ssp_core.cdr.messages import object_state
from ssp_core.closing import Closing
from ssp_core.errors import InputError, not_read
from ssp_core.hashing import sha256_file, sha256_json
from ssp_core.motion.state import ObjectState
from ssp_core.motion.state_series import Packed
from ssp_core.names import OBJECT_STATES, absolute, state_topic


class Part(McapFile):
    """A closed MCAP file that is the first or a later one of a bag.

    Args:
        later: files before it are read too, so its repeated messages are left out.

    Raises:
        InputError: it can't be opened, is no closed MCAP file, or its summary is damaged; of a file
            without an index, any of it is.
    """

    def __init__(self, path: Path, *, later: bool) -> None:
        super().__init__(path)
        self._loose = Loose()
        if not is_indexed(self.summary):
            with open_bounded(path) as stream, damage_of(path):
                self.summary, self._loose = scan(stream, self.summary)
        self.channels: dict[int, Channel] = {
            number: channel
            for number, channel in self.summary.channels.items()
            if not (later and REPEATED_KEY in channel.metadata)
        }
        self.chunks = sorted(self.summary.chunk_indexes, key=lambda index: index.chunk_start_offset)
        statistics = self.summary.statistics
        self.counts = Counter(statistics.channel_message_counts if statistics else {})

    @property
    def loose_times_ns(self) -> Sequence[int]:
        """Log times of the messages outside chunks."""
        return self._loose.times_ns

    def times(self) -> tuple[int, int] | None:
        """Return the earliest and latest log time, None for a file without messages."""
        statistics = self.summary.statistics
        if statistics is None or not statistics.message_count:
            return None
        return statistics.message_start_time, statistics.message_end_time

    def runs(
        self, topics: Collection[str] | None, start_ns: int | None, stop_ns: int | None
    ) -> list[Run]:
        """Return the places that may hold messages of some topics and times, in file order."""
        channels = {
            number: channel.topic
            for number, channel in self.channels.items()
            if topics is None or channel.topic in topics
        }
        selection = Selection(channels, start_ns, stop_ns)
        unpacked = sum(index.uncompressed_size for index in self.chunks)
        cache = ContentCache(UnpackBudget(unpacked, ratio=MAX_REREADS))
        runs: list[Run] = [
            ChunkRun(self, index, selection, cache)
            for index in self.chunks
            if selection.overlaps(index.message_start_time, index.message_end_time)
            and not channels.keys().isdisjoint(index.message_index_offsets)
        ]
        if self._loose.times_ns:
            runs.append(LooseRun(self.path, self._loose, selection))
        return runs


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic of a bag: full type name, messages, offered QoS as YAML, RIHS01 hash."""

    msgtype: str
    count: int
    offered_qos: str = ""
    type_hash: str = ""


# The number of a type that a channel doesn't have, as those of plain JSON.
NO_SCHEMA = 0
_NONE = Schema(NO_SCHEMA, b"", "", "")


def type_definition(schema: Schema, channel: Channel) -> TypeDefinition:
    """Return the definition that a file gives for a channel's type."""
    type_hash = channel.metadata.get("topic_type_hash", "")
    return TypeDefinition.of_bytes(
        schema.name, schema.encoding, schema.data, type_hash, channel.message_encoding
    )


def bag_files(path: Path) -> tuple[Path, ...]:
    """Return the MCAP files of a bag directory in order, or the one file that was named.

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


def numbered_files(folder: Path, suffix: str) -> tuple[Path, ...]:
    """Return the files of a kind in a directory, ``bag_10`` behind ``bag_9``."""

    def place(file: Path) -> tuple[str, int, str]:
        stem, _, number = file.stem.rpartition("_")
        whole = number.isascii() and number.isdigit() and len(number) < 10
        return (stem, int(number), file.name) if whole else (file.stem, -1, file.name)

    return tuple(sorted(folder.glob(f"*{suffix}"), key=place))


def mcap_files(folder: Path) -> tuple[Path, ...]:
    """Return the MCAP files in a directory, in their order.

    Raises:
        InputError: there are none.
    """
    files = numbered_files(folder, ".mcap")
    if not files:
        raise InputError(
            "has no .mcap file", file=folder, remedy="name the folder of a bag, or its .mcap file"
        )
    return files


class BagReader(Closing):
    """A bag directory or one .mcap file, open for reading; a context manager.

    Args:
        path: directory with metadata.yaml, or the file itself.
        files: of a directory without metadata.yaml, in order; None: those that it names.

    Raises:
        InputError: not there, no bag, not closed, or damaged; the message names the file.
    """

    def __init__(self, path: str | Path, files: tuple[Path, ...] | None = None) -> None:
        self.path = Path(path)
        self.topics: dict[str, TopicInfo] = {}
        self._definitions: dict[str, TypeDefinition] = {}
        self._ambiguous: dict[str, InputError] = {}
        self.files = bag_files(self.path) if files is None else files
        # Those whose content is hashed; of a bag in SQLite there are no others.
        self.stored = self.files
        self._parts = [Part(file, later=k > 0) for k, file in enumerate(self.files)]
        for part in self._parts:
            self._add_topics(part)

    def _add_topics(self, part: Part) -> None:
        for channel in part.channels.values():
            schema = part.summary.schemas.get(channel.schema_id)
            if schema is None and channel.schema_id == NO_SCHEMA:
                schema = _NONE
            if schema is None:
                raise InputError(
                    "has a channel without a type",
                    file=part.path,
                    field=channel.topic,
                    remedy="record the bag again, with the types of its topics",
                )
            definition = type_definition(schema, channel)
            before = self.topics.get(channel.topic)
            first_definition = self._definitions.setdefault(channel.topic, definition)
            if (difference := _difference(first_definition, definition)) is not None:
                self._ambiguous[channel.topic] = InputError(
                    f"has messages of {difference}",
                    file=part.path,
                    field=channel.topic,
                    remedy="cut the bag, so that each topic has one type",
                )
            self.topics[channel.topic] = TopicInfo(
                msgtype=first_definition.msgtype,
                count=(before.count if before else 0) + part.counts[channel.id],
                offered_qos=channel.metadata.get("offered_qos_profiles", ""),
                type_hash=definition.type_hash,
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
        """Return the messages by log time; of equal times, in the order of the file.

        Args:
            topics: only these; names that the bag doesn't have give nothing.
            start_ns: first log time; None: the beginning of the bag.
            stop_ns: the first log time that is no longer given.

        Raises:
            InputError: a chunk that is needed is damaged.
            ValueError: stop lies before start.
        """
        if start_ns is not None and stop_ns is not None and stop_ns < start_ns:
            raise ValueError(f"stop_ns {stop_ns} lies before start_ns {start_ns}")
        topic_names = None if topics is None else frozenset(topics)
        return merged(
            run for part in self._parts for run in part.runs(topic_names, start_ns, stop_ns)
        )

    def definition(self, topic: str) -> TypeDefinition:
        """Return the bag's definition of the type of one of its topics; KeyError for another topic.

        Raises:
            InputError: the topic has messages of two types.
        """
        if topic in self._ambiguous:
            raise self._ambiguous[topic]
        return self._definitions[topic]

    def unreadable(self) -> dict[str, InputError]:
        """Return by topic why its messages can't be decoded.

        The rest of the bag doesn't suffer from it.
        """
        errors = {}
        for topic in self.topics:
            try:
                self.store(topic)
            except InputError as error:
                errors[topic] = error
        return errors

    def store(self, topic: str) -> Typestore:
        """Return the types of one topic as the bag defines them; KeyError for another topic.

        Raises:
            InputError: the definition can't be used.
        """
        definition = self.definition(topic)
        try:
            return store_from(definition)
        except InputError as error:
            raise error.in_file(self.path) from None

    def decode(self, message: BagMessage) -> Any:
        """Return the message as an object with the type's fields, numeric arrays as numpy arrays.

        The type is the one that stands in the bag, whatever this installation knows.

        Raises:
            InputError: the bytes don't fit the type, or its definition can't be used.
            KeyError: the topic is not in this bag.
        """
        definition = self.definition(message.topic)
        store = self.store(message.topic)
        try:
            return store.deserialize_cdr(message.data, definition.msgtype)
        except (SerdeError, *DAMAGE) as error:
            raise InputError(
                f"holds a message at {message.log_time_ns} ns that is no {definition.msgtype}: "
                f"{error}",
                file=self.path,
                field=message.topic,
                remedy="record the bag again, or leave the topic out",
            ) from error

    def attachment(self, name: str) -> bytes | None:
        """Return data of an attachment, None when the bag has none of that name.

        Raises:
            InputError: it is damaged.
        """
        for part in self._parts:
            data = part.attachment(name)
            if data is not None:
                return data
        return None

    def close(self) -> None:
        """End the reading; no file stays open between two reads, so there is nothing to free."""


def _difference(one: TypeDefinition, other: TypeDefinition) -> str | None:
    """Say how the types differ that two channels of one topic have; None: they say the same."""
    if (one.msgtype, one.message_encoding) != (other.msgtype, other.message_encoding):
        return f"two types, {one.msgtype} and {other.msgtype}"
    if (one.encoding, one.text) == (other.encoding, other.text):
        return None
    try:
        if store_from(one).fielddefs == store_from(other).fielddefs:
            return None  # But for comments or ends of lines.
    except InputError:
        pass
    return f"two definitions of {one.msgtype}"


_ARRAYS = absolute(OBJECT_STATES)


def object_states(bag: BagReader, ids: Iterable[str]) -> dict[str, Packed[ObjectState]]:
    """Return the states of each of these objects in the order in which they were recorded.

    An object has a topic of its own, or its process sends one message for all its objects
    (ObjectStates.msg); a bag may hold both.

    Args:
        bag: recording of the session.
        ids: objects; those that the bag knows nothing of get none.

    Returns:
        By id. What came on an object's own topic counts as that object's, whatever it names.

    Raises:
        InputError: a message is damaged, or holds a number that stands for nothing.
    """
    topics = {absolute(state_topic(name)): name for name in ids}
    states = {name: Packed(ObjectState) for name in topics.values()}
    for message in bag.messages([*topics, _ARRAYS]):
        for state in _states(bag, message):
            name = topics.get(message.topic, state.object_id)
            if name in states:
                states[name].append(state)
    return states


def _states(bag: BagReader, message: BagMessage) -> Iterator[ObjectState]:
    decoded = bag.decode(message)
    try:
        if message.topic == _ARRAYS:
            yield from map(object_state, decoded.states)
        else:
            yield object_state(decoded)
    except ValueError as error:
        raise InputError(
            f"has an invalid state at {message.log_time_ns} ns: {error}",
            file=bag.path,
            field=message.topic,
            remedy="record the bag again",
        ) from error


def content_sha256(bag: BagReader, on_block: Callable[[], None] = lambda: None) -> str:
    """Hash of the bag's MCAP file or files; it reads every byte of them.

    Raises:
        InputError: a file of it can't be read any more.
    """
    return files_sha256(bag.stored, on_block)


def files_sha256(files: Iterable[Path], on_block: Callable[[], None] = lambda: None) -> str:
    """Hash of a bag's file; of several, that of the list of their hashes.

    Raises:
        InputError: one can't be read.
    """
    hashes = []
    for file in files:
        try:
            hashes.append(sha256_file(file, on_block))
        except OSError as error:
            raise not_read(file, error) from error
    return hashes[0] if len(hashes) == 1 else sha256_json(hashes)
