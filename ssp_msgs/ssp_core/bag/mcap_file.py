"""One MCAP file being read: bounded records, a checked summary, errors that name the file."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

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

from ssp_core.bag.bounds import MAX_CHUNK_RECORDS, MAX_SUMMARY_BYTES, check_summary
from ssp_core.errors import InputError

HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_U16 = struct.Struct("<H")
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")


class RawRecord(NamedTuple):
    """A record's kind, the offset of its first byte, and its bytes after opcode and length."""

    opcode: int
    offset: int
    body: memoryview


def inner_records(data: memoryview) -> Iterator[RawRecord]:
    """The records of an unpacked chunk, offsets from its first byte.

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


class _Fields:
    """The fields of one record, one after the other."""

    __slots__ = ("_body", "at")

    def __init__(self, body: memoryview) -> None:
        self._body = body
        self.at = 0

    def number(self, layout: struct.Struct) -> int:
        data = self.blob(layout.size)
        return int(layout.unpack(data)[0])

    def blob(self, size: int) -> memoryview:
        end = self.at + size
        if end > len(self._body):
            raise ValueError(
                f"a field of {size} bytes in a record that has {len(self._body) - self.at} left"
            )
        data = self._body[self.at : end]
        self.at = end
        return data

    def text(self) -> str:
        return str(self.blob(self.number(_U32)), "utf-8")

    def texts(self) -> dict[str, str]:
        inner = _Fields(self.blob(self.number(_U32)))
        found: dict[str, str] = {}
        while inner.at < len(inner._body):
            key = inner.text()
            if key in found:
                raise ValueError(f"key {key[:40]!r} stands twice")
            found[key] = inner.text()
        return found


def parse_schema(body: memoryview) -> Schema:
    """Raises ValueError when the lengths in it don't fit or a name is no UTF-8."""
    fields = _Fields(body)
    number = fields.number(_U16)
    name, encoding = fields.text(), fields.text()
    data = bytes(fields.blob(fields.number(_U32)))
    return Schema(id=number, name=name, encoding=encoding, data=data)


def parse_channel(body: memoryview) -> Channel:
    """Raises ValueError when the lengths in it don't fit or a text is no UTF-8."""
    fields = _Fields(body)
    number, schema_id = fields.number(_U16), fields.number(_U16)
    topic, encoding = fields.text(), fields.text()
    return Channel(number, topic, encoding, fields.texts(), schema_id)


def parse_message(body: memoryview) -> Message:
    """Raises ValueError when it is too short."""
    if len(body) < _MESSAGE.size:
        raise ValueError(f"a message of {len(body)} bytes")
    channel_id, sequence, log_time, publish_time = _MESSAGE.unpack_from(body)
    return Message(channel_id, log_time, bytes(body[_MESSAGE.size :]), publish_time, sequence)


def parse_attachment_body(body: memoryview) -> Attachment:
    """An attachment with its CRC checked; raises ValueError when that or a length is wrong."""
    fields = _Fields(body)
    log_time, create_time = fields.number(_U64), fields.number(_U64)
    name, media_type = fields.text(), fields.text()
    data = fields.blob(fields.number(_U64))
    crc = fields.number(_U32)
    if crc and crc32(body[: len(body) - _U32.size]) != crc:
        raise ValueError("an attachment's CRC is wrong")
    return Attachment(create_time, log_time, name, media_type, bytes(data))


def attachment_fits(head: bytes, length: int) -> bool:
    """Whether the first bytes of a record's body could be those of an attachment that long."""
    fields = _Fields(memoryview(head))
    try:
        fields.blob(2 * _U64.size)
        for _ in range(2):
            fields.text()
        return fields.number(_U64) + _U32.size == length - fields.at
    except ValueError:
        return False


KNOWN = frozenset(int(opcode) for opcode in Opcode)


FOOTER_BYTES = 1 + 8 + 8 + 8 + 4
RECORD_HEAD_BYTES = 1 + 8
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
    """Turns what damaged bytes raise into an InputError that names the file."""
    try:
        yield
    except DAMAGE as error:
        raise damaged(path, error) from error
    except OSError as error:
        raise InputError(f"can't be read: {error.strerror or error}", file=path) from error


def damaged(path: Path, error: Exception) -> InputError:
    """What to raise for a file whose bytes raised one of DAMAGE."""
    text = str(error) or type(error).__name__
    return InputError(f"is damaged: {text}", file=path, remedy=REPAIR)


def open_bounded(path: Path) -> BoundedFile:
    """Opens a file.

    Raises:
        InputError: it can't be opened, or is no file.
    """
    if path.exists() and not path.is_file():  # a pipe would wait for somebody to write into it
        raise InputError("is no file", file=path)
    try:
        return BoundedFile(path)
    except OSError as error:
        raise InputError(f"can't be read: {error.strerror}", file=path) from error


def read_summary(stream: BoundedFile, path: Path) -> Summary:
    """The summary section of a closed MCAP file, with its CRC checked.

    Raises:
        InputError: no MCAP file, not closed, without a summary, or damaged.
    """
    head = stream.read(len(MCAP0_MAGIC))
    if head != MCAP0_MAGIC:
        raise InputError("is no MCAP file", file=path)
    tail_bytes = FOOTER_BYTES + len(MCAP0_MAGIC)
    stream.seek(max(0, stream.size - tail_bytes))
    tail = stream.read(tail_bytes)
    if len(tail) < tail_bytes or not tail.endswith(MCAP0_MAGIC) or tail[0] != Opcode.FOOTER:
        raise InputError("was not closed by its recorder, or is cut off", file=path, remedy=REPAIR)
    summary_start, _, crc = struct.unpack_from("<QQI", tail, RECORD_HEAD_BYTES)
    if not len(MCAP0_MAGIC) <= summary_start <= stream.size - tail_bytes:
        raise InputError("has no summary section", file=path, remedy=REPAIR)
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

    Args:
        path: the file.

    Raises:
        InputError: it can't be opened, is no closed MCAP file or its summary is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        with open_bounded(path) as stream:
            self.summary = read_summary(stream, path)

    def read_at(self, offset: int, length: int) -> bytes:
        """Bytes from the middle of the file.

        Raises:
            InputError: the file can't be read.
            ValueError: it ends before.
        """
        with open_bounded(self.path) as stream:
            if offset + length > stream.size:
                raise ValueError(f"an index points beyond the end, to {length} bytes at {offset}")
            stream.seek(offset)
            return stream.read(length)

    def attachment(self, name: str) -> bytes | None:
        """The data of the first attachment of that name, with its CRC checked.

        Raises:
            InputError: it is damaged.
        """
        for index in self.summary.attachment_indexes:
            if index.name == name:
                with damage_of(self.path):
                    return parse_attachment(self.read_at(index.offset, index.length)).data
        return None


def framed_records(stream: BoundedFile) -> Iterator[tuple[int, bytes]]:
    """Offset and bytes of each record from the beginning of a file, whole ones only.

    Raises:
        ValueError: the file ends within a record, after the whole ones were given.
    """
    offset = stream.seek(len(MCAP0_MAGIC))
    while offset < stream.size:
        head = stream.read(RECORD_HEAD_BYTES)
        if len(head) < RECORD_HEAD_BYTES:
            raise ValueError("the file ends within a record")
        length = struct.unpack_from("<Q", head, 1)[0]
        if offset + RECORD_HEAD_BYTES + length > stream.size:
            raise ValueError("the file ends within a record")
        yield offset, head + stream.read(length)
        offset += RECORD_HEAD_BYTES + length
        stream.seek(offset)


def parse_attachment(raw: bytes) -> Attachment:
    """An attachment from its framed record.

    Raises:
        ValueError: it is none, or its CRC is wrong.
    """
    if raw[:1] != bytes([Opcode.ATTACHMENT]):
        raise ValueError("no attachment where one should be")
    body = raw[RECORD_HEAD_BYTES:]
    crc = struct.unpack("<I", body[-4:])[0]
    if crc and crc32(body[:-4]) != crc:
        raise ValueError("an attachment's CRC is wrong")
    attachment: Attachment = Attachment.read(ReadDataStream(io.BytesIO(body)))
    return attachment
