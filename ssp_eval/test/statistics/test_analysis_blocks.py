"""Blocks of labels: how they are drawn, how far intervals reach, and how often these are right."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
from scipy import stats
from scipy.special import ndtri

from ssp_eval.score.engine import LabelTerms
from ssp_eval.statistics.bootstrap import bootstrap_mean, bootstrap_records
from ssp_eval.statistics.resampling import (
    REACH,
    Numbers,
    block_draws,
    block_of,
    draws,
    generator,
    percentile_interval,
    reach,
    without_blocks,
)
from ssp_eval.statistics.rows import CellRow

SEED = 5
DOCS = Path(__file__).parents[3] / "docs/statistics.md"


@pytest.mark.parametrize(
    ("count", "length"),
    [(1, 1), (2, 1), (3, 1), (4, 2), (9, 2), (15, 2), (16, 3), (27, 3), (64, 4), (1000, 10)],
)
def test_the_length_of_a_block_is_the_cube_root(count: int, length: int) -> None:
    assert block_of(count) == length
    assert block_of(count, 1) == 1
    assert block_of(count, 1000) == max(1, count // 2)


def test_neighbours_are_drawn_together_and_the_first_follows_the_last() -> None:
    found = block_draws(4, 2, 4000, generator(SEED, "x"))
    pairs = {(0, 0, 1, 1), (1, 0, 0, 1), (1, 1, 0, 0), (0, 1, 1, 0)}
    possible = {tuple(map(sum, zip(a, b, strict=True))) for a in pairs for b in pairs}
    assert {tuple(map(int, row)) for row in found} == possible
    assert np.allclose(found.mean(axis=0), 1.0, atol=0.05)
    # Of nine labels in blocks of two the fifth block is cut.
    odd = block_draws(9, 2, 4000, generator(SEED, "x"))
    assert set(odd.sum(axis=1)) == {9}
    assert np.allclose(odd.mean(axis=0), 1.0, atol=0.05)
    assert np.array_equal(odd, block_draws(9, 2, 4000, generator(SEED, "x")))
    alone = block_draws(9, 1, 50, generator(SEED, "x"))
    assert np.array_equal(alone, draws(9, 50, generator(SEED, "x")))


def test_a_jackknife_leaves_out_each_block_in_turn() -> None:
    assert without_blocks(3, 1).tolist() == [[0, 1, 1], [1, 0, 1], [1, 1, 0]]
    assert without_blocks(4, 2).tolist() == [
        [0, 0, 1, 1], [1, 0, 0, 1], [1, 1, 0, 0], [0, 1, 1, 0],
    ]  # fmt: skip


def test_few_blocks_make_intervals_reach_further() -> None:
    # √(n / (n − 1)) t, which for a mean of a sample gives back Student's interval.
    assert reach(9) == pytest.approx(math.sqrt(9 / 8) * stats.t(8).ppf(0.975))
    assert reach(9 / 2) == pytest.approx(math.sqrt(4.5 / 3.5) * stats.t(3.5).ppf(0.975))
    assert reach(1e9) == pytest.approx(REACH)
    # Two clips of nine labels leave each its own mean.
    assert reach(18, 2) == pytest.approx(math.sqrt(18 / 16) * stats.t(16).ppf(0.975))
    assert reach(1) is None
    assert reach(2, 2) is None


def test_the_interval_of_a_large_sample_is_students() -> None:
    values = np.random.default_rng(SEED).normal(size=12)
    given = {str(k): [float(value)] for k, value in enumerate(values)}
    found = bootstrap_mean(given, "cells", 100_000, SEED).percentile
    exact = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    student = bootstrap_mean(given, "cells", 100, SEED).student
    assert (student.low, student.high) == pytest.approx((exact.low, exact.high), abs=1e-12)
    assert found.low is not None
    assert found.high is not None
    assert (found.low, found.high) == pytest.approx((exact.low, exact.high), abs=0.06)


def test_a_scenario_is_drawn_with_all_its_cells() -> None:
    """Copies of a scenario's one cell make its mean no more certain, and cells would."""
    two = {"s": [0.2], "t": [0.8]}
    many = {"s": [0.2] * 6, "t": [0.8] * 6}
    few, more = (bootstrap_mean(one, "scenarios", 500, SEED) for one in (two, many))
    assert (more.n, more.unit, more.value) == (2, "scenarios", pytest.approx(0.5))
    ends = [(e.percentile.low, e.percentile.high, e.bca.low, e.bca.high) for e in (few, more)]
    assert ends[1] == pytest.approx(ends[0])
    # Two units: 12.7 times half their distance, where resamples end at the two themselves.
    assert (few.percentile.low, few.percentile.high) == pytest.approx((0.2, 0.8))
    assert more.student.high == few.student.high == pytest.approx(0.5 + 12.706 * 0.3, abs=1e-3)
    # Scenarios count with their cells, as the mean does.
    uneven = bootstrap_mean({"s": [0.2], "t": [0.8] * 3}, "scenarios", 500, SEED)
    assert uneven.value == pytest.approx(0.65)
    assert (uneven.percentile.low, uneven.percentile.high) == pytest.approx((0.2, 0.8))


def terms(good: Numbers) -> LabelTerms:
    """A clip in which the given labels are good in every respect, and the others in none."""
    count, flags = len(good), good.astype(bool)
    four = np.repeat(flags[:, None], 4, axis=1)
    return LabelTerms(
        matched=np.ones(count, bool),
        output_valid=flags,
        evaluable=np.ones((count, 4), bool),
        given=four,
        hard=four.astype(float),
        soft=four.astype(float),
        interaction_evaluable=np.ones(count, bool),
        interaction_correct=flags,
        action_correct=flags,
        feasible=flags,
        trajectory_correct=flags,
        consistent=flags,
        candidate=np.zeros(count, bool),
        defensive=np.zeros(count, bool),
        record_t_s=0.5 * np.arange(count),
        risk_onset_s=0.0,
        record=np.arange(count),
        text_valid=np.ones(count, bool),
        trajectory_valid=np.ones(count, bool),
        answer=np.zeros((count, 6), int),
        lon=np.zeros(count, int),
        lat=np.zeros(count, int),
    )


def test_labels_that_come_in_stretches_have_wider_intervals_in_blocks() -> None:
    row = CellRow("s", "physical", "a", 0.5, 0.5, 0.5, 0.5, 0.5, 0.5, 0, None)
    cell = [(row, terms(np.repeat([1, 0, 1, 0], 4)))]

    def width(block: int | None) -> float:
        (found,) = bootstrap_records(cell, [], 4000, SEED, block=block).cells.values()
        interval = found["jovr"].percentile
        assert interval.low is not None
        assert interval.high is not None
        return interval.high - interval.low

    assert width(None) == width(3)
    assert width(3) > 1.4 * width(1)
    (found,) = bootstrap_records(cell, [("model",)], 100, SEED).groups[("model",)].values()
    assert found["jovr"].unit == "labels, in blocks of 3"


SHARE = 0.6
# Labels, correlation of neighbours: how often the interval holds the share, in blocks and singly.
COVERAGE = {
    (9, 0.0): (0.93, 0.90), (9, 0.5): (0.85, 0.72), (9, 0.8): (0.63, 0.48),
    (18, 0.0): (0.96, 0.94), (18, 0.5): (0.89, 0.77), (18, 0.8): (0.70, 0.52),
    (27, 0.0): (0.96, 0.94), (27, 0.5): (0.89, 0.77), (27, 0.8): (0.74, 0.52),
    (54, 0.0): (0.95, 0.94), (54, 0.5): (0.91, 0.79), (54, 0.8): (0.77, 0.55),
}  # fmt: skip


def clips(count: int, correlation: float) -> Numbers:
    """2,000 clips of labels that are right or wrong, where a hidden quality lasts."""
    rng = np.random.default_rng(1)
    hidden = np.empty((2000, count))
    hidden[:, 0] = rng.standard_normal(2000)
    for k in range(1, count):
        fresh = math.sqrt(1 - correlation**2) * rng.standard_normal(2000)
        hidden[:, k] = correlation * hidden[:, k - 1] + fresh
    return (hidden < ndtri(SHARE)).astype(np.float64)


def covered(values: Numbers, block: int, ends: float) -> float:
    weights = block_draws(values.shape[1], block, 1000, np.random.default_rng(2))
    means = values @ weights.T / values.shape[1]
    found = [percentile_interval(one, ends) for one in means]
    return float(
        np.mean([(one.low or 0.0) - 1e-9 <= SHARE <= (one.high or 0.0) + 1e-9 for one in found])
    )


@pytest.mark.parametrize(("count", "correlation"), list(COVERAGE))
def test_intervals_hold_the_truth_as_often_as_the_documentation_says(
    count: int, correlation: float
) -> None:
    values = clips(count, correlation)
    block = block_of(count)
    ends = reach(count / block)
    assert ends is not None
    in_blocks, singly = covered(values, block, ends), covered(values, 1, REACH)
    assert in_blocks > singly
    assert (in_blocks, singly) == pytest.approx(COVERAGE[count, correlation], abs=0.006)
    line = next(x for x in DOCS.read_text("utf-8").splitlines() if x.startswith(f"| {count} ("))
    place = 2 * [0.0, 0.5, 0.8].index(correlation) + 2
    told = [part.strip() for part in line.split("|")][place : place + 2]
    assert told == [f"{share:.2f}" for share in COVERAGE[count, correlation]]
