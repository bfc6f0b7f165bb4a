"""First failures as tables (METHOD 6.12): of each label time the first stage that fails."""

from __future__ import annotations

from collections.abc import Sequence

from ssp_eval.analysis.table import Column, Table, Value
from ssp_eval.report.load import CellData
from ssp_eval.score import STAGES

STAGE_NAMES = dict(
    zip(
        STAGES,
        (
            "output validity", "semantics", "critical interaction", "action commitment",
            "trajectory quality", "text–trajectory consistency", "risk response",
        ),
        strict=True,
    )
)  # fmt: skip
NONE = "none"
_COUNTS = (*(Column(key, name, "count") for key, name in STAGE_NAMES.items()),)
_NOTES = (
    "Counts of label times: of each, the first stage of the chain that fails; none: it passes all.",
)


def failures_by_cell(cells: Sequence[CellData]) -> Table:
    """Every scored cell in the order given, controls too."""
    rows: tuple[tuple[Value, ...], ...] = tuple(
        (cell.scenario, cell.domain, cell.model, cell.score.n, *_counts(cell))
        for cell in cells
        if cell.score is not None
    )
    keys = (Column(key, key, "text") for key in ("scenario", "domain", "model"))
    return Table("first_failures", "First failures of each cell", _columns(*keys), rows, _NOTES)


def failures_by_model(cells: Sequence[CellData]) -> Table:
    """Every model and control over all its scored cells, controls last."""
    groups: dict[tuple[bool, str], list[CellData]] = {}
    for cell in cells:
        if cell.score is not None:
            groups.setdefault((cell.is_control, cell.model), []).append(cell)
    rows: list[tuple[Value, ...]] = []
    for (_, model), group in sorted(groups.items()):
        counts = [_counts(cell) for cell in group]
        labels = sum(cell.score.n for cell in group if cell.score is not None)
        rows.append((model, len(group), labels, *map(sum, zip(*counts, strict=True))))
    keys = (Column("model", "model", "text"), Column("cells", "cells", "count"))
    return Table(
        "first_failures_model", "First failures of each model", _columns(*keys), tuple(rows), _NOTES
    )


def _columns(*keys: Column) -> tuple[Column, ...]:
    return (*keys, Column("n", "labels", "count"), *_COUNTS, Column(NONE, "none", "count"))


def _counts(cell: CellData) -> tuple[int, ...]:
    """Per stage, and of the labels that pass all."""
    if cell.score is None:
        return ()
    found = [cell.score.details.first_failures[stage] for stage in STAGES]
    return (*found, cell.score.n - sum(found))
