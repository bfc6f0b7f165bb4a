"""Paired tests: against second implementations, and their size where nothing is to be found."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import PermutationMethod, binomtest, wilcoxon

from ssp_eval.statistics.paired import (
    Shares,
    hodges_lehmann,
    mcnemar,
    paired_difference,
    rate_interval,
    signed_rank,
)
from ssp_eval.statistics.resampling import NO_INTERVAL

# So many that a size of 4.5 to 5 % is told from 4 %.
SIMULATIONS, RECORDINGS, LABELS = 10_000, 20, 9
LEVEL = 0.05


def null_changes(stickiness: float, rate: float = 0.5, seed: int = 1) -> np.ndarray:
    """(S, R, L, 2) whether cause and control change the answers of a model to which both are alike.

    Args:
        stickiness: share of a recording's label times that all say the same.
    """
    numbers = np.random.default_rng(seed)
    whole = numbers.random((SIMULATIONS, RECORDINGS, 1, 2)) < rate
    each = numbers.random((SIMULATIONS, RECORDINGS, LABELS, 2)) < rate
    sticks = numbers.random((SIMULATIONS, RECORDINGS, LABELS, 1)) < stickiness
    return np.where(sticks, whole, each)


def sizes(differences: np.ndarray) -> tuple[float, float]:
    """Shares of simulations that McNemar's exact test and mid-p reject.

    Args:
        differences: (S, U) of units.
    """
    pairs = zip((differences > 0).sum(1).tolist(), (differences < 0).sum(1).tolist(), strict=True)
    tests = [mcnemar(more, fewer) for more, fewer in pairs]
    rejected = [(one.p <= LEVEL, (one.p_mid or 0.0) <= LEVEL) for one in tests]
    exact, mid = np.mean(rejected, axis=0)
    return float(exact), float(mid)


@pytest.mark.parametrize("stickiness", [0.0, 0.5, 0.9])
def test_by_recording_the_tests_keep_their_size_however_alike_label_times_are(
    stickiness: float,
) -> None:
    changes = null_changes(stickiness).astype(int)
    by_recording = (changes[..., 0] - changes[..., 1]).sum(axis=2)
    exact, mid = sizes(by_recording)
    assert exact <= 0.06
    assert 0.04 <= mid <= 0.06
    rejected = np.mean([signed_rank(row).p <= LEVEL for row in by_recording[:2000] / LABELS])
    assert rejected <= 0.06


def test_by_label_time_they_reject_a_true_hypothesis_up_to_nine_times_too_often() -> None:
    for stickiness, least in ((0.5, 0.15), (0.9, 0.40)):
        changes = null_changes(stickiness).astype(int)
        by_label = (changes[..., 0] - changes[..., 1]).reshape(SIMULATIONS, -1)
        assert min(sizes(by_label)) >= least


def test_newcombes_interval_holds_the_difference_with_label_times_that_are_alike() -> None:
    held = []
    numbers = np.random.default_rng(2)
    for _ in range(400):
        whole = numbers.random((RECORDINGS, 1, 2)) < (0.6, 0.2)
        each = numbers.random((RECORDINGS, LABELS, 2)) < (0.6, 0.2)
        flags = np.where(numbers.random((RECORDINGS, LABELS, 1)) < 0.7, whole, each)
        shares = Shares.mean([Shares.of(one[:, 0], one[:, 1]) for one in flags])
        found = paired_difference(shares, RECORDINGS)
        held.append(found.low <= 0.4 <= found.high)
    assert np.mean(held) >= 0.95


@pytest.mark.parametrize(("more", "fewer"), [(9, 1), (0, 6), (4, 4), (13, 21)])
def test_mcnemar_is_a_test_of_a_fair_coin(more: int, fewer: int) -> None:
    found = mcnemar(more, fewer)
    assert found.p == pytest.approx(binomtest(more, more + fewer).pvalue)
    assert found.p_mid is not None
    assert found.p_mid < found.p
    assert found.p_least == binomtest(0, more + fewer).pvalue


def test_mid_p_counts_what_was_observed_half_on_either_side() -> None:
    # Of ten pairs nine: 2 (1 + 10) / 1024 less 10 / 1024.
    assert mcnemar(9, 1).p_mid == pytest.approx(12 / 1024)
    assert mcnemar(1, 1).p_mid == pytest.approx(1 - 0.25)


def test_the_signed_rank_is_scipys_and_exact_with_ties() -> None:
    numbers = np.random.default_rng(3)
    for count in (5, 12, 30, 80):
        values = numbers.normal(0.3, 1.0, count)
        method = "exact" if count <= 50 else "asymptotic"
        assert signed_rank(values).p == pytest.approx(wilcoxon(values, method=method).pvalue)
    tied = [-2.0, 2.0, 4.0, 4.0, 2.0, 4.0, 3.0, -3.0, 3.0]
    every = wilcoxon(tied, method=PermutationMethod(n_resamples=2**10)).pvalue
    assert signed_rank([*tied, 0.0, 0.0]).p == pytest.approx(every)
    assert signed_rank(tied).more == 7


def test_where_nothing_differs_nothing_can_be_rejected() -> None:
    for found in (mcnemar(0, 0), signed_rank([0.0] * 20), signed_rank([])):
        assert (found.p, found.p_least) == (1.0, 1.0)


def test_hodges_and_lehmanns_interval_is_the_signed_ranks() -> None:
    numbers = np.random.default_rng(4)
    values = numbers.normal(0.8, 1.0, 15)
    size, interval = hodges_lehmann(values)
    assert interval.low is not None
    assert interval.high is not None
    assert interval.low < size < interval.high
    # What lies just inside isn't rejected as the shift, what lies just outside is.
    for end, inwards in ((interval.low, 1e-6), (interval.high, -1e-6)):
        assert signed_rank(values - end - inwards).p > LEVEL
        assert signed_rank(values - end + inwards).p <= LEVEL


def test_five_differences_have_no_interval() -> None:
    assert hodges_lehmann([1.0, 2.0, 3.0, 4.0, 5.0]) == (3.0, NO_INTERVAL)
    assert hodges_lehmann([]) == (None, NO_INTERVAL)
    assert hodges_lehmann([1.0] * 6)[1].low == 1.0


def test_newcombes_worked_example() -> None:
    # 20, 12, 2 and 16 of 50 pairs: Statistics in Medicine 17:2635, 1998, method 10.
    found = paired_difference(Shares(0.40, 0.24, 0.04, 0.32), 50)
    assert (found.low, found.high) == pytest.approx((0.0562, 0.3292), abs=5e-5)
    assert rate_interval(0.0, 20).high == pytest.approx(0.1611, abs=5e-5)
