"""Tables as CSV and Parquet files, written row by row."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from ssp_core.clock import NS_PER_S
from ssp_core.errors import HostError
from ssp_monitor.bag_tools.columns import Kind

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
