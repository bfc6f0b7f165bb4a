"""What a message definition in a bag may ask for, before code is generated from it.

rosbags turns a definition into Python source: every item of an array of messages becomes a line,
constant expressions are evaluated, types may name themselves. A definition from elsewhere is
therefore looked at first, as text and then as parsed types.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

from rosbags.interfaces import Nodetype
from rosbags.serde import SerdeError
from rosbags.serde.utils import SIZEMAP
from rosbags.typesys.store import Typestore

# Autoware's and PX4's largest definitions, with all that they use, stay below a tenth of these.
MAX_TEXT_BYTES = 512 << 10
MAX_TYPES = 1000
MAX_MEMBERS = 4096
MAX_DEPTH = 32
# Items of arrays of messages and strings, which become a line of code each; all together.
MAX_UNROLLED = 4096
# Items of one array of numbers: a message of 1 GiB could hold no more.
MAX_ARRAY = 1 << 30
# Memory for the Python objects of one message.
MAX_DECODED_BYTES = 2 << 30

# CPython 3.11: an object with its dict of fields, a field's value, a string's head.
_OBJECT_BYTES = 152
_FIELD_BYTES = 40
_STRING_BYTES = 64
_LEAST_STRING_BYTES = 5

# The grammar's expressions take exponential time in nested brackets, and shifts and products make
# numbers of any size. No definition that ROS generates holds any of these.
_IDL_TOKEN = re.compile(
    r'//[^\n]*|/\*.*?(?:\*/|\Z)|"(?:\\.|[^"\\])*"|(?P<operator><<|\*)|(?P<open>[(\[{<])'
    r"|(?P<close>[)\]}>])",
    re.DOTALL,
)
_IDL_DEPTH = {"(": 1, "[": 1, "{": 8, "<": 2}
_OPENED = {")": "(", "]": "[", "}": "{", ">": "<"}
_NAME = re.compile(r"[A-Za-z]\w*(?:/[A-Za-z]\w*)+", re.ASCII)

Fields = list[tuple[str, Any]]


def check_text(text: str, *, idl: bool) -> None:
    """Refuses a text that would take the parser unreasonably long.

    Raises:
        ValueError: it is too long, or holds expressions that no generated definition has.
    """
    size = len(text.encode("utf-8", "surrogatepass"))
    if size > MAX_TEXT_BYTES:
        raise ValueError(f"{size} bytes of text, more than {MAX_TEXT_BYTES} are not read")
    if text.count("\n") > MAX_MEMBERS * 4:
        raise ValueError(f"more than {MAX_MEMBERS * 4} lines")
    if not idl:
        return
    depth = dict.fromkeys(_IDL_DEPTH, 0)
    for token in _IDL_TOKEN.finditer(text):
        if token["operator"]:
            raise ValueError(f"the operator {token['operator']} at character {token.start()}")
        if bracket := token["open"]:
            depth[bracket] += 1
            if depth[bracket] > _IDL_DEPTH[bracket]:
                raise ValueError(
                    f"brackets {bracket} nested deeper than {_IDL_DEPTH[bracket]} at character "
                    f"{token.start()}"
                )
        elif bracket := token["close"]:
            depth[_OPENED[bracket]] -= 1


def check_types(types: Mapping[str, Any]) -> None:
    """Refuses parsed types from which too much code would be made.

    Args:
        types: by name (constants, fields), as rosbags' parsers give them.

    Raises:
        ValueError: which type and field, and what is wrong there.
    """
    if len(types) > MAX_TYPES:
        raise ValueError(f"{len(types)} types, more than {MAX_TYPES} are not read")
    members = sum(len(constants) + len(fields) for constants, fields in types.values())
    if members > MAX_MEMBERS:
        raise ValueError(f"{members} fields and constants, more than {MAX_MEMBERS} are not read")
    unrolled = 0
    for name, (constants, fields) in types.items():
        if not _NAME.fullmatch(name):
            raise ValueError(f"{name[:80]!r} is no name of a type")
        for constant, _, value in constants:
            if isinstance(value, list):
                raise ValueError(f"constant {name}.{constant} is a list")
            if isinstance(value, float) and not -1.8e308 < value < 1.8e308:
                raise ValueError(f"constant {name}.{constant} is no finite number")
        for field, (kind, rest) in fields:
            if kind != Nodetype.ARRAY:
                continue
            inner, count = rest
            if not 0 < count <= MAX_ARRAY:
                raise ValueError(f"{name}.{field} has {count} items (1 to {MAX_ARRAY} are right)")
            if _is_boxed(inner):
                unrolled += count
    if unrolled > MAX_UNROLLED:
        raise ValueError(
            f"arrays of {unrolled} messages and strings, more than {MAX_UNROLLED} are not read"
        )
    _check_depth(types)


def _is_boxed(inner: Any) -> bool:
    return bool(inner[0] == Nodetype.NAME or inner[1][0] == "string")


def _named(fields: Fields) -> list[str]:
    """The message types that a type's fields name."""
    found = []
    for _, (kind, rest) in fields:
        inner = rest[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, rest)
        if inner[0] == Nodetype.NAME:
            found.append(inner[1])
    return found


def _check_depth(types: Mapping[str, Any]) -> None:
    """Raises ValueError where a type contains itself, or types nest deeper than MAX_DEPTH."""
    depths: dict[str, int] = {}
    for root in types:
        open_types: dict[str, None] = {}  # the way from the root to where we are
        stack: list[tuple[str, bool]] = [(root, False)]
        while stack:
            name, done = stack.pop()
            below = [n for n in _named(types[name][1]) if n in types]
            if done:
                del open_types[name]
                depths[name] = 1 + max((depths[n] for n in below), default=0)
                if depths[name] > MAX_DEPTH:
                    raise ValueError(f"types nest deeper than {MAX_DEPTH} in {name}")
            elif name in open_types:
                raise ValueError(f"{name} contains itself")
            elif name not in depths:
                open_types[name] = None
                stack.append((name, True))
                stack += [(n, False) for n in below]


# Behind a count, which is aligned to 4, up to where numbers of 8 bytes would begin.
_PADDING = bytes(4)
_WIDE = frozenset({"int64", "uint64", "float64"})


class BoundedStore(Typestore):
    """A store that decodes no message whose objects could take more than MAX_DECODED_BYTES.

    A byte of a message can become an object of some hundred bytes: an array of empty messages
    takes one byte an item.
    """

    def __init__(self) -> None:
        super().__init__()
        self._growth: dict[str, float] = {}

    def deserialize_cdr(self, rawdata: bytes | memoryview, typename: str) -> object:
        """As Typestore.deserialize_cdr; what rclpy writes behind a message is no part of it.

        Before the items of an empty sequence of 8-byte numbers at a message's end rclpy writes the
        padding that would align them.

        Raises:
            SerdeError: the bytes are no such message, or their objects could take too much memory.
        """
        growth = self._growth.get(typename)
        if growth is None:
            growth = self._growth[typename] = growth_of(self.fielddefs, typename)
        if len(rawdata) * growth > MAX_DECODED_BYTES:
            raise SerdeError(
                f"{len(rawdata)} bytes of small items could take "
                f"{len(rawdata) * growth / 2**30:.1f} GiB of memory once decoded "
                f"(at most {MAX_DECODED_BYTES >> 30} GiB are taken)"
            )
        try:
            return super().deserialize_cdr(rawdata, typename)
        except SerdeError:
            is_padded = bytes(rawdata[-len(_PADDING) :]) == _PADDING
            if not is_padded or not _ends_in_wide_numbers(self.fielddefs, typename):
                raise
            return super().deserialize_cdr(rawdata[: -len(_PADDING)], typename)


def _ends_in_wide_numbers(types: Mapping[str, Any], name: str) -> bool:
    """True for a type whose last field is a sequence of numbers of 8 bytes, be it in another's."""
    fields = types[name][1]
    if not fields:
        return False
    kind, rest = fields[-1][1]
    if kind == Nodetype.NAME:
        return _ends_in_wide_numbers(types, rest)
    return kind == Nodetype.SEQUENCE and rest[0][0] == Nodetype.BASE and rest[0][1][0] in _WIDE


def growth_of(types: Mapping[str, Any], msgtype: str) -> float:
    """Bytes of Python objects per byte of a message, at the worst."""
    return _growth(types, msgtype, {}, {})


def _least(types: Mapping[str, Any], name: str, sizes: dict[str, tuple[int, int]]) -> Any:
    """Least bytes of a type in a message, and bytes of its objects besides its sequences' items."""
    if name in sizes:
        return sizes[name]
    least, objects = 0, _OBJECT_BYTES
    for _, (kind, rest) in types[name][1]:
        objects += _FIELD_BYTES
        if kind == Nodetype.SEQUENCE:
            least += 4
            objects += _OBJECT_BYTES  # an empty list or array
            continue
        inner, count = rest if kind == Nodetype.ARRAY else ((kind, rest), 1)
        if inner[0] == Nodetype.NAME:
            size, more = _least(types, inner[1], sizes)
        elif inner[1][0] == "string":
            size, more = _LEAST_STRING_BYTES, _STRING_BYTES
        else:
            size, more = SIZEMAP[inner[1][0]], 0 if kind == Nodetype.ARRAY else 32
        least += size * count
        objects += more * count
    sizes[name] = least, objects
    return sizes[name]


def _growth(
    types: Mapping[str, Any],
    name: str,
    sizes: dict[str, tuple[int, int]],
    known: dict[str, float],
) -> float:
    if name in known:
        return known[name]
    worst = 1.0
    for _, (kind, rest) in types[name][1]:
        inner = rest[0] if kind in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (kind, rest)
        if inner[0] == Nodetype.NAME:
            worst = max(worst, _growth(types, inner[1], sizes, known))
        if kind != Nodetype.SEQUENCE or not _is_boxed(inner):
            continue
        if inner[0] == Nodetype.NAME:
            least, objects = _least(types, inner[1], sizes)
        else:
            least, objects = _LEAST_STRING_BYTES, _STRING_BYTES
        worst = max(worst, objects / max(1, least))
    known[name] = worst
    return worst
