"""The best blind constant: nothing that is always the same scores more, and what it is good for."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from score_inputs import any_labels

from ssp_core.errors import InputError
from ssp_core.vocabulary import CONFLICTS, LAT_ACTIONS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS
from ssp_eval.data.labels import Label, Labels
from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.evaluate.clients.models import BEST_CONSTANT, bridge_spec
from ssp_eval.extract.engine import extract
from ssp_eval.figures.scores import Scores
from ssp_eval.score.engine import score_cells
from ssp_eval.score.thresholds import DEFAULT
from ssp_eval.statistics.best_constant import Plan, Scene, _records, best_constant
from ssp_eval.statistics.constants import BELOW, constants_in
from ssp_eval.statistics.csv_rows import rows_from_csv
from ssp_eval.statistics.domains import NO_CELLS, NO_UNITS, NOT_OWED
from ssp_eval.statistics.rows import MACRO
from ssp_eval.statistics.statistics import compute
from ssp_eval.statistics.table import by_column, write_tables
from ssp_eval.statistics.tables.notices import notices
from ssp_eval.statistics.tables.scores import all_tables, matrix_table
from ssp_eval.statistics.tables.statistics import comparison_table
from tests.support.score_rows import row


def labels_of(*said: tuple[str, str, str, str], domain="synthetic", lon=("decelerate",)) -> Labels:
    """Labels 0.5 s apart: object, position, motion and conflict of each."""
    return Labels(
        "cut_in",
        domain,
        "v",
        0.0,
        True,
        tuple(
            Label(0.5 * k, "conflict", True, (one[0],), *one[1:], lon, ("straight",))
            for k, one in enumerate(said)
        ),
    )


AHEAD = ("car", "front", "cutting_in_from_left", "active")
BESIDE = ("car", "front_left", "same_direction", "potential")


def test_the_commonest_label_is_said_and_its_action_driven():
    found = best_constant((labels_of(AHEAD, AHEAD, BESIDE),))
    assert found.text == (
        "A car is directly ahead of me and is cutting in from the left. A collision with the car "
        "is imminent. I slow down and stay in my lane."
    )
    assert found.plan == Plan("decelerate", "straight")
    (score,) = found.scores
    # Of 12 slots 9 are right: 3 × 2 + the car + nothing else of the third label.
    assert score.sem_acc_eff == pytest.approx(9 / 12)
    assert (score.cia_eff, score.tqsr, score.rsr, score.jovr) == (
        pytest.approx(2 / 3),
        1.0,
        1,
        1.0,
    )
    assert score.atc_eff == score.act_acc_eff == 1.0


def test_it_is_chosen_over_all_recordings_of_a_scenario():
    """The second recording asks mostly for another place, so that the first one alone misleads."""
    one, other = labels_of(AHEAD, AHEAD, BESIDE), labels_of(BESIDE, BESIDE, BESIDE)
    assert best_constant((one,)).scene.position == "front"
    found = best_constant((one, other))
    assert found.scene.position == "front_left"
    assert found.scores[1].ivcs - found.scores[0].ivcs == pytest.approx(0.3 * 0.5 + 0.2 * 2 / 3)
    assert best_constant((one, other)) == best_constant((replace(one), replace(other)))


SCENES = st.builds(
    Scene,
    st.none() | st.lists(st.sampled_from(OBJECTS), unique=True, max_size=3).map(tuple),
    st.none() | st.sampled_from(POSITIONS),
    st.none() | st.sampled_from(MOTIONS),
    st.none() | st.sampled_from(CONFLICTS),
)


@settings(max_examples=25, deadline=None)
@given(
    st.lists(any_labels(), min_size=1, max_size=3),
    st.lists(SCENES, min_size=1, max_size=12),
)
def test_no_other_constant_scores_more(recordings, others):
    found = best_constant(tuple(recordings))
    mine = sum(score.ivcs for score in found.scores)
    for scene, (lon, lat) in zip(others, product(LON_ACTIONS, LAT_ACTIONS), strict=False):
        cells = [(one, _records(one, scene, Plan(lon, lat))) for one in recordings]
        assert sum(score.ivcs for score in score_cells(cells)) <= mine + 1e-9
    cells = [(one, _records(one, found.scene, found.plan)) for one in recordings]
    assert tuple(score_cells(cells, DEFAULT)) == found.scores


@pytest.mark.parametrize("conflict", ["no_conflict", "potential", "active"])
@pytest.mark.parametrize("motion", MOTIONS)
def test_what_it_says_is_what_the_extractor_reads(motion, conflict):
    scene = Scene(("cyclist",), "front_right", motion, conflict)
    (record,) = _records(labels_of(AHEAD), scene, Plan("decelerate", "left"))
    read = extract(record.text)
    assert {name: getattr(read, name).value for name in SLOT_NAMES} == {
        name: getattr(record.slots, name).value for name in SLOT_NAMES
    }


# -- beside models and domains --


def of_constant(domain, value, scenario="s", **others):
    return row(scenario, domain, BEST_CONSTANT, value, control=True, **others)


ROWS = [
    row("s", "synthetic", "good", 0.8),
    row("s", "physical", "good", 0.85),
    row("s", "synthetic", "bad", 0.3),
    row("s", "physical", "bad", 0.6),
    of_constant("synthetic", 0.5),
    of_constant("physical", 0.6),
]


def tables(rows):
    return {table.name: by_column(table) for table in all_tables(rows)}


def test_it_stands_among_the_controls_and_in_no_rank():
    found = tables(ROWS)
    assert [line["model"] for line in found["by_model"]] == ["bad", "good"]
    assert [line["model"] for line in found["answerers"]] == [BEST_CONSTANT]
    assert {line["rank_all"] for line in found["ranks_model"]} == {1, 2}
    ranks = {line["model"]: line for line in found["ranks_model"]}
    assert (ranks["good"]["below"], ranks["bad"]["below"]) == ("", "all, s")
    assert ranks["bad"]["constant"].value == pytest.approx(0.9 * 0.55)
    remarks = {(line["domain"], line["model"]): line["remark"] for line in found["matrix"]}
    # Equal to it isn't below it.
    assert remarks["synthetic", "bad"] == BELOW
    assert remarks["physical", "bad"] == ""
    assert remarks["synthetic", BEST_CONSTANT] == "control"


def test_a_model_without_all_recordings_is_held_against_those_that_it_has():
    rows = [*ROWS, row("s", "physical", "half", 0.55)]
    ranks = {line["model"]: line for line in tables(rows)["ranks_model"]}
    assert ranks["half"]["constant"].value == pytest.approx(0.9 * 0.6)
    assert ranks["half"]["below"] == "all, s"
    assert Scores(tuple(rows)).below("model") == {("bad",), ("half",)}


def test_a_difference_of_domains_stands_beside_that_of_the_labels_alone():
    by_model = {line["model"]: line for line in tables(ROWS)["domain_differences_model"]}
    good, bad = by_model["good"], by_model["bad"]
    assert good["labels_alone"] == bad["labels_alone"] == pytest.approx(0.09)
    assert good["finding"] == f"{NO_UNITS}; {NOT_OWED}: the labels alone give +0.090"
    assert bad["finding"] == NO_UNITS
    assert good["low"] is good["high"] is None
    (line,) = [one for one in tables(ROWS)["domain_differences"] if one["metric"] == "IVCS"]
    assert line["difference"] == pytest.approx(0.9 * 0.175)
    assert line["change"] == pytest.approx(0.175 / 0.55)
    assert line["finding"] == NO_UNITS
    compared = comparison_table(compute(ROWS, constants=constants_in(ROWS)).comparisons)
    (line,) = [
        one for one in by_column(compared) if (one["subject"], one["metric"]) == ("domain", "ivcs")
    ]
    assert abs(line["labels_alone"]) == pytest.approx(0.09)
    assert line["finding"] == NO_UNITS


def test_published_means_are_not_said_to_be_of_one_recording():
    rows = [
        row(MACRO, domain, model, value, rsr=0.5, rl_s=1.0, weighted=value)
        for model in "ab"
        for domain, value in (("simulation", 0.5), ("physical", 0.6))
    ]
    compared = by_column(comparison_table(compute(rows).comparisons))
    for line in (
        *tables(rows)["domain_differences"],
        *tables(rows)["domain_differences_model"],
        *(one for one in compared if one["subject"] == "domain"),
    ):
        assert line["low"] is None
        assert line["finding"] == NO_CELLS


def test_no_difference_of_domains_stands_bare():
    """Two scenarios give an interval over these two, for any number of models."""
    rows = [
        row(s, d, m, 0.4 + 0.1 * (d == "physical") + 0.1 * (s == "t") * (d == "physical"))
        for s in "st"
        for d in ("synthetic", "physical")
        for m in "abcdef"
    ]
    for line in (*tables(rows)["domain_differences"], *tables(rows)["domain_differences_model"]):
        assert line["low"] is not None or NO_UNITS in line["finding"]
        assert (line["low"] is not None) == (line["scenario"] == "all")
    (line,) = [
        one
        for one in tables(rows)["domain_differences"]
        if (one["scenario"], one["metric"]) == ("all", "IVCS")
    ]
    # Student's of 0.09 and 0.18 with one degree of freedom, not of twelve pairs.
    assert line["high"] - line["low"] == pytest.approx(2 * 12.706 * 0.09 / 2, rel=1e-4)
    # Nobody knows what the labels alone give.
    assert line["labels_alone"] is None
    table = comparison_table(compute(rows).comparisons)
    (tested,) = [
        one for one in by_column(table) if (one["subject"], one["metric"]) == ("domain", "ivcs")
    ]
    assert tested["high"] - tested["low"] == pytest.approx(line["high"] - line["low"])
    keys = [column.key for column in table.columns]
    assert keys.index("p_scenarios") < keys.index("p_scenarios_holm") < keys.index("p")


def test_the_interval_holds_its_difference_where_scenarios_have_unlike_numbers_of_models():
    """Five scenarios of one model that doesn't change, and one of twenty that lose 0.5."""
    rows = [
        row(s, d, m, 0.5 if s != "z" else 0.8 - 0.5 * (d == "physical"))
        for s, models in (*((s, "a") for s in "pqrst"), ("z", "abcdefghijklmnopqrst"))
        for d in ("simulation", "physical")
        for m in models
    ]
    lines = [
        one
        for one in (
            *tables(rows)["domain_differences"],
            *by_column(comparison_table(compute(rows).comparisons)),
        )
        if one.get("scenario", "all") == "all" and one["metric"] in ("IVCS", "ivcs")
        if one.get("subject", "domain") == "domain"
    ]
    assert len(lines) == 2
    for line in lines:
        difference = line.get("difference", line.get("mean_difference"))
        assert abs(difference) == pytest.approx(0.9 * 0.5 * 20 / 25)
        middle = (line["low"] + line["high"]) / 2
        assert middle == pytest.approx(difference)


def test_a_matrix_of_ours_keeps_it(tmp_path):
    path, _ = write_tables(tmp_path, [matrix_table(ROWS)], ["csv"])
    told = []
    again = rows_from_csv(path, told.append)
    assert told == []
    assert constants_in(again) == constants_in(ROWS)
    assert all_tables(again) == all_tables(ROWS)


def test_alone_it_isnt_a_control_that_shows_seeing():
    assert any("have no controls" in one.text for one in notices(ROWS))
    assert not any("Not evaluated" in one.text for one in notices(ROWS[:-1]))


@pytest.mark.parametrize("backend", ["", "openai"])
def test_its_name_is_no_models(backend):
    options = f'={{"backend": "{backend}"}}' if backend else ""
    with pytest.raises(InputError, match="name of an answerer of ours"):
        bridge_spec(BEST_CONSTANT + options)
