"""Properties of the scores of any labels and any outputs (METHOD 6)."""

import json
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from score_inputs import MOVES, SHIFTS, any_labels, any_records

from ssp_eval.data.labels import Label, Labels
from ssp_eval.data.records import BehaviourRecord, Slot, Slots
from ssp_eval.score.cell import STAGES, score_cell
from ssp_eval.score.engine import score_cells
from ssp_eval.score.thresholds import Thresholds
from ssp_vla_bridge.trajectory import Trajectory

RATIOS = (
    "jovr",
    "sem_cov",
    "sem_acc_cond",
    "sem_acc_eff",
    "sem_acc_soft",
    "cia_eff",
    "act_acc_eff",
    "stfr",
    "tqsr",
    "atc_eff",
    "ivcs",
)


@settings(max_examples=50, deadline=None)
@given(labels=any_labels(), records=any_records())
def test_every_score_is_in_its_range(labels, records):
    cell = score_cell(labels, records)
    score = cell.to_json()
    assert score_cells([(labels, records)])[0].to_json() == score
    assert all(score[key] is None or 0 <= score[key] <= 1 for key in RATIOS)
    assert score["matched"] <= min(score["n"], len(records))
    assert score["rsr"] in (0, 1)
    assert (score["rl_s"] is None) == (score["rsr"] == 0)
    assert score["rl_s"] is None or score["rl_s"] >= 0
    assert (score["sem_acc_eff"] is None) == (score["denominators"]["semantic"] == 0)
    assert (score["cia_eff"] is None) == (score["denominators"]["cia"] == 0)
    json.dumps(score, allow_nan=False)


@settings(max_examples=50, deadline=None)
@given(labels=any_labels(), records=any_records())
def test_what_is_contained_in_what(labels, records):
    """A conjunction never scores more than its parts (METHOD 6.2 to 6.8)."""
    cell = score_cell(labels, records)
    assert cell.tqsr <= cell.stfr
    assert cell.jovr * cell.n <= cell.matched
    if cell.sem_acc_eff is not None and cell.sem_cov is not None:
        assert cell.sem_acc_eff <= cell.sem_acc_soft <= cell.sem_cov
    assert sum(cell.details.first_failures.values()) <= cell.n
    assert set(cell.details.first_failures) == set(STAGES)
    for item in cell.details.judgements:
        assert item.record is not None or item.first_failure == "output_validity"
        assert not item.candidate or item.record is not None


@settings(max_examples=30, deadline=None)
@given(labels=any_labels(), records=any_records(1), data=st.data())
def test_a_record_far_from_every_label_changes_nothing_but_the_count(labels, records, data):
    stray = replace(data.draw(st.sampled_from(records)), t_s=100.0)
    before, after = score_cell(labels, records), score_cell(labels, [*records, stray])
    assert after.to_json() == before.to_json()
    first, second = score_cells([(labels, records), (labels, [*records, stray])])
    assert first == second
    assert first.to_json() == before.to_json()
    assert after.details.judgements == before.details.judgements
    assert after.details.unmatched_records == (*before.details.unmatched_records, len(records))


@settings(max_examples=30, deadline=None)
@given(labels=any_labels(), records=any_records())
def test_inputs_are_not_changed(labels, records):
    before = repr(records), repr(labels)
    score_cell(labels, records)
    assert (repr(records), repr(labels)) == before


def right_answer(label):
    text, evidence = "said", ((0, 4),)

    def slot(value):
        return None if value is None else Slot(value, evidence)

    lon, lat = label.lon_actions[0], label.lat_actions[0]
    shift = SHIFTS[lat]
    return BehaviourRecord(
        t_s=label.t_s,
        text=text,
        slots=Slots(
            slot(label.objects),
            slot(label.position),
            slot(label.motion),
            slot(label.conflict),
            slot(lon),
            slot(lat),
        ),
        trajectory=Trajectory((0.0, 0.5, 1.0), (0.0, *MOVES[lon]), (0.0, shift / 2, shift)),
    )


@settings(max_examples=30, deadline=None)
@given(labels=any_labels())
def test_a_perfect_answer_scores_one_everywhere(labels):
    items = [
        replace(item, conflict="active", lon_actions=("decelerate", "stop"), t_s=0.5 * i)
        for i, item in enumerate(labels.labels * 3)
    ]
    labels = replace(labels, labels=tuple(items), risk_time_s=0.25)
    cell = score_cell(labels, [right_answer(item) for item in items])
    score = cell.to_json()
    assert {key for key in RATIOS if key != "ivcs" and score[key] not in (1.0, None)} == set()
    assert score["rsr"] == 1
    # The label at 0 lies before the risk; the response begins at the one after it.
    assert score["rl_s"] == 0.25
    nulls = cell.details.ivcs_nulls
    lost = sum({"sem_acc_eff": 0.3, "cia_eff": 0.2}[name] for name in nulls)
    assert score["ivcs"] == pytest.approx(1 - lost, abs=1e-12)
    assert set(cell.details.first_failures.values()) == {0}


@settings(max_examples=30, deadline=None)
@given(labels=any_labels())
def test_silence_scores_zero_or_null(labels):
    score = score_cell(labels, []).to_json()
    assert score["matched"] == 0
    assert score["rl_s"] is None
    assert score["sem_acc_cond"] is None
    assert {score[key] for key in RATIOS} <= {0, None}


def test_the_hash_of_the_thresholds_is_in_the_result_and_follows_each_of_them():
    labels = Labels(
        "s",
        "physical",
        "v",
        0.0,
        True,
        (Label(0.0, "approach", False, None, None, None, None, ("maintain",), ("straight",)),),
    )
    hashes = {Thresholds().sha256}
    for name, value in vars(Thresholds()).items():
        changed = replace(Thresholds(), **{name: value + 1})
        assert score_cell(labels, [], changed).details.thresholds_sha256 == changed.sha256
        hashes.add(changed.sha256)
    assert len(hashes) == 1 + len(vars(Thresholds()))


def test_the_thresholds_are_those_of_the_method():
    """A changed default is a changed method: this hash moves only with METHOD 5.4 and 6."""
    assert vars(Thresholds()) == {
        "tolerance": 1e-9,
        "match_window_s": 0.11,
        "soft_credit": 0.5,
        "support_end_s": 1.0,
        "stop_speed_mps": 0.5,
        "accel_mps2": 0.5,
        "lateral_shift_m": 0.3,
        "max_backward_m": 0.2,
        "max_speed_mps": 25.0,
        "max_lateral_speed_mps": 5.0,
        "max_accel_mps2": 8.0,
        "response_count": 2,
        "response_gap_s": 0.6,
        "weight_jovr": 0.1,
        "weight_sem_acc_eff": 0.3,
        "weight_cia_eff": 0.2,
        "weight_tqsr": 0.3,
        "weight_rsr": 0.1,
    }


def test_the_details_name_the_records_that_no_label_takes():
    label = Label(0.0, "approach", True, (), "front", None, None, ("maintain",), ("straight",))
    labels = Labels("s", "physical", "v", None, True, (label,))
    details = score_cell(labels, [BehaviourRecord(0.2, "a"), BehaviourRecord(0.3, "b")]).details
    assert details.unmatched_records == (0, 1)
    assert details.record_labels == (None, None)


@pytest.mark.parametrize(("text", "jovr"), [("", 0.0), (" ", 0.0), ("x", 1.0)])
def test_one_character_is_a_text(text, jovr):
    label = Label(0.0, "approach", True, (), "front", None, None, ("maintain",), ("straight",))
    labels = Labels("s", "physical", "v", None, True, (label,))
    path = Trajectory((0.0, 0.5, 1.0), (0.0, *MOVES["maintain"]), (0.0, 0.0, 0.0))
    cell = score_cell(labels, [BehaviourRecord(0.0, text, trajectory=path)])
    assert cell.jovr == jovr
    assert (cell.details.judgements[0].first_failure == "output_validity") is (jovr == 0)
