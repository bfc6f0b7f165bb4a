"""How much scores and ranks differ between repetitions of the same cells (METHOD 6.13)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ssp_eval.analysis.bootstrap import Estimate
from ssp_eval.analysis.clusters import bootstrap_mean
from ssp_eval.analysis.compare import t_interval
from ssp_eval.analysis.resample import Interval
from ssp_eval.analysis.row import OK, CellRow
from ssp_eval.analysis.sensitivity import kendall_tau, signs
from ssp_eval.analysis.tables import sd
from ssp_eval.score.aggregate import BY_DOMAIN, BY_MODEL, mean, means

METRICS = ("ivcs", "jovr", "sem_acc_eff", "cia_eff", "tqsr", "rsr")


@dataclass(frozen=True)
class Spread:
    """A score over K runs.

    Args:
        names: of the cell, or of the domain or model whose macro mean it is.
        metric: of METHOD 6.14.
        k: runs that have the score.
        value: their mean.
        sd: standard deviation of a sample.
        low, high: least and greatest.
        interval: Student's t, 95 %.
        bootstrap: over the runs.
    """

    names: tuple[str, ...]
    metric: str
    k: int
    value: float
    sd: float
    low: float
    high: float
    interval: Interval
    bootstrap: Estimate


@dataclass(frozen=True)
class Stability:
    """Over the runs of a set of cells.

    Args:
        cells: per cell with at least two runs, and metric.
        macro: per domain and per model, over runs that have the same cells.
        tau: mean Kendall's τ_b between the models' ranks of two runs; None where there are fewer
            than two models or runs.
        same_order: share of pairs of runs in which all models stand in the same order.
        runs: names of the runs that macro and tau are of.
    """

    cells: tuple[Spread, ...]
    macro: tuple[Spread, ...]
    tau: float | None
    same_order: float | None
    runs: tuple[str, ...]


def run_name(row: CellRow) -> str:
    """What tells the runs of a cell apart."""
    return row.run if row.seed is None else f"{row.run} seed {row.seed}".strip()


def stability(rows: Sequence[CellRow], resamples: int, seed: int) -> Stability | None:
    """How the runs differ; None where no cell has two.

    Args:
        rows: all runs; controls and cells without a score are left out here.
        resamples, seed: of the bootstrap over runs.
    """
    valid = [row for row in rows if row.status == OK and not row.control]
    by_cell: dict[tuple[str, ...], list[CellRow]] = {}
    by_run: dict[str, list[CellRow]] = {}
    for row in valid:
        by_cell.setdefault(row.key, []).append(row)
        by_run.setdefault(run_name(row), []).append(row)
    if all(len(group) < 2 for group in by_cell.values()):
        return None
    cells = [
        spread
        for key, group in sorted(by_cell.items())
        for metric in METRICS
        if (spread := _spread(key, metric, _values(group, metric), resamples, seed))
    ]
    whole = _alike(by_run)
    macro, orders = [], []
    for by in (BY_DOMAIN, BY_MODEL):
        per_run = [means([row.cell() for row in by_run[name]], by) for name in whole]
        for key in sorted(per_run[0]):
            for metric in METRICS:
                found = [run[key][metric].value for run in per_run if key in run]
                values = [value for value in found if value is not None]
                if spread := _spread((*by, *key), metric, values, resamples, seed):
                    macro.append(spread)
        if by == BY_MODEL and len(per_run[0]) > 1:
            names = sorted(per_run[0])
            orders = [
                signs(np.array([run[name]["ivcs"].value or 0.0 for name in names]))
                for run in per_run
                if sorted(run) == names
            ]
    pairs = list(combinations(orders, 2))
    taus = [float(kendall_tau(a, b)) for a, b in pairs]
    return Stability(
        tuple(cells),
        tuple(macro),
        mean(tau for tau in taus if not np.isnan(tau)).value,
        mean(float(np.array_equal(a, b)) for a, b in pairs).value,
        tuple(whole),
    )


def _alike(by_run: Mapping[str, Sequence[CellRow]]) -> list[str]:
    """The runs that have the same cells, for the largest set of cells that several runs have."""
    having: dict[frozenset[tuple[str, str, str]], list[str]] = {}
    for name in sorted(by_run):
        having.setdefault(frozenset(row.key for row in by_run[name]), []).append(name)

    def worth(cells: frozenset[tuple[str, str, str]]) -> tuple[bool, int, int]:
        return len(having[cells]) > 1, len(cells), len(having[cells])

    return having[max(having, key=worth)]


def _values(rows: Sequence[CellRow], metric: str) -> list[float]:
    return [value for row in rows if (value := getattr(row, metric)) is not None]


def _spread(
    names: tuple[str, ...], metric: str, values: Sequence[float], resamples: int, seed: int
) -> Spread | None:
    deviation = sd(values)
    if deviation is None:
        return None
    by_run = {f"{number:06d}": [value] for number, value in enumerate(sorted(values))}
    over_runs = bootstrap_mean(by_run, "runs", resamples, seed, "runs", metric, *names)
    return Spread(
        names,
        metric,
        len(values),
        mean(values).value or 0.0,
        deviation,
        min(values),
        max(values),
        t_interval(values),
        over_runs,
    )
