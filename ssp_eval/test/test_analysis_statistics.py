"""Intervals, comparisons, sensitivity and stability, against scipy, closed forms and by hand."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import stats

from ssp_core.vocab import DOMAINS
from ssp_eval.analysis.bootstrap import bootstrap_mean, bootstrap_records
from ssp_eval.analysis.compare import Comparison, compare, holm, sign_flip_p, t_interval
from ssp_eval.analysis.drawn import resampled_scores, response_begins
from ssp_eval.analysis.resample import (
    NO_INTERVAL,
    Interval,
    bca_interval,
    draws,
    generator,
    percentile_interval,
    weighted_sums,
)
from ssp_eval.analysis.row import CellRow
from ssp_eval.analysis.sensitivity import kendall_tau, sample_weights, signs, vary_weights
from ssp_eval.analysis.stability import stability
from ssp_eval.score.aggregate import METRICS, means
from ssp_eval.score.terms import RecordTerms

NAMES = ("jovr", "sem_acc_eff", "cia_eff", "act_acc_eff", "tqsr", "atc_eff")
SEED = 5


def row(scenario, domain, model, value, **others):
    fields = dict.fromkeys(NAMES, value) | {"rsr": 0, "rl_s": None} | others
    return CellRow(scenario, domain, model, **fields)


def terms(count=9, seed=0, *, defensive=None, candidate=None):
    rng = np.random.default_rng(seed)

    def flags(*shape):
        return rng.random((count, *shape)) < 0.6

    evaluable = flags(4)
    given_slots = evaluable & flags(4)
    hard = given_slots * (rng.random((count, 4)) < 0.5).astype(float)
    interaction = flags()
    feasible = flags()
    return RecordTerms(
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
        risk_onset_s=0.5,
    )


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
    data = np.array([0.1, 0.3, 0.35, 0.5, 0.9, 0.2, 0.8])
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
    one = bootstrap_mean([0.25], 100, SEED)
    assert (one.value, one.n, one.percentile) == (0.25, 1, NO_INTERVAL)
    assert bootstrap_mean([], 100, SEED).value is None


def test_the_mean_of_0_and_1_has_the_binomial_distribution():
    found = bootstrap_mean([0.0] * 5 + [1.0] * 5, 20_000, SEED)
    exact = stats.binom(10, 0.5)
    assert found.percentile == Interval(exact.ppf(0.025) / 10, exact.ppf(0.975) / 10)
    assert found.bias == pytest.approx(0.0, abs=0.01)


@settings(max_examples=30, deadline=None)
@given(seed=st.integers(0, 999), places=st.lists(st.integers(0, 8), min_size=9, max_size=9))
def test_a_resample_scores_as_if_its_labels_stood_there(seed, places):
    """Against METHOD 6.2 to 6.8 computed plainly over the labels drawn."""
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
    assert set(found) == set(METRICS)


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
            for metric in METRICS:
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
        assert vary_weights(mixed, subject) == vary_weights(rows, subject)


def test_another_seed_gives_other_digits():
    one = bootstrap_records(cells(), [("model",)], 200, 1)
    assert one != bootstrap_records(cells(), [("model",)], 200, 2)


def test_unadmitted_cells_stay_out_of_domain_means():
    given_cells = [
        (CellRow(**{**vars(r), "admitted": r.domain != "physical"}), t) for r, t in cells()
    ]
    found = bootstrap_records(given_cells, [("domain",), ("model",)], 100, SEED)
    assert list(found.groups[("domain",)]) == [("simulation",), ("synthetic",)]
    assert found.groups[("model",)][("a",)]["ivcs"].n == 6
    pairs = {(c.first, c.second) for c in compare([r for r, _ in given_cells], "domain", SEED)}
    assert pairs == {("synthetic", "simulation")}


@pytest.mark.parametrize("count", [2, 5, 9])
def test_exact_sign_flips_are_those_of_scipy(count):
    d = np.random.default_rng(count).normal(0.3, 1, count)
    expected = stats.permutation_test(
        (d,), np.mean, permutation_type="samples", n_resamples=np.inf, alternative="two-sided"
    )
    assert sign_flip_p(d) == pytest.approx(expected.pvalue, abs=1e-12)


def test_sign_flips_by_hand():
    # Of 8 patterns only +++ and −−− have a sum of at least 6.
    assert sign_flip_p(np.array([1.0, 2.0, 3.0])) == 2 / 8
    # |1 − 2 + 3| = 2: all but those of |sum| 0 (1 + 2 − 3 and its opposite) reach it.
    assert sign_flip_p(np.array([1.0, -2.0, 3.0])) == 6 / 8
    assert sign_flip_p(np.zeros(4)) == 1.0
    # 0.1 + 0.2 and 0.3 are equal but for rounding.
    assert sign_flip_p(np.array([0.1, 0.2, -0.3])) == 1.0


def test_drawn_signs_come_near_the_exact_p_and_are_never_0():
    d = np.random.default_rng(3).normal(0.5, 1, 12)
    assert sign_flip_p(d, generator(SEED)) == pytest.approx(sign_flip_p(d), abs=0.015)
    assert sign_flip_p(np.ones(40), generator(SEED)) == 1 / 20_001


def test_students_interval_is_that_of_scipy():
    values = [0.1, 0.4, 0.35, 0.8]
    expected = stats.ttest_1samp(values, 0).confidence_interval(0.95)
    mine = t_interval(values)
    assert (mine.low, mine.high) == pytest.approx((expected.low, expected.high), abs=1e-12)
    assert t_interval([0.3]) == NO_INTERVAL


def test_holm_by_hand():
    ps = [0.01, 0.04, 0.03, None, 0.005]
    given_ps = [Comparison("model", "a", "b", "ivcs", 5, 0.1, p=p) for p in ps]
    # Sorted: 0.005 × 4, 0.01 × 3, 0.03 × 2, then 0.04 × 1, which may not be less than 0.06.
    corrected = [one.p_holm for one in holm(given_ps)]
    assert corrected == [0.03, 0.06, 0.06, None, 0.02]
    assert [one.family for one in holm(given_ps)] == [4, 4, 4, 0, 4]


def test_pairs_are_of_the_same_scenario_and_other_factor():
    rows = [
        row("s", "synthetic", "a", 0.5), row("s", "physical", "a", 0.3),
        row("t", "synthetic", "a", 0.9), row("t", "physical", "b", 0.1),
        row("s", "synthetic", "b", 0.4), row("s", "physical", "b", 0.4),
    ]  # fmt: skip
    found = {c.metric: c for c in compare(rows, "domain", SEED)}
    jovr, ivcs = found["jovr"], found["ivcs"]
    assert (jovr.n, jovr.difference, jovr.favour) == (2, pytest.approx(0.1), 0.75)
    assert jovr.p is None
    assert (ivcs.p, ivcs.p_least, ivcs.family) == (1.0, 0.5, 1)
    (alone,) = [c for c in compare(rows[:2], "domain", SEED) if c.metric == "ivcs"]
    assert (alone.n, alone.p, alone.p_holm, alone.interval) == (1, None, None, NO_INTERVAL)


@given(hnp.arrays(int, (2, 6), elements=st.integers(0, 4)))
def test_kendalls_tau_is_that_of_scipy(values):
    first, second = values.astype(float)
    mine = float(kendall_tau(signs(first), signs(second)))
    expected = stats.kendalltau(first, second).statistic
    assert (math.isnan(mine) and math.isnan(expected)) or mine == pytest.approx(expected)


def test_orders_under_random_weights_by_a_closed_form():
    # a − b is w_jovr·1 − w_tqsr·1 (equal elsewhere): even weights are as often one as the other.
    rows = [
        row("s", "physical", "a", 0.0, jovr=1.0),
        row("s", "physical", "b", 0.0, tqsr=1.0),
        row("s", "physical", "c", 1.0, rsr=1),
    ]
    found = sample_weights(rows, "model", SEED, 8000)
    orders = {(one.first, one.second): one.held for one in found.pairs}
    assert orders[("b", "a")] == pytest.approx(0.5, abs=0.02)
    # c is at least as good in everything: its order holds under whatever weights.
    assert orders[("c", "a")] == orders[("c", "b")] == 1.0
    assert found.first["c"] == 1.0
    assert sample_weights(rows[:1], "model", SEED, 10) is None


def test_one_weight_at_a_time_by_hand():
    rows = [row("s", "physical", "a", 0.0, jovr=1.0), row("s", "physical", "b", 0.0, tqsr=0.4)]
    # Defined: a 0.10, b 0.12. JOVR at 0.15 leaves TQSR 0.30 · 0.85 / 0.9: b 0.1133.
    found = vary_weights(rows, "model")
    (changed,) = [v for v in found if v.parameter == "jovr" and math.isclose(v.value, 0.15)]
    assert changed.means["a"] == pytest.approx(0.15)
    assert changed.means["b"] == pytest.approx(0.4 * 0.30 * 0.85 / 0.9)
    assert (changed.changed, changed.tau) == ((("b", "a"),), -1.0)


def test_stability_over_seeds_by_hand():
    values = {1: (0.2, 0.5), 2: (0.4, 0.5), 3: (0.9, 0.6)}
    rows = [
        row("s", "physical", model, value, seed=seed)
        for seed, both in values.items()
        for model, value in zip("ab", both, strict=True)
    ]
    found = stability(rows, 500, SEED)
    spread = next(x for x in found.cells if x.names[2] == "a" and x.metric == "jovr")
    assert (spread.k, spread.value) == (3, pytest.approx(0.5))
    assert spread.sd == pytest.approx(math.sqrt((0.09 + 0.01 + 0.16) / 2))
    assert (spread.low, spread.high) == (0.2, 0.9)
    over_runs = spread.bootstrap.percentile
    assert (over_runs.low, over_runs.high) == pytest.approx((0.2, 0.9), abs=1e-12)
    # Runs 1 and 2 agree on b before a, run 3 doesn't.
    assert found.same_order == pytest.approx(1 / 3)
    assert found.tau == pytest.approx((1 - 1 - 1) / 3)
    assert stability(rows[:2], 500, SEED) is None
