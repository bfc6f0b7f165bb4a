"""Paired tests and effect sizes: does one change move an answer more than another one does?

The unit is the recording. Answers at neighbouring label times of a recording are alike, and a test
that takes each label time for a pair of its own rejects a true null hypothesis far too often:
``docs/twins.md`` has the simulation, and ``test_paired.py`` repeats it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ssp_core.proportion import wilson_interval
from ssp_eval.score.aggregate import EQUAL
from ssp_eval.statistics.resampling import (
    LEVEL,
    NO_INTERVAL,
    REACH,
    Interval,
    Numbers,
)

# Up to here the null distribution of the signed rank is exact, beyond it is normal.
EXACT_UNITS = 50


@dataclass(frozen=True)
class Test:
    """A paired test, two-sided.

    Args:
        more, fewer: units in which the first change does more than the second, and less; those in
            which both do as much say nothing.
        p: exact, or of the signed rank.
        p_mid: mid-p of McNemar's test; None of a signed rank.
        p_least: the least that p can be with as many units that differ.
    """

    more: int
    fewer: int
    p: float
    p_mid: float | None
    p_least: float


@lru_cache(maxsize=1 << 12)
def mcnemar(more: int, fewer: int) -> Test:
    """Return McNemar's test of discordant pairs: exact, and mid-p.

    p = 2 P(X ≤ min(more, fewer)), at most 1, with X binomial (more + fewer, ½).
    mid-p = p − P(X = min), and 1 − ½ P(X = more) where both are equal (Fagerland, Lydersen and
    Laake, BMC Medical Research Methodology 13:91, 2013).
    """
    # Both take a second to import, and only a campaign with twins needs them.
    from scipy.stats import binom  # type: ignore[import-untyped]  # no types
    from statsmodels.stats.contingency_tables import (  # type: ignore[import-untyped]  # no types
        mcnemar as exact_mcnemar,
    )

    n = more + fewer
    if n == 0:
        return Test(0, 0, 1.0, 1.0, 1.0)
    p = float(exact_mcnemar([[0, more], [fewer, 0]], exact=True).pvalue)
    at = float(binom.pmf(min(more, fewer), n, 0.5))
    return Test(more, fewer, p, 1.0 - at / 2 if more == fewer else p - at, 2.0 ** (1 - n))


def signed_rank(differences: Sequence[float]) -> Test:
    """Return Wilcoxon's signed rank; differences of 0 are left out.

    Exact for up to EXACT_UNITS units, with ties too, where scipy's isn't; beyond by its normal
    approximation.
    """
    # Differences within EQUAL of each other are ties and not an order of rounding errors.
    deltas = np.round(np.asarray(differences, dtype=np.float64) / EQUAL) * EQUAL
    deltas = deltas[deltas != 0.0]
    n, more = len(deltas), int((deltas > 0).sum())
    if n == 0:
        return Test(0, 0, 1.0, None, 1.0)
    from scipy.stats import rankdata, wilcoxon  # a second to import

    if n > EXACT_UNITS:
        p = float(wilcoxon(deltas, method="asymptotic").pvalue)
    else:
        # Means of ranks that share a place are halves; doubled, they are whole.
        ranks = np.round(2 * rankdata(np.abs(deltas))).astype(np.int64)
        least = min(int(ranks[deltas > 0].sum()), int(ranks[deltas < 0].sum()))
        p = 2 * float(_chances(tuple(sorted(ranks.tolist())))[: least + 1].sum())
    return Test(more, n - more, min(1.0, p), None, 2.0 ** (1 - n))


@lru_cache(maxsize=1 << 10)
def _chances(ranks: tuple[int, ...]) -> Numbers:
    """Compute by sum of positive ranks its chance, where each sign is a coin's."""
    chances = np.ones(1)
    for rank in ranks:
        longer = np.zeros(len(chances) + rank)
        longer[: len(chances)] += chances / 2
        longer[rank:] += chances / 2
        chances = longer
    return chances


def hodges_lehmann(differences: Sequence[float]) -> tuple[float | None, Interval]:
    """Return Hodges and Lehmann's estimate of a shift: the median of all means of two differences.

    The interval, 95 %, has the signed rank's ends: the c-th least and the c-th largest of these
    means, 2 P(W < c) ≤ 5 %. Fewer than six differences have none.

    Returns:
        The estimate, None without a difference, and its interval.
    """
    values = np.asarray(differences, dtype=np.float64)
    n = len(values)
    if n == 0:
        return None, NO_INTERVAL
    first, second = np.triu_indices(n)
    walsh = np.sort((values[first] + values[second]) / 2)
    reach = _ranks_outside(n)
    interval = NO_INTERVAL
    if reach > 0:
        interval = Interval(float(walsh[reach - 1]), float(walsh[-reach]))
    return float(np.median(walsh)), interval


@lru_cache(maxsize=1 << 10)
def _ranks_outside(n: int) -> int:
    """Return the largest c with P(W < c) ≤ 2.5 %, W the signed rank of n units; 0: none."""
    tail = (1.0 - LEVEL) / 2
    if n > EXACT_UNITS:
        spread = math.sqrt(n * (n + 1) * (2 * n + 1) / 24)
        return math.floor(n * (n + 1) / 4 - REACH * spread)
    chances = _chances(tuple(range(1, n + 1)))
    return int(np.sum(np.cumsum(chances) <= tail))


@dataclass(frozen=True)
class Shares:
    """The effects of two changes on units, as shares that sum to 1; each may be a mean over units.

    Args:
        both, first, second, neither: change the answer: both, the first alone, the second alone,
            none.
    """

    both: float
    first: float
    second: float
    neither: float

    @classmethod
    def of(cls, first: Numbers, second: Numbers) -> Shares:
        """Compute the shares from (L,) flags at the label times of one recording."""
        a, b = np.asarray(first, dtype=bool), np.asarray(second, dtype=bool)
        shares = (a & b, a & ~b, ~a & b, ~a & ~b)
        return cls(*(float(share.mean()) for share in shares))

    @classmethod
    def mean(cls, of: Sequence[Shares]) -> Shares:
        """Return the unweighted mean over recordings."""
        names = ("both", "first", "second", "neither")
        return cls(*(math.fsum(getattr(one, name) for one in of) / len(of) for name in names))

    @property
    def difference(self) -> float:
        """Return how much larger the share is that the first changes."""
        return self.first - self.second


def rate_interval(rate: float, n: int) -> Interval:
    """Return Wilson's interval of a share of n units, 95 %; a single unit has none."""
    if n < 2:
        return NO_INTERVAL
    return Interval(*wilson_interval(rate, n, LEVEL))


def paired_difference(shares: Shares, n: int) -> Interval:
    """Return Newcombe's interval of the difference of two paired shares, 95 %.

    Method 10 of Newcombe, Statistics in Medicine 17:2635–2650, 1998: Wilson's intervals of both
    shares, squared and added with the correlation φ of the pairs, which is corrected for
    continuity. Where shares are means over recordings, n counts the recordings, as if all label
    times of a recording said the same: it is then wider than need be, never too narrow.
    """
    p1, p2 = shares.both + shares.first, shares.both + shares.second
    one, two = rate_interval(p1, n), rate_interval(p2, n)
    if one.low is None or one.high is None or two.low is None or two.high is None:
        return NO_INTERVAL
    product = math.sqrt(max(0.0, p1 * (1 - p1) * p2 * (1 - p2)))
    covariance = shares.both * shares.neither - shares.first * shares.second
    if covariance > 0:
        covariance = max(0.0, covariance - 0.5 / n)
    phi = covariance / product if product > EQUAL else 0.0

    def reach(a: float, b: float) -> float:
        return math.sqrt(max(0.0, a * a - 2 * phi * a * b + b * b))

    low = shares.difference - reach(p1 - one.low, two.high - p2)
    high = shares.difference + reach(one.high - p1, p2 - two.low)
    return Interval(max(-1.0, low), min(1.0, high))
