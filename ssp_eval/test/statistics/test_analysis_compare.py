"""Paired comparisons, sensitivity and stability, against scipy, closed forms and by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy import stats

from ssp_eval.statistics.comparisons import Comparison, compare, holm, sign_flip_p, t_interval
from ssp_eval.statistics.resampling import NO_INTERVAL, generator
from ssp_eval.statistics.sensitivity import kendall_tau, sample_weights, signs
from ssp_eval.statistics.statistics import stability
from tests.support.score_rows import row

SEED = 5


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
        row("s", "synthetic", "a", 0.5),
        row("s", "physical", "a", 0.3),
        row("t", "synthetic", "a", 0.9),
        row("t", "physical", "b", 0.1),
        row("s", "synthetic", "b", 0.4),
        row("s", "physical", "b", 0.4),
    ]
    found = {c.metric: c for c in compare(rows, "domain", SEED)}
    jovr, ivcs = found["jovr"], found["ivcs"]
    assert (jovr.n, jovr.difference, jovr.favour) == (2, pytest.approx(0.1), 0.75)
    assert jovr.p is None
    # b is the same in both domains, and no sign makes anything of that.
    assert (ivcs.p, ivcs.p_least, ivcs.family) == (1.0, 1.0, 1)
    (alone,) = [c for c in compare(rows[:2], "domain", SEED) if c.metric == "ivcs"]
    assert (alone.n, alone.p, alone.p_holm, alone.interval) == (1, None, None, NO_INTERVAL)


def test_pairs_of_a_scenario_can_be_flipped_together():
    rows = [
        row(s, d, m, 0.5 + 0.1 * (d == "physical") + 0.01 * k)
        for s in "st"
        for d in ("synthetic", "physical")
        for k, m in enumerate("abcdef")
    ]
    (found,) = [c for c in compare(rows, "domain", SEED) if c.metric == "ivcs"]
    # Twelve pairs of one sign, but two scenarios alone: all 4 patterns but +− and −+ reach it.
    assert (found.n, found.scenarios) == (12, 2)
    assert found.p == 2 / 2**12
    assert found.p_scenarios == 2 / 4
    one = [r for r in rows if r.scenario == "s"]
    (found,) = [c for c in compare(one, "domain", SEED) if c.metric == "ivcs"]
    assert (found.p, found.scenarios, found.p_scenarios) == (2 / 2**6, 1, None)


def test_pairs_without_a_difference_make_no_p_smaller():
    def pairs(*differences):
        rows = [row("s", "physical", str(k), 0.5 + d) for k, d in enumerate(differences)]
        rows += [row("s", "synthetic", str(k), 0.5) for k, _ in enumerate(differences)]
        (found,) = [c for c in compare(rows, "domain", SEED) if c.metric == "ivcs"]
        return found.n, found.p, found.p_least, found.exact

    assert pairs(0.1, 0.2, 0.1, 0.0, 0.0) == (5, 2 / 8, 2 / 8, True)
    assert pairs(0.1, -0.2, 0.1, 0.0) == (4, 1.0, 2 / 8, True)
    assert pairs(0.0, 0.0) == (2, 1.0, 1.0, True)
    # Only those that differ count towards what can be tried in full.
    n, p, least, exact = pairs(*[0.1] * 10, *[0.0] * 30)
    assert (n, p, least, exact) == (40, 2 / 2**10, 2 / 2**10, True)
    n, p, least, exact = pairs(*[0.1] * 17, *[0.0] * 3)
    assert (n, p, least, exact) == (20, 1 / 20_001, 1 / 20_001, False)


def test_p_over_scenarios_is_corrected_within_its_family():
    given_ps = [
        Comparison("model", "a", "b", "ivcs", 5, 0.1, p=0.5, p_scenarios=p)
        for p in (0.25, 0.5, None)
    ]
    assert [one.p_scenarios_holm for one in holm(given_ps)] == [0.5, 0.5, None]


def test_macro_means_over_runs_are_of_the_same_cells():
    rows = [
        row("s", "physical", "a", 0.2, run="1"),
        row("t", "physical", "a", 0.2, run="1"),
        row("s", "physical", "a", 0.4, run="2"),
        row("t", "physical", "a", 0.4, run="2"),
        row("s", "physical", "a", 0.3, run="3"),
        row("u", "physical", "a", 0.9, run="3"),
    ]
    found = stability(rows, 200, SEED)
    assert found.runs == ("1", "2")
    (macro,) = [x for x in found.macro if x.names[0] == "model" and x.metric == "jovr"]
    assert (macro.k, macro.low, macro.high) == (2, pytest.approx(0.2), pytest.approx(0.4))


def test_a_cell_that_one_run_did_not_admit_stays_out_of_the_domain_means_of_all():
    rows = [
        row("s", "physical", "a", 0.8, run="1"),
        row("t", "physical", "a", 0.2, run="1"),
        row("s", "physical", "a", 0.8, run="2"),
        row("t", "physical", "a", 0.2, run="2", admitted=False),
    ]
    found = stability(rows, 200, SEED)
    domain, model = (x for x in found.macro if x.metric == "jovr")
    assert (domain.names, domain.k, domain.value, domain.sd) == (("domain", "physical"), 2, 0.8, 0)
    assert (model.value, model.sd) == (pytest.approx(0.5), 0)


def test_runs_of_the_same_name_by_run_and_by_seed_are_two():
    rows = [
        row("s", "physical", "a", 0.2, run="x seed 1"),
        row("s", "physical", "a", 0.4, run="x", seed=1),
    ]
    found = stability(rows, 200, SEED)
    assert found.runs == ("x seed 1", "x seed 1")
    assert {x.k for x in found.macro} == {2}


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
    orders = {(one.first, one.second): one.share for one in found.pairs}
    assert orders[("b", "a")] == pytest.approx(0.5, abs=0.02)
    # c is at least as good in everything: its order holds under whatever weights.
    assert orders[("c", "a")] == orders[("c", "b")] == 1.0
    assert found.first["c"] == 1.0
    assert sample_weights(rows[:1], "model", SEED, 10) is None


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
