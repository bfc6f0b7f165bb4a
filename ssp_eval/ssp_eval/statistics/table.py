"""The one form that every table has, and its files: CSV, LaTeX, JSON and HTML."""

from __future__ import annotations

import csv
import io
import json
import math
import unicodedata
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from markupsafe import escape

from ssp_core.files import make_folder, write_text
from ssp_eval.score.aggregate import Mean, domain_order
from ssp_eval.score.cli import DISCLAIMER, NULL, format_response
from ssp_eval.score.metrics import BY_NAME, DIAGNOSTIC, of_role

# text: words; count: a whole number; ratio, seconds, curvature: three, two and five decimals;
# signed: a difference of ratios, with its sign; change: a relative difference, shown in percent;
# decimal: two decimals; billions: parameters; p: a p-value; number: as many digits as it has.
Kind = Literal[
    "text",
    "count",
    "ratio",
    "signed",
    "seconds",
    "curvature",
    "change",
    "decimal",
    "billions",
    "response",
    "p",
    "number",
]
# Of more names than the first number a sentence holds only as many as the second.
MOST_NAMED, NAMED = 8, 4
_DIGITS = {"ratio": 3, "seconds": 2, "decimal": 2, "curvature": 5}


@dataclass(frozen=True)
class Outcome:
    """A risk response (METHOD 6.9).

    Args:
        rsr: 1 or 0, or a share.
        rl_s: the latency in s, None without one.
    """

    rsr: float | None
    rl_s: float | None
    is_share: bool = False


Value = str | int | float | Mean | Outcome | None


@dataclass(frozen=True)
class Column:
    """One column.

    Args:
        title: for people; with the unit where there is one.
        kind: how its values are written. A Mean may stand in any column of numbers.
        printed: False: in CSV and JSON alone, for programs.
    """

    key: str
    title: str
    kind: Kind = "ratio"
    printed: bool = True

    @property
    def is_number(self) -> bool:
        """Whether it is set to the right."""
        return self.kind != "text"


@dataclass(frozen=True)
class Table:
    """A table with all its digits.

    Args:
        rows: values in the order of the columns; None is null, shown as ``–``.
        notices: why its numbers may not be compared, whatever the table; see notices.py.
    """

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Value, ...], ...]
    notes: tuple[str, ...] = ()
    notices: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for row in self.rows:
            if len(row) != len(self.columns):
                raise ValueError(f"table {self.name}: a row of {len(row)} values")

    @property
    def printed(self) -> Table:
        """The same without the columns that are for programs alone."""
        if all(column.printed for column in self.columns):
            return self
        places = [k for k, column in enumerate(self.columns) if column.printed]
        return replace(
            self,
            columns=tuple(self.columns[k] for k in places),
            rows=tuple(tuple(row[k] for k in places) for row in self.rows),
        )

    @property
    def all_notes(self) -> tuple[str, ...]:
        """What stands under it: notices, notes, and last what stands under every table."""
        return (*self.notices, *self.notes, DISCLAIMER)


@dataclass(frozen=True)
class Shown:
    """A value as people read it; a mean over another number of cells than its row has its own n."""

    text: str
    n: int | None = None

    def __str__(self) -> str:
        return self.text if self.n is None else f"{self.text} (n={self.n})"


def texts(table: Table, row: Sequence[Value]) -> list[str]:
    """The values of a row as people read them; a mean shows its n where the row's n differs."""
    return [str(field) for field in fields(table, row)]


def fields(table: Table, row: Sequence[Value]) -> list[Shown]:
    """As texts, with the n of a mean apart from it."""
    usual = next(
        (v for c, v in zip(table.columns, row, strict=True) if c.key == "n" and isinstance(v, int)),
        None,
    )
    return [
        Shown(shown(c, v), v.n if isinstance(v, Mean) and v.n not in (usual, 0) else None)
        for c, v in zip(table.columns, row, strict=True)
    ]


def shown(column: Column, value: Value) -> str:
    """A value as people read it (METHOD 6.11).

    Args:
        value: unrounded; of a mean its n is left out.
    """
    if isinstance(value, Mean):
        return shown(column, value.value)
    if isinstance(value, Outcome):
        if value.rsr is None:
            return NULL
        if value.is_share:
            return f"{value.rsr:.3f}" + ("" if value.rl_s is None else f" @{value.rl_s:.2f}")
        return format_response(round(value.rsr), value.rl_s)
    if value is None:
        return NULL
    if isinstance(value, str):
        return value
    if column.kind in _DIGITS:
        return f"{value:z.{_DIGITS[column.kind]}f}"
    if column.kind == "signed":
        return f"{value:+z.3f}"
    if column.kind == "change":
        return f"{value:+z.1%}"
    if column.kind == "p":
        return f"{value:.3f}" if value >= 0.001 else f"{value:.1e}"
    return f"{value:g}"


def by_column(table: Table | None) -> list[dict[str, Value]]:
    """The rows by key of their columns; none of no table."""
    keys = () if table is None else [column.key for column in table.columns]
    return [dict(zip(keys, row, strict=True)) for row in (() if table is None else table.rows)]


def counted(count: int, word: str) -> str:
    """``1 cell``, ``2 cells``."""
    return f"{count} {word}{'' if count == 1 else 's'}"


def some(names: Sequence[str], separator: str = ", ") -> str:
    """All of a few names, of many the first and how many more there are."""
    if len(names) <= MOST_NAMED:
        return separator.join(names)
    return f"{separator.join(names[:NAMED])}{separator}and {len(names) - NAMED} more"


def metric_columns(*names: str, printed: bool = True) -> tuple[Column, ...]:
    """A column of each of these metrics."""
    return tuple(
        Column(name, metric.label, "seconds" if metric.unit else "ratio", printed)
        for name in names
        for metric in [BY_NAME[name]]
    )


# Of a cell before its risk response and after it; of a mean with rsr and rl_s in their place.
BEFORE_RISK = metric_columns(*(x for x in of_role("component", "shown") if x != "rsr"))
AFTER_RISK = metric_columns("ivcs", *DIAGNOSTIC)
BEHIND = metric_columns(*of_role("behind"), printed=False)
MEANS = (*BEFORE_RISK, *metric_columns("rsr", "rl_s"), *AFTER_RISK)
COUNT = Column("n", "n", "count")


def in_order(group: Iterable[str]) -> list[tuple[int, str]]:
    """Key that sorts domains in their own order and everything else by name."""
    return [domain_order(key) for key in group]


_GREEK = {
    chr(code): rf"$\{name}$"
    for code, name in {
        0x3B1: "alpha", 0x3B2: "beta", 0x3B3: "gamma", 0x3B4: "delta", 0x3B5: "epsilon",
        0x3B8: "theta", 0x3BA: "kappa", 0x3BB: "lambda", 0x3BC: "mu", 0x3C0: "pi", 0x3C1: "rho",
        0x3C3: "sigma", 0x3C4: "tau", 0x3C6: "phi", 0x3C9: "omega", 0x394: "Delta",
        0x3A3: "Sigma", 0x3A9: "Omega",
    }.items()
}  # fmt: skip
_LATEX = {
    "\\": r"\textbackslash{}", "{": r"\{", "}": r"\}", "$": r"\$", "&": r"\&", "#": r"\#",
    "%": r"\%", "_": r"\_", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}",
    "<": r"\textless{}", ">": r"\textgreater{}", "|": r"\textbar{}", '"': r"\textquotedbl{}",
    "–": "--", "—": "---", "×": r"$\times$", "−": "$-$", "≥": r"$\geq$", "≤": r"$\leq$",
    "±": r"$\pm$", "[": "{[}", "]": "{]}", "'": "{'}", "`": "{`}", "…": r"\dots{}",
    "·": r"$\cdot$", "→": r"$\to$", "²": r"\textsuperscript{2}", "“": "``", "”": "''", **_GREEK,
}  # fmt: skip
# A column of text with something longer than this wraps; it is wider where texts fill many lines,
# and as wide as the page allows in a table of few columns.
_LONG, _LINES, _FEW = 24, 4, 3
_NARROW_CM, _BROAD_CM, _WHOLE_CM = 3.4, 7.0, 9.5
_CHARACTERS_PER_CM = 6.0
# Lines of a part of a table, the head not counted.
_MOST_LINES = 42
_PACKAGES = r"% needs \usepackage{array,booktabs,graphicx} and \usepackage[T1]{fontenc}"


def latex_text(text: str) -> str:
    """Words as LaTeX sets them literally; line breaks become spaces, other controls go."""
    words = " ".join(text.split())
    return "".join(_LATEX.get(c, c) for c in words if unicodedata.category(c) != "Cc")


def to_latex(table: Table) -> str:
    r"""One or several ``table`` environments with booktabs rules, for ``\input`` into a paper.

    What is wider than the text is shrunk to it, and what is longer than a page goes on in another
    part. Letters beyond Latin and Greek ones need an engine with Unicode fonts.
    """
    table = table.printed
    shown = [[str(text) for text in texts(table, row)] for row in table.rows]
    widths_cm = [
        None if column.is_number else _width_cm([row[k] for row in shown], len(table.columns))
        for k, column in enumerate(table.columns)
    ]
    parts = _parts(shown, widths_cm)
    lines = [_PACKAGES]
    for number, part in enumerate(parts, start=1):
        lines += [r"\clearpage"] if number > 1 else []
        lines += _part(table, widths_cm, part, (number, len(parts)))
    return "\n".join([*lines, ""])


def _width_cm(column: Sequence[str], columns: int) -> float | None:
    """Width in which a column of texts wraps; None where it needn't."""
    longest = max(map(len, column), default=0)
    if longest <= _LONG:
        return None
    if columns <= _FEW:
        return _WHOLE_CM
    return _NARROW_CM if longest <= _LINES * _NARROW_CM * _CHARACTERS_PER_CM else _BROAD_CM


def _parts(
    shown: Sequence[Sequence[str]], widths_cm: Sequence[float | None]
) -> list[tuple[Sequence[str], ...]]:
    """The rows in parts that fit on a page each; one empty part where there are no rows."""
    parts: list[list[Sequence[str]]] = [[]]
    used = 0
    for row in shown:
        needed = max(
            math.ceil(len(text) / (width_cm * _CHARACTERS_PER_CM)) if width_cm else 1
            for text, width_cm in zip(row, widths_cm, strict=True)
        )
        if parts[-1] and used + needed > _MOST_LINES:
            parts.append([])
            used = 0
        parts[-1].append(row)
        used += max(needed, 1)
    return [tuple(part) for part in parts]


def _part(
    table: Table,
    widths_cm: Sequence[float | None],
    rows: Sequence[Sequence[str]],
    place: tuple[int, int],
) -> list[str]:
    number, count = place
    alignment = "".join(map(_alignment, table.columns, widths_cm))
    title = table.title if count == 1 else f"{table.title} ({number} of {count})"
    label = "" if number > 1 else rf"\label{{tab:{table.name.replace('_', '-')}}}"
    lines = [
        r"\begin{table}[htbp]",
        r"\centering\small",
        rf"\caption{{{latex_text(title)}}}{label}",
        rf"\sbox0{{\begin{{tabular}}{{{alignment}}}",
        r"\toprule",
        rf"{' & '.join(latex_text(column.title) for column in table.columns)} \\",
        r"\midrule",
    ]
    for row in rows:
        fields = zip(table.columns, widths_cm, row, strict=True)
        lines.append(rf"{' & '.join(_field(*field) for field in fields)} \\")
    lines += [
        r"\bottomrule",
        r"\end{tabular}}",
        r"\ifdim\wd0>\linewidth\resizebox{\linewidth}{!}{\usebox0}\else\usebox0\fi",
    ]
    if number == count:
        notes = r"\par ".join(
            rf"\textbf{{{latex_text(note)}}}" if note in table.notices else latex_text(note)
            for note in table.all_notes
        )
        lines.append(
            rf"\par\smallskip\begin{{minipage}}{{\linewidth}}\footnotesize\raggedright {notes}"
            r"\end{minipage}"
        )
    return [*lines, r"\end{table}"]


def _alignment(column: Column, width_cm: float | None) -> str:
    if width_cm is not None:
        return rf">{{\raggedright\arraybackslash}}p{{{width_cm:g}cm}}"
    return "r" if column.is_number else "l"


def _field(column: Column, width_cm: float | None, text: str) -> str:
    if column.is_number:
        return latex_text(text.replace("-", "−"))
    if width_cm is None:
        return latex_text(text)
    # Names without spaces may be broken where their parts meet.
    return latex_text(text).replace(r"\_", r"\_\allowbreak{}").replace("/", r"/\allowbreak{}")


TABLE_FORMAT = "ssp.table/2"
# What begins like this is a formula to a spreadsheet; only text is guarded.
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


@dataclass(frozen=True)
class _Field:
    """A column of plain values: one of a table, or one of the two that a Mean or Outcome needs."""

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


def unguarded(text: str) -> str:
    """A text of our CSV without the guard before what a spreadsheet would take for a formula."""
    return text[1:] if text.startswith("'") and text[1:].startswith(_FORMULA) else text


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


def write_tables(
    folder: Path,
    tables: Iterable[Table],
    formats: Sequence[str],
    on_table: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Writes each table in each format, as ``<name>.csv``, ``.tex``, ``.json``, ``.html``.

    What must be read beside a CSV file stands in ``<name>.notes.txt``.

    Raises:
        InputError: the folder can't be written to.
    """
    make_folder(folder)
    written = []
    for table in tables:
        for name in formats:
            for suffix, convert in FORMATS[name]:
                path = folder / f"{table.name}{suffix}"
                write_text(path, convert(table))
                written.append(path)
        on_table()
    return written
