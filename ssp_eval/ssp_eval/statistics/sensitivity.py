"""The dependence of ranks by IVCS on its weights."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from ssp_eval.score.aggregate import EQUAL
from ssp_eval.score.metrics import ivcs_weights
from ssp_eval.statistics.bootstrap import RESAMPLES
from ssp_eval.statistics.resampling import Numbers, generator
from ssp_eval.statistics.rows import CellRow

_BLOCK = 1000


@dataclass(frozen=True)
class PairOrder:
    """The share of weights under which two subjects keep the order of the defined weights.

    Args:
        first, second: the one that is ahead stands first; equal ones stand by name.
        tied: they are equal under the defined weights; share is then that of equal ones.
    """

    first: str
    second: str
    tied: bool
    share: float


@dataclass(frozen=True)
class WeightSamples:
    """Ranks under weights drawn evenly from all that are ≥ 0 and sum to 1.

    Args:
        tau_mean, tau_low: mean and 5 % quantile of Kendall's τ_b to the defined ranks; None
            where one of the two rankings is all ties.
        first: per subject, share of the samples in which no other is ahead of it.
    """

    subject: str
    samples: int
    tau_mean: float | None
    tau_low: float | None
    first: dict[str, float]
    pairs: tuple[PairOrder, ...]


def component_means(rows: Sequence[CellRow], subject: str) -> dict[str, list[float]]:
    """Compute per subject the mean of each component of IVCS, null as 0 (METHOD 6.11).

    IVCS is linear in them, so the mean IVCS under any weights follows.
    """
    values_by_subject: dict[str, list[list[float]]] = {}
    for row in rows:
        if row.admitted or subject != "domain":
            values = [row.components[name] or 0.0 for name in ivcs_weights()]
            values_by_subject.setdefault(getattr(row, subject), []).append(values)
    return {
        name: [math.fsum(column) / len(cells) for column in zip(*cells, strict=True)]
        for name, cells in sorted(values_by_subject.items())
    }


def signs(values: Numbers) -> Numbers:
    """Return the order of every pair of subjects: 1 where the first is ahead, −1 behind, 0 equal.

    Args:
        values: (..., S).

    Returns:
        (..., S (S − 1) / 2).
    """
    first, second = np.triu_indices(values.shape[-1], 1)
    d = values[..., first] - values[..., second]
    return np.where(np.abs(d) <= EQUAL, 0.0, np.sign(d))


def kendall_tau(first: Numbers, second: Numbers) -> Numbers:
    """Return Kendall's τ_b of two orders as signs gives them; NaN where one is all ties."""
    agree = np.sum(first * second, axis=-1)
    norm = np.sqrt(np.sum(np.abs(first), axis=-1) * np.sum(np.abs(second), axis=-1))
    tau = np.full(np.shape(agree), np.nan)
    np.divide(agree, norm, out=tau, where=norm > 0)
    return tau


def sample_weights(
    rows: Sequence[CellRow], subject: str, seed: int, samples: int = RESAMPLES
) -> WeightSamples | None:
    """Rank under random weights; None for fewer than two subjects.

    Args:
        rows: that enter means, one per cell.
        subject: what is ranked: "model" or "domain".
        seed: of the weights.
        samples: how many weights are drawn.
    """
    components = component_means(rows, subject)
    if len(components) < 2:
        return None
    names, table = list(components), np.array(list(components.values()))
    defined = table @ np.array(list(ivcs_weights().values()))
    base = signs(defined)
    rng = generator(seed, "weights", subject)
    agreements, first, taus = np.zeros(len(base)), np.zeros(len(names)), []
    for start in range(0, samples, _BLOCK):
        count = min(_BLOCK, samples - start)
        values = rng.dirichlet(np.ones(table.shape[1]), size=count) @ table.T
        order = signs(values)
        agreements += np.sum(order == base, axis=0)
        first += np.sum(values >= values.max(axis=1, keepdims=True) - EQUAL, axis=0)
        taus.append(kendall_tau(order, base))
    tau = np.concatenate(taus)
    tau = tau[~np.isnan(tau)]
    pairs = []
    for (a, b), sign, share in zip(combinations(names, 2), base, agreements / samples, strict=True):
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
