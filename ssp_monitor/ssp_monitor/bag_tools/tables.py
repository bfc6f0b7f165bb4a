"""The table of a message type: its columns, and the rows that a message makes."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields, is_dataclass
from operator import attrgetter
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from ssp_core.bag.types import BagMessage
from ssp_core.clock import NS_PER_S

# A table with more isn't one that anybody reads.
MOST_COLUMNS = 2000
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_BYTES = ("uint8", "int8", "octet", "byte", "char")
# A UUID has 16, an array that is data rather than a value has more.
_FEW_BYTES = 32

Cell = Callable[[Any], object]
Column = tuple[str, Cell]  # name, and how its cell is got from a message or an item


def _time_columns(name: str, time_ns: Callable[[Any], int]) -> tuple[Column, Column]:
    def seconds(message: Any) -> str:
        at_ns = time_ns(message)
        sign, rest = ("-", -at_ns) if at_ns < 0 else ("", at_ns)
        return f"{sign}{rest // NS_PER_S}.{rest % NS_PER_S:09d}"

    return (f"{name}_ns", time_ns), (f"{name}_s", seconds)


_ABOUT: tuple[Column, ...] = (
    *_time_columns("log_time", attrgetter("log_time_ns")),
    *_time_columns("publish_time", attrgetter("publish_time_ns")),
    ("publish_sequence", attrgetter("sequence")),
)


@dataclass(frozen=True, slots=True)
class Layout:
    """The table of one type.

    Args:
        items: path of the array whose items are rows, empty when a message is one row.
        left_out: fields that no column holds.
    """

    head: tuple[Column, ...]
    items: str
    item: tuple[Column, ...]
    left_out: tuple[str, ...]

    @property
    def names(self) -> list[str]:
        """Names of all columns, in order."""
        index = [f"{self.items}.index"] if self.items else []
        of_head = [name for name, _ in (*_ABOUT, *self.head)]
        # A field may have the name of one of ours, or end in _ns beside a time.
        unique: dict[str, None] = {}
        for name in (*of_head, *index, *(name for name, _ in self.item)):
            while name in unique:
                name += "_"
            unique[name] = None
        return list(unique)

    def rows(self, message: BagMessage, decoded: Any) -> Iterator[list[object]]:
        """The rows of one message; None is an empty cell."""
        head = [cell(message) for _, cell in _ABOUT] + [cell(decoded) for _, cell in self.head]
        if not self.items:
            yield head
            return
        items = attrgetter(self.items)(decoded)
        if not len(items):
            yield head + [None] * (1 + len(self.item))
        for index, item in enumerate(items):
            yield [*head, index, *(cell(item) for _, cell in self.item)]


def layout_of(store: Typestore, msgtype: str) -> Layout:
    """The table of a type: nested fields have dotted names, and lists stand in a cell as JSON.

    Raises:
        ValueError: it would have too many columns.
    """
    whole = _Fields(store)
    whole.add(msgtype)
    if len(whole.arrays) != 1:
        return Layout(whole.with_arrays(), "", (), tuple(whole.left_out))
    ((name, path, item_type),) = whole.arrays
    item = _Fields(store, len(whole.columns))
    item.add(item_type, f"{name}.")
    left_out = (*whole.left_out, *item.left_out)
    return Layout(tuple(whole.columns), path, item.with_arrays(), left_out)


@dataclass(slots=True)
class _Fields:
    """The fields of a type and of those within it.

    Args:
        others: columns that the table has besides.
        arrays: of messages: name, path and type of the items.
    """

    store: Typestore
    others: int = 0
    columns: list[Column] = field(default_factory=list)
    arrays: list[tuple[str, str, str]] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)

    def with_arrays(self) -> tuple[Column, ...]:
        return (*self.columns, *((name, _json_cell(path)) for name, path, _ in self.arrays))

    def add(self, msgtype: str, prefix: str = "", within: str = "") -> None:
        kind: Any
        what: Any
        for own, (kind, what) in self.store.fielddefs[msgtype][1]:
            name, path = prefix + own, within + own
            if kind == Nodetype.BASE:
                self.columns.append((name, _scalar_cell(path, what[0])))
            elif kind == Nodetype.NAME and what in _TIMES:
                self.columns += _time_columns(name, _nanoseconds(attrgetter(path)))
            elif kind == Nodetype.NAME:
                self.add(what, f"{name}.", f"{path}.")
            else:
                self._add_array(name, path, what[0], what[1] if kind == Nodetype.ARRAY else 0)
            if self.others + len(self.columns) > MOST_COLUMNS:
                raise ValueError(f"its type has more than {MOST_COLUMNS} fields")

    def _add_array(self, name: str, path: str, items: tuple[Any, Any], length: int) -> None:
        kind, what = items
        if kind == Nodetype.NAME and what in _TIMES:
            get, time_ns = attrgetter(path), _nanoseconds(lambda item: item)
            self.columns.append((f"{name}_ns", lambda m: json.dumps([*map(time_ns, get(m))])))
        elif kind != Nodetype.BASE:
            self.arrays.append((name, path, what))
        elif what[0] in _BYTES and not 0 < length <= _FEW_BYTES:
            self.left_out.append(name)
        else:
            self.columns.append((name, _json_cell(path)))


def _nanoseconds(get: Callable[[Any], Any]) -> Callable[[Any], int]:
    def time_ns(message: Any) -> int:
        time = get(message)
        return int(time.sec) * NS_PER_S + int(time.nanosec)

    return time_ns


def _scalar_cell(path: str, base: str) -> Cell:
    get = attrgetter(path)
    if base == "bool":
        return lambda message: "true" if get(message) else "false"
    if base == "float32":
        # The shortest text that means the same float32, not the float64 that it was read as.
        return lambda message: str(np.float32(get(message)))
    return get


def _json_cell(path: str) -> Cell:
    get = attrgetter(path)
    return lambda message: json.dumps(_plain(get(message)))


def _plain(value: Any) -> Any:
    """A decoded value of lists, mappings, numbers and texts; long byte arrays as their length."""
    if is_dataclass(value) and not isinstance(value, type):
        named = [f.name for f in fields(value) if f.init and f.name != "__msgtype__"]
        return {name: _plain(getattr(value, name)) for name in named}
    if isinstance(value, np.ndarray):
        if value.dtype.itemsize == 1 and value.size > _FEW_BYTES and value.dtype != np.bool_:
            return f"{value.size} bytes"
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value
