"""Resampling with replacement, of values or of blocks; percentile and BCa intervals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri, stdtrit  # type: ignore[import-untyped]  # no types

from ssp_core.hashing import sha256_json
from ssp_eval.score.aggregate import EQUAL

Numbers = NDArray[np.float64]
LEVEL = 0.95
# How far from the middle the ends lie of a large sample, in standard deviations: 1.96.
REACH = float(ndtri((1 + LEVEL) / 2))


def student_quantile(free: float, level: float = LEVEL) -> float:
    """Return Student's quantile: how far values lie from the middle where there are few.

    Args:
        free: degrees of freedom, above 0.
        level: share of the values within ± the quantile.
    """
    return float(stdtrit(free, (1 + level) / 2))


@dataclass(frozen=True)
class Interval:
    """A confidence interval; both ends None where there is none."""

    low: float | None
    high: float | None


NO_INTERVAL = Interval(None, None)


def sd(values: Iterable[float]) -> float | None:
    """Return the standard deviation of a sample (n − 1); None of fewer than two values."""
    present = list(values)
    if len(present) < 2:
        return None
    centre = math.fsum(present) / len(present)
    return math.sqrt(math.fsum((v - centre) ** 2 for v in present) / (len(present) - 1))


def t_interval(values: Sequence[float], level: float = LEVEL) -> Interval:
    """Return Student's interval of the mean of a sample; none of fewer than two values."""
    n, spread = len(values), sd(values)
    if spread is None:
        return NO_INTERVAL
    mean = math.fsum(values) / n
    half = student_quantile(n - 1, level) * spread / math.sqrt(n)
    return Interval(mean - half, mean + half)


def cluster_interval(sums: Sequence[float], sizes: Sequence[float]) -> Interval:
    """Return Student's interval of the mean of all values, where whole clusters are independent.

    It is linear in the clusters, and of clusters of one size the interval of their means; none of
    fewer than two clusters.

    Args:
        sums: of each cluster's values.
        sizes: how many values each has.
    """
    n = len(sums)
    if n < 2:
        return NO_INTERVAL
    value, size = math.fsum(sums) / math.fsum(sizes), math.fsum(sizes) / n
    squares = [((s - value * k) / size) ** 2 for s, k in zip(sums, sizes, strict=True)]
    half = student_quantile(n - 1) * math.sqrt(math.fsum(squares) / (n * (n - 1)))
    return Interval(value - half, value + half)


def generator(seed: int, *names: str) -> np.random.Generator:
    """Return random numbers that depend on seed and purpose, not on the order of work."""
    digest = int(sha256_json([seed, *names]).removeprefix("sha256:"), 16)
    return np.random.default_rng(digest)


def draws(count: int, resamples: int, rng: np.random.Generator) -> Numbers:
    """Count how often each of count items is drawn, in resamples of count items with replacement.

    Returns:
        (resamples, count), each row summing to count.
    """
    return counted(rng.integers(0, count, size=(resamples, count)), count)


def counted(picked: NDArray[np.int64], count: int) -> Numbers:
    """Count how often each of count items stands in each row of their numbers."""
    rows = len(picked)
    places = picked + np.arange(rows)[:, None] * count
    times = np.bincount(places.ravel(), minlength=rows * count)
    return times.reshape(rows, count).astype(np.float64)


@dataclass
class NanMean:
    """Means of samples that are added one after the other, resample by resample, without NaN ones.

    Args:
        total: (B,) of the samples that aren't NaN.
        count: (B,) of these.
    """

    total: Numbers
    count: Numbers

    @classmethod
    def of(cls, resamples: int) -> NanMean:
        """Make an empty mean."""
        return cls(np.zeros(resamples), np.zeros(resamples))

    def add(self, samples: Numbers) -> None:
        there = ~np.isnan(samples)
        if there.all():
            self.total += samples
            self.count += 1.0
        else:
            self.total += np.where(there, samples, 0.0)
            self.count += there

    @property
    def mean(self) -> Numbers:
        """(B,) NaN where all samples were."""
        means = np.full_like(self.total, np.nan)
        np.divide(self.total, self.count, out=means, where=self.count > 0)
        return means


def weighted_sums(weights: Numbers, values: Numbers) -> Numbers:
    """Return Σ_i w_bi v_i for each b, added in the order of i.

    Args:
        weights: (B, N).
        values: (N, K).

    Returns:
        (K, B).
    """
    total = np.zeros((values.shape[1], len(weights)))
    scaled = np.empty(len(weights))
    # One sum after the other: B numbers stay in the cache, K times B don't.
    columns = np.ascontiguousarray(weights.T)
    for sum_, of_one in zip(total, values.T, strict=True):
        for place in np.flatnonzero(of_one):
            np.multiply(columns[place], of_one[place], out=scaled)
            sum_ += scaled
    return total


# Numbers of items that are drawn at once, 32 MB.
_AT_ONCE = 4 << 20


def resampled_sums(values: Numbers, resamples: int, rng: np.random.Generator) -> Numbers:
    """Compute ``weighted_sums`` of as many draws of the values, in blocks of resamples.

    The numbers are those of one call: the memory alone doesn't grow with their count.

    Args:
        values: (N, K).
        resamples: how many, B.
        rng: random numbers.

    Returns:
        (K, B).
    """
    count = len(values)
    block = max(1, _AT_ONCE // count)
    sizes = [min(block, resamples - first) for first in range(0, resamples, block)]
    return np.hstack([weighted_sums(draws(count, size, rng), values) for size in sizes])


def percentile_interval(samples: Numbers, reach: float | None = REACH) -> Interval:
    """Return the equal-tailed percentile interval of what resamples gave; NaN ones are left out.

    Args:
        samples: resampled values, (B,).
        reach: its ends lie at the quantiles Φ(−reach) and Φ(reach); None: there is no interval.
    """
    return intervals(samples[~np.isnan(samples)], percentile_shares(reach))[0]


def bca_interval(
    samples: Numbers,
    estimate: float,
    jackknife: Numbers,
    reach: float | None = REACH,
    items: float | None = None,
) -> Interval:
    """Return the bias-corrected and accelerated interval; NaN resamples are left out.

    Args:
        samples: resampled values, (B,).
        estimate: the value on the data.
        jackknife: the estimate with each item, or each block of items, left out.
        reach: see percentile_interval.
        items: K, blocks that don't overlap; None: as many as there are values of the jackknife.
    """
    present = samples[~np.isnan(samples)]
    return intervals(present, bca_shares(present, estimate, jackknife, reach, items))[0]


Shares = tuple[float, float]


def intervals(present: Numbers, *ends: Shares | None) -> tuple[Interval, ...]:
    """Return the intervals between quantiles of resampled values, which are sorted once.

    Args:
        present: resampled values without NaN, (B,).
        ends: shares of the values below the two ends of each interval; None: there is none.
    """
    if not len(present) or not any(ends):
        return (NO_INTERVAL,) * len(ends)
    shares = [share for one in ends if one is not None for share in one]
    quantiles = iter(np.quantile(present, shares).tolist())
    return tuple(
        NO_INTERVAL if one is None else Interval(next(quantiles), next(quantiles)) for one in ends
    )


def percentile_shares(reach: float | None) -> Shares | None:
    """Return the shares of resamples below the ends of a percentile interval."""
    return None if reach is None else (float(ndtr(-reach)), float(ndtr(reach)))


def bca_shares(
    present: Numbers,
    estimate: float,
    jackknife: Numbers,
    reach: float | None,
    items: float | None = None,
) -> Shares | None:
    """Return the shares of resamples below the ends of the BCa interval (Efron 1987).

    z_0 = Φ⁻¹(share of resamples below the estimate, ties half), a = γ / (6 √K) with γ the skewness
    of the mean of the jackknife less each of its values, and the shares are
    Φ(z_0 + (z_0 ± reach) / (1 − a (z_0 ± reach))). For single items a is Σ d³ / 6 (Σ d²)^1.5.
    Values within EQUAL of each other are ties, and not an order of rounding errors.

    Args:
        present: resampled values without NaN, (B,).
        estimate: see bca_interval.
        jackknife: see bca_interval.
        reach: see bca_interval.
        items: see bca_interval.

    Returns:
        None where the resamples all lie on one side of the estimate, or where there are none;
        those of the median where nothing varies.
    """
    left_out = jackknife[~np.isnan(jackknife)]
    if not len(present) or not len(left_out) or reach is None:
        return None
    if np.ptp(present) <= EQUAL:
        return 0.5, 0.5
    fewer = np.sum(present < estimate - EQUAL)
    below = (fewer + np.sum(present <= estimate + EQUAL)) / (2 * len(present))
    if not 0.0 < below < 1.0:
        return None
    z_0 = float(ndtri(below))
    d = left_out.mean() - left_out
    varies = np.abs(d).max() > EQUAL
    a = math.fsum(d**3) / (6 * math.fsum(d**2) ** 1.5) if varies else 0.0
    if items is not None:
        a *= math.sqrt(len(left_out) / items)
    low, high = z_0 - reach, z_0 + reach
    if a * low >= 1 or a * high >= 1:
        return None
    return float(ndtr(z_0 + low / (1 - a * low))), float(ndtr(z_0 + high / (1 - a * high)))


def block_of(count: int, override: int | None = None) -> int:
    """Return how many labels are drawn together: the rounded cube root of their number.

    That is the order of length at which the variance of a mean is estimated best (Hall, Horowitz
    and Jing 1995); 2 for nine labels, 3 for 27, 4 for 64. At least two blocks fit into the clip.

    Args:
        count: labels of the clip.
        override: another length, which is cut to half of the clip.
    """
    length = round(count ** (1 / 3)) if override is None else override
    return max(1, min(length, count // 2))


def block_draws(count: int, block: int, resamples: int, rng: np.random.Generator) -> Numbers:
    """Count how often each of count labels is drawn in resamples of count labels.

    The last block of a resample is cut where it would be one label too many.

    Returns:
        (resamples, count), each row summing to count.
    """
    if block == 1:
        return draws(count, resamples, rng)
    starts = rng.integers(0, count, size=(resamples, -(-count // block)))
    picked = (starts[:, :, None] + np.arange(block)) % count
    return counted(picked.reshape(resamples, -1)[:, :count], count)


def without_blocks(count: int, block: int) -> Numbers:
    """Return the weights with each block of consecutive labels left out in turn, for a jackknife.

    Returns:
        (count, count).
    """
    places = np.arange(count)
    apart = (places[None, :] - places[:, None]) % count
    return (apart >= block).astype(np.float64)


def reach(blocks: float, groups: int = 1, level: float = LEVEL) -> float | None:
    """Compute how far from the middle an interval ends, in a normal's standard deviations.

    A resample varies less than the data by 1 − 1/K with K blocks, and K is small. The expanded
    percentile interval (Hesterberg 2015) ends further out: √(K / (K − G)) t, with t Student's
    quantile with K − G degrees of freedom and G groups that are drawn from apart.

    Args:
        blocks: K, that were drawn from in all groups.
        groups: G, such as clips.
        level: of the interval.

    Returns:
        None where there is nothing to tell a spread from.
    """
    free = blocks - groups
    if free <= 0.0:
        return None
    return student_quantile(free, level) * math.sqrt(blocks / free)
