"""Intervals, comparisons, sensitivity and stability, against scipy, closed forms and by hand."""

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import stats

from ssp_core.vocabulary import DOMAINS
from ssp_eval.score.aggregate import means
from ssp_eval.score.engine import LabelTerms
from ssp_eval.score.metrics import IVCS_FIRST, METRIC_NAMES
from ssp_eval.statistics import resampling
from ssp_eval.statistics.bootstrap import (
    bootstrap_mean,
    bootstrap_records,
    clip_generator,
    resampled_scores,
    response_begins,
)
from ssp_eval.statistics.comparisons import compare, compared_metrics
from ssp_eval.statistics.resampling import (
    NO_INTERVAL,
    Interval,
    bca_interval,
    bca_shares,
    block_draws,
    draws,
    generator,
    percentile_interval,
    reach,
    resampled_sums,
    weighted_sums,
)
from ssp_eval.statistics.rows import CellRow
from ssp_eval.statistics.sensitivity import sample_weights

SEED = 5


def terms(count=9, seed=0, *, defensive=None, candidate=None):
    rng = np.random.default_rng(seed)

    def flags(*shape):
        return rng.random((count, *shape)) < 0.6

    evaluable = flags(4)
    given_slots = evaluable & flags(4)
    hard = given_slots * (rng.random((count, 4)) < 0.5).astype(float)
    interaction = flags()
    feasible = flags()
    return LabelTerms(
        matched=np.ones(count, bool),
        output_valid=flags(),
        evaluable=evaluable,
        given=given_slots,
        hard=hard,
        soft=np.maximum(hard, 0.5 * given_slots),
        interaction_evaluable=interaction,
        interaction_correct=interaction & flags(),
        action_correct=flags(),
        feasible=feasible,
        trajectory_correct=feasible & flags(),
        consistent=flags(),
        candidate=np.ones(count, bool) if candidate is None else np.array(candidate),
        defensive=flags() if defensive is None else np.array(defensive),
        record_t_s=0.5 * np.arange(count),
        record=np.arange(count),
        text_valid=np.ones(count, bool),
        trajectory_valid=np.ones(count, bool),
        answer=np.zeros((count, 6), int),
        lon=np.zeros(count, int),
        lat=np.zeros(count, int),
        risk_onset_s=0.5,
    )


@pytest.mark.parametrize("count", [2, 7, 100])
@pytest.mark.parametrize("at_once", [1, 99, 1000])
def test_resamples_in_blocks_are_those_of_one_call(
    count: int, at_once: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(resampling, "_AT_ONCE", at_once)
    values = np.random.default_rng(5).normal(size=(count, 2))
    whole = weighted_sums(draws(count, 120, generator(SEED, "x")), values)
    assert np.array_equal(resampled_sums(values, 120, generator(SEED, "x")), whole)


@pytest.mark.parametrize("count", [1, 2, 9])
def test_draws_are_with_replacement_and_seeded(count):
    first = draws(count, 4000, generator(SEED, "x"))
    assert np.array_equal(first, draws(count, 4000, generator(SEED, "x")))
    assert set(first.sum(axis=1)) == {count}
    # Each item is drawn a binomial number of times: mean 1, variance 1 − 1/n.
    assert np.allclose(first.mean(axis=0), 1.0, atol=0.1)
    assert np.allclose(first.var(axis=0), 1 - 1 / count, atol=0.12)
    if count > 1:
        assert not np.array_equal(first, draws(count, 4000, generator(SEED, "y")))


@given(hnp.arrays(float, (4, 3), elements=st.floats(0, 1)))
def test_weighted_sums_are_those_of_a_matrix_product(values):
    weights = draws(4, 50, generator(SEED))
    assert np.allclose(weighted_sums(weights, values), (weights @ values).T, atol=1e-12)


def test_percentile_and_bca_are_those_of_scipy():
    # Means of eight sixteenths have no rounding errors, which scipy doesn't take for ties.
    data = np.array([1, 3, 5, 8, 14, 2, 12, 4]) / 16
    for method, ours in (("percentile", None), ("BCa", "jackknife")):
        found = stats.bootstrap(
            (data,), np.mean, n_resamples=3000, method=method, rng=np.random.default_rng(1)
        )
        samples = found.bootstrap_distribution
        left_out = (data.sum() - data) / (len(data) - 1)
        mine = (
            percentile_interval(samples)
            if ours is None
            else bca_interval(samples, data.mean(), left_out)
        )
        assert mine.low == pytest.approx(found.confidence_interval.low, abs=1e-12)
        assert mine.high == pytest.approx(found.confidence_interval.high, abs=1e-12)


def test_intervals_where_nothing_varies_or_nothing_is_known():
    assert percentile_interval(np.array([np.nan, np.nan])) == NO_INTERVAL
    assert percentile_interval(np.array([0.5, np.nan, 0.5])) == Interval(0.5, 0.5)
    assert bca_interval(np.full(9, 0.5), 0.5, np.full(3, 0.5)) == Interval(0.5, 0.5)
    # All resamples lie above the estimate: there is no correction that would help.
    assert bca_interval(np.array([0.6, 0.7]), 0.5, np.array([0.4, 0.5])) == NO_INTERVAL
    assert percentile_interval(np.array([0.1, 0.2]), None) == NO_INTERVAL
    one = bootstrap_mean({"a": [0.25]}, "cells", 100, SEED)
    assert (one.value, one.n, one.percentile) == (0.25, 1, NO_INTERVAL)
    assert bootstrap_mean({}, "cells", 100, SEED).value is None


@settings(max_examples=30, deadline=None)
@given(st.lists(st.sampled_from([-1e-13, 0.0, 1e-13]), min_size=9, max_size=9))
def test_rounding_errors_are_ties_of_a_bca_interval(errors):
    noise = np.array(errors)
    samples = np.repeat([0.2, 0.5, 0.5, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0], 9)
    left_out = np.array([0.4, 0.5, 0.6, 0.7, 0.6, 0.5, 0.4, 0.6, 0.7])
    exact = bca_shares(samples, 0.5, left_out, 1.96)
    assert exact is not None
    assert bca_shares(samples + np.tile(noise, 9), 0.5, left_out + noise, 1.96) == pytest.approx(
        exact, abs=1e-9
    )
    # Nothing varies but the last digit: neither in the resamples nor in the jackknife.
    assert bca_shares(0.5 + noise, 0.5, left_out, 1.96) == (0.5, 0.5)
    flat, none = 0.5 + noise, np.full(9, 0.5)
    assert bca_shares(samples, 0.5, flat, 1.96) == bca_shares(samples, 0.5, none, 1.96)


def test_the_mean_of_0_and_1_has_the_binomial_distribution():
    values = {str(k): [float(k % 2)] for k in range(10)}
    found = bootstrap_mean(values, "cells", 20_000, SEED)
    exact = stats.binom(10, 0.5)
    # Quantiles of the resamples, but further out than 2.5 %, for there are ten values only.
    tail = stats.norm.cdf(-np.sqrt(10 / 9) * stats.t(9).ppf(0.975))
    assert found.percentile == Interval(exact.ppf(tail) / 10, exact.ppf(1 - tail) / 10)
    assert found.bias == pytest.approx(0.0, abs=0.01)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 999), places=st.lists(st.integers(0, 8), min_size=9, max_size=9))
def test_a_resample_scores_as_if_its_labels_stood_there(seed, places):
    """The scores are those of METHOD 6.2 to 6.8, computed plainly over the labels drawn."""
    cell = terms(seed=seed)
    weights = np.bincount(places, minlength=9).astype(float)[None]
    found = {name: value[0] for name, value in resampled_scores(cell, weights).items()}
    drawn = np.array(places)
    assert found["jovr"] == pytest.approx(cell.output_valid[drawn].mean())
    assert found["tqsr"] == pytest.approx(cell.trajectory_correct[drawn].mean())
    evaluable = cell.evaluable[drawn].sum()
    if evaluable:
        assert found["sem_acc_eff"] == pytest.approx(cell.hard[drawn].sum() / evaluable)
    else:
        assert np.isnan(found["sem_acc_eff"])
    interactions = cell.interaction_evaluable[drawn].sum()
    assert np.isnan(found["cia_eff"]) == (interactions == 0)
    begins = [i for i in places if response_begins(cell)[i]]
    assert found["rsr"] == bool(begins)
    if begins:
        assert found["rl_s"] == pytest.approx(max(0.0, 0.5 * min(begins) - 0.5))
    parts = [np.nan_to_num(found[n]) for n in ("jovr", "sem_acc_eff", "cia_eff", "tqsr", "rsr")]
    assert found["ivcs"] == pytest.approx(np.dot([0.1, 0.3, 0.2, 0.3, 0.1], parts))
    assert set(found) == set(METRIC_NAMES)


@pytest.mark.parametrize(
    ("defensive", "candidate", "begins"),
    [
        ([0, 1, 1, 0], [1, 1, 1, 1], [1]),
        ([1, 1, 1, 0], [1, 1, 1, 1], [0, 1]),
        ([0, 1, 0, 1], [1, 1, 1, 1], []),
        # A label that yields no candidate doesn't break a run, but the gap of 1.0 s does.
        ([0, 1, 0, 1], [1, 1, 0, 1], []),
        ([1, 1, 0, 0], [1, 0, 1, 1], []),
        ([0, 0, 0, 1], [1, 1, 1, 1], []),
    ],
)
def test_labels_that_begin_a_response(defensive, candidate, begins):
    cell = terms(4, defensive=np.array(defensive, bool), candidate=np.array(candidate, bool))
    assert list(np.flatnonzero(response_begins(cell))) == begins


def cells(count_models=3):
    found = []
    places = itertools.product(("cut_in", "vru"), DOMAINS, "abc"[:count_models])
    for number, (scenario, domain, model) in enumerate(places):
        cell = terms(seed=number)
        one = {k: v[0] for k, v in resampled_scores(cell, np.ones((1, 9))).items() if k != "ivcs"}
        scores = {k: None if np.isnan(v) else float(v) for k, v in one.items()}
        found.append((CellRow(scenario, domain, model, **scores), cell))
    return found


def test_group_values_are_the_means_of_the_method_and_lie_in_their_intervals():
    given_cells = cells()
    found = bootstrap_records(given_cells, [("domain",), ("model",)], 500, SEED)
    for by, groups in found.groups.items():
        expected = means([one.cell() for one, _ in given_cells], by)
        for key, estimates in groups.items():
            for metric in METRIC_NAMES:
                assert estimates[metric].n == expected[key][metric].n
                assert estimates[metric].value == pytest.approx(expected[key][metric].value)
            ivcs = estimates["ivcs"]
            assert ivcs.percentile.low <= ivcs.value <= ivcs.percentile.high


@settings(max_examples=5, deadline=None)
@given(order=st.permutations(range(18)))
def test_the_order_of_cells_changes_no_digit(order):
    given_cells = cells()
    by = [("domain",), ("scenario", "model")]
    assert bootstrap_records([given_cells[i] for i in order], by, 200, SEED) == bootstrap_records(
        given_cells, by, 200, SEED
    )
    rows = [one for one, _ in given_cells]
    mixed = [rows[i] for i in order]
    for subject in ("model", "domain"):
        assert compare(mixed, subject, SEED) == compare(rows, subject, SEED)
        assert sample_weights(mixed, subject, SEED, 200) == sample_weights(rows, subject, SEED, 200)


def test_another_seed_gives_other_digits():
    one = bootstrap_records(cells(), [("model",)], 200, 1)
    assert one != bootstrap_records(cells(), [("model",)], 200, 2)


def test_repetitions_and_like_models_make_no_interval_narrower():
    """Copies of a cell bring no new labels, so the mean is as uncertain as the cell."""
    (row, of_cell), *_ = cells()
    by = [("domain",), ("model",)]
    alone = bootstrap_records([(row, of_cell)], by, 400, SEED)
    runs = [(replace(row, run=str(k)), of_cell) for k in range(5)]
    models = [(replace(row, model=name), of_cell) for name in "abcde"]
    for copies in (runs, models):
        found = bootstrap_records(copies, by, 400, SEED)
        expected = alone.groups[("domain",)][(row.domain,)]
        mine = found.groups[("domain",)][(row.domain,)]
        for metric in METRIC_NAMES:
            if expected[metric].percentile.low is not None:
                assert (mine[metric].percentile.low, mine[metric].percentile.high) == pytest.approx(
                    (expected[metric].percentile.low, expected[metric].percentile.high)
                )


def test_two_models_on_one_clip_have_an_interval_over_its_labels():
    """Both models have the same draws; the ends are those of intervals from few blocks."""
    chosen = cells()[:2]
    found = bootstrap_records(chosen, [], 500, SEED).differences
    (row, first), (_, second) = chosen
    weights = block_draws(9, 2, 500, clip_generator(SEED, row, 9))
    for metric in ("ivcs", "tqsr", "sem_acc_eff"):
        apart = resampled_scores(first, weights)[metric] - resampled_scores(second, weights)[metric]
        assert found[("a", "b"), metric] == percentile_interval(apart, reach(4.5))
    # Student's interval over pairs of cells needs two of them.
    (one,) = [c for c in compare([r for r, _ in chosen], "model", SEED) if c.metric == "ivcs"]
    assert (one.n, one.interval) == (1, NO_INTERVAL)
    assert found[("a", "b"), "ivcs"].low < one.difference < found[("a", "b"), "ivcs"].high


def test_models_that_answer_alike_differ_by_nothing_in_any_resample():
    (row, of_cell), *_ = cells()
    same = [(row, of_cell), (replace(row, model="b"), of_cell)]
    found = bootstrap_records(same, [], 200, SEED).differences
    assert {(one.low, one.high) for one in found.values()} == {(0.0, 0.0)}


def test_differences_over_labels_are_of_the_clips_that_both_models_have():
    """Model c lacks two thirds of the clips: a and b compare as before, c where it has clips."""
    every = cells()
    whole = bootstrap_records(every, [], 200, SEED).differences
    fewer = [one for one in every if one[0].model != "c" or one[0].domain == "physical"]
    found = bootstrap_records(fewer, [], 200, SEED).differences
    assert found[("a", "b"), "ivcs"] == whole[("a", "b"), "ivcs"]
    there = [one for one in every if one[0].domain == "physical"]
    assert (
        found[("a", "c"), "ivcs"]
        == (bootstrap_records(there, [], 200, SEED).differences[("a", "c"), "ivcs"])
    )
    unlike = [(r, terms(8, seed=3) if r.model == "b" else t) for r, t in every]
    # Other numbers of labels aren't drawn alike.
    assert not [
        key for key in bootstrap_records(unlike, [], 200, SEED).differences if "b" in key[0]
    ]


def test_of_many_models_only_ivcs_is_compared_over_labels():
    assert compared_metrics("abc") == IVCS_FIRST
    assert compared_metrics([str(k) for k in range(13)]) == ("ivcs",)
    assert compared_metrics([str(k) for k in range(61)]) == ()


def test_unadmitted_cells_stay_out_of_domain_means():
    given_cells = [
        (CellRow(**{**vars(r), "admitted": r.domain != "physical"}), t) for r, t in cells()
    ]
    found = bootstrap_records(given_cells, [("domain",), ("model",)], 100, SEED)
    assert list(found.groups[("domain",)]) == [("simulation",), ("synthetic",)]
    assert found.groups[("model",)][("a",)]["ivcs"].n == 6
    pairs = {(c.first, c.second) for c in compare([r for r, _ in given_cells], "domain", SEED)}
    assert pairs == {("synthetic", "simulation")}
