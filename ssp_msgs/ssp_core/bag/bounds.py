"""What a reader of bags believes: limits for files from elsewhere, and chunks unpacked within them.

A file may claim any length, and a few kilobytes can unpack to gigabytes. Lengths are compared with
what is there before anything is read or made, and what a chunk unpacks to is bounded by what it
claims, which is bounded here.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import zstandard
from isal.isal_zlib import crc32
from mcap.summary import Summary

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
# Read as a whole.
MAX_ATTACHMENT_BYTES = 1 << 30
# Any other record: a schema, a channel, an index of a chunk's messages, a message outside chunks.
MAX_RECORD_BYTES = MAX_CHUNK_BYTES + (64 << 10)
# Message definitions of one file: 200 types of 20 kB are 4 MB. Parsing takes 10 us per byte.
MAX_SCHEMAS_BYTES = 16 << 20

_CHUNK_HEAD = struct.Struct("<QQQII")
_INDEX_ENTRY_BYTES = 16
_U64 = struct.Struct("<Q")
_PIECE = 1 << 20


class UnpackBudget:
    """How much the chunks of one file may unpack to, all together.

    Args:
        file_bytes: size of the file.
        ratio: how many times as much they may unpack to.
    """

    def __init__(self, file_bytes: int, *, ratio: int = MAX_RATIO) -> None:
        self._most = self._left = ANY_TOTAL_BYTES + ratio * file_bytes

    def take(self, unpacked_bytes: int) -> None:
        """Raises ValueError when the file's chunks unpack to more than is believed."""
        self._left -= unpacked_bytes
        if self._left < 0:
            raise ValueError(f"its chunks unpack to more than {self._most} bytes")


class ChunkParts(NamedTuple):
    """The fields of a Chunk record; data is a view of the record's bytes."""

    start_ns: int
    end_ns: int
    unpacked_bytes: int
    crc: int
    compression: str
    data: memoryview


def chunk_parts(body: bytes | memoryview) -> ChunkParts:
    """The fields of a Chunk record, from its bytes after opcode and length.

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
    """How long a chunk's body is by the first bytes of it, None when they are too few."""
    if len(head) < _CHUNK_HEAD.size:
        return None
    *_, name_bytes = _CHUNK_HEAD.unpack_from(head)
    data_at = _CHUNK_HEAD.size + name_bytes + _U64.size
    if data_at > len(head):
        return None
    return int(data_at + _U64.unpack_from(head, data_at - _U64.size)[0])


def head_fits(head: bytes, length: int) -> bool:
    """Whether the first bytes of a record's body could be those of a chunk of that length."""
    return chunk_length(head) == length


def check_claim(compression: str, unpacked_bytes: int, packed_bytes: int) -> None:
    """Refuses a chunk by what it claims, before anything of it is unpacked.

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
    """What a chunk holds, with its CRC checked.

    Raises:
        ValueError: it doesn't unpack to what it claims, or its CRC is wrong.
    """
    data = unpack(parts.compression, parts.data, parts.unpacked_bytes)
    if parts.crc and crc32(data) != parts.crc:
        raise ValueError("crc validation failed in a chunk")
    return data


def unpack(compression: str, data: memoryview, unpacked_bytes: int) -> memoryview:
    """Compressed bytes unpacked; never more than was claimed, nor more at once than is there.

    Raises:
        ValueError: they don't unpack, or to another number of bytes.
    """
    check_claim(compression, unpacked_bytes, len(data))
    if not compression:
        return data
    try:
        unpacked = (_unzstd if compression == "zstd" else _unlz4)(data, unpacked_bytes)
    except (zstandard.ZstdError, RuntimeError, EOFError) as error:
        raise ValueError(f"a chunk doesn't unpack: {error}") from error
    if len(unpacked) != unpacked_bytes:
        what = "more" if len(unpacked) > unpacked_bytes else "less"
        raise ValueError(f"a chunk unpacks to {what} than the {unpacked_bytes} bytes it claims")
    return memoryview(unpacked)


def _unzstd(data: memoryview, most: int) -> bytearray:
    """At most one piece more than ``most``; the frame's own claims are not looked at."""
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
        raise ValueError("a chunk ends within its compressed data")
    if decompressor.unused_data:
        raise ValueError("a chunk goes on after its compressed data")
    return unpacked


def check_summary(summary: Summary, data_end: int, file_bytes: int) -> None:
    """Refuses indexes that would make a reader read a place twice, or beyond the data.

    Args:
        summary: as parsed.
        data_end: where the data section ends and the summary begins.
        file_bytes: size of the file.

    Raises:
        ValueError: which index, and what is wrong with it.
    """
    chunks = summary.chunk_indexes
    _check_places(
        "chunk",
        ((c.chunk_start_offset, c.chunk_length + c.message_index_length) for c in chunks),
        data_end,
    )
    budget = UnpackBudget(file_bytes)
    for chunk in chunks:
        budget.take(chunk.uncompressed_size)
        check_claim(chunk.compression, chunk.uncompressed_size, chunk.compressed_size)
        if chunk.compressed_size > chunk.chunk_length:
            raise ValueError(f"the chunk at byte {chunk.chunk_start_offset} has no such length")
        if chunk.message_index_length > _INDEX_ENTRY_BYTES * MAX_CHUNK_RECORDS:
            raise ValueError(
                f"the chunk at byte {chunk.chunk_start_offset} has more than {MAX_CHUNK_RECORDS} "
                "messages"
            )
    _check_places(
        "attachment", ((a.offset, a.length) for a in summary.attachment_indexes), data_end
    )
    for index in summary.attachment_indexes:
        if index.length > MAX_ATTACHMENT_BYTES:
            raise ValueError(
                f"attachment {index.name[:80]!r} has {index.length} bytes, "
                f"more than {MAX_ATTACHMENT_BYTES} are not read"
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
