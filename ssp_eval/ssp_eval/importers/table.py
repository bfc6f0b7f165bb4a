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
from ssp_core.decimals import decimal
from ssp_core.errors import InputError
from ssp_core.files.reading import read_text
from ssp_core.geometry import FloatArray
from ssp_core.motion.state import DEFAULT_SIZES, Size
from ssp_core.vocabulary import OBJECTS, ObjectClass
from ssp_eval.importers.findings import Findings
from ssp_eval.importers.tracks import Samples, Source, size_of

MAX_BYTES = 256 << 20
_MOTION = ("x_m", "y_m", "yaw_rad", "speed_mps")
_RATES = ("yaw_rate_radps", "acceleration_mps2")
_EXTENT = ("length_m", "width_m")
COLUMNS = ("t_s", "id", "class", *_MOTION, *_EXTENT)
OPTIONAL = ("height_m", *_RATES)
# Sizes of one object that differ by more than this are two objects'.
_SIZE_M = 0.1
_LONGEST_M = 40.0
# Later than the year 2090, where it counts from 1970.
_LATEST_S = 4e9


@dataclass(frozen=True)
class TableObject:
    """One object of a table: its class, its extent in its class' proportions, and its rows."""

    object_class: ObjectClass
    size: Size
    samples: Samples


@dataclass(frozen=True)
class Table:
    """A table of states: objects by id, in the order of their first rows, and unused columns."""

    objects: Mapping[str, TableObject]
    ignored: tuple[str, ...]


def read_table(path: Path, findings: Findings) -> Table:
    """Read and check a table of states.

    Args:
        path: a CSV file.
        findings: take each kind of error in each column once, with file, first line, column,
            value, remedy and the number of rows.

    Raises:
        InputError: with all of them, within ``findings.listed``.
    """
    header, lines, cells = _read(path, findings)
    columns = dict(zip(header, zip(*cells, strict=True), strict=True))
    classes = _classes(path, lines, columns["id"], columns["class"], findings)
    numbers = {
        name: _numbers(path, lines, name, columns[name], findings)
        for name in ("t_s", *_MOTION, *_EXTENT, *OPTIONAL)
        if name in columns
    }
    findings.need()
    ids = np.array(columns["id"])
    objects = {}
    for name, object_class in classes.items():
        rows_of = np.flatnonzero(ids == name)
        own_lines = [lines[i] for i in rows_of]
        own = {column: values[rows_of] for column, values in numbers.items()}
        source = Source(path, f"id {name}", own_lines)
        objects[name] = _object(source, object_class, own, findings)
    findings.need()
    ignored = tuple(name for name in header if name not in (*COLUMNS, *OPTIONAL))
    return Table(objects, ignored)


def _read(path: Path, findings: Findings) -> tuple[list[str], list[int], list[list[str]]]:
    """Read header, line numbers and cells of the rows that have as many as the header."""
    rows = csv.reader(io.StringIO(read_text(path, MAX_BYTES).removeprefix("\ufeff")), strict=True)
    lines: list[int] = []
    cells: list[list[str]] = []
    other: list[tuple[int, int]] = []
    try:
        header = [name.strip() for name in next(rows, [])]
        _check_header(path, header, findings)
        for row in rows:
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                other.append((rows.line_num, len(row)))
                continue
            lines.append(rows.line_num)
            cells.append([cell.strip() for cell in row])
    except csv.Error as error:
        raise InputError(
            f"is no CSV: {error}", file=path, line=rows.line_num, remedy="save it as plain CSV"
        ) from error
    if other:
        findings.note(
            "table",
            InputError(
                f"has {other[0][1]} values, the header {len(header)}{_further(len(other))}",
                file=path,
                line=other[0][0],
                remedy="a comma separates values, a point is the decimal mark",
            ),
        )
    if not cells:
        findings.need()
        raise InputError("holds no row", file=path, remedy=f"columns: {', '.join(COLUMNS)}")
    return header, lines, cells


def _further(count: int) -> str:
    """Say in how many rows beside the first one an error stands."""
    return "" if count == 1 else f", and so in {count - 1} further row{'s' * (count > 2)}"


def _check_header(path: Path, header: Sequence[str], findings: Findings) -> None:
    for name in (*COLUMNS, *OPTIONAL):
        if header.count(name) > 1:
            findings.note(
                "table",
                InputError("stands twice", file=path, line=1, field=name, remedy="one column each"),
            )
    for i, missing in enumerate(name for name in COLUMNS if name not in header):
        near = [g for g in header if g.split("_")[0].lower() == missing.split("_")[0]]
        unit = f"; {near[0]} isn't read, convert and rename it" if near else ""
        findings.note(
            "table",
            InputError(
                "is missing",
                file=path,
                line=1,
                field=missing,
                value=None if i else ",".join(header),
                remedy=f"the columns are {', '.join(COLUMNS)} (m, s, rad){unit}",
            ),
        )
    findings.need()


def _classes(
    path: Path, lines: Sequence[int], ids: Sequence[str], words: Sequence[str], findings: Findings
) -> dict[str, ObjectClass]:
    """Return the class of each id, which never changes."""
    words_by_id: dict[str, str] = {}
    last: dict[str, int] = {}
    empty: list[int] = []
    unknown: dict[str, list[int]] = {}
    changed: dict[str, InputError] = {}
    for line, name, word in zip(lines, ids, words, strict=True):
        if not name:
            empty.append(line)
        if word not in OBJECTS:
            unknown.setdefault(word, []).append(line)
        if not name or word not in OBJECTS:
            continue
        if words_by_id.setdefault(name, word) != word and name not in changed:
            changed[name] = InputError(
                f"{name} was a {words_by_id[name]} until line {last[name]}: one id must be one "
                "object",
                file=path,
                line=line,
                field="class",
                value=word,
                remedy="mend the ids",
            )
        last[name] = line
    if empty:
        findings.note(
            "table",
            InputError(
                f"is empty{_further(len(empty))}",
                file=path,
                line=empty[0],
                field="id",
                remedy="every row names its object",
            ),
        )
    for word, places in unknown.items():
        findings.note(
            "table",
            InputError(
                f"is no class{_further(len(places))}",
                file=path,
                line=places[0],
                field="class",
                value=word,
                remedy=f"known: {', '.join(OBJECTS)}",
            ),
        )
    for error in changed.values():
        findings.note("table", error)
    return {name: ObjectClass.from_word(word) for name, word in words_by_id.items()}


def _numbers(
    path: Path, lines: Sequence[int], name: str, texts: Sequence[str], findings: Findings
) -> FloatArray:
    """Return a column of finite numbers; extents are those of road users, times are in s."""
    column = np.array([_number(text) for text in texts])
    none = ~np.isfinite(column)
    wrong = [(none, "is no number", "every row needs all its values")]
    if name in (*_EXTENT, "height_m"):
        far = ~none & ((column <= 0.0) | (column > _LONGEST_M))
        remedy = f"m, above 0 and up to {_LONGEST_M:g}"
        wrong.append((far, "is no extent of a road user", remedy))
    if name == "t_s":
        far = ~none & (np.abs(column) > _LATEST_S)
        wrong.append((far, "is no time in s: ms or ns?", "convert the times to s"))
    for rows, problem, remedy in wrong:
        if rows.any():
            i = int(np.argmax(rows))
            findings.note(
                "table",
                InputError(
                    f"{problem}{_further(int(rows.sum()))}",
                    file=path,
                    line=lines[i],
                    field=name,
                    value=texts[i],
                    remedy=remedy,
                ),
            )
    return column


def _number(text: str) -> float:
    try:
        return decimal(text)
    except ValueError:
        return math.nan


def _object(
    source: Source,
    object_class: ObjectClass,
    columns: Mapping[str, FloatArray],
    findings: Findings,
) -> TableObject:
    extent = {}
    for name in (*_EXTENT, "height_m"):
        values = columns.get(name, np.array([DEFAULT_SIZES[object_class].height_m]))
        extent[name] = float(values[0])
        other = np.abs(values - values[0]) > _SIZE_M
        if other.any() and source.lines is not None:
            i = int(np.argmax(other))
            findings.note(
                "table",
                InputError(
                    f"was {values[0]:g} in line {source.lines[0]}: one id must be one object",
                    file=source.file,
                    line=source.lines[i],
                    field=name,
                    value=float(values[i]),
                    remedy="mend the ids",
                ),
            )
    stamps_ns = np.array([seconds_to_ns(t_s) for t_s in columns["t_s"]], dtype=np.int64)
    motion = {name: columns[name] for name in (*_MOTION, *_RATES) if name in columns}
    return TableObject(
        object_class, size_of(object_class, **extent), Samples(stamps_ns, motion, source)
    )
