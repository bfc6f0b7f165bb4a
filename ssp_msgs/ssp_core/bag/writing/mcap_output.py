"""One MCAP file being written: chunks and records in their order, and their way to the disk."""

from __future__ import annotations

import os
import struct
import threading
import time
from collections import Counter
from collections.abc import Sequence
from hashlib import sha256
from io import FileIO
from pathlib import Path
from typing import NamedTuple, TypeAlias

import zstandard
from isal.isal_zlib import crc32, crc32_combine
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    ChunkIndex,
    DataEnd,
    Header,
    McapRecord,
    Metadata,
    Schema,
)
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.writing.chain import (
    CHUNK_RECORD_BYTES,
    NOTHING,
    SEAL_NAME,
    Chain,
    Ending,
    Maker,
    chunk_record,
    closing_record,
    opening_record,
    record_bytes,
)
from ssp_core.bag.writing.file_index import FileIndex, span

# Opcode, length of what follows, channel, sequence, log time, publish time.
MESSAGE_HEAD = struct.Struct("<BQHIQQ")
MESSAGE_BODY_BYTES = MESSAGE_HEAD.size - 9
# Opcode, length, start, end, uncompressed size, CRC, length of the compression's name, data length.
CHUNK_HEAD = struct.Struct("<BQQQQIIQ")
# The same with the name of a compression; states and plans pack to a tenth at its lowest level, in
# a thousandth of the time that a run takes.
PACKED_HEAD = struct.Struct("<BQQQQII4sQ")
PACKING, PACKING_LEVEL = "zstd", 1
# Opcode, length, channel, length of the entries; each entry is a log time and an offset.
INDEX_HEAD = struct.Struct("<BQHI")
INDEX_ENTRY_BYTES = 16
_MESSAGE = int(Opcode.MESSAGE)
# Copying a small message costs less than one more buffer for the system to gather.
COPIED_BYTES = 8192

Buffer: TypeAlias = bytes | bytearray | memoryview


class FinishedChunk(NamedTuple):
    """A Chunk record and its MessageIndex records.

    It holds their bytes, length and CRC, what stands of them in the summary, and messages by
    channel.
    """

    buffers: list[Buffer]
    length: int
    crc: int
    chunk_index: ChunkIndex
    counts: dict[int, int]


class ChunkBuilder:
    """The open chunk: a reference to each large message, a copy of the small ones.

    Args:
        packed: its content is compressed when it is finished.
    """

    __slots__ = ("_buffers", "_entries", "_small", "packed", "size")

    def __init__(self, *, packed: bool = False) -> None:
        self.packed = packed
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
        """Append a message; large data must not change until the chunk was written.

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
        """Count the messages by channel."""
        return {channel: len(entries) // 2 for channel, entries in self._entries.items()}

    def times(self) -> tuple[int, int] | None:
        """Return the earliest and latest log time, None while there is no message."""
        if not self._entries:
            return None
        times = [entries[::2] for entries in self._entries.values()]
        return min(map(min, times)), max(map(max, times))

    def finish(self, offset: int) -> FinishedChunk:
        """Return the records of what was added; the builder is empty afterwards.

        Args:
            offset: where the first of them will begin in the file.
        """
        payload = self._buffers
        if self._small:
            payload.append(self._small)
        payload_crc = 0
        for buffer in payload:
            payload_crc = crc32(buffer, payload_crc)
        start_ns, end_ns = self.times() or (0, 0)
        if self.packed:
            packed = zstandard.ZstdCompressor(level=PACKING_LEVEL).compress(b"".join(payload))
            payload, stored_bytes, stored_crc = [packed], len(packed), crc32(packed)
            layout, name = PACKED_HEAD, PACKING.encode()
        else:
            stored_bytes, stored_crc = self.size, payload_crc
            layout, name = CHUNK_HEAD, b""
        head = layout.pack(
            Opcode.CHUNK,
            layout.size - 9 + stored_bytes,
            start_ns,
            end_ns,
            self.size,
            payload_crc,
            len(name),
            *([name] if name else []),
            stored_bytes,
        )
        chunk_bytes = len(head) + stored_bytes
        indexes, offsets = _message_indexes(self._entries, offset + chunk_bytes)
        crc = crc32_combine(crc32(head), stored_crc, stored_bytes)
        finished = FinishedChunk(
            [head, *payload, indexes],
            chunk_bytes + len(indexes),
            crc32(indexes, crc),
            ChunkIndex(
                chunk_length=chunk_bytes,
                chunk_start_offset=offset,
                compression=name.decode(),
                compressed_size=stored_bytes,
                message_end_time=end_ns,
                message_index_length=len(indexes),
                message_index_offsets=offsets,
                message_start_time=start_ns,
                uncompressed_size=self.size,
            ),
            self.counts(),
        )
        self._clear()
        return finished


def _message_indexes(entries: dict[int, list[int]], begin: int) -> tuple[bytearray, dict[int, int]]:
    """Return the MessageIndex records one after the other, and where each channel's begins."""
    records = bytearray()
    offsets = {}
    for channel_id, flat in entries.items():
        offsets[channel_id] = begin + len(records)
        size = 8 * len(flat)
        records += INDEX_HEAD.pack(Opcode.MESSAGE_INDEX, 6 + size, channel_id, size)
        records += struct.pack(f"<{len(flat)}Q", *flat)
    return records, offsets


# A sync that takes longer makes the writer wait for it, so that what the disk can't keep up with
# waits where it is counted and bounded, and not in the system's memory.
OVERDUE_S = 1.0
# How long one request waits at most: the writer must still notice that it is to end.
LONGEST_WAIT_S = 5.0
# Where one sync takes as much as this, raw images are being recorded. Their pages are given back,
# so that the next ones are written into the same memory: to find new pages for 166 MB/s costs a
# quarter of a core, and pushes all else out of the system's cache.
GIVEN_BACK_BYTES = 16 << 20


class DiskSync:
    """Runs fdatasync behind the writer's back, so that a disk's hiccup doesn't hold it up.

    The thread starts with the first request and works on descriptors of its own, so a file may
    be closed at any time. Requests for a file that already waits for its turn are one request:
    no more than one is running and one waiting per file, however slow the disk is.
    """

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._waiting: dict[str, tuple[int, float]] = {}
        self._running_since_s: float | None = None
        self._stopped = False
        self._error: OSError | None = None
        self._thread: threading.Thread | None = None

    @property
    def age_s(self) -> float:
        """Seconds since the oldest request that is not done yet, 0.0 when all are done."""
        with self._changed:
            return self._age_s()

    def _age_s(self) -> float:
        since = [asked_s for _, asked_s in self._waiting.values()]
        if self._running_since_s is not None:
            since.append(self._running_since_s)
        return time.monotonic() - min(since) if since else 0.0

    def request(self, name: str, descriptor: int) -> None:
        """Ask for a file to be synchronised soon.

        Args:
            name: of the file; a name waits once.
            descriptor: of the open file; it is duplicated, so that its owner may close it.

        Raises:
            OSError: an earlier request failed: what was written may be lost.
        """
        with self._changed:
            self._raise()
            if name not in self._waiting:
                self._waiting[name] = (os.dup(descriptor), time.monotonic())
                self._changed.notify_all()
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="bag-sync", daemon=True)
            self._thread.start()

    def wait_for_overdue(self) -> None:
        """Wait until no request is older than OVERDUE_S, or for LONGEST_WAIT_S.

        Raises:
            OSError: a request failed: what was written may be lost.
        """
        with self._changed:
            self._changed.wait_for(
                lambda: self._error is not None or self._stopped or self._age_s() <= OVERDUE_S,
                LONGEST_WAIT_S,
            )
            self._raise()

    def finish(self) -> None:
        """Wait until everything asked for is done, and end the thread.

        Raises:
            OSError: a request failed.
        """
        self.abandon()
        if self._thread is not None:
            self._thread.join()
        self._raise()

    def abandon(self) -> None:
        """Let the thread end when it has done what it was asked for; don't wait for it."""
        with self._changed:
            self._stopped = True
            self._changed.notify_all()

    def _raise(self) -> None:
        if self._error is not None:
            raise OSError(self._error.errno, self._error.strerror)

    def _run(self) -> None:
        synced: dict[str, int] = {}
        while True:
            with self._changed:
                while not self._waiting and not self._stopped:
                    self._changed.wait()
                if not self._waiting:
                    return
                name = next(iter(self._waiting))
                descriptor, self._running_since_s = self._waiting.pop(name)
            failed = None
            try:
                start, end = synced.get(name, 0), os.fstat(descriptor).st_size
                os.fdatasync(descriptor)
                if end - start >= GIVEN_BACK_BYTES:
                    os.posix_fadvise(descriptor, start, end - start, os.POSIX_FADV_DONTNEED)
                synced[name] = end
            except OSError as error:
                failed = error
            finally:
                os.close(descriptor)
            with self._changed:
                self._error = failed or self._error
                self._running_since_s = None
                self._changed.notify_all()


CHUNK_BYTES = 1 << 20
GATHERED = os.sysconf("SC_IOV_MAX")


def write_buffers(descriptor: int, buffers: Sequence[Buffer], gathered: int = GATHERED) -> None:
    """Write all buffers in order, without joining them.

    Args:
        descriptor: of the open file.
        buffers: the bytes.
        gathered: buffers that the system takes in one call.

    Raises:
        OSError: the disk didn't take everything.
    """
    left = list(buffers)
    at = 0
    while at < len(left):
        byte_count = os.writev(descriptor, left[at : at + gathered])
        if byte_count == 0 and any(map(len, left[at : at + gathered])):
            raise OSError(0, "the system took no byte")
        while at < len(left) and byte_count >= len(left[at]):
            byte_count -= len(left[at])
            at += 1
        if byte_count:
            left[at] = memoryview(left[at])[byte_count:]


class McapOutput:
    """Header, schemas, channels, chunks, attachments and metadata, then the summary.

    Schemas and channels stand between the chunks, so that a damaged chunk takes no other chunk's
    types with it. Messages go into ``chunk`` directly; ``flush`` writes it. A chunk's seal stands
    before it, so that a file that is cut off is sealed up to its last whole chunk. OSError passes
    through, and closing is the caller's.

    Args:
        file: opened to be written, and empty.
        path: of it.
        chain: that the files of a bag share.
        number: of the file in its bag.
        packed: its chunks are compressed.

    Raises:
        OSError: the file can't be written.
    """

    def __init__(
        self,
        file: FileIO,
        path: Path,
        library: str,
        chain: Chain | None = None,
        *,
        number: int = 0,
        maker: Maker = Maker.WRITER,
        packed: bool = False,
    ) -> None:
        self._ahead: list[bytes]
        self._begin(file, path, Chain() if chain is None else chain, packed=packed)
        opening = opening_record(maker, number, self._chain.end.hex())
        # What belongs before the open chunk and was not written yet.
        self._ahead = [MCAP0_MAGIC, record_bytes(Header("ros2", library)), opening]
        self._ahead_bytes = sum(map(len, self._ahead))
        self._index.metadata_count = 1

    @classmethod
    def reopen(
        cls, path: Path, summary: Summary, data_end: int, crc: int, end: bytes
    ) -> McapOutput:
        """Open a closed file of one chunk or more, to write more behind its data.

        The summary stays in the file until something is written over it.

        Args:
            path: of the file.
            summary: of the file.
            data_end: where the record DataEnd stands.
            crc: that it states.
            end: digest of the closing record.
        """
        output = cls.__new__(cls)
        output._begin(FileIO(path, "r+b"), path, Chain(end))
        output._file.seek(data_end)
        output._offset, output._crc = data_end, crc
        output._index = FileIndex.of(summary)
        return output

    def _begin(self, file: FileIO, path: Path, chain: Chain, *, packed: bool = False) -> None:
        self.path = path
        self._file = file
        self._chain = chain
        self._offset = 0
        self._crc = 0
        self.chunk = ChunkBuilder(packed=packed)
        self._index = FileIndex()
        self._ahead = []
        self._ahead_bytes = 0

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
        return self._index.chunk_bytes

    def counts(self) -> Counter[int]:
        """Count the messages by channel, those in the open chunk included."""
        return self._index.counts + Counter(self.chunk.counts())

    def times(self) -> tuple[int, int] | None:
        """Return the earliest and latest log time, None while there is no message."""
        return span(self._index.times, self.chunk.times())

    def add_schema(self, schema: Schema) -> None:
        self._index.schemas.append(schema)
        self._put_ahead(schema)

    def add_channel(self, channel: Channel) -> None:
        self._index.channels.append(channel)
        self._put_ahead(channel)

    def _put_ahead(self, record: McapRecord) -> None:
        data = record_bytes(record)
        self._ahead.append(data)
        self._ahead_bytes += len(data)

    def flush(self) -> None:
        """End the open chunk and hand everything to the system."""
        if self._ahead:
            ahead = b"".join(self._ahead)
            self._ahead, self._ahead_bytes = [], 0
            self._write([ahead], len(ahead), crc32(ahead))
        if self.chunk.size:
            times = self.chunk.times()
            place = self._offset + CHUNK_RECORD_BYTES
            buffers, length, crc, chunk_index, counts = self.chunk.finish(place)
            *content, indexes = buffers
            if self.chunk.packed:
                # The chunk's checksum is that of its messages, and none covers what is stored.
                for buffer in content:
                    self._chain.take_whole(buffer)
            else:
                self._chain.take(content)
            self._index.add_chunk(chunk_index, counts, times)
            seal = chunk_record(self._index.chunks, self._chain.close())
            crc = crc32_combine(crc32(seal), crc, length)
            self._write([seal, *buffers], len(seal) + length, crc, chained=[indexes])

    def attach(self, name: str, media_type: str, data: bytes, log_time_ns: int) -> None:
        """Write a file into this one, behind the open chunk and without copying it."""
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
        self._index.attachments.append(index)
        self._write(buffers, index.length, whole)

    def add_metadata(self, name: str, values: dict[str, str]) -> None:
        self.flush()
        data = record_bytes(Metadata(name, values))
        self._index.add_metadata(name, self._offset, len(data))
        self._write([data], len(data), crc32(data))

    def finish(self, ending: Ending = Ending.BAG) -> None:
        """Write what waits, the seal, the summary and the footer; nothing may follow."""
        self.flush()
        seal_bytes = len(closing_record(ending, NOTHING.hex(), NOTHING.hex()))
        self._index.add_metadata(SEAL_NAME, self._offset, seal_bytes)
        data_end_bytes = len(record_bytes(DataEnd(0)))
        summary_start = self._offset + seal_bytes + data_end_bytes
        summary, summary_offsets = self._index.records(summary_start)
        hashed = sha256(summary + summary_offsets)
        self._chain.take([hashed.digest()])
        seal = closing_record(ending, hashed.hexdigest(), self._chain.close())
        self._write([seal], len(seal), crc32(seal), chained=[])
        data_end = record_bytes(DataEnd(self._crc))
        footer = struct.pack(
            "<BQQQ", Opcode.FOOTER, 20, summary_start, summary_start + len(summary)
        )
        tail = summary + summary_offsets + footer
        tail += struct.pack("<I", crc32(tail)) + MCAP0_MAGIC
        write_buffers(self.descriptor, [data_end, tail])

    @property
    def seal_end(self) -> str:
        """Digest of the chain up to its last seal."""
        return self._chain.end.hex()

    def close(self) -> None:
        """Close the file as it is. A second call does nothing."""
        self._file.close()

    def _write(
        self,
        buffers: Sequence[Buffer],
        length: int,
        crc: int,
        chained: Sequence[Buffer] | None = None,
    ) -> None:
        """Write buffers; all of them are in the chain unless others are named for it."""
        for buffer in buffers if chained is None else chained:
            self._chain.take_whole(buffer)
        write_buffers(self.descriptor, buffers)
        self._offset += length
        self._crc = crc32_combine(self._crc, crc, length)
