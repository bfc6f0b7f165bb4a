"""What the head of the page says of a campaign: who was evaluated on what, and how many cells."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ssp_eval.report.load import CellData


@dataclass(frozen=True)
class Summary:
    """Names and counts.

    Args:
        title: of the page.
        scenarios, domains: names.
        models: names of models.
        controls: names of controls.
        labels: label times of scored cells, of models and of controls.
        scored: scored cells of models, and how many there are.
        scored_controls: the same of controls.
        statuses: cells without a score by status.
        missing: answers that didn't come, of models and of controls.
        admissions: what audits say of the cells.
        audit_links: scenario and page of each audit.
    """

    title: str
    scenarios: tuple[str, ...]
    domains: tuple[str, ...]
    models: tuple[str, ...]
    controls: tuple[str, ...]
    labels: tuple[int, int]
    scored: tuple[int, int]
    scored_controls: tuple[int, int]
    statuses: Mapping[str, int]
    missing: tuple[int, int]
    admissions: tuple[str, ...]
    audit_links: tuple[tuple[str, str], ...]


def summary(cells: Sequence[CellData], audits: Mapping[str, str]) -> Summary:
    """The summary of all cells of a campaign.

    Args:
        cells: in the order in which they are shown.
        audits: path of an audit's page by the audit's hash.
    """
    own = [cell for cell in cells if not cell.is_control]
    controls = [cell for cell in cells if cell.is_control]
    models = tuple(dict.fromkeys(cell.model for cell in own))
    scenarios = tuple(sorted({cell.scenario for cell in cells}))
    return Summary(
        title=_title(models, scenarios),
        scenarios=scenarios,
        domains=tuple(dict.fromkeys(cell.domain for cell in cells)),
        models=models,
        controls=tuple(sorted({cell.model for cell in controls})),
        labels=(_labels(own), _labels(controls)),
        scored=_scored(own),
        scored_controls=_scored(controls),
        statuses=dict(sorted(Counter(c.facts.status for c in cells if not c.score).items())),
        missing=(_missing(own), _missing(controls)),
        admissions=tuple(sorted({cell.admission for cell in cells})),
        audit_links=tuple(_audit_links(cells, audits).items()),
    )


def _scored(cells: Sequence[CellData]) -> tuple[int, int]:
    return sum(cell.score is not None for cell in cells), len(cells)


def _labels(cells: Sequence[CellData]) -> int:
    return sum(cell.score.n for cell in cells if cell.score is not None)


def _missing(cells: Sequence[CellData]) -> int:
    return sum(len(cell.facts.answers.missing) for cell in cells if cell.score is not None)


def _title(models: Sequence[str], scenarios: Sequence[str]) -> str:
    """Who was evaluated on what, in words; counts where there are many."""

    def listed(names: Sequence[str], many: str) -> str:
        words = [name.replace("_", " ") for name in names]
        return " and ".join(words) if 0 < len(words) <= 2 else f"{len(words)} {many}"

    title = f"{listed(models, 'models')} on {listed(scenarios, 'scenarios')}"
    return title[0].upper() + title[1:]


def _audit_links(cells: Sequence[CellData], audits: Mapping[str, str]) -> dict[str, str]:
    """Page of the audit by scenario."""
    found: dict[str, str] = {}
    for cell in cells:
        page = audits.get(cell.audit_sha256 or "")
        if page is not None:
            found.setdefault(cell.scenario, page)
    return found
