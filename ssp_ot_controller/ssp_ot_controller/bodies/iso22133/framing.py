"""Frames of ISO 22133: header, items, checksum, and their recovery from a stream of bytes.

All numbers are little-endian. A frame is a header of 18 bytes (sync word, payload's length,
acknowledge request and version, transmitter, receiver, counter, message), a payload of items (value
id, length, content), and a CRC-16 (polynomial 0x1021, start 0) over header and payload. Only wire
version 2 is public; any other version is refused.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum

SYNC = b"\x7f\x7e"
VERSION = 2
TCP_PORT = 53241
UDP_PORT = 53240
# An id that isn't known yet.
NO_ID = 0xFFFF_FFFF
# The control centre's id, and that of a receiver that isn't known.
CENTRE_ID = 0

# Sync word, payload's length, acknowledge request and version, transmitter, receiver, counter,
# message.
_HEADER = struct.Struct("<2sIBIIBH")
_ITEM = struct.Struct("<HH")
_CRC = struct.Struct("<H")
HEADER_BYTES = _HEADER.size
FRAME_BYTES = _HEADER.size + _CRC.size
_ACKNOWLEDGE = 0x80
# Payloads that are expected of an object, and of a centre that sends trajectories.
LONGEST_PAYLOAD_BYTES = 4096
LONGEST_TRAJECTORY_BYTES = 1 << 20
# Of damaged bytes, so many are kept as evidence.
EVIDENCE_BYTES = 64


class Reason(Enum):
    """The reason why bytes are refused."""

    SYNC = "sync word"
    VERSION = "version"
    LENGTH = "length"
    CHECKSUM = "checksum"
    MESSAGE = "message id"
    ITEM = "item"
    MISSING = "missing value"
    ORDER = "order"


@dataclass(frozen=True, slots=True)
class RejectedBytes:
    """Bytes that are not taken.

    Args:
        evidence: the first of them, at most EVIDENCE_BYTES.
    """

    reason: Reason
    text: str
    evidence: bytes = b""


@dataclass(frozen=True, slots=True)
class Header:
    """The header of every message.

    Args:
        message_id: 16 bits; see ``messages.MessageId``.
        transmitter_id: 32 bits, NO_ID until an object has been given one.
        receiver_id: 32 bits.
        counter: 8 bits, counts the messages that a transmitter sends.
        acknowledge: the receiver is asked for a GREM.
    """

    message_id: int
    transmitter_id: int = CENTRE_ID
    receiver_id: int = CENTRE_ID
    counter: int = 0
    acknowledge: bool = False


@dataclass(frozen=True, slots=True)
class Frame:
    """An unbroken frame.

    Args:
        data: all of its bytes, as they came.
    """

    header: Header
    data: bytes

    @property
    def payload(self) -> bytes:
        return self.data[_HEADER.size : -_CRC.size]


@dataclass(frozen=True, slots=True)
class Item:
    """One part of a payload."""

    value_id: int
    content: bytes


def pack_frame(header: Header, payload: bytes) -> bytes:
    """Return the bytes of a frame.

    Raises:
        ValueError: a number is larger than its field.
    """
    version = VERSION | (_ACKNOWLEDGE if header.acknowledge else 0)
    try:
        head = _HEADER.pack(
            SYNC,
            len(payload),
            version,
            header.transmitter_id,
            header.receiver_id,
            header.counter,
            header.message_id,
        )
    except struct.error as error:
        raise ValueError(f"{header}: {error}") from None
    body = head + payload
    return body + _CRC.pack(crc_hqx(body, 0))


def pack_items(items: Iterable[Item]) -> bytes:
    """Return the bytes of a payload.

    Raises:
        ValueError: a content is longer than 65,535 bytes.
    """
    parts: list[bytes] = []
    for item in items:
        if len(item.content) > 0xFFFF:
            raise ValueError(f"item 0x{item.value_id:04X} has {len(item.content)} bytes")
        parts += _ITEM.pack(item.value_id, len(item.content)), item.content
    return b"".join(parts)


def items_of(payload: bytes) -> tuple[Item, ...] | RejectedBytes:
    """Return the items of a payload in their order."""
    items: list[Item] = []
    at = 0
    while at < len(payload):
        start = at + _ITEM.size
        if start > len(payload):
            return RejectedBytes(
                Reason.ITEM, f"ends {start - len(payload)} bytes before its length"
            )
        value_id, size = _ITEM.unpack_from(payload, at)
        at = start + size
        if at > len(payload):
            text = f"item 0x{value_id:04X} says {size} bytes, {len(payload) - start} are left"
            return RejectedBytes(Reason.ITEM, text, payload[start - _ITEM.size :][:EVIDENCE_BYTES])
        items.append(Item(value_id, payload[start:at]))
    return tuple(items)


class StreamDecoder:
    """Frames out of bytes that come in pieces of any size, and may be damaged.

    After damage it goes on at the next sync word from which a whole frame with a fitting checksum
    can be read. It keeps no more bytes than the longest frame has.

    Args:
        longest_payload_bytes: a header that states more is taken for damage. What comes from a
            control centre needs LONGEST_TRAJECTORY_BYTES.

    Attributes:
        rejected: how many headers or checksums were not taken, by their reason.
        skipped_bytes: how many bytes belonged to no frame.
    """

    def __init__(self, longest_payload_bytes: int = LONGEST_PAYLOAD_BYTES) -> None:
        self.rejected: Counter[Reason] = Counter()
        self.skipped_bytes = 0
        self._longest = longest_payload_bytes
        self._buffer = bytearray()
        self._in_sync = True

    @property
    def waiting_bytes(self) -> int:
        """Bytes of a frame that isn't complete."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[Frame | RejectedBytes]:
        """Return the frames that these bytes complete, and each loss of synchronisation, in order.

        A loss is reported once, with what was found first; what follows it is counted.
        """
        self._buffer += data
        return self._scan(0)

    def resync(self) -> list[Frame | RejectedBytes]:
        """Give up the frame that is waited for, and look for others in what there is.

        For callers with a clock: a damaged length may announce more bytes than will ever come.
        """
        if not self._buffer:
            return []
        text = f"incomplete with {len(self._buffer)} bytes"
        lost = self._lose(Reason.LENGTH, text, 0)
        self.skipped_bytes += 1
        return [*lost, *self._scan(1)]

    def _scan(self, at: int) -> list[Frame | RejectedBytes]:
        outcomes: list[Frame | RejectedBytes] = []
        buffer = self._buffer
        while True:
            start = self._next_sync(at)
            if start > at:
                outcomes += self._lose(Reason.SYNC, f"{start - at} bytes without a sync word", at)
                self.skipped_bytes += start - at
                at = start
            outcome = self._read(at)
            if outcome is None:
                del buffer[:at]
                return outcomes
            if isinstance(outcome, Frame):
                self._in_sync = True
                outcomes.append(outcome)
                at += len(outcome.data)
            else:
                outcomes += self._lose(outcome.reason, outcome.text, at)
                self.skipped_bytes += len(SYNC)
                at += len(SYNC)

    def _next_sync(self, at: int) -> int:
        """Find where the next sync word begins, or may begin with bytes to come."""
        start = self._buffer.find(SYNC, at)
        if start >= 0:
            return start
        end = len(self._buffer)
        return end - 1 if end > at and self._buffer[-1] == SYNC[0] else end

    def _read(self, at: int) -> Frame | RejectedBytes | None:
        """Read the frame that begins at a sync word; None when it isn't complete."""
        buffer = self._buffer
        if len(buffer) - at < _HEADER.size:
            return None
        fields = _HEADER.unpack_from(buffer, at)
        _, size, version, transmitter_id, receiver_id, counter, message_id = fields
        if version & ~_ACKNOWLEDGE != VERSION:
            text = f"version {version & ~_ACKNOWLEDGE}, only {VERSION} is known"
            return RejectedBytes(Reason.VERSION, text)
        if size > self._longest:
            return RejectedBytes(Reason.LENGTH, f"says {size} bytes, limit is {self._longest}")
        end = at + _HEADER.size + size
        if len(buffer) < end + _CRC.size:
            return None
        data = bytes(buffer[at : end + _CRC.size])
        (stated,) = _CRC.unpack_from(data, len(data) - _CRC.size)
        crc = crc_hqx(data[: -_CRC.size], 0)
        if stated != crc:
            text = f"message 0x{message_id:04X} states 0x{stated:04X}, its bytes give 0x{crc:04X}"
            return RejectedBytes(Reason.CHECKSUM, text)
        acknowledge = bool(version & _ACKNOWLEDGE)
        header = Header(message_id, transmitter_id, receiver_id, counter, acknowledge)
        return Frame(header, data)

    def _lose(self, reason: Reason, text: str, at: int) -> list[RejectedBytes]:
        self.rejected[reason] += 1
        if not self._in_sync:
            return []
        self._in_sync = False
        return [RejectedBytes(reason, text, bytes(self._buffer[at : at + EVIDENCE_BYTES]))]


def frames_of(datagram: bytes) -> list[Frame | RejectedBytes]:
    """Return the frames of one datagram; what is left at its end is a rejected one."""
    decoder = StreamDecoder()
    frames = decoder.feed(datagram)
    while decoder.waiting_bytes:
        frames += decoder.resync()
    return frames
