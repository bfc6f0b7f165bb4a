"""The one form that every table has, and its files: CSV and LaTeX."""

from __future__ import annotations

import csv
import io
import unicodedata
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, Literal

from ssp_core.files.folders import new_files
from ssp_core.files.writing import write_text
from ssp_eval.score.aggregate import Mean, domain_order
from ssp_eval.score.cli import DISCLAIMER, NULL, format_response
from ssp_eval.score.metrics import BY_NAME, DIAGNOSTIC, of_role

# text: words; count: a whole number; ratio, seconds: three and two decimals;
# signed: a difference of ratios, with its sign; change: a relative difference, shown in percent;
# decimal: two decimals; billions: parameters; p: a p-value; number: as many digits as it has.
Kind = Literal[
    "text",
    "count",
    "ratio",
    "signed",
    "seconds",
    "change",
    "decimal",
    "billions",
    "response",
    "p",
    "number",
]
# Of more names than the first number a sentence holds only as many as the second.
MOST_NAMED, NAMED = 8, 4
_DIGITS = {"ratio": 3, "seconds": 2, "decimal": 2}


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
        """Tell whether it is set to the right."""
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
        """Return the texts under it: notices, notes, and last those under every table."""
        return (*self.notices, *self.notes, DISCLAIMER)


@dataclass(frozen=True)
class CellText:
    """A value as people read it; a mean over another number of cells than its row has its own n."""

    text: str
    n: int | None = None

    def __str__(self) -> str:
        return self.text if self.n is None else f"{self.text} (n={self.n})"


def texts(table: Table, row: Sequence[Value]) -> list[str]:
    """Return a row's values as people read them; a mean shows its n where it isn't the row's."""
    return [str(field) for field in fields(table, row)]


def fields(table: Table, row: Sequence[Value]) -> list[CellText]:
    """Write a row as texts, with the n of a mean apart from it."""
    usual = next(
        (v for c, v in zip(table.columns, row, strict=True) if c.key == "n" and isinstance(v, int)),
        None,
    )
    return [
        CellText(format_value(c, v), v.n if isinstance(v, Mean) and v.n not in (usual, 0) else None)
        for c, v in zip(table.columns, row, strict=True)
    ]


def format_value(column: Column, value: Value) -> str:
    """Return a value as people read it (METHOD 6.11).

    Args:
        column: of the value, for its digits.
        value: unrounded; of a mean its n is left out.
    """
    if isinstance(value, Mean):
        return format_value(column, value.value)
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
    """Return the rows by key of their columns; none of no table."""
    keys = () if table is None else [column.key for column in table.columns]
    return [dict(zip(keys, row, strict=True)) for row in (() if table is None else table.rows)]


def counted(count: int, word: str) -> str:
    """Return a count with its noun: ``1 cell``, ``2 cells``."""
    return f"{count} {word}{'' if count == 1 else 's'}"


def some(names: Sequence[str], separator: str = ", ") -> str:
    """Return a few names in full, of many the first ones and the number of the rest."""
    if len(names) <= MOST_NAMED:
        return separator.join(names)
    return f"{separator.join(names[:NAMED])}{separator}and {len(names) - NAMED} more"


def metric_columns(*names: str, printed: bool = True) -> tuple[Column, ...]:
    """Return a column of each of these metrics."""
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
    """Return the key that sorts domains in their own order and everything else by name."""
    return [domain_order(key) for key in group]


_GREEK = {
    chr(code): rf"$\{name}$"
    for code, name in {
        0x3B1: "alpha",
        0x3B2: "beta",
        0x3B3: "gamma",
        0x3B4: "delta",
        0x3B5: "epsilon",
        0x3B8: "theta",
        0x3BA: "kappa",
        0x3BB: "lambda",
        0x3BC: "mu",
        0x3C0: "pi",
        0x3C1: "rho",
        0x3C3: "sigma",
        0x3C4: "tau",
        0x3C6: "phi",
        0x3C9: "omega",
        0x394: "Delta",
        0x3A3: "Sigma",
        0x3A9: "Omega",
    }.items()
}
_LATEX = {
    "\\": r"\textbackslash{}",
    "{": r"\{",
    "}": r"\}",
    "$": r"\$",
    "&": r"\&",
    "#": r"\#",
    "%": r"\%",
    "_": r"\_",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "<": r"\textless{}",
    ">": r"\textgreater{}",
    "|": r"\textbar{}",
    '"': r"\textquotedbl{}",
    "–": "--",
    "—": "---",
    "×": r"$\times$",
    "−": "$-$",
    "≥": r"$\geq$",
    "≤": r"$\leq$",
    "±": r"$\pm$",
    "[": "{[}",
    "]": "{]}",
    "'": "{'}",
    "`": "{`}",
    "…": r"\dots{}",
    "·": r"$\cdot$",
    "→": r"$\to$",
    "²": r"\textsuperscript{2}",
    "“": "``",
    "”": "''",
    **_GREEK,
}
_PACKAGES = r"% needs \usepackage{booktabs} and \usepackage[T1]{fontenc}"


def latex_text(text: str) -> str:
    """Return words as LaTeX sets them literally; line breaks become spaces, other controls go."""
    words = " ".join(text.split())
    return "".join(_LATEX.get(c, c) for c in words if unicodedata.category(c) != "Cc")


def to_latex(table: Table) -> str:
    r"""Return a ``table`` environment with booktabs rules and notes, for ``\input`` into a paper.

    Letters beyond Latin and Greek ones need an engine with Unicode fonts.
    """
    table = table.printed
    numeric = [column.is_number for column in table.columns]

    def line(fields: Iterable[str]) -> str:
        return rf"{' & '.join(map(latex_text, fields))} \\"

    rows = [
        [
            text.replace("-", "−") if number else text
            for number, text in zip(numeric, row, strict=True)
        ]
        for row in (map(str, texts(table, row)) for row in table.rows)
    ]
    lines = [
        _PACKAGES,
        r"\begin{table}[htbp]",
        r"\centering\small",
        rf"\caption{{{latex_text(table.title)}}}\label{{tab:{table.name.replace('_', '-')}}}",
        rf"\begin{{tabular}}{{{''.join('r' if number else 'l' for number in numeric)}}}",
        r"\toprule",
        line(column.title for column in table.columns),
        r"\midrule",
        *map(line, rows),
        r"\bottomrule",
        r"\end{tabular}",
    ]
    for note in table.all_notes:
        text = latex_text(note)
        bold = rf"\textbf{{{text}}}" if note in table.notices else text
        lines.append(rf"\par\smallskip\footnotesize {bold}")
    return "\n".join([*lines, r"\end{table}", ""])


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
        """Return its type by Table Schema.

        A column of whole numbers with a null is one of numbers.
        """
        if self.kind == "text":
            return "string"
        whole = self.kind == "count" and all(isinstance(value, int) for value in self.values)
        return "integer" if whole else "number"


def _fields(table: Table) -> list[_Field]:
    """Return the table's columns without Means, each of which has its n beside it, and Outcomes."""
    plain_fields = []
    for index, column in enumerate(table.columns):
        values = [row[index] for row in table.rows]
        if column.kind == "response":
            outcomes = [v if isinstance(v, Outcome) else Outcome(None, None) for v in values]
            plain_fields.append(_Field("rsr", "RSR", "ratio", tuple(v.rsr for v in outcomes)))
            plain_fields.append(
                _Field("rl_s", "RL (s)", "seconds", tuple(v.rl_s for v in outcomes))
            )
            continue
        plain_fields.append(
            _Field(column.key, column.title, column.kind, tuple(map(_plain, values)))
        )
        if any(isinstance(v, Mean) for v in values):
            ns = tuple(v.n if isinstance(v, Mean) else None for v in values)
            plain_fields.append(_Field(f"{column.key}_n", f"n of {column.title}", "count", ns))
    return plain_fields


def _plain(value: Value) -> str | float | None:
    if isinstance(value, Outcome):
        raise ValueError("a response stands outside a column of its kind")
    return value.value if isinstance(value, Mean) else value


def to_csv(table: Table) -> str:
    """Return comma-separated values with every digit; a mean has its n in the next column.

    There is nothing but a header and the rows, so that any reader takes it; see to_notes.
    """
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    fields = _fields(table)
    writer.writerow([field.key for field in fields])
    writer.writerows(zip(*([_csv_value(v) for v in field.values] for field in fields), strict=True))
    return stream.getvalue()


def to_notes(table: Table) -> str:
    """Write the text that belongs beside the CSV: title, and a paragraph per notice and note."""
    return "\n\n".join((table.title, *table.all_notes)) + "\n"


def _csv_value(value: str | float | None) -> str:
    if value is None:
        return ""
    if isinstance(value, str):
        return f"'{value}" if value.startswith(_FORMULA) else value
    return repr(value)


def unguarded(text: str) -> str:
    """Return a text of our CSV without the guard against its reading as a formula."""
    return text[1:] if text.startswith("'") and text[1:].startswith(_FORMULA) else text


def to_data(table: Table) -> dict[str, Any]:
    """Return the table as plain values for JSON, in full precision, with a Table Schema.

    The columns are those of the CSV. ``pandas.read_json(file, orient="table")`` takes it, which
    looks at schema and data alone.
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


Files = tuple[tuple[str, Callable[[Table], str]], ...]
# By format its files, each with what its name ends in.
FORMATS: Mapping[str, Files] = MappingProxyType(
    {
        "csv": ((".csv", to_csv), (".notes.txt", to_notes)),
        "latex": ((".tex", to_latex),),
    }
)


def write_tables(
    folder: Path,
    tables: Iterable[Table],
    formats: Sequence[str],
    on_table: Callable[[], None] = lambda: None,
) -> list[Path]:
    """Write each table in each format, as ``<name>.csv`` or ``<name>.tex``: all of them or none.

    What must be read beside a CSV file stands in ``<name>.notes.txt``.

    Raises:
        InputError: the folder can't be written to.
        HostError: the disk doesn't take them.
    """
    paths = []
    with new_files(folder) as scratch:
        for table in tables:
            for name in formats:
                for suffix, convert in FORMATS[name]:
                    file = f"{table.name}{suffix}"
                    write_text(scratch / file, convert(table))
                    paths.append(folder / file)
            on_table()
    return paths
