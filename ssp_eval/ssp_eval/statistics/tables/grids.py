"""A table as the page shows it: its fields as texts, with bars, shades and links."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

from ssp_eval.score.aggregate import Mean
from ssp_eval.statistics.table import Column, Table, Value, fields
from ssp_eval.statistics.tables.statistics import NONE, STAGE_NAMES

# Letters beyond which a text keeps some width on a narrow screen.
_LONG = 40
# Beyond, a table is folded up.
MOST_OPEN = 60
MAIN = ("ivcs", "ivcs_difference")


@dataclass(frozen=True)
class Field:
    """One field: text, the n of a mean where the row's n differs, and how it looks.

    Args:
        n: empty where there is nothing to say.
        share: 0 to 1, of a bar or a shade; None where there is none.
        href: where it leads, empty for nowhere.
    """

    text: str
    n: str
    look: str
    share: float | None = None
    href: str = ""


@dataclass(frozen=True)
class Grid:
    """A table of the page."""

    name: str
    title: str
    heads: tuple[Field, ...]
    rows: tuple[tuple[Field, ...], ...]
    notes: tuple[str, ...]

    @property
    def folded(self) -> bool:
        """Too long to stand open."""
        return len(self.rows) > MOST_OPEN


def grid(table: Table, links: Sequence[str] = ()) -> Grid:
    """Return the table for the page.

    Args:
        table: with all rows.
        links: where the name of each row's model leads; none: nowhere.
    """
    places = [
        place
        for place, column in enumerate(table.columns)
        if column.printed and not _is_empty(table, place)
    ]
    columns = [table.columns[place] for place in places]
    heads = tuple(Field(column.title, "", _look(column)) for column in columns)
    rows = []
    for row, link in zip(table.rows, links or [""] * len(table.rows), strict=True):
        row_fields = fields(table, row)
        total = sum(_count(table, row, key) for key in (*STAGE_NAMES, NONE))
        rows.append(
            tuple(
                Field(
                    _cell_text(column, row_fields[place].text),
                    "" if row_fields[place].n is None else f"n={row_fields[place].n}",
                    _look(column) or ("words" if len(row_fields[place].text) > _LONG else ""),
                    _share(column, row[place], total),
                    link if column.key == "model" else "",
                )
                for column, place in zip(columns, places, strict=True)
            )
        )
    return Grid(table.name, table.title, heads, tuple(rows), table.notes)


def _is_empty(table: Table, place: int) -> bool:
    """Tell whether a column of words has none and only takes room."""
    is_text = table.columns[place].kind == "text"
    return is_text and bool(table.rows) and not any(row[place] for row in table.rows)


def _cell_text(column: Column, text: str) -> str:
    """Return names of scenarios as words, a count of none as a dot."""
    if column.key in STAGE_NAMES or column.key == NONE:
        return "·" if text == "0" else text
    return text.replace("_", " ") if column.key == "scenario" else text


def _look(column: Column) -> str:
    if column.key in STAGE_NAMES:
        return "num heat"
    if column.key == NONE:
        return "num clean"
    main = " main" if column.key in MAIN else ""
    bar = " bar" if column.kind == "ratio" else ""
    return f"num{bar}{main}" if column.is_number else ""


def _count(table: Table, row: Sequence[Value], key: str) -> int:
    value = next((v for c, v in zip(table.columns, row, strict=True) if c.key == key), 0)
    return value if isinstance(value, int) else 0


def _share(column: Column, value: Value, total: int) -> float | None:
    if column.key in STAGE_NAMES or column.key == NONE:
        return value / total if total and isinstance(value, int) else 0.0
    number = value.value if isinstance(value, Mean) else value
    if column.kind != "ratio" or not isinstance(number, int | float):
        return None
    return min(max(float(number), 0.0), 1.0)


def common_notes(grids: Sequence[Grid]) -> tuple[tuple[str, ...], list[Grid]]:
    """Return the notes that all have, and the grids without them."""
    if not grids:
        return (), []
    common = tuple(n for n in grids[0].notes if all(n in one.notes for one in grids))
    return common, [without_notes(one, common) for one in grids]


def without_notes(one: Grid, page_notes: Collection[str]) -> Grid:
    """Return the grid without notes that the page has already shown."""
    return replace(one, notes=tuple(note for note in one.notes if note not in page_notes))
