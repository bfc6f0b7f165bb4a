"""Finds the records of an MCAP file from its first byte on, past places that are damaged."""

from __future__ import annotations

import re
import struct
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.bounds import (
    MAX_ATTACHMENT_BYTES,
    MAX_RECORD_BYTES,
    chunk_parts,
    head_fits,
)
from ssp_core.bag.mcap_file import BoundedFile
from ssp_core.bag.records import HEAD, KNOWN

_PRIVATE = 0x80  # opcodes from here on are anybody's
_DATA_END = struct.Struct("<BQI")
_FOOTER = struct.Struct("<BQQQI")
_PIECE = 1 << 20
_FIRST_PIECE = 512  # of a search: what is looked for mostly stands near
# A chunk's first bytes: lengths below 4 GiB, the compression's name of 0, 3 or 4 letters.
_CHUNK_BEGIN = re.compile(
    rb"(?=\x06.{4}\x00{4}.{16}.{4}\x00{4}.{4}[\x00\x03\x04]\x00{3})", re.DOTALL
)
_CHUNK_BEGIN_BYTES = 41
_CHUNK_HEAD_BYTES = 44  # fields before the data, with the longest name of a compression


class Frame(NamedTuple):
    """Where a record stands: kind, offset of its first byte, bytes after opcode and length."""

    opcode: int
    offset: int
    length: int

    @property
    def end(self) -> int:
        return self.offset + HEAD.size + self.length


class Gap(NamedTuple):
    """A place where no record begins, and where the next one was found (None: nowhere)."""

    offset: int
    why: str
    next_offset: int | None


def read_frame(stream: BoundedFile, offset: int) -> Frame:
    """The record that begins at an offset.

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
    limit = MAX_RECORD_BYTES if opcode != Opcode.ATTACHMENT else MAX_ATTACHMENT_BYTES
    # What isn't known is passed over and never read.
    if length > limit and opcode in KNOWN:
        raise ValueError(f"a record of {length} bytes, more than {limit} are not read")
    return Frame(opcode, offset, length)


def read_body(stream: BoundedFile, frame: Frame) -> memoryview:
    """The bytes of a record after opcode and length."""
    stream.seek(frame.offset + HEAD.size)
    return memoryview(stream.read(frame.length))


def data_crc(stream: BoundedFile) -> bool | None:
    """Whether the CRC over all data of a closed file is right.

    Returns:
        None: the file has none, or was not closed.
    """
    tail_at = stream.size - _FOOTER.size - len(MCAP0_MAGIC)
    if tail_at < len(MCAP0_MAGIC) + _DATA_END.size:
        return None
    stream.seek(tail_at)
    opcode, _, summary_start, _, _ = _FOOTER.unpack(stream.read(_FOOTER.size))
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


class Walk:
    """Records of a file in order; after a damaged place it goes on at the next whole chunk.

    What is looked at in vain while searching is bounded by twice the size of the file, so that
    no file takes more time than in proportion to its size.

    Args:
        stream: the file.
        known: offsets at which records begin, from the file's own index; empty without one.
    """

    def __init__(self, stream: BoundedFile, known: Sequence[int] = ()) -> None:
        self._stream = stream
        self._known = sorted(known)
        self._budget = 2 * stream.size
        self._doubt: Frame | None = None

    def __iter__(self) -> Iterator[Frame | Gap]:
        offset = len(MCAP0_MAGIC)
        while offset < self._stream.size:
            try:
                frame = read_frame(self._stream, offset)
            except ValueError as error:
                gap = Gap(offset, str(error), self._next_record(offset + 1))
            else:
                yield frame
                offset = frame.end
                if not self._doubted(frame) or self._plausible(offset):
                    continue
                why = "the damaged record's length is wrong too"
                gap = Gap(offset, why, self._next_record(frame.offset + 1))
            yield gap
            if gap.next_offset is None:
                return
            offset = gap.next_offset

    def doubt(self, frame: Frame) -> None:
        """The record just given is damaged: perhaps in its length."""
        self._doubt = frame

    def _doubted(self, frame: Frame) -> bool:
        return self._doubt == frame

    def _plausible(self, offset: int) -> bool:
        try:
            read_frame(self._stream, offset)
        except ValueError:
            return False
        return True

    def _next_record(self, start: int) -> int | None:
        """Where the next record begins that the index names, or the next chunk."""
        place = bisect_left(self._known, start)
        indexed = self._known[place] if place < len(self._known) else None
        for offset in self._chunk_begins(start, indexed or self._stream.size):
            if self._is_chunk(offset):
                return offset
        return indexed

    def _chunk_begins(self, start: int, stop: int) -> Iterator[int]:
        """Offsets of what looks like the first bytes of a chunk."""
        at, size = start, _FIRST_PIECE
        while at < stop:
            size = min(size, stop - at)
            self._stream.seek(at)
            piece = self._stream.read(size + _CHUNK_BEGIN_BYTES)
            for found in _CHUNK_BEGIN.finditer(piece):
                if found.start() < size:
                    yield at + found.start()
            at += size
            size = min(2 * size, _PIECE)

    def _is_chunk(self, offset: int) -> bool:
        """Whether a chunk begins there: a right CRC, or for a packed one a record behind it."""
        try:
            frame = read_frame(self._stream, offset)
            self._stream.seek(offset + HEAD.size)
            if not head_fits(self._stream.read(_CHUNK_HEAD_BYTES), frame.length):
                return False
            if frame.length > self._budget:
                return False
            self._budget -= frame.length
            parts = chunk_parts(read_body(self._stream, frame))
        except ValueError:
            return False
        if parts.compression:  # its CRC is of what it unpacks to, which is looked at later
            return self._plausible(frame.end)
        return bool(parts.crc) and crc32(parts.data) == parts.crc
