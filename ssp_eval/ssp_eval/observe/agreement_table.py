"""Where two or more observers agree, as a table."""

from __future__ import annotations

from rich.table import Table

from ssp_eval.recordings.agreement import Agreement


def agreement_table(found: Agreement) -> Table:
    """Field, each observer's answer, how they agree, and what counts."""
    table = Table(box=None, pad_edge=False)
    for name in ("field", *found.observers, "", "counts"):
        table.add_column(name, overflow="fold")
    for row in found.rows:
        table.add_row(row.field, *row.values, row.verdict, row.result)
    return table


def agreement_summary(found: Agreement) -> str:
    """One sentence."""
    differing = found.differing
    if not differing:
        return f"{found.by} differ in nothing (times within {found.tolerance_s:g} s)"
    return f"{found.by} differ in {len(differing)}: {', '.join(differing)}"
