"""Intervals of a mean over runs, cells or scenarios: whole clusters of values are drawn."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ssp_eval.analysis.bootstrap import RESAMPLES, SEED, Estimate, estimated
from ssp_eval.analysis.resample import (
    Interval,
    Numbers,
    draws,
    generator,
    student_quantile,
    weighted_sums,
)


def bootstrap_mean(
    values: Mapping[str, Sequence[float]],
    unit: str,
    resamples: int = RESAMPLES,
    seed: int = SEED,
    *names: str,
) -> Estimate:
    """The mean of all values with its intervals, where whole clusters of them are drawn.

    Args:
        values: by cluster, such as a scenario's cells, or a run's one score; there are no
            intervals of fewer than two clusters.
        unit: what a cluster is, in the plural.
        resamples: how many.
        seed, names: see generator.
    """
    clusters = [values[name] for name in sorted(values)]
    sums = np.array([math.fsum(one) for one in clusters])
    sizes = np.array([len(one) for one in clusters], dtype=np.float64)
    n = len(clusters)
    if n < 2:
        return Estimate(float(sums[0] / sizes[0]) if n else None, n, unit=unit)
    weights = draws(n, resamples, generator(seed, *names))
    total, count = weighted_sums(weights, np.column_stack((sums, sizes)))
    left_out = (sums.sum() - sums) / (sizes.sum() - sizes)
    value = float(sums.sum() / sizes.sum())
    found = estimated(total / count, value, n, left_out, n, unit)
    return replace(found, student=_student(sums - value * sizes, float(sizes.mean()), value))


def _student(residuals: Numbers, size: float, value: float) -> Interval:
    """Student's interval of a mean over clusters; that of a sample where all have one value.

    Args:
        residuals: of each cluster, its sum less what the mean gives for its size.
        size: mean size of a cluster.
        value: the mean.
    """
    n = len(residuals)
    deviation = math.sqrt(math.fsum((residuals / size) ** 2) / (n * (n - 1)))
    half = student_quantile(n - 1) * deviation
    return Interval(value - half, value + half)
