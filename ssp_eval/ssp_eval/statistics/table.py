"""The one form that every table has before it becomes CSV, LaTeX, JSON or HTML."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from ssp_eval.score.aggregate import Mean, domain_order
from ssp_eval.score.cli import DISCLAIMER, NULL, format_response
from ssp_eval.score.metrics import DIAGNOSTIC, METRIC_LABELS

# text: words; count: a whole number; ratio, seconds, curvature: three, two and five decimals;
# signed: a difference of ratios, with its sign; change: a relative difference, shown in percent;
# billions: parameters; p: a p-value.
Kind = Literal[
    "text",
    "count",
    "ratio",
    "signed",
    "seconds",
    "curvature",
    "change",
    "billions",
    "response",
    "p",
]
# Of more names than the first number a sentence holds only as many as the second.
MOST_NAMED, NAMED = 8, 4
_DIGITS = {"ratio": 3, "seconds": 2, "curvature": 5}


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
        notes: what a reader must know, one sentence each.
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
        column: that it stands in.
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
        Column(name, METRIC_LABELS[name], "seconds" if name == "rl_s" else "ratio", printed)
        for name in names
    )


SCORES = metric_columns("jovr", "sem_cov", "sem_acc_eff", "cia_eff", "tqsr", "ivcs", *DIAGNOSTIC)
MEANS = (*SCORES[:5], *metric_columns("rsr", "rl_s"), *SCORES[5:])
COUNT = Column("n", "n", "count")


def in_order(group: Iterable[str]) -> list[tuple[int, str]]:
    """Key that sorts domains in their own order and everything else by name."""
    return [domain_order(key) for key in group]
