"""The full matrix as a table: every run of every cell, with all that it takes to read it back."""

from __future__ import annotations

from collections.abc import Sequence

from ssp_eval.analysis.row import OK, CellRow, over_what
from ssp_eval.analysis.table import Column, Outcome, Table, Value
from ssp_eval.analysis.table_columns import COUNT, SCORES, TITLES, in_order

YES, NO = "yes", "no"
# In CSV and JSON alone: what another analysis of the same cells needs, and no reader of a page.
_BEHIND = (
    Column("sem_acc_cond", "SemAcc cond", printed=False),
    Column("sem_acc_soft", "SemAcc soft", printed=False),
    Column("total_b", "total (B)", "billions", printed=False),
    Column("active_b", "active (B)", "billions", printed=False),
    *(
        Column(key, key, "text", printed=False)
        for key in (
            "architecture",
            "control",
            "admitted",
            "stand_in",
            "status",
            "reason",
            "thresholds",
        )
    ),
)


def matrix_table(rows: Sequence[CellRow]) -> Table:
    """Every run of every cell, controls and lost ones too (METHOD 6.13)."""
    runs, seeds = any(row.run for row in rows), any(row.seed is not None for row in rows)
    columns = (
        *(Column(key, key, "text") for key in ("scenario", "domain", "model")),
        *((Column("run", "run", "text"),) if runs else ()),
        *((Column("seed", "seed", "count"),) if seeds else ()),
        COUNT,
        *SCORES[:5],
        Column("response", "risk", "response"),
        *SCORES[5:],
        Column("remark", "remark", "text"),
        *_BEHIND,
    )

    def key(row: CellRow) -> tuple[object, ...]:
        seed = -1 if row.seed is None else row.seed
        return row.scenario, in_order([row.domain]), row.control, row.model, row.run, seed

    table_rows: list[tuple[Value, ...]] = []
    for row in sorted(rows, key=key):
        scores = [getattr(row, column.key) for column in SCORES]
        table_rows.append(
            (
                row.scenario, row.domain, row.model, *((row.run,) if runs else ()),
                *((row.seed,) if seeds else ()), row.n, *scores[:5],
                Outcome(row.rsr, row.rl_s, bool(row.over)), *scores[5:], _remark(row),
                row.sem_acc_cond, row.sem_acc_soft, row.total_b, row.active_b, row.architecture,
                YES if row.control else NO, YES if row.admitted else NO,
                YES if row.stand_in else NO, row.status, row.reason,
                row.thresholds,
            )
        )  # fmt: skip
    notes = ["n counts labels."]
    if over_what(rows):
        notes.append("risk of a macro row: the share of cells with a response, @ their mean RL.")
    if any(row.ivcs_nulls for row in rows):
        notes.append("A component without a denominator counts as 0 in IVCS.")
    return Table("matrix", "Scores per cell", columns, tuple(table_rows), tuple(notes))


def _remark(row: CellRow) -> str:
    parts = []
    if row.control:
        parts.append("control")
    if row.status != OK:
        parts.append(f"{row.status}: {row.reason}" if row.reason else row.status)
    elif not row.admitted:
        parts.append(row.reason or "not admitted")
    if row.thresholds:
        parts.append("other thresholds")
    if row.ivcs_nulls:
        parts.append("null: " + ", ".join(TITLES[name] for name in row.ivcs_nulls))
    return "; ".join(parts)
