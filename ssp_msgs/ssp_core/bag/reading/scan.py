"""The index of a file that has none, made in one pass through it; messages outside chunks."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from mcap.opcode import Opcode
from mcap.records import AttachmentIndex, ChunkIndex, Statistics
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.reading.index import Entry, Selection
from ssp_core.bag.reading.mcap_file import (
    HEAD,
    BoundedFile,
    Names,
    RecordFrame,
    UnpackBudget,
    check_summary,
    chunk_parts,
    data_crc,
    inner_records,
    open_bounded,
    parse_attachment,
    read_body,
    read_frame,
    unpack_chunk,
)
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.mcap_output import MESSAGE_BODY_BYTES, MESSAGE_HEAD


def is_indexed(summary: Summary) -> bool:
    """Tell whether a summary says where all messages of its file are, how many, and their types."""
    statistics, channels = summary.statistics, summary.channels
    if statistics is None or (statistics.message_count and not summary.chunk_indexes):
        return False
    used = {number for index in summary.chunk_indexes for number in index.message_index_offsets}
    return (
        all(index.message_index_offsets for index in summary.chunk_indexes)
        and bool(statistics.channel_message_counts or not statistics.message_count)
        and channels.keys() >= used
        and all(
            channel.schema_id in summary.schemas or not channel.schema_id
            for channel in channels.values()
        )
    )


@dataclass(slots=True)
class Loose:
    """Messages outside chunks: 18 bytes of each, whatever its size."""

    times_ns: array[int] = field(default_factory=lambda: array("Q"))
    offsets: array[int] = field(default_factory=lambda: array("Q"))
    channels: array[int] = field(default_factory=lambda: array("H"))

    def entries(self, selection: Selection) -> Iterator[Entry]:
        """Log time and offset in the file, in order of both."""
        times = np.frombuffer(self.times_ns, dtype=np.uint64)
        mask = np.isin(np.frombuffer(self.channels, dtype=np.uint16), list(selection.topics))
        if selection.start_ns is not None:
            mask &= times >= max(0, selection.start_ns)
        if selection.stop_ns is not None:
            mask &= times < max(0, selection.stop_ns)
        which = np.flatnonzero(mask)
        for at in which[np.argsort(times[which], kind="stable")]:
            yield self.times_ns[at], self.offsets[at]


def scan(stream: BoundedFile, own_summary: Summary) -> tuple[Summary, Loose]:
    """Go through a file from its beginning to the end of its data.

    Args:
        stream: the open file.
        own_summary: of the file; what it says of types, topics and counts stays.

    Raises:
        ValueError: the file is cut off or damaged; the message names the record.
    """
    if data_crc(stream) is False:
        raise ValueError("the CRC of the data is wrong")
    scanner = _Scan(stream, own_summary)
    offset = len(MCAP0_MAGIC)
    while True:
        try:
            frame = read_frame(stream, offset)
            if frame.opcode == Opcode.DATA_END:
                break
            scanner.record(frame)
        except ValueError as error:
            raise ValueError(f"record at byte {offset}: {error}") from error
        offset = frame.end
    summary = scanner.summary()
    check_summary(summary, offset, stream.size)
    return summary, scanner.loose


class _Scan:
    def __init__(self, stream: BoundedFile, own_summary: Summary) -> None:
        self.loose = Loose()
        self._stream = stream
        self._own_summary = own_summary
        self._names = Names(own_summary)
        self._budget = UnpackBudget(stream.size)
        self._chunks: list[ChunkIndex] = []
        self._attachments: list[AttachmentIndex] = []
        self._counts: Counter[int] = Counter()
        self._times: list[int] = []

    def record(self, frame: RecordFrame) -> None:
        """Take what an index would say of a record; raise ValueError when it is damaged."""
        if frame.opcode == Opcode.CHUNK:
            self._chunk(frame)
        elif frame.opcode == Opcode.MESSAGE:
            if frame.length < MESSAGE_BODY_BYTES:
                raise ValueError(f"a message of {frame.length} bytes")
            self._stream.seek(frame.offset)
            head = MESSAGE_HEAD.unpack(self._stream.read(MESSAGE_HEAD.size))
            self.loose.times_ns.append(head[4])
            self.loose.offsets.append(frame.offset)
            self.loose.channels.append(head[2])
        elif frame.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            self._names.add(frame.opcode, read_body(self._stream, frame))
        elif frame.opcode == Opcode.ATTACHMENT:
            one = parse_attachment(read_body(self._stream, frame))
            self._attachments.append(
                AttachmentIndex(
                    offset=frame.offset,
                    length=HEAD.size + frame.length,
                    log_time=one.log_time,
                    create_time=one.create_time,
                    data_size=len(one.data),
                    name=one.name,
                    media_type=one.media_type,
                )
            )

    def _chunk(self, frame: RecordFrame) -> None:
        parts = chunk_parts(read_body(self._stream, frame))
        self._budget.take(parts.unpacked_bytes)
        content, counts = unpack_chunk(parts), Counter[int]()
        first, last = 0, 0
        for record in inner_records(content):
            if record.opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._names.add(record.opcode, record.body)
            elif record.opcode == Opcode.MESSAGE:
                if len(record.body) < MESSAGE_BODY_BYTES:
                    raise ValueError(f"a message of {len(record.body)} bytes")
                _, _, channel, _, time_ns, _ = MESSAGE_HEAD.unpack_from(content, record.offset)
                first = min(first, time_ns) if counts else time_ns
                last = max(last, time_ns)
                counts[channel] += 1
        if not counts:
            return
        self._counts += counts
        self._times = [min([first, *self._times]), max([last, *self._times])]
        self._chunks.append(
            ChunkIndex(
                chunk_length=HEAD.size + frame.length,
                chunk_start_offset=frame.offset,
                compression=parts.compression,
                compressed_size=len(parts.data),
                message_end_time=last,
                message_index_length=0,
                message_index_offsets=dict.fromkeys(counts, 0),
                message_start_time=first,
                uncompressed_size=parts.unpacked_bytes,
            )
        )

    def summary(self) -> Summary:
        """Return the findings as the file could have stated them."""
        findings = Summary()
        findings.schemas, findings.channels = self._names.schemas, self._names.channels
        findings.chunk_indexes, findings.attachment_indexes = self._chunks, self._attachments
        counts = self._counts + Counter(self.loose.channels)
        for number in sorted(counts.keys() - findings.channels.keys()):
            raise ValueError(f"channel {number} has messages and no topic")
        own_statistics = self._own_summary.statistics
        if own_statistics and (
            own_statistics.channel_message_counts or not own_statistics.message_count
        ):
            findings.statistics = own_statistics
            return findings
        loose = self.loose.times_ns
        times = self._times + ([min(loose), max(loose)] if loose else [])
        findings.statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(findings.channels),
            channel_message_counts=dict(counts),
            chunk_count=len(self._chunks),
            message_count=counts.total(),
            message_end_time=max(times, default=0),
            message_start_time=min(times, default=0),
            metadata_count=0,
            schema_count=len(findings.schemas),
        )
        return findings


class LooseRun:
    """The messages of a file that stand outside chunks."""

    def __init__(self, path: Path, loose: Loose, selection: Selection) -> None:
        self.path = path
        self.start_ns = min(loose.times_ns)
        self._loose = loose
        self._selection = selection
        self._stream: BoundedFile | None = None

    def entries(self) -> Iterator[Entry]:
        self._stream = open_bounded(self.path)
        return self._loose.entries(self._selection)

    def message(self, entry: Entry) -> BagMessage:
        if self._stream is None:
            raise ValueError("the run was closed")
        frame = read_frame(self._stream, entry[1])
        self._stream.seek(frame.offset)
        record = memoryview(self._stream.read(HEAD.size + frame.length))
        return self._selection.message(record, 0, entry[0])

    def close(self) -> None:
        if self._stream is not None:
            self._stream.close()
