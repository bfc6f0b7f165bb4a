"""Chunks of an MCAP file: messages go in, the buffers of their records come out."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TypeAlias

from isal.isal_zlib import crc32, crc32_combine
from mcap.opcode import Opcode
from mcap.records import ChunkIndex

# Opcode, length of what follows, channel, sequence, log time, publish time.
MESSAGE_HEAD = struct.Struct("<BQHIQQ")
MESSAGE_BODY_BYTES = MESSAGE_HEAD.size - 9
# Opcode, length, start, end, uncompressed size, CRC, length of the compression's name, data length.
CHUNK_HEAD = struct.Struct("<BQQQQIIQ")
# Opcode, length, channel, length of the entries; each entry is a log time and an offset.
INDEX_HEAD = struct.Struct("<BQHI")
INDEX_ENTRY_BYTES = 16
_MESSAGE = int(Opcode.MESSAGE)
# Copying a small message costs less than one more buffer for the system to gather.
COPIED_BYTES = 8192

Buffer: TypeAlias = bytes | bytearray | memoryview


@dataclass(frozen=True, slots=True)
class FinishedChunk:
    """A Chunk record and its MessageIndex records.

    Args:
        buffers: the bytes, in order.
        length: of all buffers.
        crc: of all bytes.
        chunk_bytes: length of the Chunk record alone.
        payload_bytes: length of the messages in it.
        start_ns, end_ns: earliest and latest log time.
        index_offsets: where each channel's MessageIndex record begins, from the first buffer.
        counts: messages by channel.
    """

    buffers: list[Buffer]
    length: int
    crc: int
    chunk_bytes: int
    payload_bytes: int
    start_ns: int
    end_ns: int
    index_offsets: dict[int, int]
    counts: dict[int, int]

    def index(self, offset: int) -> ChunkIndex:
        """The ChunkIndex record of this chunk when it begins at that offset of the file."""
        return ChunkIndex(
            chunk_length=self.chunk_bytes,
            chunk_start_offset=offset,
            compression="",
            compressed_size=self.payload_bytes,
            message_end_time=self.end_ns,
            message_index_length=self.length - self.chunk_bytes,
            message_index_offsets={
                channel: offset + begin for channel, begin in self.index_offsets.items()
            },
            message_start_time=self.start_ns,
            uncompressed_size=self.payload_bytes,
        )


class ChunkBuilder:
    """The open chunk: a reference to each large message, a copy of the small ones."""

    __slots__ = ("_buffers", "_entries", "_small", "size")

    def __init__(self) -> None:
        self._clear()

    def _clear(self) -> None:
        self.size = 0
        self._small = bytearray()
        self._buffers: list[Buffer] = []
        # Log times and offsets in turn, by channel.
        self._entries: dict[int, list[int]] = {}

    def add(
        self, channel_id: int, sequence: int, log_time_ns: int, publish_time_ns: int, data: bytes
    ) -> None:
        """Appends a message; large data must not change until the chunk was written.

        Raises:
            struct.error: a number doesn't fit its field; nothing has happened then.
        """
        length = len(data)
        head = MESSAGE_HEAD.pack(
            _MESSAGE,
            length + MESSAGE_BODY_BYTES,
            channel_id,
            sequence,
            log_time_ns,
            publish_time_ns,
        )
        entries = self._entries.get(channel_id)
        if entries is None:
            entries = self._entries[channel_id] = []
        entries += (log_time_ns, self.size)
        self._small += head
        if length <= COPIED_BYTES:
            self._small += data
        else:
            self._buffers += (self._small, data)
            self._small = bytearray()
        self.size += MESSAGE_HEAD.size + length

    def counts(self) -> dict[int, int]:
        """Messages by channel."""
        return {channel: len(entries) // 2 for channel, entries in self._entries.items()}

    def times(self) -> tuple[int, int] | None:
        """Earliest and latest log time, None while there is no message."""
        if not self._entries:
            return None
        times = [entries[::2] for entries in self._entries.values()]
        return min(map(min, times)), max(map(max, times))

    def finish(self) -> FinishedChunk:
        """The records of what was added; the builder is empty afterwards."""
        payload = self._buffers
        if self._small:
            payload.append(self._small)
        payload_crc = 0
        for buffer in payload:
            payload_crc = crc32(buffer, payload_crc)
        start_ns, end_ns = self.times() or (0, 0)
        head = CHUNK_HEAD.pack(
            Opcode.CHUNK,
            CHUNK_HEAD.size - 9 + self.size,
            start_ns,
            end_ns,
            self.size,
            payload_crc,
            0,
            self.size,
        )
        chunk_bytes = len(head) + self.size
        index, index_offsets = _message_indexes(self._entries, chunk_bytes)
        crc = crc32_combine(crc32(head), payload_crc, self.size)
        finished = FinishedChunk(
            buffers=[head, *payload, index],
            length=chunk_bytes + len(index),
            crc=crc32(index, crc),
            chunk_bytes=chunk_bytes,
            payload_bytes=self.size,
            start_ns=start_ns,
            end_ns=end_ns,
            index_offsets=index_offsets,
            counts=self.counts(),
        )
        self._clear()
        return finished


def _message_indexes(entries: dict[int, list[int]], begin: int) -> tuple[bytearray, dict[int, int]]:
    """MessageIndex records one after the other, and where each channel's begins."""
    records = bytearray()
    offsets = {}
    for channel_id, flat in entries.items():
        offsets[channel_id] = begin + len(records)
        size = 8 * len(flat)
        records += INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel_id, size)
        records += struct.pack(f"<{len(flat)}Q", *flat)
    return records, offsets
