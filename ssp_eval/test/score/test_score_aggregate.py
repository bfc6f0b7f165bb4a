"""METHOD 6.13: means, ranks, changes of rank, relative differences."""

import random
from dataclasses import fields

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_eval.score.aggregate import (
    BY_DOMAIN,
    BY_MODEL,
    BY_SCENARIO_DOMAIN,
    BY_SCENARIO_MODEL,
    Cell,
    Mean,
    RankChange,
    means,
    ranking,
    ranks,
    relative_difference,
)
from ssp_eval.score.metrics import METRIC_NAMES, CellMetrics
from ssp_eval.statistics.rows import GIVEN, Scores
from ssp_eval.statistics.tables.scores import uneven


def cell(scenario, domain, model, ivcs=0.5, *, admitted=True, **values):
    score = dict.fromkeys(METRIC_NAMES, 0.0) | {"rl_s": None, "ivcs": ivcs} | values
    return Cell(scenario, domain, model, score, admitted)


CELLS = [
    cell("cut_in", "synthetic", "a", 0.2, rsr=1, rl_s=0.5),
    cell("cut_in", "physical", "a", 0.4, rsr=0),
    cell("cut_in", "synthetic", "b", 0.5, rsr=1, rl_s=1.5, cia_eff=None),
    cell("vru", "synthetic", "a", 0.9, rsr=0),
    cell("vru", "synthetic", "b", 0.6, rsr=0, cia_eff=0.5),
]


def test_means_are_unweighted_over_cells():
    assert means(CELLS, BY_DOMAIN)[("physical",)]["ivcs"] == Mean(0.4, 1)
    assert means(CELLS, BY_DOMAIN)[("synthetic",)]["ivcs"] == Mean(pytest.approx(0.55), 4)
    assert means(CELLS, BY_MODEL)[("a",)]["ivcs"] == Mean(pytest.approx(0.5), 3)
    assert means(CELLS, BY_SCENARIO_DOMAIN)[("cut_in", "synthetic")]["ivcs"] == Mean(0.35, 2)
    assert means(CELLS, BY_SCENARIO_MODEL)[("cut_in", "a")]["ivcs"].value == pytest.approx(0.3)
    assert list(means(CELLS, BY_SCENARIO_MODEL)) == [
        ("cut_in", "a"),
        ("cut_in", "b"),
        ("vru", "a"),
        ("vru", "b"),
    ]


def test_rsr_counts_failures_and_rl_only_successes():
    synthetic = means(CELLS, BY_DOMAIN)[("synthetic",)]
    assert synthetic["rsr"] == Mean(0.5, 4)
    assert synthetic["rl_s"] == Mean(1.0, 2)
    assert means(CELLS, BY_DOMAIN)[("physical",)]["rl_s"] == Mean(None, 0)


def test_a_null_ratio_is_left_out_and_n_says_so():
    assert means(CELLS, BY_MODEL)[("b",)]["cia_eff"] == Mean(0.5, 1)


def test_cells_that_no_audit_admitted_stay_out_of_domain_means_only():
    cells = [*CELLS, cell("vru", "physical", "a", 0.0, admitted=False)]
    assert means(cells, BY_DOMAIN) == means(CELLS, BY_DOMAIN)
    assert means(cells, BY_SCENARIO_DOMAIN) == means(CELLS, BY_SCENARIO_DOMAIN)
    assert means(cells, BY_MODEL)[("a",)]["ivcs"].n == 4


def test_the_same_cell_twice_is_refused():
    with pytest.raises(ValueError, match="vru / synthetic / b occurs twice"):
        means([*CELLS, CELLS[-1]], BY_MODEL)


@settings(max_examples=50, deadline=None)
@given(
    values=st.lists(st.none() | st.floats(0, 1), min_size=1, max_size=8), seed=st.integers(0, 99)
)
def test_the_order_of_cells_changes_nothing(values, seed):
    cells = [
        cell(f"s{i % 2}", f"d{i % 3}", f"m{i}", value or 0.0, jovr=value)
        for i, value in enumerate(values)
    ]
    shuffled = random.Random(seed).sample(cells, len(cells))
    for by in (BY_DOMAIN, BY_MODEL, BY_SCENARIO_DOMAIN, BY_SCENARIO_MODEL):
        assert means(shuffled, by) == means(cells, by)
    assert ranking(shuffled, "model") == ranking(cells, "model")


def test_ranks_share_places_and_skip_the_next():
    assert ranks({"a": 0.5, "b": 0.9, "c": 0.5, "d": None, "e": 0.1}) == {
        "a": 2,
        "b": 1,
        "c": 2,
        "d": None,
        "e": 4,
    }


def test_ranks_come_from_unrounded_values():
    assert ranks({"a": 0.5, "b": 0.5 + 1e-11}) == {"a": 2, "b": 1}


def test_what_differs_by_rounding_alone_shares_a_rank():
    # Three of nine plans right weigh as much in IVCS as a response: 0.3 · 3/9 and 0.1 · 1.
    planned, responded = 0.3 * (3 / 9), 0.1 * 1
    assert planned != responded
    assert ranks({"a": planned, "b": responded, "c": 0.05}) == {"a": 1, "b": 1, "c": 3}


def test_what_differs_by_the_limit_of_rounding_shares_a_rank():
    assert ranks({"a": 0.0, "b": 1e-12, "c": 2.5e-12}) == {"a": 2, "b": 2, "c": 1}


def test_a_domain_s_places_are_scenarios_and_models():
    a, b = cell("s", "synthetic", "a"), cell("s", "physical", "a")
    assert not uneven([a, b], "domain")
    assert uneven([a, cell("s", "physical", "b")], "domain")


def test_subjects_with_as_many_cells_need_not_have_the_same():
    a, b = cell("s", "physical", "a"), cell("t", "physical", "b")
    assert uneven([a, b], "model")
    assert not uneven([a, cell("s", "physical", "b")], "model")
    other = cell("t", "synthetic", "a", admitted=False)
    assert not uneven([a, other], "domain")
    assert uneven([a, cell("t", "synthetic", "a")], "domain")


def test_a_change_of_rank_between_scenarios_is_pointed_out():
    table = ranking(CELLS, "model")
    assert table.scenarios == {"cut_in": {"a": 2, "b": 1}, "vru": {"a": 1, "b": 2}}
    assert table.macro == {"a": 2, "b": 1}
    assert table.changes == (
        RankChange("a", ("cut_in", "vru"), (2, 1)),
        RankChange("b", ("cut_in", "vru"), (1, 2)),
    )


def test_a_subject_that_a_scenario_lacks_has_no_change_of_rank():
    table = ranking(CELLS, "domain")
    assert table.scenarios == {
        "cut_in": {"physical": 1, "synthetic": 2},
        "vru": {"synthetic": 1},
    }
    assert [change.subject for change in table.changes] == ["synthetic"]


@pytest.mark.parametrize(
    ("value", "reference", "expected"),
    [
        (0.6, 0.5, 0.2),
        (0.4, 0.5, -0.2),
        (0.5, 0.5, 0.0),
        (0.5, 0, None),
        (None, 1, None),
        (1, None, None),
    ],
)
def test_relative_difference(value, reference, expected):
    result = relative_difference(value, reference)
    assert result is None if expected is None else result == pytest.approx(expected, abs=1e-12)


def test_the_written_fields_are_the_metrics_of_the_table():
    of_cell = [field.name for field in fields(CellMetrics)]
    assert of_cell == ["n", "matched", *METRIC_NAMES, "semantic_denominator", "cia_denominator"]
    assert tuple(field.name for field in fields(Scores)) == GIVEN
