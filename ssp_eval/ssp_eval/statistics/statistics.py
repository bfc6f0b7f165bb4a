"""All statistics of a set of cells: from rows alone, and from records where there are any."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from types import MappingProxyType

import numpy as np

from ssp_eval.evaluate.store.results import CellData
from ssp_eval.score.aggregate import (
    BY_DOMAIN,
    BY_MODEL,
    BY_SCENARIO_DOMAIN,
    BY_SCENARIO_MODEL,
    Cell,
    mean,
    means,
)
from ssp_eval.score.engine import cell_terms
from ssp_eval.score.metrics import IVCS_FIRST
from ssp_eval.statistics.bootstrap import (
    RESAMPLES,
    SEED,
    Bootstrap,
    Estimate,
    Group,
    bootstrap_mean,
    bootstrap_records,
)
from ssp_eval.statistics.comparisons import Comparison, compare
from ssp_eval.statistics.constants import Place
from ssp_eval.statistics.resampling import NO_INTERVAL, Interval, sd, t_interval
from ssp_eval.statistics.rows import OK, CellRow, entering, one_scale, over_what
from ssp_eval.statistics.sensitivity import WeightSamples, kendall_tau, sample_weights, signs


@dataclass(frozen=True)
class Spread:
    """A score over K runs.

    Args:
        names: of the cell, or of the domain or model whose macro mean it is.
        interval: Student's t, 95 %.
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
    """The stability over the runs of a set of cells.

    Args:
        cells: per cell with at least two runs, and metric.
        macro: per domain and per model, over runs that have the same cells.
        tau: mean Kendall's τ_b between the models' ranks of two runs; None where there are fewer
            than two models or runs.
        same_order: share of pairs of runs in which all models stand in the same order.
    """

    cells: tuple[Spread, ...]
    macro: tuple[Spread, ...]
    tau: float | None
    same_order: float | None
    runs: tuple[str, ...]


# A repetition: its run and seed.
Run = tuple[str, int | None]


def run_name(run: Run) -> str:
    """Return the name of a repetition, for people; two can share it ("a seed 1")."""
    name, seed = run
    return name if seed is None else f"{name} seed {seed}".strip()


def stability(rows: Sequence[CellRow], resamples: int, seed: int) -> Stability | None:
    """Compute how the runs differ; None where no cell has two.

    A cell is admitted if all its runs are, as in the means over runs: otherwise the domain means of
    two runs would be over different recordings.

    Args:
        rows: all runs; controls and cells without a score are left out here.
        resamples: of the intervals.
        seed: of the random numbers.
    """
    valid = [row for row in rows if row.status == OK and not row.control]
    outside = {row.key for row in valid if not row.admitted}
    valid = [replace(row, admitted=row.key not in outside) for row in valid]
    by_cell: dict[tuple[str, ...], list[CellRow]] = {}
    by_run: dict[Run, list[CellRow]] = {}
    for row in valid:
        by_cell.setdefault(row.key, []).append(row)
        by_run.setdefault((row.run, row.seed), []).append(row)
    if all(len(group) < 2 for group in by_cell.values()):
        return None
    cells = [
        spread
        for key, group in sorted(by_cell.items())
        for metric in IVCS_FIRST
        if (spread := _spread(key, metric, _values(group, metric), resamples, seed))
    ]
    whole = _alike(by_run)
    macro, orders = [], []
    for by in (BY_DOMAIN, BY_MODEL):
        per_run = [means([row.cell() for row in by_run[run]], by) for run in whole]
        for key in sorted(per_run[0]):
            for metric in IVCS_FIRST:
                run_means = [run[key][metric].value for run in per_run if key in run]
                values = [value for value in run_means if value is not None]
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
        tuple(map(run_name, whole)),
    )


def _alike(by_run: Mapping[Run, Sequence[CellRow]]) -> list[Run]:
    """Return the runs with the same cells, for the largest set of cells of several runs."""
    having: dict[frozenset[tuple[str, str, str]], list[Run]] = {}
    for run in sorted(by_run, key=lambda one: (run_name(one), one[0])):
        having.setdefault(frozenset(row.key for row in by_run[run]), []).append(run)

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


SUBJECTS = ("model", "domain")
GROUPINGS = (BY_DOMAIN, BY_MODEL, BY_SCENARIO_DOMAIN, BY_SCENARIO_MODEL)


@dataclass(frozen=True)
class Options:
    """The settings that random numbers depend on.

    Args:
        resamples: of every bootstrap, and sets of weights.
        block: labels that are drawn together; None: ssp_eval.statistics.resampling.block_of.
    """

    resamples: int = RESAMPLES
    seed: int = SEED
    block: int | None = None


@dataclass(frozen=True)
class Statistics:
    """The content of ``statistics.json``.

    Args:
        records: intervals over records; None where only component scores are known.
        over_cells: mean IVCS by grouping and group, its interval over the cells, and over their
            scenarios where these differ from cells.
        comparisons: of domains, then of models.
        weights: ranks under random weights, per subject that has at least two names.
        runs: how repetitions differ; None without any.
    """

    records: Bootstrap | None
    over_cells: dict[Group, dict[Group, tuple[Estimate, ...]]]
    comparisons: tuple[Comparison, ...]
    weights: tuple[WeightSamples, ...]
    runs: Stability | None


def steps_of(rows: Sequence[CellRow], has_records: bool) -> int:
    """Return how often compute calls on_step."""
    valid = [row for row in one_scale(rows) if row.status == OK and not row.control]
    return (len(valid) if has_records else 0) + len(SUBJECTS)


def compute(
    rows: Sequence[CellRow],
    data: Sequence[CellData] = (),
    options: Options = Options(),
    on_step: Callable[[], None] = lambda: None,
    constants: Mapping[Place, Cell] = MappingProxyType({}),
) -> Statistics:
    """Compute all statistics that the cells allow.

    Args:
        rows: of all cells.
        data: the cells themselves in the order of the rows, none where they aren't known.
        options: seed, resamples and block.
        on_step: called at each subject, and after each cell that is resampled.
        constants: the best blind constant's cells; empty: they are unknown.
    """
    entrants = entering(rows)
    over = over_what(rows)
    alike = one_scale(rows)
    scored_ids = {id(row) for row in alike if row.status == OK and not row.control}
    pairs = [
        (row, cell) for row, cell in zip(rows, data, strict=bool(data)) if id(row) in scored_ids
    ]
    comparisons: list[Comparison] = []
    weights: list[WeightSamples] = []
    for subject in SUBJECTS:
        on_step()
        if subject in over:
            continue
        comparisons += compare(entrants, subject, options.seed, constants)
        sampled = sample_weights(entrants, subject, options.seed, options.resamples)
        if sampled is not None:
            weights.append(sampled)
    records = None
    if pairs:
        with_terms = [
            (row, cell_terms(cell.labels, cell.records, cell.thresholds))
            for row, cell in pairs
            if cell.score
        ]
        thresholds = pairs[0][1].thresholds
        records = bootstrap_records(
            with_terms,
            GROUPINGS,
            options.resamples,
            options.seed,
            on_step,
            options.block,
            thresholds,
        )
        comparisons = [
            replace(
                one,
                over_labels=records.differences.get(
                    ((one.first, one.second), one.metric), NO_INTERVAL
                ),
            )
            if one.subject == "model"
            else one
            for one in comparisons
        ]
    return Statistics(
        records,
        {by: _over_cells(entrants, by, options) for by in GROUPINGS if over.isdisjoint(by)},
        tuple(comparisons),
        tuple(weights),
        stability(alike, options.resamples, options.seed),
    )


def _over_cells(
    rows: Sequence[CellRow], by: Group, options: Options
) -> dict[Group, tuple[Estimate, ...]]:
    cells: dict[Group, dict[str, list[float]]] = {}
    scenarios: dict[Group, dict[str, list[float]]] = {}
    for row in rows:
        if row.ivcs is not None and (row.admitted or "domain" not in by):
            key = tuple(getattr(row, name) for name in by)
            cells.setdefault(key, {})["\0".join(row.key)] = [row.ivcs]
            scenarios.setdefault(key, {}).setdefault(row.scenario, []).append(row.ivcs)
    estimates = {}
    for key in sorted(cells):
        units = [(cells[key], "cells")]
        if 1 < len(scenarios[key]) < len(cells[key]):
            units.append((scenarios[key], "scenarios"))
        estimates[key] = tuple(
            bootstrap_mean(values, unit, options.resamples, options.seed, unit, *by, *key)
            for values, unit in units
        )
    return estimates
