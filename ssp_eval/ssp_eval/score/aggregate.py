"""Means, ranks and relative differences over cells (METHOD 6.13)."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

from ssp_core.vocabulary import DOMAINS
from ssp_eval.score.metrics import METRIC_NAMES

# Values that differ by less are equal: what is left is rounding. Equal parts of IVCS need not have
# the same last digit: 0.3 · 1/3 is less than 0.1 in floating point.
EQUAL = 1e-12

# The groupings of METHOD 6.13.
BY_DOMAIN = ("domain",)
BY_MODEL = ("model",)
BY_SCENARIO_DOMAIN = ("scenario", "domain")
BY_SCENARIO_MODEL = ("scenario", "model")


@dataclass(frozen=True)
class Cell:
    """A scored cell with its score output (METHOD 6.14).

    Args:
        domain: synthetic, simulation or physical.
        score: at least the keys of METRIC_NAMES, unrounded, null as None.
        admitted: False where the audit refused a partner of the recording, or where no audit
            knows it; such a cell stays out of domain means (METHOD 4).
    """

    scenario: str
    domain: str
    model: str
    score: Mapping[str, float | None]
    admitted: bool = True


@dataclass(frozen=True)
class Mean:
    """An unweighted mean with the number of cells that it is taken over.

    Args:
        value: None if no cell has a value.
        n: cells with a value; null ones (an empty denominator, RL of a failure) don't count.
    """

    value: float | None
    n: int


def mean(values: Iterable[float | None]) -> Mean:
    """Return the unweighted mean of the values that aren't null; their order doesn't matter."""
    present = [value for value in values if value is not None]
    return Mean(math.fsum(present) / len(present) if present else None, len(present))


def means(cells: Sequence[Cell], by: Sequence[str]) -> dict[tuple[str, ...], dict[str, Mean]]:
    """Return the mean of every metric per group (METHOD 6.13): RSR as 0/1, RL over successes only.

    Args:
        cells: those that are valid; a run that isn't never gets here.
        by: BY_DOMAIN, BY_MODEL, BY_SCENARIO_DOMAIN or BY_SCENARIO_MODEL. Cells that aren't
            admitted are left out where the grouping has the domain.

    Returns:
        Per group, in sorted order, the means by metric.

    Raises:
        ValueError: the same scenario, domain and model occurs twice.
    """
    _refuse_duplicates(cells)
    groups: dict[tuple[str, ...], list[Cell]] = {}
    for cell in cells:
        if cell.admitted or "domain" not in by:
            groups.setdefault(tuple(getattr(cell, key) for key in by), []).append(cell)
    return {
        key: {metric: mean(cell.score[metric] for cell in group) for metric in METRIC_NAMES}
        for key, group in sorted(groups.items())
    }


def _refuse_duplicates(cells: Sequence[Cell]) -> None:
    keys: set[tuple[str, str, str]] = set()
    for cell in cells:
        key = (cell.scenario, cell.domain, cell.model)
        if key in keys:
            raise ValueError(f"cell {' / '.join(key)} occurs twice")
        keys.add(key)


def ranks(values: Mapping[str, float | None]) -> dict[str, int | None]:
    """Rank per subject, 1 for the largest value; equal ones (EQUAL) share a rank, null has none."""
    present = [value for value in values.values() if value is not None]
    return {
        subject: None if value is None else 1 + sum(other > value + EQUAL for other in present)
        for subject, value in values.items()
    }


@dataclass(frozen=True)
class RankChange:
    """A subject whose rank differs between two scenarios.

    Args:
        scenarios: the two scenarios, in sorted order.
    """

    subject: str
    scenarios: tuple[str, str]
    ranks: tuple[int, int]


@dataclass(frozen=True)
class Ranking:
    """Ranks of models or domains by one metric (METHOD 6.13).

    Args:
        scenarios: per scenario, rank by subject.
        changes: every change of rank between two scenarios; pointed out, not averaged away.
    """

    scenarios: dict[str, dict[str, int | None]]
    macro: dict[str, int | None]
    changes: tuple[RankChange, ...]


def ranking(cells: Sequence[Cell], subject: str, metric: str = "ivcs") -> Ranking:
    """Rank per scenario and for the macro average, from unrounded means (METHOD 6.13).

    Args:
        cells: those that enter means.
        subject: what is ranked: "model" or "domain".
        metric: one of METRIC_NAMES; the larger the better.

    Raises:
        ValueError: see means.
    """
    per_scenario: dict[str, dict[str, float | None]] = {}
    for (scenario, name), group in means(cells, ("scenario", subject)).items():
        per_scenario.setdefault(scenario, {})[name] = group[metric].value
    macro = {name: group[metric].value for (name,), group in means(cells, (subject,)).items()}
    by_scenario = {scenario: ranks(values) for scenario, values in per_scenario.items()}
    return Ranking(by_scenario, ranks(macro), tuple(_changes(by_scenario, sorted(macro))))


def domain_order(domain: str) -> tuple[int, str]:
    """Sort domains as METHOD names them, and everything else by name after them."""
    return (DOMAINS.index(domain) if domain in DOMAINS else len(DOMAINS), domain)


def _changes(
    by_scenario: Mapping[str, Mapping[str, int | None]], subjects: Sequence[str]
) -> Iterable[RankChange]:
    for subject in subjects:
        for first, second in combinations(sorted(by_scenario), 2):
            before = by_scenario[first].get(subject)
            after = by_scenario[second].get(subject)
            if before is not None and after is not None and before != after:
                yield RankChange(subject, (first, second), (before, after))


def relative_difference(value: float | None, reference: float | None) -> float | None:
    """Return (value − reference) / |reference|, unrounded; None if it has no meaning."""
    if value is None or reference is None or reference == 0:
        return None
    return (value - reference) / abs(reference)
