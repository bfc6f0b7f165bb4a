"""Ranks of models or domains by IVCS, per scenario and over all (METHOD 6.13)."""

from __future__ import annotations

from collections.abc import Sequence

from ssp_eval.analysis.row import MACRO
from ssp_eval.analysis.table import Column, Table
from ssp_eval.score.aggregate import Cell, Ranking, means, ranking

# Of more scenarios than these there are too many pairs to read.
MOST_PAIRED = 6
CHANGES = "changes"


def rank_table(cells: Sequence[Cell], subject: str, notes: Sequence[str]) -> Table:
    """Ranks by IVCS per scenario and over all, every change of rank pointed out.

    Args:
        cells: that enter means.
        subject: ``model`` or ``domain``.
        notes: to stand under it.
    """
    found = ranking(cells, subject)
    scenarios = sorted(name for name in found.scenarios if name != MACRO)
    values = {key[0]: value["ivcs"] for key, value in means(cells, (subject,)).items()}
    rows = tuple(
        (
            name,
            *(found.scenarios[scenario].get(name) for scenario in scenarios),
            found.macro[name],
            values[name],
            _changes(found, name),
        )
        for name in sorted(found.macro, key=lambda n: (found.macro[n] or len(values), n))
    )
    columns = (
        Column(subject, subject, "text"),
        *(Column(f"rank_{name}", name.replace("_", " "), "count") for name in scenarios),
        Column("rank_all", "all", "count"),
        Column("ivcs", "mean IVCS"),
        Column(CHANGES, "changes of rank", "text"),
    )
    said = ["Rank 1 is the largest mean IVCS, from unrounded values; equal ones share a rank."]
    if not found.changes and len(scenarios) > 1:
        said.append("No rank changes between scenarios.")
    return Table(f"ranks_{subject}", f"Ranks of {subject}s", columns, rows, (*said, *notes))


def _changes(found: Ranking, name: str) -> str:
    """``2 in cut_in, 1 in vru_crossing`` for each pair; of many scenarios the range."""
    changes = [change for change in found.changes if change.subject == name]
    if not changes:
        return ""
    if len(found.scenarios) <= MOST_PAIRED:
        return "; ".join(
            f"{change.ranks[0]} in {change.scenarios[0]}, {change.ranks[1]} in "
            f"{change.scenarios[1]}"
            for change in changes
        )
    ranks = [
        (rank, scenario)
        for scenario in sorted(found.scenarios)
        if (rank := found.scenarios[scenario].get(name)) is not None
    ]
    best, worst = min(ranks), max(ranks, key=lambda pair: pair[0])
    return (
        f"from {best[0]} in {best[1]} to {worst[0]} in {worst[1]}, "
        f"{len({rank for rank, _ in ranks})} different ranks in {len(ranks)} scenarios"
    )
