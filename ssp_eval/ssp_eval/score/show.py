"""How scores are written for people; computing and rounding never meet anywhere else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from rich.table import Table
from rich.text import Text

from ssp_eval.score.cell import CellMetrics
from ssp_eval.score.ivcs import ivcs_weights

NULL = "–"
DISCLAIMER = "IVCS is no safety certificate."

_COLUMNS = (
    ("JOVR", "jovr"),
    ("SemCov", "sem_cov"),
    ("SemAcc cond", "sem_acc_cond"),
    ("SemAcc eff", "sem_acc_eff"),
    ("SemAcc soft", "sem_acc_soft"),
    ("CIA", "cia_eff"),
    ("ActAcc", "act_acc_eff"),
    ("STFR", "stfr"),
    ("TQSR", "tqsr"),
    ("ATC", "atc_eff"),
)


def format_ratio(value: float | None) -> str:
    """Three decimals, ``–`` for null (METHOD 6.11)."""
    return NULL if value is None else f"{value:.3f}"


def format_response(rsr: int, rl_s: float | None) -> str:
    """``S@1.50`` with the latency in seconds, or ``F`` (METHOD 6.9)."""
    return f"S@{rl_s:.2f}" if rsr and rl_s is not None else "F"


@dataclass(frozen=True)
class Scored:
    """A case and its scores.

    Args:
        name: of the case.
        records: how many it has.
        metrics: its scores.
    """

    name: str
    records: int
    metrics: CellMetrics

    @property
    def nulls(self) -> list[str]:
        """Components that are null and count as 0 in IVCS (METHOD 6.11)."""
        return [name for name in ivcs_weights() if getattr(self.metrics, name) is None]


def score_table(cases: Sequence[Scored]) -> Table:
    """The scores of several cells; ``*`` marks an IVCS in which a null component counts as 0."""
    table = Table(title="Scores per cell (METHOD 6)")
    table.add_column("case", no_wrap=True)
    table.add_column("matched", justify="right", no_wrap=True)
    for heading in [*(name for name, _ in _COLUMNS), "response", "IVCS"]:
        table.add_column(heading, justify="right", no_wrap=True)
    for case in cases:
        score = case.metrics
        flag = "*" if case.nulls else ""
        table.add_row(
            Text(case.name),
            f"{score.matched}/{score.n}",
            *(format_ratio(getattr(score, key)) for _, key in _COLUMNS),
            format_response(score.rsr, score.rl_s),
            format_ratio(score.ivcs) + flag,
        )
    return table


def score_notes(cases: Sequence[Scored]) -> list[str]:
    """The lines that belong under the table."""
    notes = [DISCLAIMER]
    for case in cases:
        if case.nulls:
            names = ", ".join(case.nulls)
            notes.append(f"* {case.name}: no denominator for {names}, counted as 0 in IVCS.")
        if unmatched := case.records - case.metrics.matched:
            notes.append(f"{case.name}: records that match no label, ignored: {unmatched}.")
    return notes
