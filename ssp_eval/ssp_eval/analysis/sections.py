"""Statistics as the parts of a page: which tables stand together, and how much of each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from markupsafe import Markup

from ssp_eval.analysis.formats import to_html
from ssp_eval.analysis.table import Table

# Beyond, a table is only begun; the files of --tables hold it whole.
MOST_ROWS = 120
_PARTS = (
    ("Intervals", "intervals_"),
    ("Paired comparisons", "comparisons"),
    ("Sensitivity", "weights_"),
    ("Sensitivity", "sensitivity"),
    ("Stability over runs", "stability"),
    ("Curvature of the path", "curvature"),
)


@dataclass(frozen=True)
class Part:
    """One part of the page, its tables as HTML."""

    title: str
    tables: tuple[tuple[str, Markup], ...]


def page_parts(tables: Sequence[Table]) -> list[Part]:
    """The parts that there is something for, in a fixed order.

    Args:
        tables: of statistics_tables.
    """
    found: dict[str, list[tuple[str, Markup]]] = {}
    for title, prefix in _PARTS:
        for table in tables:
            if table.name.startswith(prefix) and table.rows:
                # to_html escapes every value.
                html = Markup(to_html(shortened(table)))
                found.setdefault(title, []).append((table.title, html))
    return [Part(title, tuple(of_part)) for title, of_part in found.items()]


def shortened(table: Table, most: int = MOST_ROWS) -> Table:
    """The first rows of a long table, with a note that says so."""
    if len(table.rows) <= most:
        return table
    note = f"The first {most} of {len(table.rows)} rows; ssp report --tables DIR writes all."
    return replace(table, rows=table.rows[:most], notes=(note, *table.notes))
