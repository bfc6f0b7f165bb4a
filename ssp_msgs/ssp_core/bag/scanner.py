"""Finds the records of an MCAP file from its first byte on, past places that are damaged."""

from __future__ import annotations

import re
import struct
from bisect import bisect_left
from collections.abc import Callable, Iterator, Sequence
from typing import NamedTuple

from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.mcap_file import (
    HEAD,
    KNOWN,
    BoundedFile,
    RecordFrame,
    attachment_fits,
    chunk_length,
    chunk_parts,
    inner_records,
    read_body,
    read_frame,
)

_INDEX = struct.Struct("<HI")  # a MessageIndex: channel, and bytes of the entries that follow
_U16 = struct.Struct("<H")
_PIECE = 1 << 20
_FIRST_PIECE = 512  # of a search: what is looked for mostly stands near
# A chunk's first bytes: lengths below 4 GiB, the compression's name of 0, 3 or 4 letters.
_CHUNK_BEGIN = re.compile(
    rb"(?=\x06.{4}\x00{4}.{16}.{4}\x00{4}.{4}[\x00\x03\x04]\x00{3})", re.DOTALL
)
_CHUNK_BEGIN_BYTES = 41
_ATTACHMENT_HEAD_BYTES = 4096  # its names stand in these
_CHUNK_HEAD_BYTES = 44  # fields before the data, with the longest name of a compression


class DamagedSpan(NamedTuple):
    """A place where no record begins, and where the next one was found (None: nowhere)."""

    offset: int
    why: str
    next_offset: int | None


class RecordScanner:
    """Records of a file in order; after a damaged place it goes on at the next whole chunk.

    What is looked at in vain while searching is bounded by twice the size of the file, so that
    no file takes more time than in proportion to its size.

    Args:
        known: offsets at which records begin, from the file's own index; empty without one.
        knows: whether a channel of that number was seen.
    """

    def __init__(
        self,
        stream: BoundedFile,
        known: Sequence[int] = (),
        knows: Callable[[int], bool] = lambda _: False,
    ) -> None:
        self._stream = stream
        self._knows = knows
        self._known = sorted(known)
        self._budget = 2 * stream.size
        self._doubt: RecordFrame | None = None

    def __iter__(self) -> Iterator[RecordFrame | DamagedSpan]:
        offset = len(MCAP0_MAGIC)
        while offset < self._stream.size:
            try:
                frame = read_frame(self._stream, offset)
            except ValueError as error:
                gap = DamagedSpan(offset, str(error), self._behind(offset))
            else:
                yield frame
                offset = frame.end
                if not self._doubted(frame) or self._continues(offset):
                    continue
                why = "the damaged record's length is wrong too"
                gap = DamagedSpan(offset, why, self._behind(frame.offset))
            yield gap
            if gap.next_offset is None:
                return
            offset = gap.next_offset

    def doubt(self, frame: RecordFrame) -> None:
        """The record just given is damaged: perhaps in its length."""
        self._doubt = frame

    def _doubted(self, frame: RecordFrame) -> bool:
        return self._doubt == frame

    def _behind(self, offset: int) -> int | None:
        """Where to go on behind a damaged record: at its end, where that can be told.

        A payload may itself hold an MCAP file, so a record is searched only when nothing else
        says where it ends.
        """
        for end in self._claimed_ends(offset):
            if end <= self._stream.size and self._continues(end):
                return end if end < self._stream.size else None
        if self._is_torn(offset):
            place = bisect_left(self._known, offset + 1)
            return self._known[place] if place < len(self._known) else None
        return self._next_record(offset + 1)

    def _head(self, offset: int) -> tuple[int, int, bytes] | None:
        """Opcode, claimed length and first bytes of what stands there."""
        self._stream.seek(offset)
        head = self._stream.read(HEAD.size + _CHUNK_HEAD_BYTES)
        if len(head) < HEAD.size:
            return None
        opcode, length = HEAD.unpack_from(head)
        return opcode, length, head[HEAD.size :]

    def _claimed_ends(self, offset: int) -> Iterator[int]:
        """Where a record says that it ends: by its length, and by that of a chunk's data."""
        found = self._head(offset)
        if found is not None:
            _, length, body = found
            yield offset + HEAD.size + length
            by_data = chunk_length(body)
            if by_data is not None:
                yield offset + HEAD.size + by_data

    def _is_torn(self, offset: int) -> bool:
        """Whether a sound record begins there that the end of the file has cut off."""
        found = self._head(offset)
        if found is None or offset + HEAD.size + found[1] <= self._stream.size:
            return False
        opcode, length, body = found
        if opcode == Opcode.CHUNK:
            return chunk_length(body) == length
        if opcode == Opcode.MESSAGE_INDEX:
            return len(body) >= _INDEX.size and _INDEX.unpack_from(body)[1] == length - _INDEX.size
        if opcode == Opcode.ATTACHMENT:
            self._stream.seek(offset + HEAD.size)
            return attachment_fits(self._stream.read(_ATTACHMENT_HEAD_BYTES), length)
        return False

    def _continues(self, offset: int) -> bool:
        """Whether the file ends there, or a record begins that another one follows."""
        if offset == self._stream.size or self._is_torn(offset):
            return True
        try:
            frame = read_frame(self._stream, offset)
            if frame.opcode not in KNOWN:
                return False
            if frame.opcode == Opcode.FOOTER or frame.end == self._stream.size:
                return True
            return self._is_torn(frame.end) or read_frame(self._stream, frame.end).opcode > 0
        except ValueError:
            return False

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
            if chunk_length(self._stream.read(_CHUNK_HEAD_BYTES)) != frame.length:
                return False
            if frame.length > self._budget:
                return False
            self._budget -= frame.length
            parts = chunk_parts(read_body(self._stream, frame))
        except ValueError:
            return False
        if parts.compression:  # its CRC is of what it unpacks to, which is looked at later
            return self._continues(frame.end)
        if not parts.crc or crc32(parts.data) != parts.crc:
            return False
        return self._is_ours(frame, parts.data)

    def _is_ours(self, frame: RecordFrame, data: memoryview) -> bool:
        """Whether its index follows, or else all its channels are known."""
        try:
            channels = {
                _U16.unpack_from(record.body)[0]
                for record in inner_records(data)
                if record.opcode == Opcode.MESSAGE and len(record.body) >= _U16.size
            }
        except ValueError:
            return False
        indexed, at = set(), frame.end
        while (found := self._head(at)) is not None and found[0] == Opcode.MESSAGE_INDEX:
            if len(found[2]) < _INDEX.size or self._is_torn(at):
                break
            indexed.add(_INDEX.unpack_from(found[2])[0])
            at += HEAD.size + found[1]
        return indexed == channels or all(map(self._knows, channels))
