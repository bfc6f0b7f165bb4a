"""Tables as CSV, LaTeX, JSON and HTML; all digits in CSV and JSON, rounded ones elsewhere."""

from __future__ import annotations

import csv
import io
import json
import unicodedata
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any

from markupsafe import Markup, escape

from ssp_eval.analysis.table import Column, Outcome, Table, Value, texts
from ssp_eval.score.aggregate import Mean

TABLE_SCHEMA = "ssp.table/1"
# What begins like this is a formula to a spreadsheet; only text is guarded.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")
_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "%": r"\%", "_": r"\_", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}",
    "–": "--", "×": r"$\times$", "−": "$-$", "≥": r"$\geq$", "≤": r"$\leq$", "Δ": r"$\Delta$",
    "τ": r"$\tau$", "±": r"$\pm$", "[": "{[}", "]": "{]}", "'": "{'}", "`": "{`}", "…": r"\dots{}",
    "α": r"$\alpha$",
}  # fmt: skip


def to_csv(table: Table) -> str:
    """Comma-separated, every digit; a mean has its n in a column beside it.

    The notes follow as lines that begin with ``#``.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([name for i, c in enumerate(table.columns) for name in _csv_names(table, i, c)])
    for row in table.rows:
        writer.writerow([field for i, v in enumerate(row) for field in _csv_fields(table, i, v)])
    for note in table.all_notes:
        writer.writerow([f"# {note}"])
    return stream.getvalue()


def _holds(table: Table, index: int, kind: type) -> bool:
    return any(isinstance(row[index], kind) for row in table.rows)


def _csv_names(table: Table, index: int, column: Column) -> list[str]:
    if column.kind == "response":
        return ["rsr", "rl_s"]
    return [column.key, f"{column.key}_n"] if _holds(table, index, Mean) else [column.key]


def _csv_fields(table: Table, index: int, value: Value) -> list[str]:
    if table.columns[index].kind == "response":
        outcome = value if isinstance(value, Outcome) else Outcome(None, None)
        return [_plain(outcome.rsr), _plain(outcome.rl_s)]
    if isinstance(value, Mean):
        return [_plain(value.value), str(value.n)]
    if isinstance(value, Outcome):
        raise TypeError(f"a risk response in column {table.columns[index].key}")
    return [_plain(value), ""] if _holds(table, index, Mean) else [_plain(value)]


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


def latex_text(text: str) -> str:
    """Words as LaTeX sets them literally; line breaks become spaces, other controls go."""
    words = " ".join(text.split())
    return "".join(_LATEX.get(c, c) for c in words if unicodedata.category(c) != "Cc")


def to_latex(table: Table) -> str:
    """A ``table`` environment with booktabs rules, for ``\\input`` into a paper.

    It needs the packages booktabs, and fontenc with T1; text beyond Latin letters needs an engine
    that reads UTF-8 fonts.
    """
    alignment = "".join("r" if column.is_number else "l" for column in table.columns)
    head = " & ".join(latex_text(column.title) for column in table.columns)
    lines = [
        r"% needs \usepackage{booktabs} and \usepackage[T1]{fontenc}",
        r"\begin{table}",
        r"\centering\small",
        rf"\caption{{{latex_text(table.title)}}}",
        rf"\label{{tab:{table.name.replace('_', '-')}}}",
        rf"\begin{{tabular}}{{{alignment}}}",
        r"\toprule",
        rf"{head} \\",
        r"\midrule",
    ]
    for row in table.rows:
        fields = zip(table.columns, texts(table, row), strict=True)
        lines.append(rf"{' & '.join(_latex_field(*field) for field in fields)} \\")
    lines += [r"\bottomrule", r"\end{tabular}"]
    lines += [rf"\par\smallskip{{\footnotesize {latex_text(note)}}}" for note in table.all_notes]
    return "\n".join([*lines, r"\end{table}", ""])


def _latex_field(column: Column, text: str) -> str:
    return latex_text(text.replace("-", "−") if column.is_number else text)


def to_html(table: Table) -> str:
    """A fragment: a figure with the table and its notes, no style of its own."""
    return str(Markup("").join(_html_parts(table)))


def _html_parts(table: Table) -> Iterator[Markup]:
    yield Markup('<figure class="table" id="table-{}">\n<figcaption>{}</figcaption>\n').format(
        table.name, table.title
    )
    yield Markup('<div class="scroll"><table>\n<thead><tr>')
    for column in table.columns:
        yield Markup("<th{}>{}</th>").format(_css(column), column.title)
    yield Markup("</tr></thead>\n<tbody>\n")
    for row in table.rows:
        cells = zip(table.columns, texts(table, row), strict=True)
        fields = (Markup("<td{}>{}</td>").format(_css(column), text) for column, text in cells)
        yield Markup("<tr>") + Markup("").join(fields) + Markup("</tr>\n")
    yield Markup("</tbody></table></div>\n")
    for note in table.all_notes:
        yield Markup('<p class="sub">{}</p>\n').format(escape(note))
    yield Markup("</figure>\n")


def _css(column: Column) -> Markup:
    return Markup(' class="num"') if column.is_number else Markup("")


FORMATS: Mapping[str, tuple[str, Callable[[Table], str]]] = MappingProxyType(
    {
        "csv": (".csv", to_csv),
        "latex": (".tex", to_latex),
        "json": (".json", to_json),
        "html": (".html", to_html),
    }
)
