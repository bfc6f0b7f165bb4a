"""What lies in an MCAP file without an index of its chunks, from one pass through it."""

from __future__ import annotations

import struct
from array import array
from collections import Counter
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field

import numpy as np
from isal.isal_zlib import crc32
from mcap.opcode import Opcode
from mcap.records import ChunkIndex
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.chunk import MESSAGE_HEAD
from ssp_core.bag.chunk_reading import Entry
from ssp_core.bag.mcap_file import RECORD_HEAD_BYTES, BoundedFile, framed_records


@dataclass(slots=True)
class Scan:
    """Chunks, and the messages outside chunks: per message 18 bytes, whatever its size."""

    chunks: list[ChunkIndex] = field(default_factory=list)
    times_ns: array[int] = field(default_factory=lambda: array("Q"))
    offsets: array[int] = field(default_factory=lambda: array("Q"))
    channels: array[int] = field(default_factory=lambda: array("H"))

    def entries(
        self, channels: Collection[int], start_ns: int | None, stop_ns: int | None
    ) -> Iterator[Entry]:
        """Log time and offset in the file of messages outside chunks, in order of both."""
        times = np.frombuffer(self.times_ns, dtype=np.uint64)
        wanted = np.isin(np.frombuffer(self.channels, dtype=np.uint16), list(channels))
        if start_ns is not None:
            wanted &= times >= max(0, start_ns)
        if stop_ns is not None:
            wanted &= times < max(0, stop_ns)
        which = np.flatnonzero(wanted)
        for at in which[np.argsort(times[which], kind="stable")]:
            yield self.times_ns[at], self.offsets[at]

    def counts(self) -> Counter[int]:
        """Messages outside chunks by channel."""
        return Counter(self.channels)


def scan(stream: BoundedFile) -> Scan:
    """Goes through a file from its beginning to the end of its data.

    Raises:
        ValueError: the file is cut off, or the CRC of its data is wrong.
        struct.error: a record is shorter than its kind.
    """
    found = Scan()
    crc = crc32(MCAP0_MAGIC)
    for offset, raw in framed_records(stream):
        if raw[0] == Opcode.DATA_END:
            (expected,) = struct.unpack_from("<I", raw, RECORD_HEAD_BYTES)
            if expected and expected != crc:
                raise ValueError("the CRC of the data is wrong")
            return found
        crc = crc32(raw, crc)
        if raw[0] == Opcode.MESSAGE:
            _, _, channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(raw)
            found.times_ns.append(log_time_ns)
            found.offsets.append(offset)
            found.channels.append(channel)
        elif raw[0] == Opcode.CHUNK:
            start_ns, end_ns, size = struct.unpack_from("<QQQ", raw, RECORD_HEAD_BYTES)
            found.chunks.append(
                ChunkIndex(
                    chunk_length=len(raw),
                    chunk_start_offset=offset,
                    compression="",
                    compressed_size=0,
                    message_end_time=end_ns,
                    message_index_length=0,
                    message_index_offsets={},
                    message_start_time=start_ns,
                    uncompressed_size=size,
                )
            )
    raise ValueError("the data has no end")
