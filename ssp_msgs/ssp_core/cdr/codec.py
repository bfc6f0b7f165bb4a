"""CDR as rclpy sends it (XCDR1, little endian): what all hand-written codecs share.

A message is four bytes of encapsulation, then its fields in their order, each aligned to its own
size (8 at most) counted from the byte after the encapsulation. A string is its length in bytes with
the closing NUL (uint32), the UTF-8 text and the NUL. An array is its length (uint32) and its items.

A layout says the fields of a message in their order, a letter each: ``?BHIQd`` as in ``struct``,
``t`` a string, ``s`` a stamp in ns, ``m`` a std_msgs/Header in frame map, of which the stamp
counts. States, which come most often, have code of their own (``states``).

Padding is zero here; rclpy leaves in it what was in memory before, so that equal messages are equal
bytes only when these functions wrote them.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable
from functools import cache, lru_cache, wraps
from itertools import islice
from typing import Any, TypeVar

from ssp_core.clock import NS_PER_S, time_ns
from ssp_core.names import MAP_FRAME

ENCAPSULATION = b"\x00\x01\x00\x00"
START = len(ENCAPSULATION)
# Some middleware rounds a payload up to a multiple of four bytes.
_ROUNDING = 3
_SHORT = 64
# Ids, names and reasons.
MOST_TEXT = 4096
_U32 = struct.Struct("<I")
_STAMP = struct.Struct("<iI")

T = TypeVar("T")


def align4(at: int) -> int:
    """Return the first offset from ``at`` on where a 4-byte field may begin."""
    return (at + 3) & ~3


def align8(at: int) -> int:
    """Return the first offset from ``at`` on where an 8-byte field may begin."""
    return ((at + 3) & ~7) + 4


@cache
def _parts(layout: str) -> list[str]:
    """Return the layout's letters, with numbers that follow each other in one part."""
    return re.findall(r"[tsm]|[?BHIQd]+", layout)


@cache
def _numbers(letters: str, phase: int) -> struct.Struct:
    """Return the struct of numbers that follow each other, each aligned to its size.

    Args:
        letters: a format letter of ``struct`` for each number.
        phase: how far they begin behind a multiple of 8, counted from START.
    """
    form, at = "<", phase
    for letter in letters:
        size = struct.calcsize(letter)
        form += f"{-at % size}x{letter}"
        at += -at % size + size
    return struct.Struct(form)


# -- writing -----------------------------------------------------------------------------------


def u32_bytes(value: int) -> bytes:
    """Return a uint32; raise ValueError when the value is none."""
    try:
        return _U32.pack(value)
    except struct.error as error:
        raise ValueError(f"{value}: {error}") from None


def raw_text(text: str) -> bytes:
    """Return a string's UTF-8 without length and NUL.

    Raises:
        ValueError: a NUL in the text, or half a character.
    """
    raw = text.encode()
    if b"\0" in raw:
        raise ValueError(f"no message can carry a NUL inside a text: {text!r}")
    return raw


@lru_cache(maxsize=256)
def text_bytes(text: str) -> bytes:
    """Return a string as it stands at an aligned offset, without padding; raise as ``raw_text``."""
    raw = raw_text(text)
    return _U32.pack(len(raw) + 1) + raw + b"\0"


@lru_cache(maxsize=256)
def padded_text(text: str) -> bytes:
    """Encode as ``text_bytes``, up to the next multiple of 4.

    This is for a field of 4 bytes or more after it.
    """
    raw = text_bytes(text)
    return raw + bytes(-len(raw) % 4)


def stamp_bytes(stamp_ns: int) -> bytes:
    """Return a builtin_interfaces/Time; raise ValueError beyond its 32 bits of seconds."""
    try:
        return _STAMP.pack(*divmod(stamp_ns, NS_PER_S))
    except struct.error as error:
        raise ValueError(f"stamp {stamp_ns} ns: {error}") from None


_FRAME = padded_text(MAP_FRAME)
_WRITERS: dict[str, Callable[[Any], bytes]] = {
    "t": text_bytes,
    "s": stamp_bytes,
    "m": lambda stamp_ns: stamp_bytes(stamp_ns) + _FRAME,
}


def write(layout: str, values: Iterable[Any], at: int = START) -> bytes:
    """Return the fields as they stand in a message at an offset, with the padding before them.

    Raises:
        ValueError: what a field can't hold.
    """
    out, left = bytearray(), iter(values)
    try:
        for part in _parts(layout):
            writer = _WRITERS.get(part)
            if writer is None:
                numbers = _numbers(part, (at + len(out) - START) & 7)
                out += numbers.pack(*islice(left, len(part)))
            else:
                out += bytes(-(at + len(out)) & 3) + writer(next(left))
    except struct.error as error:
        raise ValueError(f"{layout} {values}: {error}") from None
    return bytes(out)


def fields_of(message: Any) -> list[Any]:
    """Return the fields of a dataclass with slots, in their order."""
    return [getattr(message, name) for name in message.__slots__]


# -- reading -----------------------------------------------------------------------------------


def read_u32(data: bytes, at: int) -> tuple[int, int]:
    """Return a uint32 at the next aligned offset, and the offset behind it."""
    at = (at + 3) & ~3
    return _U32.unpack_from(data, at)[0], at + 4


def read_stamp(data: bytes, at: int) -> tuple[int, int]:
    """Return a stamp in ns at the next aligned offset, and the offset behind it."""
    at = (at + 3) & ~3
    return time_ns(*_STAMP.unpack_from(data, at)), at + 8


def read_header(data: bytes, at: int) -> tuple[int, int]:
    """Return the stamp of a std_msgs/Header in ns, and the offset behind its frame_id."""
    stamp_ns, at = read_stamp(data, at)
    return stamp_ns, skip_text(data, at)


def read_text(data: bytes, at: int) -> tuple[str, int]:
    """Return a string at the next aligned offset, and the offset behind it.

    Raises:
        ValueError: it runs out of the message, isn't closed, or is no UTF-8.
    """
    at = (at + 3) & ~3
    return text_of(data, at + 4, _U32.unpack_from(data, at)[0])


def text_of(data: bytes, at: int, size: int) -> tuple[str, int]:
    """Return the string whose length was read already, and the offset behind it.

    It raises as ``read_text``.
    """
    end = at + size
    if size > MOST_TEXT:
        raise ValueError(f"a text of {size} bytes, at most {MOST_TEXT} are read")
    if end > len(data):
        raise ValueError(f"a text of {size} bytes in a message of {len(data)}")
    if size == 0:  # as other vendors may write an empty string
        return "", end
    if data[end - 1]:
        raise ValueError(f"a text that isn't closed: {data[at:end][:40]!r}")
    raw = data[at : end - 1]
    return _short_text(raw) if size <= _SHORT else _text(raw), end


def _text(raw: bytes) -> str:
    if b"\0" in raw:
        raise ValueError(f"a NUL inside a text: {raw[:40]!r}")
    return raw.decode()


# The same few names come again and again.
_short_text = lru_cache(maxsize=1024)(_text)


def skip_text(data: bytes, at: int) -> int:
    """Return the offset behind the string at the next aligned offset, whatever it says."""
    size, at = read_u32(data, at)
    if at + size > len(data):
        raise ValueError(f"a text of {size} bytes in a message of {len(data)}")
    return at + size


def read(layout: str, data: bytes, at: int) -> tuple[list[Any], int]:
    """Return the fields from an offset on, and the offset behind them.

    Raises:
        ValueError: a text or a stamp that is none.
        struct.error, IndexError: the message ends before.
    """
    values: list[Any] = []
    for part in _parts(layout):
        reader = _READERS.get(part)
        if reader is None:
            numbers = _numbers(part, (at - START) & 7)
            values += numbers.unpack_from(data, at)
            at += numbers.size
        else:
            value, at = reader(data, at)
            values.append(value)
    return values, at


_READERS: dict[str, Callable[[bytes, int], tuple[Any, int]]] = {
    "t": read_text,
    "s": read_stamp,
    "m": read_header,
}


def read_count(data: bytes, at: int, least: int) -> tuple[int, int]:
    """Return the length of an array at the next aligned offset, and the offset behind it.

    Args:
        data: of the whole message.
        at: offset from which the array is looked for.
        least: bytes that an item takes at the least; a length that can't fit isn't believed.
    """
    count, at = read_u32(data, at)
    if count * least > len(data) - at:
        raise ValueError(f"{count} items in {len(data) - at} bytes")
    return count, at


def check_start(data: bytes) -> None:
    """Raise ValueError for a message that isn't little-endian XCDR1."""
    if data[:2] != ENCAPSULATION[:2]:
        raise ValueError(f"encapsulation {bytes(data[:2]).hex()!r} instead of '0001'")


def decoder(read: Callable[[bytes, int], tuple[T, int]]) -> Callable[[bytes], T]:
    """Make a function that decodes whole messages out of one that reads the fields at an offset.

    The result raises ValueError for everything that is no such message, and nothing else.
    """

    @wraps(read)
    def decode(data: bytes) -> T:
        check_start(data)
        try:
            value, end = read(data, START)
        except (struct.error, IndexError) as error:
            raise ValueError(f"{len(data)} bytes are too few: {error}") from None
        if not 0 <= len(data) - end <= _ROUNDING:
            raise ValueError(f"the message has {len(data)} bytes, its fields {end}")
        return value

    return decode
