"""The engine against METHOD 6 read aloud, and many cells at once against each alone."""

import importlib.util
import math
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from score_inputs import any_labels, any_records

from ssp_eval.data.labels import load_labels
from ssp_eval.data.records import Slot, load_records
from ssp_eval.score import matching
from ssp_eval.score.cell import score_cell, score_in_detail
from ssp_eval.score.columns import encode
from ssp_eval.score.engine import LabelTerms, batch_terms, cell_terms, score_cells, score_columns
from ssp_eval.score.matching import match
from ssp_eval.score.metrics import CellMetrics, exact_sum
from ssp_eval.score.thresholds import Thresholds
from ssp_vla_bridge.trajectory import Trajectory
from tests.support.rows import check_rows

TESTS = Path(__file__).parents[3] / "tests"
GOLDEN = sorted(path.parent for path in (TESTS / "golden").glob("*/expected.json"))
EXACT = ("n", "matched", "rsr", "denominators")

cell = st.tuples(any_labels(), any_records())
# Other thresholds than METHOD's, so that none of them stands in the formulas as a number.
OTHERS = (
    Thresholds(),
    Thresholds(response_count=3, response_gap_s=0.4, match_window_s=0.2, soft_credit=0.25),
    Thresholds(response_count=1, support_end_s=0.9, stop_speed_mps=1.5, accel_mps2=1.0),
    Thresholds(lateral_shift_m=0.6, max_backward_m=5.0, max_speed_mps=50.0, max_accel_mps2=100.0),
    Thresholds(max_lateral_speed_mps=50.0, tolerance=1e-6, weight_jovr=0.2, weight_rsr=0.0),
)


@pytest.fixture(scope="module")
def naive():
    """tests/bench/naive_scorer.py."""
    path = TESTS / "bench" / "naive_scorer.py"
    spec = importlib.util.spec_from_file_location("naive_scorer", path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def near(first, second):
    """Assert that two score outputs agree to 1e-12 in every key of METHOD 6.14."""
    assert list(first) == list(second)
    for key, value in first.items():
        if key in EXACT or value is None or second[key] is None:
            assert value == second[key], key
        else:
            assert math.isclose(value, second[key], rel_tol=0, abs_tol=1e-12), key


def same(first, second):
    """Assert that two score outputs are the same to the last bit."""
    assert list(first) == list(second)
    assert first == second


def same_terms(first, second):
    for item in fields(LabelTerms):
        if item.name == "record":  # a row of all cells' records
            continue
        one, other = getattr(first, item.name), getattr(second, item.name)
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12, err_msg=item.name)


@settings(max_examples=25, deadline=None)
@given(cells=st.lists(cell, min_size=1, max_size=3), thresholds=st.sampled_from(OTHERS))
def test_many_cells_at_once_score_what_each_scores_alone(cells, thresholds):
    batch = score_cells(cells, thresholds)
    assert len(batch) == len(cells)
    for (labels, records), scores in zip(cells, batch, strict=True):
        same(scores.to_json(), score_cell(labels, records, thresholds).to_json())


@settings(max_examples=25, deadline=None)
@given(cells=st.lists(cell, min_size=1, max_size=3), thresholds=st.sampled_from(OTHERS))
def test_their_terms_are_the_same_too(cells, thresholds):
    terms = batch_terms(encode(cells), thresholds)
    for number, (labels, records) in enumerate(cells):
        same_terms(terms.cell(number), cell_terms(labels, records, thresholds))


@settings(max_examples=25, deadline=None)
@given(cell=cell)
def test_both_agree_with_the_method_read_aloud(naive, cell):
    near(score_cell(*cell).to_json(), naive.score(*cell))


def test_golden_cases(naive):
    def check(case):
        labels = load_labels(case / "labels.json")
        records = load_records(case / "records.jsonl")
        expected = score_cell(labels, records)
        same(score_cells([(labels, records)])[0].to_json(), expected.to_json())
        near(naive.score(labels, records), expected.to_json())
        same_terms(batch_terms(encode([(labels, records)])).cell(0), cell_terms(labels, records))

    check_rows(check, [(case,) for case in GOLDEN])


def golden_cells():
    return [
        (load_labels(case / "labels.json"), load_records(case / "records.jsonl")) for case in GOLDEN
    ]


@settings(max_examples=20, deadline=None)
@given(order=st.permutations(range(len(GOLDEN))))
def test_permuting_cells_permutes_their_scores(order):
    cells = golden_cells()
    scores = score_cells(cells)
    assert score_cells([cells[i] for i in order]) == [scores[i] for i in order]


@pytest.mark.parametrize("thresholds", OTHERS)
def test_details_of_many_cells_are_those_of_each_alone(thresholds):
    cells = golden_cells()
    in_detail = score_in_detail(cells, thresholds)
    assert in_detail == [score_cell(*cell, thresholds) for cell in cells]
    for found, metrics in zip(in_detail, score_cells(cells, thresholds), strict=True):
        assert found.to_json() == metrics.to_json()
        assert found.details.thresholds_sha256 == thresholds.sha256
        assert (found.details.response_record is not None) == bool(metrics.rsr)
        assert math.isclose(sum(found.details.ivcs_terms.values()), metrics.ivcs, abs_tol=1e-12)
    terms = batch_terms(encode(cells), thresholds)
    for number, found in enumerate(in_detail):
        feasible = [judged.feasible_valid for judged in found.details.judgements]
        assert feasible == terms.cell(number).feasible.tolist()


@pytest.mark.parametrize("name", [item.name for item in fields(Thresholds)])
def test_each_threshold_changes_a_score_or_its_details(name):
    cells, before = golden_cells(), getattr(Thresholds(), name)
    found = {
        factor: score_in_detail(cells, replace(Thresholds(), **{name: type(before)(factor)}))
        for factor in (1e-3 if name != "response_count" else 1, before, 50.0)
    }
    told = [
        [replace(score.details, thresholds_sha256="") for score in scores]
        for scores in found.values()
    ]
    numbers = [[score.to_json() for score in scores] for scores in found.values()]
    assert told[0] != told[1] or told[1] != told[2] or numbers[0] != numbers[1]


def test_the_terms_of_a_cell_among_others_are_its_own():
    cells = golden_cells()
    terms = batch_terms(encode(cells), OTHERS[2])
    for number, (labels, records) in enumerate(cells):
        same_terms(terms.cell(number), cell_terms(labels, records, OTHERS[2]))


def test_what_an_addition_loses_is_summed_beside():
    terms = [np.array([number, 0.1]) for number in (1e16, 1.0, 1.0, -1e16)]
    assert exact_sum(terms).tolist() == [2.0, math.fsum([0.1] * 4)]


def test_more_cells_than_a_block_of_the_encoder_holds():
    cells = golden_cells()
    assert score_cells(cells * 3) == score_cells(cells) * 3


def test_a_path_is_read_between_its_samples():
    """6 m/s all the way, sampled every 0.4 s: x is 0, 3 and 6 m at 0, 0.5 and 1 s (METHOD 6.6)."""
    labels, records = golden_cells()[0]
    path = Trajectory((0.0, 0.4, 0.8, 1.2), (0.0, 2.4, 4.8, 7.2), (0.0, 0.4, 0.8, 1.2))
    label = replace(labels.labels[0], lon_actions=("maintain",), lat_actions=("left",))
    cell = replace(labels, labels=(label,)), [replace(records[0], t_s=label.t_s, trajectory=path)]
    assert [score.tqsr for score in score_cells([cell])] == [1.0]
    assert score_cell(*cell).tqsr == 1.0


def test_overflow_and_empty_denominators_are_nobody_s_error():
    with np.errstate(all="raise"):
        scores = dict(zip((case.name for case in GOLDEN), score_cells(golden_cells()), strict=True))
    assert scores["huge_numbers"].stfr == 0
    assert scores["null_denominators"].cia_eff is None


@pytest.mark.parametrize(
    ("places_m", "lon"),
    [
        ((-8e307, 2e307, 1.2e308), "maintain"),
        ((-1e308, 0.0, 1.7e308), "accelerate"),
        ((-1.7e308, 0.0, 1e308), "decelerate"),
    ],
)
def test_two_infinite_speeds_have_the_difference_of_their_steps(places_m, lon):
    """Both speeds are more than a double holds; what they differ by has a sign (METHOD 6.6)."""
    labels, records = golden_cells()[0]
    path = Trajectory((0.0, 0.5, 1.0), places_m, (0.0, 0.0, 0.0))
    label = replace(labels.labels[0], lon_actions=(lon,), lat_actions=("straight",))
    cell = replace(labels, labels=(label,)), [replace(records[0], t_s=label.t_s, trajectory=path)]
    with np.errstate(all="raise"):
        same(score_cells([cell])[0].to_json(), score_cell(*cell).to_json())
    score = score_cell(*cell)
    assert score.stfr == 0
    assert score.details.judgements[0].trajectory_lon == lon


def test_scores_are_named_and_typed_as_those_of_a_cell():
    scores = score_columns(encode(golden_cells()))
    assert list(scores.values) == [item.name for item in fields(CellMetrics)]
    whole = ("n", "matched", "rsr", "semantic_denominator", "cia_denominator")
    for cell in scores.cells():
        for name, value in vars(cell).items():
            assert value is None or type(value) is (int if name in whole else float), name
    assert math.isnan(batch_terms(encode(golden_cells())).rows.risk_onset_s)


def test_whole_numbers_are_numbers():
    labels, records = golden_cells()[0]
    label = replace(labels.labels[0], t_s=1, lon_actions=("maintain",), lat_actions=("straight",))
    path = Trajectory((0, 1), (0, 5), (0, 0))
    cell = (
        replace(labels, labels=(label, replace(label, t_s=3)), risk_time_s=1),
        [replace(records[0], t_s=1, trajectory=path)],
    )
    same(score_cells([cell])[0].to_json(), score_cell(*cell).to_json())
    assert score_cell(*cell).tqsr == 0.5


def overlapping(cell):
    """The same with a second record 1 ms after the first."""
    labels, records = cell
    return labels, [records[0], replace(records[0], t_s=records[0].t_s + 0.001), *records[2:]]


def test_only_overlapping_windows_need_the_exact_matcher(monkeypatch):
    calls = []

    def counted(labels_s, records_s, thresholds):
        calls.append(len(labels_s))
        return match(labels_s, records_s, thresholds)

    monkeypatch.setattr(matching, "match", counted)
    (nine,) = [
        cell
        for cell, case in zip(golden_cells(), GOLDEN, strict=True)
        if case.name == "nine_labels"
    ]
    scores = score_cells([nine, overlapping(nine), nine])
    assert calls == [9]
    assert scores[0] == scores[2] == score_cells([nine])[0]
    same(scores[1].to_json(), score_cell(*overlapping(nine)).to_json())
    close = replace(nine[0], labels=(nine[0].labels[0], replace(nine[0].labels[1], t_s=0.01)))
    far = replace(close, labels=(close.labels[0], replace(close.labels[1], t_s=5.0)))
    score_cells([(close, nine[1][:1]), (far, nine[1][:1])])
    assert calls == [9, 9, 2]


def test_many_cells_of_a_shape_are_matched_in_portions(monkeypatch):
    cells = golden_cells()
    expected = score_cells(cells)
    monkeypatch.setattr(matching, "_TABLE", 1)
    assert score_cells(cells) == expected


def test_no_cells_have_no_scores():
    assert score_cells([]) == []


def test_a_cell_without_labels_is_refused():
    labels, records = golden_cells()[0]
    with pytest.raises(ValueError, match=r"^a cell without labels has no scores$"):
        score_cells([(replace(labels, labels=()), records)])


@pytest.mark.parametrize(
    ("slot", "value"), [("position", "above"), ("objects", ("tram",)), ("objects", "car")]
)
def test_a_word_of_no_vocabulary_is_refused(slot, value):
    labels, records = golden_cells()[0]
    slots = replace(records[0].slots, **{slot: Slot(value, ((0, 1),))})
    with pytest.raises(ValueError, match="isn't of the vocabulary"):
        score_cells([(labels, [replace(records[0], slots=slots)])])
