"""One MCAP file being read within bounds: records, chunks, a checked summary, named errors."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple, TypeVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from isal.isal_zlib import crc32
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import (
    Attachment,
    AttachmentIndex,
    Channel,
    ChunkIndex,
    McapRecord,
    Message,
    MetadataIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from ssp_core.errors import InputError, not_read

# A chunk holds a message at the least, and ROS carries no message beyond 4 GiB; images and point
# clouds of 100 MB are usual, of 1 GB aren't known.
MAX_CHUNK_BYTES = 1 << 30
# zstd makes 30,000 zeros one byte, so a black image of 100 MB may be packed as well as a bomb is.
# What unpacks to less than this may have any ratio, beyond it a ratio that real data reach.
ANY_RATIO_BYTES = 256 << 20
MAX_RATIO = 1000
# How often chunks that overlap in time are unpacked again where they don't fit into memory.
MAX_REREADS = 16
# Messages in a chunk are held as objects while they are put in order; writers end a chunk at some
# MB, which are 100,000 messages of the smallest kind.
MAX_CHUNK_RECORDS = 4_000_000
# All chunks of a file together: what its size allows at that ratio, and a few of any ratio.
ANY_TOTAL_BYTES = 4 << 30
# Read as a whole: indexes of 500,000 chunks with ten channels each, which are a day at 6 MB/s.
MAX_SUMMARY_BYTES = 128 << 20
# Any record that is read as a whole: a chunk, an attachment, an index of a chunk's messages.
MAX_RECORD_BYTES = MAX_CHUNK_BYTES + (64 << 10)
# Message definitions of one file: 200 types of 20 kB are 4 MB. Parsing takes 10 us per byte.
MAX_SCHEMAS_BYTES = 16 << 20

_CHUNK_HEAD = struct.Struct("<QQQII")
_INDEX_ENTRY_BYTES = 16
_U64 = struct.Struct("<Q")
# Fields before a chunk's data, with the longest name of a compression.
CHUNK_HEAD_BYTES = _CHUNK_HEAD.size + 4 + _U64.size
_PIECE = 1 << 20


class UnpackBudget:
    """The total size that the chunks of one file may unpack to.

    Args:
        file_bytes: size of the file.
        ratio: how many times as much they may unpack to.
    """

    def __init__(self, file_bytes: int, *, ratio: int = MAX_RATIO) -> None:
        self._most = self._left = ANY_TOTAL_BYTES + ratio * file_bytes

    def take(self, unpacked_bytes: int) -> None:
        """Raise ValueError when the file's chunks unpack to more than is believed."""
        self._left -= unpacked_bytes
        if self._left < 0:
            raise ValueError(f"the chunks up to here unpack to more than {self._most} bytes")


class ChunkParts(NamedTuple):
    """The fields of a Chunk record; data is a view of the record's bytes."""

    start_ns: int
    end_ns: int
    unpacked_bytes: int
    crc: int
    compression: str
    data: memoryview


def chunk_parts(body: bytes | memoryview) -> ChunkParts:
    """Return the fields of a Chunk record, from its bytes after opcode and length.

    Raises:
        ValueError: the lengths in it don't fit, or claim more than is believed.
    """
    view = memoryview(body)
    if len(view) < _CHUNK_HEAD.size:
        raise ValueError("a chunk is cut off")
    start_ns, end_ns, unpacked, crc, name_bytes = _CHUNK_HEAD.unpack_from(view)
    data_at = _CHUNK_HEAD.size + name_bytes + _U64.size
    if data_at > len(view):
        raise ValueError("a chunk is cut off")
    name = bytes(view[_CHUNK_HEAD.size : _CHUNK_HEAD.size + name_bytes])
    (data_bytes,) = _U64.unpack_from(view, data_at - _U64.size)
    if data_bytes != len(view) - data_at:
        raise ValueError(f"a chunk claims {data_bytes} bytes and has {len(view) - data_at}")
    compression = name.decode("ascii", "backslashreplace")
    check_claim(compression, unpacked, data_bytes)
    return ChunkParts(start_ns, end_ns, unpacked, crc, compression, view[data_at:])


def chunk_length(head: bytes) -> int | None:
    """Read the length of a chunk's body from its first bytes, None when they are too few."""
    if len(head) < _CHUNK_HEAD.size:
        return None
    *_, name_bytes = _CHUNK_HEAD.unpack_from(head)
    data_at = _CHUNK_HEAD.size + name_bytes + _U64.size
    if data_at > len(head):
        return None
    return int(data_at + _U64.unpack_from(head, data_at - _U64.size)[0])


def check_claim(compression: str, unpacked_bytes: int, packed_bytes: int) -> None:
    """Refuse a chunk by what it claims, before anything of it is unpacked.

    Raises:
        ValueError: the claim is beyond belief, or the compression is unknown.
    """
    if compression not in ("", "zstd", "lz4"):
        raise ValueError(f"compression {compression[:40]!r} is unknown (zstd and lz4 are read)")
    if unpacked_bytes > MAX_CHUNK_BYTES:
        raise ValueError(
            f"a chunk of {unpacked_bytes} bytes, more than {MAX_CHUNK_BYTES} are not read"
        )
    if not compression and unpacked_bytes != packed_bytes:
        raise ValueError(f"a chunk claims {unpacked_bytes} bytes and has {packed_bytes}")
    if unpacked_bytes > max(ANY_RATIO_BYTES, MAX_RATIO * packed_bytes):
        raise ValueError(
            f"a chunk claims to unpack from {packed_bytes} to {unpacked_bytes} bytes, "
            f"more than {MAX_RATIO} times as many"
        )


def unpack_chunk(parts: ChunkParts) -> memoryview:
    """Return the content of a chunk, with its CRC checked; never more at once than is there.

    Raises:
        ValueError: it doesn't unpack to what it claims, or its CRC is wrong.
    """
    data, claimed = parts.data, parts.unpacked_bytes
    if parts.compression:
        try:
            unpacked = (_unzstd if parts.compression == "zstd" else _unlz4)(data, claimed)
        except (zstandard.ZstdError, RuntimeError, EOFError) as error:
            raise ValueError(f"a chunk doesn't unpack: {error}") from error
        if len(unpacked) != claimed:
            what = "more" if len(unpacked) > claimed else "less"
            unpacked.clear()  # an error that is kept keeps its frames, and what they hold
            raise ValueError(f"a chunk unpacks to {what} than the {claimed} bytes it claims")
        data = memoryview(unpacked)
    if parts.crc and crc32(data) != parts.crc:
        raise ValueError("crc validation failed in a chunk")
    return data


def _unzstd(data: memoryview, most: int) -> bytearray:
    """Unpack at most one piece more than ``most``; the frame's own claims are not looked at."""
    unpacked = bytearray()
    # A frame asks for a window of its own choice: zstd's own limit, or all that it unpacks to.
    window = 1 << max(27, (most - 1).bit_length())
    decompressor = zstandard.ZstdDecompressor(max_window_size=window)
    with decompressor.stream_reader(data, read_across_frames=True) as stream:
        while len(unpacked) <= most:
            piece = stream.read(min(_PIECE, most + 1 - len(unpacked)))
            if not piece:
                break
            unpacked += piece
    return unpacked


def _unlz4(data: memoryview, most: int) -> bytearray:
    unpacked = bytearray()
    decompressor = lz4.frame.LZ4FrameDecompressor()
    piece = decompressor.decompress(data, max_length=min(_PIECE, most + 1))
    while True:
        unpacked += piece
        if len(unpacked) > most or decompressor.eof or decompressor.needs_input:
            break
        piece = decompressor.decompress(b"", max_length=min(_PIECE, most + 1 - len(unpacked)))
    if len(unpacked) <= most and not decompressor.eof:
        unpacked.clear()
        raise ValueError("a chunk ends within its compressed data")
    if decompressor.unused_data:
        unpacked.clear()
        raise ValueError("a chunk goes on after its compressed data")
    return unpacked


def check_summary(summary: Summary, data_end: int, file_bytes: int) -> None:
    """Refuse indexes that would make a reader read a place twice, or beyond the data.

    Args:
        summary: as the file states it.
        data_end: where the data section ends and the summary begins.
        file_bytes: size of the file.

    Raises:
        ValueError: which index, and what is wrong with it.
    """
    chunks, attachments = summary.chunk_indexes, summary.attachment_indexes
    _check_places(
        "chunk",
        ((c.chunk_start_offset, c.chunk_length + c.message_index_length) for c in chunks),
        data_end,
    )
    _check_places("attachment", ((a.offset, a.length) for a in attachments), data_end)
    budget = UnpackBudget(file_bytes)
    for chunk in chunks:
        try:
            budget.take(chunk.uncompressed_size)
            check_claim(chunk.compression, chunk.uncompressed_size, chunk.compressed_size)
            if chunk.compressed_size > chunk.chunk_length:
                raise ValueError("it is shorter than its data")
            if chunk.message_index_length > _INDEX_ENTRY_BYTES * MAX_CHUNK_RECORDS:
                raise ValueError(f"it has more than {MAX_CHUNK_RECORDS} messages")
        except ValueError as error:
            raise ValueError(f"record at byte {chunk.chunk_start_offset}: {error}") from error
    for index in attachments:
        if index.length > MAX_RECORD_BYTES:
            raise ValueError(
                f"attachment {index.name[:80]!r} has {index.length} bytes, "
                f"more than {MAX_RECORD_BYTES} are not read"
            )
    size = sum(len(schema.data) for schema in summary.schemas.values())
    if size > MAX_SCHEMAS_BYTES:
        raise ValueError(
            f"{size} bytes of message definitions, more than {MAX_SCHEMAS_BYTES} are not read"
        )


def _check_places(kind: str, places: Iterable[tuple[int, int]], data_end: int) -> None:
    before = 0
    for offset, length in sorted(places):
        if offset < before:
            raise ValueError(f"two {kind} indexes for the bytes from {offset} on")
        before = offset + length
        if not length or before > data_end:
            raise ValueError(f"the {kind} index for byte {offset} points beyond the data")


HEAD = struct.Struct("<BQ")
FOOTER = struct.Struct("<BQQQI")
_DATA_END = struct.Struct("<BQI")
_MESSAGE = struct.Struct("<HIQQ")
_PRIVATE = 0x80  # opcodes from here on are anybody's


Record = TypeVar("Record", Schema, Channel, Attachment)


class RawRecord(NamedTuple):
    """A record's kind, the offset of its first byte, and its bytes after opcode and length."""

    opcode: int
    offset: int
    body: memoryview


def inner_records(data: memoryview) -> Iterator[RawRecord]:
    """Yield the records of an unpacked chunk, offsets from its first byte.

    Raises:
        ValueError: a record runs out of the chunk, after the whole ones were given.
    """
    offset, count, size = 0, 0, len(data)
    while offset < size:
        count += 1
        if count > MAX_CHUNK_RECORDS:
            raise ValueError(f"a chunk of more than {MAX_CHUNK_RECORDS} records")
        if offset + HEAD.size > size:
            raise ValueError("a chunk ends within a record")
        opcode, length = HEAD.unpack_from(data, offset)
        begin = offset + HEAD.size
        if length > size - begin:
            raise ValueError(f"a record of {length} bytes in a chunk that has {size - begin} left")
        yield RawRecord(opcode, offset, data[begin : begin + length])
        offset = begin + length


class _Fields(ReadDataStream):
    """The fields of one record; one that is cut off is an error."""

    def read(self, length: int) -> bytes:
        data = bytes(self._stream.read(length))
        if len(data) < length:
            raise ValueError(f"a field of {length} bytes in a record that has {len(data)} left")
        self._count += length
        return data


def parse_record(kind: type[Record], body: memoryview) -> Record:
    """Return a schema or channel; raise ValueError for a wrong length or text other than UTF-8."""
    record: Record = kind.read(_Fields(io.BytesIO(body)))
    return record


class Names:
    """Types and topics by number, as a summary has them and as they are found in the data.

    The first one of a number counts.
    """

    def __init__(self, summary: Summary) -> None:
        self.schemas, self.channels = dict(summary.schemas), dict(summary.channels)
        self._left = MAX_SUMMARY_BYTES

    def add(self, opcode: int, body: memoryview) -> None:
        """Take a schema or a channel; raise ValueError as ``parse_record``, or for too many."""
        if opcode == Opcode.SCHEMA:
            schema = parse_record(Schema, body)
            if schema.id not in self.schemas:
                self._take(len(body))
                self.schemas[schema.id] = schema
        else:
            channel = parse_record(Channel, body)
            if channel.id not in self.channels:
                self._take(len(body))
                self.channels[channel.id] = channel

    def _take(self, size: int) -> None:
        self._left -= size
        if self._left < 0:
            raise ValueError(f"topics and types of more than {MAX_SUMMARY_BYTES} bytes")


def parse_message(body: memoryview) -> Message:
    """Return a message; raise ValueError when it is too short."""
    if len(body) < _MESSAGE.size:
        raise ValueError(f"a message of {len(body)} bytes")
    channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
    return Message(channel_id, log_time, bytes(body[_MESSAGE.size :]), publish_time, sequence)


def parse_attachment(body: memoryview) -> Attachment:
    """Return an attachment; raise ValueError when its CRC or a length is wrong."""
    if len(body) < 4:
        raise ValueError("an attachment is cut off")
    crc = int.from_bytes(body[-4:], "little")
    if crc and crc32(body[:-4]) != crc:
        raise ValueError("an attachment's CRC is wrong")
    return parse_record(Attachment, body)


KNOWN = frozenset(int(opcode) for opcode in Opcode)


REPAIR = "`ssp bag recover` keeps what can be read"

# What the mcap package and its decompressors raise on bytes that are no MCAP; lz4 raises a plain
# RuntimeError. KeyError and IndexError come from references to records that aren't there.
DAMAGE = (
    McapError,
    ValueError,
    KeyError,
    IndexError,
    OverflowError,
    MemoryError,
    RuntimeError,
    struct.error,
    zstandard.ZstdError,
)


class BoundedFile(io.BufferedReader):
    """A file whose read() asks for no more than is there, whatever length damaged bytes claim."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path, "rb"))
        self.size = self.seek(0, io.SEEK_END)
        self.seek(0)

    def read(self, size: int | None = -1, /) -> bytes:
        left = max(0, self.size - self.tell())
        return super().read(left if size is None or size < 0 else min(size, left))


@contextmanager
def damage_of(path: Path) -> Iterator[None]:
    """Turn what damaged bytes raise into an InputError that names the file."""
    try:
        yield
    except DAMAGE as error:
        raise damaged(path, error) from error
    except OSError as error:
        raise not_read(path, error) from error


def damaged(path: Path, error: Exception) -> InputError:
    """Make the error for a file whose bytes raised one of DAMAGE."""
    text = str(error) or type(error).__name__
    return InputError(f"is damaged: {text}", file=path, remedy=REPAIR)


def open_bounded(path: Path) -> BoundedFile:
    """Open a file.

    Raises:
        InputError: it can't be opened, or is no file.
    """
    if path.exists() and not path.is_file():  # a pipe would wait for somebody to write into it
        raise InputError("is no file", file=path, remedy="name a file")
    try:
        return BoundedFile(path)
    except OSError as error:
        raise not_read(path, error) from error


class RecordFrame(NamedTuple):
    """The place of a record: kind, offset of its first byte, bytes after opcode and length."""

    opcode: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        return self.offset + HEAD.size + self.length


def read_frame(stream: BoundedFile, offset: int) -> RecordFrame:
    """Return the record that begins at an offset.

    Raises:
        ValueError: none does, or it is longer than the file or than is believed.
    """
    stream.seek(offset)
    head = stream.read(HEAD.size)
    if len(head) < HEAD.size:
        raise ValueError("the file ends within a record")
    opcode, length = HEAD.unpack(head)
    if opcode not in KNOWN and opcode < _PRIVATE:
        raise ValueError(f"no record begins with byte {opcode}")
    if length > stream.size - offset - HEAD.size:
        raise ValueError("the file ends within a record")
    # What isn't known is passed over and never read.
    if length > MAX_RECORD_BYTES and opcode in KNOWN:
        raise ValueError(f"a record of {length} bytes, more than {MAX_RECORD_BYTES} are not read")
    return RecordFrame(opcode, offset, length)


def read_body(stream: BoundedFile, frame: RecordFrame) -> memoryview:
    """Return the bytes of a record after opcode and length."""
    stream.seek(frame.offset + HEAD.size)
    return memoryview(stream.read(frame.length))


def data_crc(stream: BoundedFile) -> bool | None:
    """Tell whether the CRC over all data of a closed file is right; None: there is none."""
    tail_at = stream.size - FOOTER.size - len(MCAP0_MAGIC)
    if tail_at < len(MCAP0_MAGIC) + _DATA_END.size:
        return None
    stream.seek(tail_at)
    opcode, _, summary_start, _, _ = FOOTER.unpack(stream.read(FOOTER.size))
    if opcode != Opcode.FOOTER or stream.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
        return None
    data_end = (summary_start or tail_at) - _DATA_END.size
    if not len(MCAP0_MAGIC) <= data_end <= tail_at - _DATA_END.size:
        return None
    stream.seek(data_end)
    opcode, length, stated = _DATA_END.unpack(stream.read(_DATA_END.size))
    if opcode != Opcode.DATA_END or length != 4 or not stated:
        return None
    stream.seek(0)
    crc, left = 0, data_end
    while left:
        piece = stream.read(min(_PIECE, left))
        if not piece:  # it became shorter meanwhile
            return False
        crc = crc32(piece, crc)
        left -= len(piece)
    return bool(crc == stated)


def read_summary(stream: BoundedFile, path: Path) -> Summary:
    """Return the summary section of a closed MCAP file, its CRC checked; empty where it has none.

    Raises:
        InputError: no MCAP file, not closed, or damaged.
    """
    head = stream.read(len(MCAP0_MAGIC))
    if head != MCAP0_MAGIC:
        raise InputError("is no MCAP file", file=path, remedy="name a file of a recording in MCAP")
    tail_bytes = FOOTER.size + len(MCAP0_MAGIC)
    stream.seek(max(0, stream.size - tail_bytes))
    tail = stream.read(tail_bytes)
    if len(tail) < tail_bytes or not tail.endswith(MCAP0_MAGIC) or tail[0] != Opcode.FOOTER:
        raise InputError("was not closed by its recorder, or is cut off", file=path, remedy=REPAIR)
    _, _, summary_start, _, crc = FOOTER.unpack_from(tail)
    if not summary_start:
        return Summary()
    if not len(MCAP0_MAGIC) <= summary_start <= stream.size - tail_bytes:
        raise InputError("is damaged: its summary is beyond its end", file=path, remedy=REPAIR)
    if stream.size - summary_start > MAX_SUMMARY_BYTES:
        raise InputError(
            f"has a summary of more than {MAX_SUMMARY_BYTES} bytes", file=path, remedy=REPAIR
        )
    stream.seek(summary_start)
    block = stream.read(stream.size - summary_start)
    # The CRC stands last in the footer and covers everything before it.
    if crc and crc32(block[: -len(MCAP0_MAGIC) - 4]) != crc:
        raise InputError("is damaged: the summary's CRC is wrong", file=path, remedy=REPAIR)
    summary = Summary()
    with damage_of(path):
        records = StreamReader(io.BytesIO(block), skip_magic=True, record_size_limit=len(block))
        for record in records.records:
            _collect(summary, record)
        check_summary(summary, summary_start, stream.size)
    return summary


def _collect(summary: Summary, record: McapRecord) -> None:
    if isinstance(record, Schema):
        summary.schemas[record.id] = record
    elif isinstance(record, Channel):
        summary.channels[record.id] = record
    elif isinstance(record, Statistics):
        summary.statistics = record
    elif isinstance(record, ChunkIndex):
        summary.chunk_indexes.append(record)
    elif isinstance(record, AttachmentIndex):
        summary.attachment_indexes.append(record)
    elif isinstance(record, MetadataIndex):
        summary.metadata_indexes.append(record)


class McapFile:
    """A closed MCAP file. It is opened for each read, so that a bag of many files holds none open.

    Raises:
        InputError: it can't be opened, is no closed MCAP file or its summary is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with open_bounded(path) as stream:
            self.summary = read_summary(stream, path)

    def read_at(self, offset: int, length: int) -> bytes:
        """Return the bytes from the middle of the file.

        Raises:
            InputError: the file can't be read.
            ValueError: it ends before.
        """
        with open_bounded(self.path) as stream:
            if offset + length > stream.size:
                raise ValueError(f"an index points beyond the end, to {length} bytes at {offset}")
            stream.seek(offset)
            return stream.read(length)

    def message_index(self, chunk: ChunkIndex) -> bytes:
        """Return the MessageIndex records behind a chunk; raise as ``read_at``."""
        return self.read_at(
            chunk.chunk_start_offset + chunk.chunk_length, chunk.message_index_length
        )

    def attachment(self, name: str) -> bytes | None:
        """Return the data of the last attachment of that name, with its CRC checked.

        Raises:
            InputError: it is damaged.
        """
        indexes = self.summary.attachment_indexes
        for index in sorted(indexes, key=lambda index: index.offset, reverse=True):
            if index.name == name:
                with damage_of(self.path):
                    record = memoryview(self.read_at(index.offset, index.length))
                    if record[:1] != bytes([Opcode.ATTACHMENT]):
                        raise ValueError("no attachment where one should be")
                    return bytes(parse_attachment(record[HEAD.size :]).data)
        return None
