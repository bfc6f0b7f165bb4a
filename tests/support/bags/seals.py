"""Edits of bags by somebody who mends the checksums and doesn't know of the seal."""

from __future__ import annotations

import struct

from isal.isal_zlib import crc32
from mcap.opcode import Opcode


def with_checksums(data: bytearray) -> bytes:
    """The bytes of a file with all its checksums, and the place of its summary, mended."""
    offset = 8
    while data[offset] != Opcode.DATA_END:
        length = int.from_bytes(data[offset + 1 : offset + 9], "little")
        if data[offset] == Opcode.CHUNK:
            crc = crc32(data[offset + 49 : offset + 9 + length])
            data[offset + 33 : offset + 37] = crc.to_bytes(4, "little")
        elif data[offset] == Opcode.ATTACHMENT:
            crc = crc32(data[offset + 9 : offset + 9 + length - 4])
            data[offset + 9 + length - 4 : offset + 9 + length] = crc.to_bytes(4, "little")
        offset += 9 + length
    struct.pack_into("<Q", data, len(data) - 28, offset + 13)
    data[offset + 9 : offset + 13] = crc32(data[:offset]).to_bytes(4, "little")
    crc = crc32(data[offset + 13 : len(data) - 12])
    data[len(data) - 12 : len(data) - 8] = crc.to_bytes(4, "little")
    return bytes(data)
