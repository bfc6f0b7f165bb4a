"""Tables as CSV, LaTeX, JSON and HTML; all digits in CSV and JSON, rounded ones elsewhere."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

from markupsafe import escape

from ssp_eval.analysis.latex import to_latex
from ssp_eval.analysis.table import Kind, Outcome, Table, Value, texts
from ssp_eval.score.aggregate import Mean

TABLE_FORMAT = "ssp.table/2"
# What begins like this is a formula to a spreadsheet; only text is guarded.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class _Field:
    """A column of plain values: one of a table, or one of the two that a Mean or Outcome needs.

    Args:
        key: in CSV and JSON.
        title: for people.
        kind: how people read it.
        values: of all rows.
    """

    key: str
    title: str
    kind: Kind
    values: tuple[str | float | None, ...]

    @property
    def type(self) -> str:
        """By Table Schema; a reader's integer has no null, so that whole numbers with one have."""
        if self.kind == "text":
            return "string"
        whole = self.kind == "count" and all(isinstance(value, int) for value in self.values)
        return "integer" if whole else "number"


def _fields(table: Table) -> list[_Field]:
    """The table's columns without Means, each of which has its n beside it, and Outcomes."""
    made = []
    for index, column in enumerate(table.columns):
        values = [row[index] for row in table.rows]
        if column.kind == "response":
            told = [v if isinstance(v, Outcome) else Outcome(None, None) for v in values]
            made.append(_Field("rsr", "RSR", "ratio", tuple(v.rsr for v in told)))
            made.append(_Field("rl_s", "RL (s)", "seconds", tuple(v.rl_s for v in told)))
            continue
        made.append(_Field(column.key, column.title, column.kind, tuple(map(_plain, values))))
        if any(isinstance(v, Mean) for v in values):
            ns = tuple(v.n if isinstance(v, Mean) else None for v in values)
            made.append(_Field(f"{column.key}_n", f"n of {column.title}", "count", ns))
    return made


def _plain(value: Value) -> str | float | None:
    if isinstance(value, Outcome):
        raise ValueError("a response stands outside a column of its kind")
    return value.value if isinstance(value, Mean) else value


def to_csv(table: Table) -> str:
    """Comma-separated, every digit; a mean has its n in a column beside it.

    There is nothing but a header and the rows, so that any reader takes it; see to_notes.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    fields = _fields(table)
    writer.writerow([field.key for field in fields])
    writer.writerows(zip(*([_csv_value(v) for v in field.values] for field in fields), strict=True))
    return stream.getvalue()


def to_notes(table: Table) -> str:
    """What must be read beside the CSV: the title, then a paragraph for each notice and note."""
    return "\n\n".join((table.title, *table.all_notes)) + "\n"


def _csv_value(value: str | float | None) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(_FORMULA) else value
    return repr(value)


def to_data(table: Table) -> dict[str, Any]:
    """The table as plain values for JSON, every digit: the columns of the CSV as a Table Schema.

    ``pandas.read_json(file, orient="table")`` takes it, which looks at schema and data alone.
    """
    fields = _fields(table)
    keys = [field.key for field in fields]
    return {
        "format": TABLE_FORMAT,
        "name": table.name,
        "title": table.title,
        "schema": {
            "fields": [
                {"name": f.key, "type": f.type, "title": f.title, "kind": f.kind} for f in fields
            ]
        },
        "data": [
            dict(zip(keys, row, strict=True))
            for row in zip(*(field.values for field in fields), strict=True)
        ],
        "notices": list(table.notices),
        "notes": list(table.all_notes),
    }


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
