"""The table of states beside a video: another simulator's, or a positioning system's (METHOD 4.3).

A CSV file with a header; one row an object and time, the rows of one object in order of time.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ssp_core.clock import seconds_to_ns
from ssp_core.errors import InputError
from ssp_core.files import read_text
from ssp_core.motion.state import DEFAULT_SIZES, Size
from ssp_core.vocabulary import OBJECTS, ObjectClass
from ssp_eval.importers.tracks import Samples, Source, size_of

MAX_BYTES = 256 << 20
# Header, and the name that METHOD 4.3 gives the column.
COLUMNS: Mapping[str, str] = {
    "t_s": "time",
    "id": "id",
    "class": "class",
    "x_m": "x",
    "y_m": "y",
    "yaw_rad": "yaw",
    "speed_mps": "speed",
    "length_m": "length",
    "width_m": "width",
}
OPTIONAL = ("height_m", "yaw_rate_radps", "acceleration_mps2")
_WORDS = ("id", "class")
_POSITIVE = ("length_m", "width_m", "height_m")
# Sizes of one object that differ by more than this are two objects'.
_SIZE_M = 0.1
_LONGEST_M = 40.0


@dataclass(frozen=True)
class TableObject:
    """One object of a table.

    Args:
        name: its id there.
        object_class: word.
        size: extent of its class' proportions.
        samples: its rows.
    """

    name: str
    object_class: ObjectClass
    size: Size
    samples: Samples


@dataclass(frozen=True)
class Table:
    """A table of states.

    Args:
        path: of the file.
        objects: by id, in the order of their first rows.
        ignored: columns that nobody reads.
    """

    path: Path
    objects: Mapping[str, TableObject]
    ignored: tuple[str, ...]


def read_table(path: Path) -> Table:
    """Reads and checks a table of states.

    Raises:
        InputError: a column is missing, a value is none, or an id changes its class or size; with
            file, line, column, value and remedy.
    """
    text = read_text(path, MAX_BYTES).removeprefix("\ufeff")
    rows = csv.reader(io.StringIO(text), strict=True)
    try:
        header = [name.strip() for name in next(rows, [])]
        columns, ignored = _columns(path, header)
        found: dict[str, _Rows] = {}
        for row in rows:
            line = rows.line_num
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                raise InputError(
                    f"has {len(row)} values, the header {len(header)}", file=path, line=line,
                    remedy="a comma separates values, a point is the decimal mark",
                )  # fmt: skip
            values = {name: row[i].strip() for name, i in columns.items()}
            if not values["id"]:
                raise InputError("is empty", file=path, line=line, field="id",
                                 remedy="every row names its object")  # fmt: skip
            found.setdefault(values["id"], _Rows(path)).take(line, values)
    except csv.Error as error:
        raise InputError(
            f"is no CSV: {error}", file=path, line=rows.line_num, remedy="save it as plain CSV"
        ) from error
    if not found:
        raise InputError("holds no row", file=path, remedy=f"columns: {', '.join(COLUMNS)}")
    return Table(path, {name: one.object(name) for name, one in found.items()}, ignored)


def _columns(path: Path, header: Sequence[str]) -> tuple[dict[str, int], tuple[str, ...]]:
    """Where each column stands, and the columns that nobody reads."""
    names = {short: name for name, short in COLUMNS.items()}
    known: dict[str, int] = {}
    ignored = []
    for i, given in enumerate(header):
        name = names.get(given, given)
        if name in known:
            raise InputError("stands twice", file=path, line=1, field=given,
                             remedy="one column each")  # fmt: skip
        if name in COLUMNS or name in OPTIONAL:
            known[name] = i
        else:
            ignored.append(given)
    missing = [name for name in COLUMNS if name not in known]
    if missing:
        near = [g for g in ignored if g.split("_")[0].lower() == missing[0].split("_")[0]]
        unit = f"; {near[0]} has another unit, convert it" if near else ""
        raise InputError(
            "is missing", file=path, line=1, field=missing[0], value=",".join(header),
            remedy=f"the columns are {', '.join(COLUMNS)} (m, s, rad){unit}",
        )  # fmt: skip
    return known, tuple(ignored)


class _Rows:
    """The rows of one object while a table is read."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._lines: list[int] = []
        self._numbers: dict[str, list[float]] = {}
        self._class = ""

    def take(self, line: int, values: Mapping[str, str]) -> None:
        word = values["class"]
        if word not in OBJECTS:
            raise InputError("is no class", file=self._path, line=line, field="class", value=word,
                             remedy=f"known are {', '.join(OBJECTS)}")  # fmt: skip
        if self._lines and word != self._class:
            raise InputError(
                f"{values['id']} was a {self._class} until line {self._lines[-1]}: one id must be "
                "one object",
                file=self._path, line=line, field="class", value=word, remedy="mend the ids",
            )  # fmt: skip
        self._class = word
        for name, text in values.items():
            if name not in _WORDS:
                self._numbers.setdefault(name, []).append(self._number(line, name, text))
        self._lines.append(line)

    def _number(self, line: int, name: str, text: str) -> float:
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not math.isfinite(number):
            raise InputError("is no number", file=self._path, line=line, field=name, value=text,
                             remedy="every row needs all its values")  # fmt: skip
        if name in _POSITIVE:
            if not 0.0 < number <= _LONGEST_M:
                raise InputError(
                    "is no extent of a road user", file=self._path, line=line, field=name,
                    value=number, remedy=f"m, above 0 and up to {_LONGEST_M:g}",
                )  # fmt: skip
            before = self._numbers.get(name, [])
            if before and abs(before[0] - number) > _SIZE_M:
                raise InputError(
                    f"was {before[0]:g} in line {self._lines[0]}: one id must be one object",
                    file=self._path, line=line, field=name, value=number, remedy="mend the ids",
                )  # fmt: skip
        return number

    def object(self, name: str) -> TableObject:
        n = {key: np.array(values) for key, values in self._numbers.items()}
        word = ObjectClass.from_word(self._class)
        height_m = n["height_m"][0] if "height_m" in n else DEFAULT_SIZES[word].height_m
        return TableObject(
            name,
            word,
            size_of(word, float(n["length_m"][0]), float(n["width_m"][0]), float(height_m)),
            Samples(
                np.array([seconds_to_ns(t) for t in n["t_s"]], dtype=np.int64),
                n["x_m"],
                n["y_m"],
                n["yaw_rad"],
                n["speed_mps"],
                n.get("yaw_rate_radps"),
                n.get("acceleration_mps2"),
                Source(self._path, f"id {name}", tuple(self._lines)),
            ),
        )
