"""Tables of a topic: the columns that a message type makes, its rows, and CSV and Parquet files."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from operator import attrgetter
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

from ssp_core.bag.types import BagMessage
from ssp_core.clock import NS_PER_S
from ssp_core.errors import HostError

# A table with more isn't one that anybody reads.
MOST_COLUMNS = 2000
_TIMES = ("builtin_interfaces/msg/Time", "builtin_interfaces/msg/Duration")
_BYTES = ("uint8", "int8", "octet", "byte", "char")
# A UUID has 16, an array that is data rather than a value has more.
_FEW_BYTES = 32


class Kind(Enum):
    """What a column holds; SECONDS holds nanoseconds and is shown as seconds."""

    INT = "int"
    UINT = "uint"
    FLOAT32 = "float32"
    FLOAT64 = "float64"
    BOOL = "bool"
    TEXT = "text"
    SECONDS = "seconds"
    INTS = "ints"
    UINTS = "uints"
    FLOATS = "floats"
    TEXTS = "texts"
    JSON = "json"


@dataclass(frozen=True, slots=True)
class Column:
    """One column: its name, what it holds, and how the value is got from a message or an item."""

    name: str
    kind: Kind
    value: Callable[[Any], Any]


_ABOUT = (
    Column("log_time_ns", Kind.UINT, attrgetter("log_time_ns")),
    Column("log_time_s", Kind.SECONDS, attrgetter("log_time_ns")),
    Column("publish_time_ns", Kind.UINT, attrgetter("publish_time_ns")),
    Column("publish_time_s", Kind.SECONDS, attrgetter("publish_time_ns")),
    Column("publish_sequence", Kind.INT, attrgetter("sequence")),
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
    def columns(self) -> list[tuple[str, Kind]]:
        """Names and kinds of all columns, in order."""
        index = [(f"{self.items}.index", Kind.INT)] if self.items else []
        named = [(c.name, c.kind) for c in (*_ABOUT, *self.head)]
        named += index + [(c.name, c.kind) for c in self.item]
        # A field may have the name of one of ours, or end in _ns beside a time.
        seen: set[str] = set()
        unique = []
        for name, kind in named:
            while name in seen:
                name += "_"
            seen.add(name)
            unique.append((name, kind))
        return unique

    def rows(self, message: BagMessage, decoded: Any) -> Iterator[list[Any]]:
        """The rows of one message; None is an empty cell."""
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
    """The table of a type.

    Raises:
        ValueError: it would have too many columns.
    """
    walk = _Walk(store)
    walk.fields(msgtype, "", "")
    arrays = walk.arrays
    if len(arrays) != 1:
        head = [*walk.columns, *(Column(n, Kind.JSON, _as_json(p)) for n, p, _ in arrays)]
        return Layout(tuple(head), "", (), tuple(walk.left_out))
    name, path, item_type = arrays[0]
    inner = _Walk(store, walk.count)
    inner.fields(item_type, f"{name}.", "")
    item = [*inner.columns, *(Column(n, Kind.JSON, _as_json(p)) for n, p, _ in inner.arrays)]
    return Layout(tuple(walk.columns), path, tuple(item), (*walk.left_out, *inner.left_out))


class _Walk:
    def __init__(self, store: Typestore, count: int = 0) -> None:
        self._store = store
        self.count = count
        self.columns: list[Column] = []
        self.arrays: list[tuple[str, str, str]] = []  # name, path, type of the items
        self.left_out: list[str] = []

    def fields(self, msgtype: str, prefix: str, path: str) -> None:
        field: str
        what: Any
        for field, (kind, what) in self._store.fielddefs[msgtype][1]:
            name, at = prefix + field, path + field
            if kind == Nodetype.BASE:
                self._add(name, _scalar_kind(what[0]), attrgetter(at))
            elif kind == Nodetype.NAME and what in _TIMES:
                self._add(f"{name}_ns", Kind.INT, _nanoseconds(at))
                self._add(f"{name}_s", Kind.SECONDS, _nanoseconds(at))
            elif kind == Nodetype.NAME:
                self.fields(what, f"{name}.", f"{at}.")
            else:
                self._array(name, at, what[0], what[1] if kind == Nodetype.ARRAY else 0)

    def _array(self, name: str, at: str, items: tuple[Any, Any], length: int) -> None:
        kind, what = items
        if kind == Nodetype.NAME and what in _TIMES:
            self._add(f"{name}_ns", Kind.INTS, _nanoseconds_of_each(at))
        elif kind != Nodetype.BASE:
            self.arrays.append((name, at, what))
        elif what[0] in _BYTES and not 0 < length <= _FEW_BYTES:
            self.left_out.append(name)
        else:
            self._add(name, _list_kind(what[0]), _as_list(at))

    def _add(self, name: str, kind: Kind, value: Callable[[Any], Any]) -> None:
        self.count += 1
        if self.count > MOST_COLUMNS:
            raise ValueError(f"its type has more than {MOST_COLUMNS} fields")
        self.columns.append(Column(name, kind, value))


def _scalar_kind(base: str) -> Kind:
    if base == "uint64":
        return Kind.UINT
    named = {
        "bool": Kind.BOOL,
        "string": Kind.TEXT,
        "wstring": Kind.TEXT,
        "float32": Kind.FLOAT32,
        "float64": Kind.FLOAT64,
    }
    return named.get(base, Kind.INT)


def _list_kind(base: str) -> Kind:
    if base in ("string", "wstring"):
        return Kind.TEXTS
    if base == "uint64":
        return Kind.UINTS
    return Kind.FLOATS if base in ("float32", "float64", "float128") else Kind.INTS


def _nanoseconds(path: str) -> Callable[[Any], int]:
    get = attrgetter(f"{path}.sec", f"{path}.nanosec")

    def value(message: Any) -> int:
        seconds, nanoseconds = get(message)
        return int(seconds) * NS_PER_S + int(nanoseconds)

    return value


def _nanoseconds_of_each(path: str) -> Callable[[Any], list[int]]:
    get = attrgetter(path)
    return lambda message: [int(t.sec) * NS_PER_S + int(t.nanosec) for t in get(message)]


def _as_list(path: str) -> Callable[[Any], list[Any]]:
    get = attrgetter(path)

    def value(message: Any) -> list[Any]:
        found = get(message)
        return found.tolist() if isinstance(found, np.ndarray) else list(found)

    return value


def _as_json(path: str) -> Callable[[Any], str]:
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


# Cells of a Parquet file that wait in memory for the next row group.
_GROUP_BYTES = 4 << 20
_CELL_BYTES = 64


class TableFile(Protocol):
    """A table being written."""

    rows: int

    def write(self, row: Sequence[Any]) -> None:
        """Appends one row, with a value or None for each column."""

    def close(self) -> None:
        """Writes what is left."""


def _decimal_seconds(time_ns: int) -> str:
    sign, rest = ("-", -time_ns) if time_ns < 0 else ("", time_ns)
    return f"{sign}{rest // NS_PER_S}.{rest % NS_PER_S:09d}"


# float32 as the shortest text that means the same float32, not as the float64 it was read as.
_TEXTS: dict[Kind, Callable[[Any], str]] = {
    Kind.FLOAT32: lambda value: str(np.float32(value)),
    Kind.BOOL: lambda value: "true" if value else "false",
    Kind.SECONDS: _decimal_seconds,
    Kind.INTS: json.dumps,
    Kind.UINTS: json.dumps,
    Kind.FLOATS: json.dumps,
    Kind.TEXTS: json.dumps,
}


class CsvFile:
    """A CSV file with a head line; lists stand in a cell as JSON, seconds with all their digits."""

    suffix = ".csv"

    def __init__(self, path: Path, columns: Sequence[tuple[str, Kind]]) -> None:
        self.rows = 0
        self._texts = [_TEXTS.get(kind) for _, kind in columns]
        # What no UTF-8 can hold must not end the export.
        self._stream = path.open("w", encoding="utf-8", errors="backslashreplace", newline="")
        self._csv = csv.writer(self._stream, lineterminator="\n")
        self._csv.writerow([name for name, _ in columns])

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


class ParquetFile:
    """A Parquet file with typed columns; seconds are float64, lists are lists.

    Raises:
        HostError: pyarrow is not installed.
    """

    suffix = ".parquet"

    def __init__(self, path: Path, columns: Sequence[tuple[str, Kind]]) -> None:
        try:
            import pyarrow as pa  # type: ignore[import-untyped]
            import pyarrow.parquet as pq  # type: ignore[import-untyped]
        except ModuleNotFoundError as error:
            raise HostError(
                "pyarrow is not installed, which Parquet needs; `pip install pyarrow` adds it, "
                "and --csv does without"
            ) from error
        types = {
            Kind.INT: pa.int64(),
            Kind.UINT: pa.uint64(),
            Kind.FLOAT32: pa.float32(),
            Kind.FLOAT64: pa.float64(),
            Kind.BOOL: pa.bool_(),
            Kind.TEXT: pa.string(),
            Kind.JSON: pa.string(),
            Kind.SECONDS: pa.float64(),
            Kind.INTS: pa.list_(pa.int64()),
            Kind.UINTS: pa.list_(pa.uint64()),
            Kind.FLOATS: pa.list_(pa.float64()),
            Kind.TEXTS: pa.list_(pa.string()),
        }
        self.rows = 0
        self._schema = pa.schema([(name, types[kind]) for name, kind in columns])
        self._kinds = [kind for _, kind in columns]
        self._table = pa.Table
        self._writer = pq.ParquetWriter(path, self._schema, compression="zstd")
        self._clear()

    def _clear(self) -> None:
        self._waiting: list[list[Any]] = [[] for _ in self._kinds]
        self._bytes = 0

    def write(self, row: Sequence[Any]) -> None:
        for value, kind, column in zip(row, self._kinds, self._waiting, strict=True):
            column.append(_fitting(value, kind))
            self._bytes += _CELL_BYTES + (len(value) if hasattr(value, "__len__") else 0)
        self.rows += 1
        if self._bytes >= _GROUP_BYTES:
            self._flush()

    def _flush(self) -> None:
        self._writer.write_table(self._table.from_arrays(self._arrays(), schema=self._schema))
        self._clear()

    def _arrays(self) -> list[Any]:
        import pyarrow as pa

        return [
            pa.array(column, field.type)
            for column, field in zip(self._waiting, self._schema, strict=True)
        ]

    def close(self) -> None:
        if self._waiting and self._waiting[0]:
            self._flush()
        self._writer.close()


def _fitting(value: Any, kind: Kind) -> Any:
    if value is None:
        return None
    if kind is Kind.SECONDS:
        return value / NS_PER_S
    if kind in (Kind.TEXT, Kind.JSON):
        return value.encode("utf-8", "backslashreplace").decode()
    return value
