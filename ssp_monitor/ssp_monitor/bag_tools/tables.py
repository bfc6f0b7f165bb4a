"""The table of a message type: its columns, the rows of a message, and its CSV file."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from operator import attrgetter
from pathlib import Path
from typing import Any, NamedTuple

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


def _decimal_seconds(time_ns: int) -> str:
    sign, rest = ("-", -time_ns) if time_ns < 0 else ("", time_ns)
    return f"{sign}{rest // NS_PER_S}.{rest % NS_PER_S:09d}"


# The text of a cell; a value whose column has None is written as `csv` writes it.
Text = Callable[[Any], str] | None

# float32 as the shortest text that means the same float32, not as the float64 it was read as.
_TEXTS: dict[str, Text] = {
    "float32": lambda value: str(np.float32(value)),
    "bool": lambda value: "true" if value else "false",
}


class Column(NamedTuple):
    """One column: its name, the value of a message, and the text of a value in the file."""

    name: str
    value: Callable[[Any], Any]
    text: Text = None


def _time_columns(name: str, time_ns: Callable[[Any], int]) -> tuple[Column, Column]:
    return Column(f"{name}_ns", time_ns), Column(f"{name}_s", time_ns, _decimal_seconds)


_ABOUT: tuple[Column, ...] = (
    *_time_columns("log_time", attrgetter("log_time_ns")),
    *_time_columns("publish_time", attrgetter("publish_time_ns")),
    Column("publish_sequence", attrgetter("sequence")),
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
    def columns(self) -> dict[str, Text]:
        """Map the name of each column to the text of its values, in order."""
        index = [Column(f"{self.items}.index", len)] if self.items else []
        # A field may have the name of one of ours, or end in _ns beside a time.
        unique: dict[str, Text] = {}
        for name, _, text in (*_ABOUT, *self.head, *index, *self.item):
            while name in unique:
                name += "_"
            unique[name] = text
        return unique

    def rows(self, message: BagMessage, decoded: Any) -> Iterator[list[Any]]:
        """Yield the rows of one message; None is an empty cell."""
        head = [c.value(message) for c in _ABOUT] + [c.value(decoded) for c in self.head]
        if not self.items:
            yield head
            return
        items = attrgetter(self.items)(decoded)
        if not len(items):
            yield head + [None] * (1 + len(self.item))
        for index, item in enumerate(items):
            yield [*head, index, *(c.value(item) for c in self.item)]


def layout_of(store: Typestore, msgtype: str) -> Layout:
    """Return the table of a type: nested fields have dotted names.

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
        as_json = (Column(name, _as_json(path)) for name, path, _ in self.arrays)
        return (*self.columns, *as_json)

    def add(self, msgtype: str, prefix: str = "", within: str = "") -> None:
        kind: Any
        what: Any
        for own, (kind, what) in self.store.fielddefs[msgtype][1]:
            name, path = prefix + own, within + own
            if kind == Nodetype.BASE:
                self.columns.append(Column(name, attrgetter(path), _TEXTS.get(what[0])))
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
            self.columns.append(Column(f"{name}_ns", lambda m: [*map(time_ns, get(m))], json.dumps))
        elif kind != Nodetype.BASE:
            self.arrays.append((name, path, what))
        elif what[0] in _BYTES and not 0 < length <= _FEW_BYTES:
            self.left_out.append(name)
        else:
            self.columns.append(Column(name, _as_list(path), json.dumps))


def _nanoseconds(get: Callable[[Any], Any]) -> Callable[[Any], int]:
    def time_ns(message: Any) -> int:
        time = get(message)
        return int(time.sec) * NS_PER_S + int(time.nanosec)

    return time_ns


def _as_list(path: str) -> Callable[[Any], list[Any]]:
    get = attrgetter(path)

    def value(message: Any) -> list[Any]:
        elements = get(message)
        return elements.tolist() if isinstance(elements, np.ndarray) else list(elements)

    return value


def _as_json(path: str) -> Callable[[Any], str]:
    get = attrgetter(path)
    return lambda message: json.dumps(_plain(get(message)))


def _plain(value: Any) -> Any:
    """Return a decoded value as lists, mappings, numbers and texts; long bytes as their length."""
    if is_dataclass(value) and not isinstance(value, type):
        field_names = [f.name for f in fields(value) if f.init and f.name != "__msgtype__"]
        return {name: _plain(getattr(value, name)) for name in field_names}
    if isinstance(value, np.ndarray):
        if value.dtype.itemsize == 1 and value.size > _FEW_BYTES and value.dtype != np.bool_:
            return f"{value.size} bytes"
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value


class CsvFile:
    """A CSV file with a head line; lists stand in a cell as JSON, seconds with all their digits."""

    def __init__(self, path: Path, columns: dict[str, Text]) -> None:
        self.rows = 0
        self._texts = list(columns.values())
        # What no UTF-8 can hold must not end the export.
        self._stream = path.open("w", encoding="utf-8", errors="backslashreplace", newline="")
        self._csv = csv.writer(self._stream, lineterminator="\n")
        self._csv.writerow(columns)

    def write(self, row: Sequence[Any]) -> None:
        self._csv.writerow(
            [
                value if value is None or text is None else text(value)
                for value, text in zip(row, self._texts, strict=True)
            ]
        )
        self.rows += 1

    def close(self) -> None:
        self._stream.close()
