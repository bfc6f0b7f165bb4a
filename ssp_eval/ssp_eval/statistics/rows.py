"""A scored cell as one flat row, which is all that tables, statistics and figures take."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, make_dataclass, replace
from pathlib import Path

from ssp_eval.data.labels import LabelComparison, compare_by_scenario
from ssp_eval.evaluate.admission import ADMITTED
from ssp_eval.evaluate.results import CellData, load_cells
from ssp_eval.score.aggregate import Cell, mean
from ssp_eval.score.metrics import COMPONENTS, METRIC_NAMES, ivcs
from ssp_eval.score.thresholds import DEFAULT

OK = "ok"
# Scenario or domain of a row that is a published mean over scenarios or domains: a macro row.
MACRO = "macro"
# Why an ok row stays out of domain means, where it isn't the audit that says so (METHOD 5.2b).
OTHER_LABELS = "not comparable: labels at other places of the phases in other domains"


# IVCS follows from the others.
_GIVEN = tuple(name for name in METRIC_NAMES if name != "ivcs")


@dataclass(frozen=True)
class CellRow(
    make_dataclass(  # type: ignore[misc]  # its scores are the metrics
        "Scores", [(name, float | None, None) for name in _GIVEN], frozen=True, kw_only=True
    )
):
    """One cell, scenario × domain × model, with its scores by the keys of METHOD 6.14.

    A score is None where it is null or not known. RSR is 1 or 0; where several runs of a cell are
    taken together, and in a macro row, it is a mean.

    Args:
        admitted: False keeps it out of domain means (METHOD 4 and 5.2b).
        status: ok, refused or failed; only an ok one has scores.
        reason: why it is not ok, or OTHER_LABELS.
        thresholds: hash of those that it was scored with; empty: METHOD's, or nobody said.
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
    thresholds: str = ""
    weighted: float | None = None

    @property
    def ivcs(self) -> float | None:
        """IVCS of the components (METHOD 6.10), a null one as 0; None unless the cell is ok."""
        if self.status != OK:
            return None
        return self.weighted if self.weighted is not None else ivcs(self.components)

    @property
    def components(self) -> dict[str, float | None]:
        """What IVCS is made of, by name."""
        return {name: getattr(self, name) for name in COMPONENTS}

    @property
    def ivcs_nulls(self) -> tuple[str, ...]:
        """Components that are null and count as 0 in IVCS (METHOD 6.11); to be flagged."""
        if self.status != OK:
            return ()
        return tuple(name for name, value in self.components.items() if value is None)

    @property
    def key(self) -> tuple[str, str, str]:
        """Which cell it is."""
        return self.scenario, self.domain, self.model

    @property
    def over(self) -> frozenset[str]:
        """What a macro row is a mean over: scenario, domain or both; empty for a cell."""
        return frozenset(name for name in ("scenario", "domain") if getattr(self, name) == MACRO)

    def cell(self) -> Cell:
        """As ssp_eval.score.aggregate takes it."""
        score = {name: getattr(self, name) for name in METRIC_NAMES}
        return Cell(*self.key, score, self.admitted)


def entering(rows: Iterable[CellRow]) -> list[CellRow]:
    """The rows that may enter means and ranks: valid ones, controls left out; one per cell.

    Cells that were scored with other thresholds than the rest are left out too.
    """
    return merged([row for row in one_scale(rows) if row.status == OK and not row.control])


def one_scale(rows: Iterable[CellRow]) -> list[CellRow]:
    """The rows that one scale measures: METHOD's thresholds if any cell has them, else those of
    most cells. Rows without a score have no scale, and stay.
    """
    listed = list(rows)
    main = scale(listed)
    return [row for row in listed if row.status != OK or row.thresholds == main]


def scale(rows: Iterable[CellRow]) -> str:
    """Hash of the thresholds whose cells enter means, see one_scale; empty: METHOD's."""
    counts = Counter(row.thresholds for row in rows if row.status == OK)
    return min(counts, key=lambda name: (name != "", -counts[name], name), default="")


def merged(rows: Sequence[CellRow]) -> list[CellRow]:
    """One row per cell, with the means of the metrics over its runs; RL over successes only.

    Runs that were scored with different thresholds stay apart.

    Args:
        rows: valid ones. A cell is admitted if all its runs are.
    """
    runs: dict[tuple[str, ...], list[CellRow]] = {}
    for row in rows:
        runs.setdefault((*row.key, row.thresholds), []).append(row)
    return [group[0] if len(group) == 1 else _merge(group) for group in runs.values()]


def _merge(group: Sequence[CellRow]) -> CellRow:
    values = {name: mean(getattr(row, name) for row in group).value for name in _GIVEN}
    return replace(
        group[0],
        **values,  # type: ignore[arg-type]  # the names are those of METRICS
        weighted=mean(row.ivcs for row in group).value,
        admitted=all(row.admitted for row in group),
        run=f"mean of {len(group)} runs",
        seed=None,
        n=group[0].n if len({row.n for row in group}) == 1 else None,
    )


def over_what(rows: Iterable[CellRow]) -> frozenset[str]:
    """What these rows are means over, see CellRow.over; a file has rows of one kind alone."""
    return frozenset().union(*(row.over for row in rows))


def repeated(rows: Iterable[CellRow]) -> bool:
    """True where some cell has more than one run."""
    keys = [row.key for row in rows if row.status == OK and not row.control]
    return len(keys) != len(set(keys))


def rows_from_campaign(out: Path, run: str = "") -> list[CellRow]:
    """All cells of a campaign, scored again from their records; refused and failed ones too.

    Args:
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

    scores = {name: None if score is None else getattr(score, name) for name in _GIVEN}
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
        status=cell.facts.status,
        reason="; ".join(reasons),
        thresholds="" if cell.thresholds == DEFAULT else cell.thresholds.sha256,
    )
