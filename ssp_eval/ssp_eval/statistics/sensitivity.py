"""How far IVCS and ranks depend on weights, thresholds and repetitions (METHOD 6.13)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ssp_eval.score.aggregate import BY_DOMAIN, BY_MODEL, EQUAL, Cell, mean, means
from ssp_eval.score.columns import Columns
from ssp_eval.score.engine import score_columns
from ssp_eval.score.metrics import IVCS_FIRST, ivcs_weights
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_eval.statistics.bootstrap import Estimate, bootstrap_mean
from ssp_eval.statistics.comparisons import t_interval
from ssp_eval.statistics.resampling import Interval, Numbers, generator
from ssp_eval.statistics.rows import OK, CellRow
from ssp_eval.statistics.tables import sd

SAMPLES = 10_000
_BLOCK = 1000
# By how much each weight is multiplied, one at a time; the others share what is left as before.
WEIGHT_FACTORS = (0.0, 0.5, 1.5, 2.0)
# Values to try for each threshold, one at a time; those of METHOD 6 lie between them.
GRID: Mapping[str, tuple[float, ...]] = {
    "match_window_s": (0.05, 0.08, 0.15, 0.20, 0.25),
    "stop_speed_mps": (0.25, 0.40, 0.60, 0.75, 1.00),
    "accel_mps2": (0.25, 0.40, 0.60, 0.75, 1.00),
    "lateral_shift_m": (0.15, 0.20, 0.25, 0.35, 0.40, 0.50),
    "response_gap_s": (0.40, 0.50, 0.70, 0.80, 1.20),
}


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


@dataclass(frozen=True)
class Variation:
    """IVCS and ranks with one number changed.

    Args:
        parameter: a weight's metric, or a field of Thresholds.
        defined: what METHOD 6 says.
        tau: Kendall's τ_b to the defined ranks.
        changed: pairs of subjects whose order turned round, ``a, b`` with a ahead before.
        largest: largest change of IVCS of a cell; None where only means were looked at.
    """

    subject: str
    parameter: str
    value: float
    defined: float
    means: dict[str, float]
    tau: float | None
    changed: tuple[tuple[str, str], ...]
    largest: float | None = None


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


def _number(value: Numbers | float) -> float | None:
    return None if np.isnan(value) else float(value)


def sample_weights(
    rows: Sequence[CellRow], subject: str, seed: int, samples: int = SAMPLES
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


def vary_weights(rows: Sequence[CellRow], subject: str) -> list[Variation]:
    """Each weight multiplied by WEIGHT_FACTORS, one at a time, the others scaled to sum to 1."""
    components = component_means(rows, subject)
    weights = ivcs_weights()
    before = _dot(components, weights)
    found = []
    for name, defined in weights.items():
        for factor in WEIGHT_FACTORS:
            value = defined * factor
            rest = (1.0 - value) / (1.0 - defined)
            changed = {n: value if n == name else w * rest for n, w in weights.items()}
            after = _dot(components, changed)
            found.append(_variation(subject, name, value, defined, before, after))
    return found


def _dot(components: Mapping[str, list[float]], weights: Mapping[str, float]) -> dict[str, float]:
    return {
        name: math.fsum(w * v for w, v in zip(weights.values(), values, strict=True))
        for name, values in components.items()
    }


def _variation(
    subject: str,
    parameter: str,
    value: float,
    defined: float,
    before: Mapping[str, float],
    after: Mapping[str, float],
    largest: float | None = None,
) -> Variation:
    names = sorted(before)
    old = signs(np.array([before[name] for name in names]))
    new = signs(np.array([after[name] for name in names]))
    pairs = list(combinations(names, 2))
    turned = tuple(
        pair if was > 0 else (pair[1], pair[0])
        for pair, was, now in zip(pairs, old, new, strict=True)
        if was * now < 0
    )
    tau = _number(kendall_tau(old, new)) if pairs else None
    return Variation(subject, parameter, value, defined, dict(after), tau, turned, largest)


def vary_thresholds(
    rows: Sequence[CellRow],
    columns: Columns,
    subjects: Sequence[str] = ("model", "domain"),
    on_step: Callable[[], None] = lambda: None,
    thresholds: Thresholds = DEFAULT,
) -> list[Variation]:
    """Every cell scored again with one threshold changed at a time (GRID).

    Args:
        rows: that enter means, in the order of the columns; one run.
    """
    defined = score_columns(columns, thresholds).values["ivcs"]
    before = {subject: _macro(rows, defined, subject) for subject in subjects}
    found = []
    for parameter, values in GRID.items():
        for value in values:
            changed = replace(thresholds, **{parameter: value})  # type: ignore[arg-type]
            scores = score_columns(columns, changed).values["ivcs"]
            largest = float(np.max(np.abs(scores - defined)))
            for subject in (name for name in subjects if before[name]):
                after = _macro(rows, scores, subject)
                at = float(getattr(thresholds, parameter))
                found.append(
                    _variation(subject, parameter, value, at, before[subject], after, largest)
                )
            on_step()
    return found


def _macro(rows: Sequence[CellRow], scores: Numbers, subject: str) -> dict[str, float]:
    """Mean IVCS by subject, from the one place that averages."""
    cells = [
        Cell(*row.key, {**row.cell().score, "ivcs": float(score)}, row.admitted)
        for row, score in zip(rows, scores, strict=True)
    ]
    return {key[0]: one["ivcs"].value or 0.0 for key, one in means(cells, (subject,)).items()}


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
