"""Records of an MCAP file from their bytes: every length is held against what is there."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import Attachment, Channel, Message, Schema

from ssp_core.bag.bounds import MAX_CHUNK_RECORDS

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
