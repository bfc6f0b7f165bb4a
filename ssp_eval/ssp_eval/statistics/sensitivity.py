"""How far IVCS and ranks depend on weights and thresholds."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ssp_eval.evaluate.results import CellData
from ssp_eval.score.aggregate import EQUAL, Cell, means
from ssp_eval.score.columns import encode
from ssp_eval.score.engine import score_columns
from ssp_eval.score.metrics import ivcs_weights
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_eval.statistics.bootstrap import RESAMPLES
from ssp_eval.statistics.resampling import Numbers, generator
from ssp_eval.statistics.rows import CellRow

_BLOCK = 1000
# By how much each weight is multiplied, one at a time; the others share what is left as before.
WEIGHT_FACTORS = (0.0, 0.5, 1.5, 2.0)
# Values to try for each threshold and the tolerance, one at a time; those of METHOD 6 lie between.
GRID: Mapping[str, tuple[float, ...]] = {
    "match_window_s": (0.05, 0.08, 0.15, 0.20, 0.25),
    "stop_speed_mps": (0.25, 0.40, 0.60, 0.75, 1.00),
    "accel_mps2": (0.25, 0.40, 0.60, 0.75, 1.00),
    "lateral_shift_m": (0.15, 0.20, 0.25, 0.35, 0.40, 0.50),
    "response_gap_s": (0.40, 0.50, 0.70, 0.80, 1.20),
    "tolerance": (0.0, 1e-6, 1e-3),
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
    tau = float(kendall_tau(old, new))
    return Variation(
        subject, parameter, value, defined, dict(after), None if math.isnan(tau) else tau, turned,
        largest,
    )  # fmt: skip


def vary_thresholds(
    pairs: Sequence[tuple[CellRow, CellData]],
    subjects: Sequence[str] = ("model", "domain"),
    on_step: Callable[[], None] = lambda: None,
    thresholds: Thresholds = DEFAULT,
) -> list[Variation]:
    """Every cell scored again with one threshold changed at a time (GRID).

    Args:
        pairs: the cells that enter means, one run of each.
    """
    rows = [row for row, _ in pairs]
    columns = encode([(cell.labels, cell.records) for _, cell in pairs])
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
