"""One MCAP file being written: which record comes where, and the bytes on their way to the disk."""

from __future__ import annotations

import os
import struct
from collections import Counter
from collections.abc import Sequence
from io import FileIO
from pathlib import Path

from isal.isal_zlib import crc32, crc32_combine
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    DataEnd,
    Header,
    McapRecord,
    Metadata,
    MetadataIndex,
    Schema,
    Statistics,
    SummaryOffset,
)
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.chunk import Buffer, ChunkBuilder

CHUNK_BYTES = 1 << 20
GATHERED = os.sysconf("SC_IOV_MAX")


def write_buffers(descriptor: int, buffers: Sequence[Buffer], gathered: int = GATHERED) -> None:
    """Writes all buffers in order, without joining them.

    Args:
        descriptor: open for writing.
        buffers: the bytes.
        gathered: buffers that the system takes in one call.

    Raises:
        OSError: the disk didn't take everything.
    """
    left = list(buffers)
    at = 0
    while at < len(left):
        written = os.writev(descriptor, left[at : at + gathered])
        if written == 0 and any(map(len, left[at : at + gathered])):
            raise OSError(0, "the system took no byte")
        while at < len(left) and written >= len(left[at]):
            written -= len(left[at])
            at += 1
        if written:
            left[at] = memoryview(left[at])[written:]


def record_bytes(*records: McapRecord) -> bytes:
    """Records as they stand in a file."""
    builder = RecordBuilder()
    for record in records:
        record.write(builder)
    data: bytes = builder.end()  # type: ignore[no-untyped-call]  # mcap leaves it bare
    return data


class McapOutput:
    """Header, schemas, channels, chunks, attachments and metadata, then the summary.

    Schemas and channels stand between the chunks, so that a damaged chunk takes no other chunk's
    types with it. Messages go into ``chunk`` directly; ``flush`` writes it. OSError passes through,
    and closing is the caller's.

    Args:
        path: the file; it must not exist.
        library: what the header names as the writer.

    Raises:
        OSError: the file can't be made or written.
    """

    def __init__(self, path: Path, library: str) -> None:
        self.path = path
        self._file = FileIO(path, "xb")
        self._offset = 0
        self._crc = 0
        self.chunk = ChunkBuilder()
        self._schemas: list[Schema] = []
        self._channels: list[Channel] = []
        self._chunks = 0
        # As it stands in the summary: as objects it would take ten times the memory.
        self._chunk_index = bytearray()
        self._attachments: list[AttachmentIndex] = []
        self._metadata: list[MetadataIndex] = []
        self._counts: Counter[int] = Counter()
        self._times: tuple[int, int] | None = None
        # What belongs before the open chunk and was not written yet.
        self._ahead: list[bytes] = [MCAP0_MAGIC, record_bytes(Header("ros2", library))]
        self._ahead_bytes = sum(map(len, self._ahead))

    @property
    def descriptor(self) -> int:
        return self._file.fileno()

    @property
    def size(self) -> int:
        """Bytes that the file has with what waits in memory, without indexes and summary."""
        return self._offset + self._ahead_bytes + self.chunk.size

    @property
    def index_bytes(self) -> int:
        """Bytes that the summary takes for the chunks so far."""
        return len(self._chunk_index)

    def counts(self) -> Counter[int]:
        """Messages by channel, those in the open chunk included."""
        return self._counts + Counter(self.chunk.counts())

    def times(self) -> tuple[int, int] | None:
        """Earliest and latest log time, None while there is no message."""
        return _span(self._times, self.chunk.times())

    def add_schema(self, schema: Schema) -> None:
        self._schemas.append(schema)
        self._put_ahead(schema)

    def add_channel(self, channel: Channel) -> None:
        self._channels.append(channel)
        self._put_ahead(channel)

    def _put_ahead(self, record: McapRecord) -> None:
        data = record_bytes(record)
        self._ahead.append(data)
        self._ahead_bytes += len(data)

    def flush(self) -> None:
        """Ends the open chunk and hands everything to the system."""
        if self._ahead:
            ahead = b"".join(self._ahead)
            self._ahead, self._ahead_bytes = [], 0
            self._write([ahead], len(ahead), crc32(ahead))
        if self.chunk.size:
            finished = self.chunk.finish()
            self._chunks += 1
            self._chunk_index += record_bytes(finished.index(self._offset))
            self._counts.update(finished.counts)
            self._times = _span(self._times, (finished.start_ns, finished.end_ns))
            self._write(finished.buffers, finished.length, finished.crc)

    def attach(self, name: str, media_type: str, data: bytes, log_time_ns: int) -> None:
        """Writes a file into this one, behind the open chunk and without copying it."""
        self.flush()
        index = AttachmentIndex(self._offset, 0, log_time_ns, 0, len(data), name, media_type)
        body = bytearray(struct.pack("<QQ", log_time_ns, 0))
        for text in (name.encode(), media_type.encode()):
            body += struct.pack("<I", len(text)) + text
        body += struct.pack("<Q", len(data))
        crc = struct.pack("<I", crc32(data, crc32(body)))
        head = struct.pack("<BQ", Opcode.ATTACHMENT, len(body) + len(data) + len(crc))
        buffers: list[Buffer] = [head, body, data, crc]
        index.length = sum(map(len, buffers))
        whole = 0
        for buffer in buffers:
            whole = crc32(buffer, whole)
        self._attachments.append(index)
        self._write(buffers, index.length, whole)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        self.flush()
        data = record_bytes(Metadata(name, values))
        self._metadata.append(MetadataIndex(self._offset, len(data), name))
        self._write([data], len(data), crc32(data))

    def finish(self) -> None:
        """Writes what waits, the summary and the footer; nothing may follow."""
        self.flush()
        data_end = record_bytes(DataEnd(self._crc))
        summary_start = self._offset + len(data_end)
        summary, summary_offsets = self._summary(summary_start)
        footer = struct.pack(
            "<BQQQ", Opcode.FOOTER, 20, summary_start, summary_start + len(summary)
        )
        tail = summary + summary_offsets + footer
        tail += struct.pack("<I", crc32(tail)) + MCAP0_MAGIC
        write_buffers(self.descriptor, [data_end, tail])

    def close(self) -> None:
        """Closes the file as it is. A second call does nothing."""
        self._file.close()

    def _summary(self, start: int) -> tuple[bytes, bytes]:
        """The groups of the summary as they stand from an offset on, and the records that find
        them."""
        summary, offsets = b"", b""
        for opcode, group in self._groups():
            if group:
                offsets += record_bytes(SummaryOffset(opcode, start + len(summary), len(group)))
                summary += group
        return summary, offsets

    def _groups(self) -> list[tuple[Opcode, bytes | bytearray]]:
        start_ns, end_ns = self._times or (0, 0)
        statistics = Statistics(
            attachment_count=len(self._attachments),
            channel_count=len(self._channels),
            # Channels without messages are named too, as rosbag2 does.
            channel_message_counts={c.id: self._counts[c.id] for c in self._channels},
            chunk_count=self._chunks,
            message_count=self._counts.total(),
            message_end_time=end_ns,
            message_start_time=start_ns,
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )
        return [
            (Opcode.SCHEMA, record_bytes(*self._schemas)),
            (Opcode.CHANNEL, record_bytes(*self._channels)),
            (Opcode.STATISTICS, record_bytes(statistics)),
            (Opcode.CHUNK_INDEX, self._chunk_index),
            (Opcode.ATTACHMENT_INDEX, record_bytes(*self._attachments)),
            (Opcode.METADATA_INDEX, record_bytes(*self._metadata)),
        ]

    def _write(self, buffers: Sequence[Buffer], length: int, crc: int) -> None:
        write_buffers(self.descriptor, buffers)
        self._offset += length
        self._crc = crc32_combine(self._crc, crc, length)


def _span(one: tuple[int, int] | None, other: tuple[int, int] | None) -> tuple[int, int] | None:
    if one is None or other is None:
        return one or other
    return min(one[0], other[0]), max(one[1], other[1])
