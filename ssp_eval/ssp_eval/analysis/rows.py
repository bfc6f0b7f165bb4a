"""The rows of a campaign's folder; those of a CSV file come from cells_csv."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ssp_eval.analysis.row import OTHER_LABELS, CellRow
from ssp_eval.evaluate.admission import ADMITTED
from ssp_eval.labels.comparable import LabelComparison, compare_by_scenario
from ssp_eval.report.load import CellData, load_cells
from ssp_eval.score import DEFAULT


def rows_from_campaign(out: Path, run: str = "") -> list[CellRow]:
    """All cells of a campaign, scored again from their records; refused and failed ones too.

    Args:
        out: campaign folder.
        run: name of the repetition, where several campaigns are taken together.

    Raises:
        InputError: it is no campaign folder, or a file in it is damaged.
    """
    return rows_from_cells(load_cells(out), run)


def rows_from_cells(cells: list[CellData], run: str = "") -> list[CellRow]:
    """The rows of cells that were loaded already; see rows_from_campaign.

    Recordings whose labels can't be compared between domains (METHOD 5.2b) stay out of domain
    means, as those that the audit didn't admit.
    """
    compared = compared_labels(cells)
    return [_row_of(cell, run, compared.get(cell.scenario)) for cell in cells]


def compared_labels(cells: Iterable[CellData]) -> dict[str, LabelComparison]:
    """What the labels of each scenario's scored recordings allow, within one run."""
    return compare_by_scenario((c.scenario, c.domain, c.labels) for c in cells if c.score)


def _row_of(cell: CellData, run: str, compared: LabelComparison | None) -> CellRow:
    facts, score = cell.facts.model_facts, cell.score

    is_comparable = score is None or compared is None or compared.comparable
    reasons = [*cell.facts.reasons, *([] if is_comparable else [OTHER_LABELS])]

    def value(name: str) -> float | None:
        return None if score is None else getattr(score, name)

    return CellRow(
        scenario=cell.scenario,
        domain=cell.domain,
        model=cell.model,
        jovr=value("jovr"),
        sem_acc_eff=value("sem_acc_eff"),
        cia_eff=value("cia_eff"),
        act_acc_eff=value("act_acc_eff"),
        tqsr=value("tqsr"),
        atc_eff=value("atc_eff"),
        rsr=value("rsr"),
        rl_s=value("rl_s"),
        sem_cov=value("sem_cov"),
        stfr=value("stfr"),
        sem_acc_cond=value("sem_acc_cond"),
        sem_acc_soft=value("sem_acc_soft"),
        n=len(cell.labels.labels),
        run=run,
        total_b=facts.total_b,
        active_b=facts.active_b,
        architecture=facts.architecture,
        control=cell.is_control,
        admitted=cell.admission == ADMITTED and is_comparable,
        stand_in=cell.facts.stand_in,
        status=cell.facts.status,
        reason="; ".join(reasons),
        thresholds="" if cell.thresholds == DEFAULT else cell.thresholds.sha256,
    )
