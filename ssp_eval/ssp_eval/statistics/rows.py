"""A scored cell as one flat row, which is all that tables, statistics and figures take."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import permutations
from pathlib import Path

from ssp_eval.data.labels import LabelComparison, Labels, compare_by_scenario, compare_labels
from ssp_eval.evaluate.store.admission import ADMITTED
from ssp_eval.evaluate.store.cell_file import losses_text, outages
from ssp_eval.evaluate.store.results import CellData, load_cells
from ssp_eval.score.aggregate import Cell, mean
from ssp_eval.score.metrics import COMPONENTS, METRIC_NAMES, ivcs
from ssp_eval.score.thresholds import DEFAULT
from ssp_eval.statistics.names import doubtful_names

OK = "ok"
# Scenario or domain of a row that is a published mean over scenarios or domains: a macro row.
MACRO = "macro"
# Why an ok row stays out of domain means, where it isn't the audit that says so (METHOD 5.2b).
OTHER_LABELS = "not comparable: labels at different places within the phases across domains"


# The metrics that a row is made of; IVCS follows from the others.
GIVEN = tuple(name for name in METRIC_NAMES if name != "ivcs")


@dataclass(frozen=True, kw_only=True)
class Scores:
    """The metrics of GIVEN, in their order; None where one is null or not known."""

    jovr: float | None = None
    sem_cov: float | None = None
    sem_acc_cond: float | None = None
    sem_acc_eff: float | None = None
    sem_acc_soft: float | None = None
    cia_eff: float | None = None
    act_acc_eff: float | None = None
    stfr: float | None = None
    tqsr: float | None = None
    atc_eff: float | None = None
    rsr: float | None = None
    rl_s: float | None = None


@dataclass(frozen=True)
class CellRow(Scores):
    """One cell, scenario × domain × model, with its scores by the keys of METHOD 6.14.

    A score is None where it is null or not known. RSR is 1 or 0; where several runs of a cell are
    taken together, and in a macro row, it is a mean.

    Args:
        admitted: False keeps it out of domain means (METHOD 4 and 5.2b).
        status: ok, refused or failed; only an ok one has scores.
        reason: why it is not ok, or OTHER_LABELS; of an ok one also what an outage cost, and who
            drove the recording.
        lost: answers that an outage cost: they count as missing outputs in every mean.
        declared_by: who says of which domain the recording is; empty where no person had to.
        thresholds: hash of those that it was scored with; empty: METHOD's, or not stated.
        weighted: IVCS where it isn't METHOD 6.10 of this row's components: a mean over runs, or as
            it was published of a macro row.
    """

    scenario: str
    domain: str
    model: str
    n: int | None = None
    run: str = ""
    seed: int | None = None
    total_b: float | None = None
    active_b: float | None = None
    architecture: str = ""
    control: bool = False
    admitted: bool = True
    stand_in: bool = False
    status: str = OK
    reason: str = ""
    lost: int = 0
    thresholds: str = ""
    declared_by: str = ""
    weighted: float | None = None

    @property
    def ivcs(self) -> float | None:
        """IVCS of the components (METHOD 6.10), a null one as 0; None unless the cell is ok."""
        if self.status != OK:
            return None
        return self.weighted if self.weighted is not None else ivcs(self.components)

    @property
    def components(self) -> dict[str, float | None]:
        """Return the components of IVCS by name."""
        return {name: getattr(self, name) for name in COMPONENTS}

    @property
    def ivcs_nulls(self) -> tuple[str, ...]:
        """Components that are null and count as 0 in IVCS (METHOD 6.11); to be flagged."""
        if self.status != OK:
            return ()
        return tuple(name for name, value in self.components.items() if value is None)

    @property
    def key(self) -> tuple[str, str, str]:
        """Return the identity of the cell."""
        return self.scenario, self.domain, self.model

    @property
    def over(self) -> frozenset[str]:
        """Return what a macro row is a mean over: scenario, domain or both; empty for a cell."""
        return frozenset(name for name in ("scenario", "domain") if getattr(self, name) == MACRO)

    def cell(self) -> Cell:
        """Make the cell that ssp_eval.score.aggregate takes."""
        score = {name: getattr(self, name) for name in METRIC_NAMES}
        return Cell(*self.key, score, self.admitted)


def entering(rows: Iterable[CellRow]) -> list[CellRow]:
    """Return the rows that may enter means and ranks: valid ones, controls left out; one per cell.

    Cells that were scored with other thresholds than the rest are left out too.
    """
    return merged([row for row in one_scale(rows) if row.status == OK and not row.control])


def one_scale(rows: Iterable[CellRow]) -> list[CellRow]:
    """Return the rows that one scale measures.

    That is METHOD's thresholds if any cell has them, else those of most cells. Rows without a score
    have no scale, and stay.
    """
    listed = list(rows)
    main = scale(listed)
    return [row for row in listed if row.status != OK or row.thresholds == main]


def scale(rows: Iterable[CellRow]) -> str:
    """Hash of the thresholds whose cells enter means, see one_scale; empty: METHOD's."""
    counts = Counter(row.thresholds for row in rows if row.status == OK)
    return min(counts, key=lambda name: (name != "", -counts[name], name), default="")


def merged(rows: Sequence[CellRow]) -> list[CellRow]:
    """Return one row per cell, with the means of the metrics over its runs; RL over successes only.

    Runs that were scored with different thresholds stay apart.

    Args:
        rows: valid ones. A cell is admitted if all its runs are.
    """
    runs: dict[tuple[str, ...], list[CellRow]] = {}
    for row in rows:
        runs.setdefault((*row.key, row.thresholds), []).append(row)
    return [group[0] if len(group) == 1 else _merge(group) for group in runs.values()]


def _merge(group: Sequence[CellRow]) -> CellRow:
    values = {name: mean(getattr(row, name) for row in group).value for name in GIVEN}
    return replace(
        group[0],
        **values,  # type: ignore[arg-type]  # the names are those of METRICS
        weighted=mean(row.ivcs for row in group).value,
        admitted=all(row.admitted for row in group),
        lost=sum(row.lost for row in group),
        run=f"mean of {len(group)} runs",
        seed=None,
        n=group[0].n if len({row.n for row in group}) == 1 else None,
    )


def over_what(rows: Iterable[CellRow]) -> frozenset[str]:
    """Return what these rows are means over, see CellRow.over; a file has rows of one kind only."""
    return frozenset().union(*(row.over for row in rows))


def repeated(rows: Iterable[CellRow]) -> bool:
    """Return True where some cell has more than one run."""
    keys = [row.key for row in rows if row.status == OK and not row.control]
    return len(keys) != len(set(keys))


def rows_from_campaign(out: Path, run: str = "") -> list[CellRow]:
    """Load all cells of a campaign, scored again from their records; refused and failed ones too.

    Args:
        out: campaign folder.
        run: name of the repetition, where several campaigns are taken together.

    Raises:
        InputError: it is no campaign folder, or a file in it is damaged.
    """
    return rows_from_cells(load_cells(out), run)


def rows_from_cells(cells: list[CellData], run: str = "") -> list[CellRow]:
    """Return the rows of cells that were loaded already; see rows_from_campaign.

    Recordings whose labels can't be compared between domains (METHOD 5.2b) stay out of domain
    means, as those that the audit didn't admit.
    """
    compared = compared_labels(cells)
    return [_row_of(cell, run, compared.get(cell.scenario)) for cell in cells]


def compared_labels(cells: Iterable[CellData]) -> dict[str, LabelComparison]:
    """Compare the labels of each scenario's scored recordings, within one run."""
    return compare_by_scenario((c.scenario, c.domain, c.labels) for c in cells if c.score)


def apart_across_runs(cells: Iterable[CellData]) -> set[str]:
    """Return the scenarios that aren't comparable between domains over the runs of all cells.

    In these, some labels of one domain have no comparable ones in another (METHOD 5.2b).
    """
    by_scenario: dict[str, dict[str, dict[Labels, None]]] = {}
    for cell in cells:
        if cell.score:
            domains = by_scenario.setdefault(cell.scenario, {})
            domains.setdefault(cell.domain, {})[cell.labels] = None

    def comparable(one: Labels, others: Iterable[Labels]) -> bool:
        return any(compare_labels({"one": one, "other": other}).comparable for other in others)

    return {
        scenario
        for scenario, domains in by_scenario.items()
        for own, others in permutations(domains.values(), 2)
        if not all(comparable(one, others) for one in own)
    }


def without_domains(row: CellRow) -> CellRow:
    """Return a scored row kept out of domain means, with OTHER_LABELS among its reasons."""
    if row.status != OK or OTHER_LABELS in row.reason:
        return row
    reason = "; ".join(filter(None, (row.reason, OTHER_LABELS)))
    return replace(row, admitted=False, reason=reason)


def _row_of(cell: CellData, run: str, compared: LabelComparison | None) -> CellRow:
    facts, score = cell.facts.model_facts, cell.score

    is_comparable = score is None or compared is None or compared.comparable
    reasons = [*cell.facts.reasons, *([] if is_comparable else [OTHER_LABELS])]
    lost = outages(cell.facts.answers.missing_by_kind)
    if lost:
        reasons.append(losses_text(lost))

    if driver := cell.facts.clip.driven_by:
        reasons.append(f"driven by {driver}")

    scores = {name: None if score is None else getattr(score, name) for name in GIVEN}
    return CellRow(
        scenario=cell.scenario,
        domain=cell.domain,
        model=cell.model,
        **scores,
        n=len(cell.labels.labels),
        run=run,
        total_b=facts.total_b,
        active_b=facts.active_b,
        architecture=facts.architecture,
        control=cell.is_control,
        admitted=cell.admission == ADMITTED and is_comparable,
        stand_in=cell.facts.stand_in,
        declared_by=cell.facts.clip.declared_by,
        status=cell.facts.status,
        reason="; ".join(reasons),
        lost=0 if score is None else sum(lost.values()),
        thresholds="" if cell.thresholds == DEFAULT else cell.thresholds.sha256,
    )


def doubtful(rows: Iterable[CellRow]) -> list[tuple[str, tuple[str, ...]]]:
    """Find names of rows that a reader of means must know of, see doubtful_names."""
    models = [row for row in rows if not row.control]
    scenarios = [row.scenario for row in models if row.scenario != MACRO]
    return doubtful_names({"scenario": scenarios, "model": [row.model for row in models]})
