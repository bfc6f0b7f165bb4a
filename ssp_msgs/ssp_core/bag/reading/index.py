"""The places of the messages in a bag's files, and these messages in order of log time."""

from __future__ import annotations

import heapq
import struct
from array import array
from collections import OrderedDict
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Protocol, TypeAlias

from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from ssp_core.bag.reading.mcap_file import (
    DAMAGE,
    HEAD,
    MAX_RECORD_BYTES,
    McapFile,
    UnpackBudget,
    chunk_parts,
    damaged,
    inner_records,
    unpack_chunk,
)
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.mcap_output import (
    INDEX_ENTRY_BYTES,
    INDEX_HEAD,
    MESSAGE_BODY_BYTES,
    MESSAGE_HEAD,
)

_ENTRY = struct.Struct("<QQ")
# A message's log time, and where it begins in what its chunk holds.
Entry: TypeAlias = tuple[int, int]


def chunk_content(record: memoryview) -> memoryview:
    """Return the content of a chunk, with its CRC checked.

    Raises:
        ValueError: it is damaged, too large, or compressed in a way that is not read here.
    """
    if len(record) < HEAD.size or HEAD.unpack_from(record) != (
        Opcode.CHUNK,
        len(record) - HEAD.size,
    ):
        raise ValueError("no chunk where the index has one")
    return unpack_chunk(chunk_parts(record[HEAD.size :]))


def indexed_entries(region: bytes, index: ChunkIndex, channels: Collection[int]) -> list[Entry]:
    """Return the messages of some channels in a chunk, from the MessageIndex records behind it.

    Raises:
        ValueError: a record is damaged or missing.
    """
    entries: list[Entry] = []
    first = index.chunk_start_offset + index.chunk_length
    for channel, offset in index.message_index_offsets.items():
        if channel not in channels:
            continue
        at = offset - first
        if not 0 <= at <= len(region) - INDEX_HEAD.size:
            raise ValueError("a message index lies outside its place")
        opcode, length, channel_id, size = INDEX_HEAD.unpack_from(region, at)
        begin = at + INDEX_HEAD.size
        if (
            opcode != Opcode.MESSAGE_INDEX
            or channel_id != channel
            or length != size + 6
            or size % INDEX_ENTRY_BYTES
            or size > len(region) - begin
        ):
            raise ValueError(f"the message index of channel {channel} is damaged")
        entries += _ENTRY.iter_unpack(region[begin : begin + size])
    return entries


def scanned_entries(content: memoryview, channels: Collection[int]) -> list[Entry]:
    """Return the messages of some channels in a chunk that has no message index.

    Raises:
        ValueError: the chunk's records are cut off.
    """
    entries = []
    for record in inner_records(content):
        if record.opcode == Opcode.MESSAGE:
            if len(record.body) < MESSAGE_BODY_BYTES:
                raise ValueError(f"a message of {len(record.body)} bytes")
            _, _, channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(content, record.offset)
            if channel in channels:
                entries.append((log_time_ns, record.offset))
    return entries


# Content of chunks that is kept while their times overlap; the rest is read again.
KEPT_BYTES = 256 << 20
_MESSAGE = int(Opcode.MESSAGE)


@dataclass(frozen=True, slots=True)
class Selection:
    """The wanted part of one file: topics by channel, log times from start to before stop in ns."""

    topics: Mapping[int, str]
    start_ns: int | None
    stop_ns: int | None

    def times(self, entries: list[Entry]) -> Iterator[Entry]:
        """Return the entries within the times, in order of log time and then of the file.

        They wait as 16 bytes each, however many chunks overlap.
        """
        start, stop = self.start_ns, self.stop_ns
        if start is not None:
            entries = [entry for entry in entries if entry[0] >= start]
        if stop is not None:
            entries = [entry for entry in entries if entry[0] < stop]
        entries.sort()
        numbers = iter(array("Q", chain.from_iterable(entries)))
        return zip(numbers, numbers, strict=True)

    def overlaps(self, first_ns: int, last_ns: int) -> bool:
        return (self.start_ns is None or last_ns >= self.start_ns) and (
            self.stop_ns is None or first_ns < self.stop_ns
        )

    def message(self, record: memoryview, at: int, log_time_ns: int) -> BagMessage:
        """Return the message whose record begins at an offset.

        Raises:
            ValueError: there is none of the wanted topics with that log time.
            struct.error: it is cut off.
        """
        opcode, length, channel, sequence, logged, published = MESSAGE_HEAD.unpack_from(record, at)
        topic = self.topics.get(channel)
        end = at + HEAD.size + length
        if (
            opcode != _MESSAGE
            or topic is None
            or logged != log_time_ns
            or length < MESSAGE_BODY_BYTES
            or end > len(record)
        ):
            raise ValueError(f"no message of {log_time_ns} ns where the index has one")
        data = bytes(record[at + MESSAGE_HEAD.size : end])
        return BagMessage(topic, logged, published, data, sequence)


class ContentCache:
    """Content of the chunks that are being read, the longest unused dropped when it is too much.

    Args:
        budget: what may be unpacked; chunks that overlap more than fits are unpacked again.
        limit_bytes: kept at once.
    """

    def __init__(self, budget: UnpackBudget, limit_bytes: int = KEPT_BYTES) -> None:
        self._budget = budget
        self._limit = limit_bytes
        self._bytes = 0
        self._chunks: OrderedDict[ChunkRun, memoryview] = OrderedDict()

    def __len__(self) -> int:
        return len(self._chunks)

    def content(self, run: ChunkRun) -> memoryview:
        content = self._chunks.get(run)
        if content is None:
            content = self._chunks[run] = run.load()
            self._budget.take(len(content))
            self._bytes += len(content)
            while self._bytes > self._limit and len(self._chunks) > 1:
                self._bytes -= len(self._chunks.popitem(last=False)[1])
        elif len(self._chunks) > 1:
            self._chunks.move_to_end(run)
        return content

    def drop(self, run: ChunkRun) -> None:
        content = self._chunks.pop(run, None)
        if content is not None:
            self._bytes -= len(content)


class ChunkRun:
    """One chunk; it is read when its first wanted message is, and not when it has none.

    No message is earlier than ``start_ns``.
    """

    def __init__(
        self, file: McapFile, index: ChunkIndex, selection: Selection, cache: ContentCache
    ) -> None:
        self.path = file.path
        self.start_ns = index.message_start_time
        self._file = file
        self._index = index
        self._selection = selection
        self._cache = cache

    def entries(self) -> Iterator[Entry]:
        """Return the wanted messages by log time, then by their order in the file."""
        index = self._index
        if index.message_index_length:
            region = self._file.message_index(index)
            entries = indexed_entries(region, index, self._selection.topics)
        else:
            entries = scanned_entries(self._cache.content(self), self._selection.topics)
        if entries:
            first, last = min(entries)[0], max(entries)[0]
            if first < index.message_start_time or last > index.message_end_time:
                raise ValueError("a chunk holds messages outside the times of its index")
            if len({at for _, at in entries}) != len(entries):
                raise ValueError("a message index names a message twice")
        return self._selection.times(entries)

    def message(self, entry: Entry) -> BagMessage:
        return self._selection.message(self._cache.content(self), entry[1], entry[0])

    def load(self) -> memoryview:
        index = self._index
        if index.chunk_length > MAX_RECORD_BYTES:
            raise ValueError(
                f"a record of {index.chunk_length} bytes, more than {MAX_RECORD_BYTES} are not read"
            )
        record = self._file.read_at(index.chunk_start_offset, index.chunk_length)
        return chunk_content(memoryview(record))

    def close(self) -> None:
        self._cache.drop(self)


class Run(Protocol):
    """Messages that lie together in a file, none of them earlier than ``start_ns``."""

    path: Path
    start_ns: int

    def entries(self) -> Iterator[Entry]: ...
    def message(self, entry: Entry) -> BagMessage: ...
    def close(self) -> None: ...


def merged(runs: Iterable[Run]) -> Iterator[BagMessage]:
    """Yield the messages of all runs by log time; of equal times, by run and then by file order.

    A run is read when its time comes, so only those that overlap are held.

    Raises:
        InputError: a run is damaged.
    """
    ordered = sorted(enumerate(runs), key=lambda item: (item[1].start_ns, item[0]))
    active: list[_Cursor] = []
    try:
        for number, run in ordered:
            yield from _until(active, (run.start_ns, number))
            _push(active, number, run, _entries(run))
        yield from _until(active, None)
    finally:
        for _, run in ordered:
            run.close()


# Log time of the next message, number of the run, the next message, those behind it, the run.
_Cursor = tuple[int, int, Entry, Iterator[Entry], Run]


def _entries(run: Run) -> Iterator[Entry]:
    try:
        return run.entries()
    except DAMAGE as error:
        raise damaged(run.path, error) from error


def _push(active: list[_Cursor], number: int, run: Run, entries: Iterator[Entry]) -> None:
    entry = next(entries, None)
    if entry is None:
        run.close()
    else:
        heapq.heappush(active, (entry[0], number, entry, entries, run))


def _until(active: list[_Cursor], limit: tuple[int, int] | None) -> Iterator[BagMessage]:
    """Yield the messages of the active runs that come before a time and a run's number."""
    while active and (limit is None or active[0][:2] < limit):
        _, number, entry, entries, run = heapq.heappop(active)
        bound = min((b for b in (limit, active[0][:2] if active else None) if b), default=None)
        try:
            following: Entry | None = entry
            while following and (bound is None or (following[0], number) < bound):
                yield run.message(following)
                following = next(entries, None)
        except DAMAGE as error:
            raise damaged(run.path, error) from error
        if following is None:
            run.close()
        else:
            heapq.heappush(active, (following[0], number, following, entries, run))
