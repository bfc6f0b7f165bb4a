"""Markdown tables of a plan, written as the lists of rows that the adapters read.

A table is one list: its header states columns and units, and each line below the rule is a row.
Where one column names whose a row is, the own vehicle's rows are the list. Any other table that
names road users, or that lacks a pair of columns that an interface reads, stays as it is and holds
no list.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

_RULE = re.compile(r"[ \t]*\|?[ \t]*:?-+:?[ \t]*(?:\|[ \t]*:?-+:?[ \t]*)+\|?[ \t]*")
_NUMBER = r"[+\-\u2212\u2013]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_TIME = re.compile(rf"(?:t\s*[=+]?\s*)?({_NUMBER})\s*(ms|s|secs?|seconds?)?", re.IGNORECASE)
_TIME_WITH_UNIT = re.compile(
    rf"(?:t\s*[=+]?\s*)?{_NUMBER}\s*(?:ms|s|secs?|seconds?)", re.IGNORECASE
)
_NAME = re.compile(r"[^\W\d_]+")
_UNIT = re.compile(r"[\[(/]\s*([^\W\d_]+(?:/[^\W\d_]+)?|1/k?m|m\^-1|m⁻¹)")
_ELIDED = re.compile(r"(?:[.]{2,}|…|⋯)")
_OF_USERS = frozenset(
    {"object", "objects", "agent", "actor", "vehicle", "class", "type", "label", "name", "user"}
    | {"participant", "track", "obstacle", "id", "category", "car", "pedestrian", "cyclist"}
    | {"van", "bus", "truck", "lead", "other", "bicycle", "motorcycle", "walker", "leader"}
)
_OWN = frozenset({"ego", "own", "my", "vut"})
_TIMES = frozenset({"t", "time", "timestamp", "second", "seconds"})
# A direction says more than an axis, and comes first where a header names both.
_FIRST = ("forward", "ahead", "longitudinal", "x", "dx", "δx", "east", "easting", "latitude", "u")
_SECOND = ("left", "right", "lateral", "y", "dy", "δy", "north", "northing", "longitude", "v")
_SPEED = ("speed", "velocity", "v")
_CURVATURE = ("curvature", "kappa", "κ", "k")


@dataclass(frozen=True)
class _Column:
    place: int
    name: str
    unit: str


def with_lists_for_tables(text: str, is_of_points: bool, text_is_cut: bool) -> str:
    """Replace each table of a plan by a heading and a list, in time linear in the length.

    Args:
        text: the answer's.
        is_of_points: whether the interface reads points, not pairs of speed and curvature.
        text_is_cut: whether the text is known to end at the limit of tokens, so that a table at its
            end isn't known to be whole.
    """
    if "|" not in text:
        return text
    lines = text.split("\n")
    output_lines: list[str] = []
    at = 0
    while at < len(lines):
        if at + 1 < len(lines) and "|" in lines[at] and _RULE.fullmatch(lines[at + 1]) is not None:
            end = at + 2
            while end < len(lines) and "|" in lines[end]:
                end += 1
            is_open = text_is_cut and not any(line.strip() for line in lines[end:])
            replacement = _list_of(lines[at], lines[at + 2 : end], is_of_points, is_open)
            output_lines += lines[at:end] if replacement is None else [replacement]
            at = end
        else:
            output_lines.append(lines[at])
            at += 1
    return "\n".join(output_lines)


def _list_of(header: str, lines: Sequence[str], is_of_points: bool, is_open: bool) -> str | None:
    """Write a table as a list; None where it isn't one of a plan."""
    cells = [_cells(line) for line in lines]
    titles = _cells(header)
    if any(not _OWN.isdisjoint(_words(title)) for title in titles):
        titles = [title if _is_own(title) else "" for title in titles]
    elif any(not _OF_USERS.isdisjoint(_words(title)) for title in titles):
        rows_of_own = _own_rows(titles, cells)
        if not rows_of_own:
            return None
        lines = [lines[i] for i in rows_of_own]
        cells = [cells[i] for i in rows_of_own]
    first, second = (_FIRST, _SECOND) if is_of_points else (_SPEED, _CURVATURE)
    pair = [_column(titles, names) for names in (first, second)]
    one, other = pair
    if one is None or other is None or one.place == other.place or not cells:
        return None
    columns = sorted((one, other), key=lambda column: column.place)
    time = _time_place(titles, cells)
    rows: list[str] = []
    for i, row in enumerate(cells):
        is_begun = i == len(cells) - 1 and not lines[i].rstrip().endswith("|")
        if not (is_open and is_begun and header.rstrip().endswith("|")):  # its end may lack
            rows.append(_row(row, columns, time, titles))
    names = [column.name for column in columns]
    if time is not None:
        names.insert(0, "t_s" if _states_unit(titles[time], [row[time:] for row in cells]) else "t")
    units = "".join(
        f" ({unit})" for unit in dict.fromkeys(column.unit for column in columns) if unit
    )
    return f"({', '.join(names)}){units} [{', '.join(rows)}" + ("" if is_open else "]")


def _own_rows(titles: Sequence[str], cells: Sequence[Sequence[str]]) -> list[int]:
    """Return the rows that a column of road users gives to the own vehicle."""
    user_columns = [i for i, title in enumerate(titles) if not _OF_USERS.isdisjoint(_words(title))]
    if len(user_columns) != 1:
        return []
    place = user_columns[0]
    return [
        i
        for i, row in enumerate(cells)
        if place < len(row) and not _OWN.isdisjoint(_words(row[place]))
    ]


def _cells(line: str) -> list[str]:
    parts = line.strip().removeprefix("|").removesuffix("|").split("|")
    return [re.sub(r"[*`$\\]", "", part).strip() for part in parts]


def _words(title: str) -> list[str]:
    return [word.lower() for word in _NAME.findall(title.replace("Δ", "δ"))]


def _is_own(title: str) -> bool:
    """Tell a column of the own vehicle, or of time, in a table that names others' too."""
    words = set(_words(title))
    return bool(words & (_OWN | _TIMES)) or not words & (_OF_USERS | {"x", "y"})


def _column(titles: Sequence[str], names: Sequence[str]) -> _Column | None:
    """Find the column of one of some names; the earlier of the names counts first."""
    for name in names:
        for place, title in enumerate(titles):
            words = _words(title)
            if name not in words or not _TIMES.isdisjoint(words):
                continue
            if name == "lateral" or (name in ("x", "y") and len(words) > 1):
                name = next((side for side in ("left", "right") if side in words), name)
            unit = _UNIT.search(title)
            unit_name = (
                unit[1].lower() if unit is not None and unit[1].lower() not in words[:1] else ""
            )
            return _Column(place, name, "" if unit_name in names else unit_name)
    return None


def _time_place(titles: Sequence[str], cells: Sequence[Sequence[str]]) -> int | None:
    for place, title in enumerate(titles):
        if not _TIMES.isdisjoint(_words(title)):
            return place
        column = [row[place] for row in cells if place < len(row)]
        if all(_TIME_WITH_UNIT.fullmatch(cell) for cell in column):
            return place
    return None


def _states_unit(title: str, cells: Sequence[Sequence[str]]) -> bool:
    """Tell whether a column of times says that they are seconds, or of what they are converted."""
    has_unit = not {"s", "ms", "sec", "secs", "second", "seconds"}.isdisjoint(_words(title))
    return has_unit or all(one and _TIME_WITH_UNIT.fullmatch(one[0]) for one in cells)


def _row(
    row: Sequence[str], columns: Sequence[_Column], time: int | None, titles: Sequence[str]
) -> str:
    if any(_ELIDED.fullmatch(cell) for cell in row):
        return "..."
    values = [row[column.place] if column.place < len(row) else "?" for column in columns]
    if time is not None and time < len(row):
        match = _TIME.fullmatch(row[time])
        unit = (match[2] or "") if match is not None else ""
        is_ms = unit.lower() == "ms" or (not unit and "ms" in _words(titles[time]))
        stated = row[time] if match is None else match[1]
        values.insert(0, f"{float(stated) / 1000:g}" if is_ms and match is not None else stated)
    return f"[{', '.join(value or '?' for value in values)}]"
