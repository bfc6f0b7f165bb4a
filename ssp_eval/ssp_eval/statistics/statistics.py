"""All statistics of a set of cells: from rows alone, and from records where there are any."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ssp_eval.evaluate.results import CellData
from ssp_eval.score.aggregate import (
    BY_DOMAIN,
    BY_MODEL,
    BY_SCENARIO_DOMAIN,
    BY_SCENARIO_MODEL,
    EQUAL,
    mean,
    means,
)
from ssp_eval.score.engine import cell_terms
from ssp_eval.score.metrics import IVCS_FIRST, ivcs_weights
from ssp_eval.statistics.bootstrap import (
    RESAMPLES,
    SEED,
    Bootstrap,
    Estimate,
    Group,
    bootstrap_mean,
    bootstrap_records,
)
from ssp_eval.statistics.comparisons import Comparison, compare, t_interval
from ssp_eval.statistics.resampling import NO_INTERVAL, Interval, Numbers, generator
from ssp_eval.statistics.rows import OK, CellRow, entering, one_scale, over_what
from ssp_eval.statistics.tables import sd

_BLOCK = 1000


@dataclass(frozen=True)
class PairOrder:
    """How often the order of two subjects is that of the defined weights.

    Args:
        first, second: the one that is ahead stands first; equal ones stand by name.
        tied: they are equal under the defined weights; held is then the share of equal ones.
    """

    first: str
    second: str
    tied: bool
    held: float


@dataclass(frozen=True)
class WeightSamples:
    """Ranks under weights drawn evenly from all that are ≥ 0 and sum to 1.

    Args:
        tau_mean, tau_low: mean and 5 % quantile of Kendall's τ_b to the defined ranks; None
            where one of the two rankings is all ties.
        first: per subject, share of the samples in which nobody is ahead of it.
    """

    subject: str
    samples: int
    tau_mean: float | None
    tau_low: float | None
    first: dict[str, float]
    pairs: tuple[PairOrder, ...]


def component_means(rows: Sequence[CellRow], subject: str) -> dict[str, list[float]]:
    """Per subject the mean of each component of IVCS over its cells, null as 0 (METHOD 6.11).

    IVCS is linear in them, so the mean IVCS under any weights follows.
    """
    found: dict[str, list[list[float]]] = {}
    for row in rows:
        if row.admitted or subject != "domain":
            values = [row.components[name] or 0.0 for name in ivcs_weights()]
            found.setdefault(getattr(row, subject), []).append(values)
    return {
        name: [math.fsum(column) / len(cells) for column in zip(*cells, strict=True)]
        for name, cells in sorted(found.items())
    }


def signs(values: Numbers) -> Numbers:
    """The order of every pair of subjects: 1 where the first is ahead, −1 behind, 0 equal.

    Args:
        values: (..., S).

    Returns:
        (..., S (S − 1) / 2).
    """
    first, second = np.triu_indices(values.shape[-1], 1)
    d = values[..., first] - values[..., second]
    return np.where(np.abs(d) <= EQUAL, 0.0, np.sign(d))


def kendall_tau(first: Numbers, second: Numbers) -> Numbers:
    """Kendall's τ_b of two orders as signs gives them; NaN where one is all ties."""
    agree = np.sum(first * second, axis=-1)
    norm = np.sqrt(np.sum(np.abs(first), axis=-1) * np.sum(np.abs(second), axis=-1))
    tau = np.full(np.shape(agree), np.nan)
    np.divide(agree, norm, out=tau, where=norm > 0)
    return tau


def sample_weights(
    rows: Sequence[CellRow], subject: str, seed: int, samples: int = RESAMPLES
) -> WeightSamples | None:
    """Ranks under random weights; None of fewer than two subjects.

    Args:
        rows: that enter means, one per cell.
    """
    components = component_means(rows, subject)
    if len(components) < 2:
        return None
    names, table = list(components), np.array(list(components.values()))
    defined = table @ np.array(list(ivcs_weights().values()))
    base = signs(defined)
    rng = generator(seed, "weights", subject)
    held, first, taus = np.zeros(len(base)), np.zeros(len(names)), []
    for start in range(0, samples, _BLOCK):
        count = min(_BLOCK, samples - start)
        values = rng.dirichlet(np.ones(table.shape[1]), size=count) @ table.T
        order = signs(values)
        held += np.sum(order == base, axis=0)
        first += np.sum(values >= values.max(axis=1, keepdims=True) - EQUAL, axis=0)
        taus.append(kendall_tau(order, base))
    tau = np.concatenate(taus)
    tau = tau[~np.isnan(tau)]
    pairs = []
    for (a, b), sign, share in zip(combinations(names, 2), base, held / samples, strict=True):
        ahead, behind = (b, a) if sign < 0 else (a, b)
        pairs.append(PairOrder(ahead, behind, sign == 0, float(share)))
    return WeightSamples(
        subject,
        samples,
        float(tau.mean()) if len(tau) else None,
        float(np.quantile(tau, 0.05)) if len(tau) else None,
        {name: float(share) for name, share in zip(names, first / samples, strict=True)},
        tuple(pairs),
    )


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
    """Over the runs of a set of cells.

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


def run_name(row: CellRow) -> str:
    """What tells the runs of a cell apart."""
    return row.run if row.seed is None else f"{row.run} seed {row.seed}".strip()


def stability(rows: Sequence[CellRow], resamples: int, seed: int) -> Stability | None:
    """How the runs differ; None where no cell has two.

    Args:
        rows: all runs; controls and cells without a score are left out here.
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
        for metric in IVCS_FIRST
        if (spread := _spread(key, metric, _values(group, metric), resamples, seed))
    ]
    whole = _alike(by_run)
    macro, orders = [], []
    for by in (BY_DOMAIN, BY_MODEL):
        per_run = [means([row.cell() for row in by_run[name]], by) for name in whole]
        for key in sorted(per_run[0]):
            for metric in IVCS_FIRST:
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


SUBJECTS = ("model", "domain")
GROUPINGS = (BY_DOMAIN, BY_MODEL, BY_SCENARIO_DOMAIN, BY_SCENARIO_MODEL)


@dataclass(frozen=True)
class Options:
    """What random numbers depend on.

    Args:
        resamples: of every bootstrap, and sets of weights.
        block: labels that are drawn together; None: ssp_eval.statistics.resampling.block_of.
    """

    resamples: int = RESAMPLES
    seed: int = SEED
    block: int | None = None


@dataclass(frozen=True)
class Statistics:
    """What ``statistics.json`` holds.

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
    """How often compute calls on_step."""
    valid = [row for row in one_scale(rows) if row.status == OK and not row.control]
    return (len(valid) if has_records else 0) + len(SUBJECTS)


def compute(
    rows: Sequence[CellRow],
    data: Sequence[CellData] = (),
    options: Options = Options(),
    on_step: Callable[[], None] = lambda: None,
) -> Statistics:
    """Everything that the cells allow.

    Args:
        data: the cells themselves in the order of the rows, none where they aren't known.
    """
    chosen = entering(rows)
    over = over_what(rows)
    alike = one_scale(rows)
    kept = {id(row) for row in alike if row.status == OK and not row.control}
    pairs = [(row, cell) for row, cell in zip(rows, data, strict=bool(data)) if id(row) in kept]
    comparisons: list[Comparison] = []
    weights: list[WeightSamples] = []
    for subject in SUBJECTS:
        on_step()
        if subject in over:
            continue
        comparisons += compare(chosen, subject, options.seed)
        sampled = sample_weights(chosen, subject, options.seed, options.resamples)
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
            with_terms, GROUPINGS, options.resamples, options.seed, on_step, options.block,
            thresholds,
        )  # fmt: skip
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
        {by: _over_cells(chosen, by, options) for by in GROUPINGS if over.isdisjoint(by)},
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
    found = {}
    for key in sorted(cells):
        units = [(cells[key], "cells")]
        if 1 < len(scenarios[key]) < len(cells[key]):
            units.append((scenarios[key], "scenarios"))
        found[key] = tuple(
            bootstrap_mean(values, unit, options.resamples, options.seed, unit, *by, *key)
            for values, unit in units
        )
    return found
