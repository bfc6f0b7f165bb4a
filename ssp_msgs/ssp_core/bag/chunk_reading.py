"""Chunks of an MCAP file being read: what they hold, and which messages are where."""

from __future__ import annotations

import struct
from collections.abc import Collection
from typing import TypeAlias

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import ChunkIndex

from ssp_core.bag.bounds import chunk_parts, unpack
from ssp_core.bag.chunk import INDEX_ENTRY_BYTES, INDEX_HEAD, MESSAGE_BODY_BYTES, MESSAGE_HEAD
from ssp_core.bag.records import HEAD, inner_records

_ENTRY = struct.Struct("<QQ")

# A message's log time, and where it begins in what its chunk holds.
Entry: TypeAlias = tuple[int, int]


def chunk_content(record: memoryview) -> memoryview:
    """What a chunk holds, with its CRC checked.

    Args:
        record: the Chunk record with opcode and length.

    Raises:
        ValueError: it is damaged, too large, or compressed in a way that is not read here.
    """
    if len(record) < HEAD.size or HEAD.unpack_from(record) != (
        Opcode.CHUNK,
        len(record) - HEAD.size,
    ):
        raise ValueError("no chunk where the index has one")
    parts = chunk_parts(record[HEAD.size :])
    content = unpack(parts.compression, parts.data, parts.unpacked_bytes)
    if parts.crc and crc32(content) != parts.crc:
        raise ValueError("crc validation failed in a chunk")
    return content


def indexed_entries(region: bytes, index: ChunkIndex, channels: Collection[int]) -> list[Entry]:
    """Messages of some channels in a chunk, from the MessageIndex records behind it.

    Args:
        region: these records, all of them.
        index: of the chunk.
        channels: the channels wanted.

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
        opcode, length, found, size = INDEX_HEAD.unpack_from(region, at)
        begin = at + INDEX_HEAD.size
        if (
            opcode != Opcode.MESSAGE_INDEX
            or found != channel
            or length != size + 6
            or size % INDEX_ENTRY_BYTES
            or size > len(region) - begin
        ):
            raise ValueError(f"the message index of channel {channel} is damaged")
        entries += _ENTRY.iter_unpack(region[begin : begin + size])
    return entries


def scanned_entries(content: memoryview, channels: Collection[int]) -> list[Entry]:
    """Messages of some channels in a chunk that has no message index.

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
