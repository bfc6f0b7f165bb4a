"""Tables as CSV, LaTeX, JSON and HTML; all digits in CSV and JSON, rounded ones elsewhere."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from markupsafe import escape

from ssp_eval.analysis.latex import to_latex
from ssp_eval.analysis.table import Column, Outcome, Table, Value, texts
from ssp_eval.score.aggregate import Mean

TABLE_SCHEMA = "ssp.table/1"
# What begins like this is a formula to a spreadsheet; only text is guarded.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def to_csv(table: Table) -> str:
    """Comma-separated, every digit; a mean has its n in a column beside it.

    There is nothing but a header and the rows, so that any reader takes it; see to_notes.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    kinds = [_csv_kind(table, index) for index in range(len(table.columns))]
    names = zip(table.columns, kinds, strict=True)
    writer.writerow([name for column, kind in names for name in _csv_names(column, kind)])
    for row in table.rows:
        values = zip(row, kinds, strict=True)
        writer.writerow([field for value, kind in values for field in _csv_fields(value, kind)])
    return stream.getvalue()


def to_notes(table: Table) -> str:
    """What must be read beside the CSV: the title, then a paragraph for each notice and note."""
    return "\n\n".join((table.title, *table.all_notes)) + "\n"


def _csv_kind(table: Table, index: int) -> type | None:
    """Mean or Outcome where a column needs two in CSV."""
    if table.columns[index].kind == "response":
        return Outcome
    return Mean if any(isinstance(row[index], Mean) for row in table.rows) else None


def _csv_names(column: Column, kind: type | None) -> list[str]:
    if kind is Outcome:
        return ["rsr", "rl_s"]
    return [column.key, f"{column.key}_n"] if kind is Mean else [column.key]


def _csv_fields(value: Value, kind: type | None) -> list[str]:
    if isinstance(value, Outcome):
        return [_plain(value.rsr), _plain(value.rl_s)]
    if isinstance(value, Mean):
        return [_plain(value.value), str(value.n)]
    return [_plain(value)] if kind is None else [_plain(value), ""]


def _plain(value: str | float | None) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(_FORMULA) else value
    return repr(value)


def to_data(table: Table) -> dict[str, Any]:
    """The table as plain values for JSON, every digit."""
    keys = [column.key for column in table.columns]
    return {
        "schema": TABLE_SCHEMA,
        "name": table.name,
        "title": table.title,
        "columns": [{"key": c.key, "title": c.title, "kind": c.kind} for c in table.columns],
        "rows": [dict(zip(keys, map(_json_value, row), strict=True)) for row in table.rows],
        "notices": list(table.notices),
        "notes": list(table.all_notes),
    }


def _json_value(value: Value) -> Any:
    if isinstance(value, Mean):
        return {"value": value.value, "n": value.n}
    if isinstance(value, Outcome):
        return {"rsr": value.rsr, "rl_s": value.rl_s}
    return value


def to_json(table: Table) -> str:
    """See to_data."""
    return json.dumps(to_data(table), indent=1, ensure_ascii=False, allow_nan=False) + "\n"


def to_html(table: Table) -> str:
    """A fragment: a figure with the table and its notes, no style of its own."""
    return "".join(_html_parts(table.printed))


def _html_parts(table: Table) -> Iterator[str]:
    styles = [' class="num"' if column.is_number else "" for column in table.columns]
    heads = zip(styles, table.columns, strict=True)
    yield f'<figure class="table" id="table-{escape(table.name)}">\n'
    yield f"<figcaption>{escape(table.title)}</figcaption>\n"
    yield '<div class="scroll"><table>\n<thead><tr>'
    yield "".join(f"<th{style}>{escape(column.title)}</th>" for style, column in heads)
    yield "</tr></thead>\n<tbody>\n"
    for row in table.rows:
        written = zip(styles, texts(table, row), strict=True)
        cells = "".join(f"<td{style}>{escape(text)}</td>" for style, text in written)
        yield f"<tr>{cells}</tr>\n"
    yield "</tbody></table></div>\n"
    for note in table.all_notes:
        look = "notice" if note in table.notices else "sub"
        yield f'<p class="{look}">{escape(note)}</p>\n'
    yield "</figure>\n"


Files = tuple[tuple[str, Callable[[Table], str]], ...]
# By format its files, each with what its name ends in.
FORMATS: Mapping[str, Files] = MappingProxyType(
    {
        "csv": ((".csv", to_csv), (".notes.txt", to_notes)),
        "latex": ((".tex", to_latex),),
        "json": ((".json", to_json),),
        "html": ((".html", to_html),),
    }
)
