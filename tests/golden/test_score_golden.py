"""Every folder beside this file: scores worked out by hand (see README.md)."""

import json
import re
from collections import Counter
from functools import cache
from pathlib import Path

import pytest

from ssp_eval.data.labels import load_labels
from ssp_eval.data.records import load_records
from ssp_eval.score.cell import STAGES, CellScore, score_cell
from tests.support.rows import check_rows

CASES = sorted(path.parent for path in Path(__file__).parent.glob("*/expected.json"))


@cache
def scored(case: Path) -> CellScore:
    return score_cell(load_labels(case / "labels.json"), load_records(case / "records.jsonl"))


def expected(case: Path) -> dict:
    return json.loads((case / "expected.json").read_text())


def test_the_cases_are_found():
    assert len(CASES) >= 59


def test_the_readme_says_of_each_case_what_it_stands_for():
    table = (Path(__file__).parent / "README.md").read_text().partition("| METHOD |")[2]
    cases = {case.name for case in CASES}
    # What isn't a case is a key of the files.
    keys = {"invalid", "first_frame_dynamics", "risk_time_s"}
    assert cases <= set(re.findall(r"`(\w+)`", table)) <= cases | keys


def test_scores_are_as_worked_out_by_hand():
    check_rows(check_score, [(case,) for case in CASES])


def check_score(case):
    want, got = expected(case)["score"], scored(case).to_json()
    assert list(got) == list(want)
    nulls = {key for key, value in want.items() if value is None}
    assert {key for key, value in got.items() if value is None} == nulls
    assert got.pop("denominators") == want.pop("denominators")
    numbers = {key: value for key, value in want.items() if key not in nulls}
    assert {key: got[key] for key in numbers} == pytest.approx(numbers, rel=0, abs=1e-12)


def test_judgements_are_as_worked_out_by_hand():
    check_rows(check_judgements, [(case,) for case in CASES])


def check_judgements(case):
    judgements = scored(case).details.judgements
    for name, want in expected(case)["per_label"].items():
        assert [getattr(item, name) for item in judgements] == want, name


def test_first_failures_are_counted():
    check_rows(check_first_failures, [(case,) for case in CASES])


def check_first_failures(case):
    details = scored(case).details
    found = Counter(item.first_failure for item in details.judgements)
    assert details.first_failures == {stage: found[stage] for stage in STAGES}
    assert list(details.first_failures) == list(STAGES)


def test_the_details_lead_back_to_the_outputs():
    """The case says: nine labels, none for 4.0, a stray record at 2.25, the response at 3.0."""
    cell = scored(Path(__file__).parent / "nine_labels")
    details = cell.details
    assert details.record_labels == (0, 1, 2, 3, 4, None, 5, 6, 7)
    assert details.response_record == 7
    assert details.risk_onset_s == 2.0
    assert details.ivcs_terms == pytest.approx(
        {
            "jovr": 0.1 * 8 / 9,
            "sem_acc_eff": 0.3 * 30 / 34,
            "cia_eff": 0.2 * 7 / 8,
            "tqsr": 0.3 * 6 / 9,
            "rsr": 0.1,
        },
        abs=1e-12,
    )
    first, last = details.judgements[0], details.judgements[8]
    assert (first.label_t_s, first.record_t_s) == (0.0, 0.0)
    assert (first.text_lon, first.text_lat) == ("maintain", "straight")
    assert (first.trajectory_lon, first.trajectory_lat) == ("maintain", "straight")
    assert (last.label_t_s, last.record, last.text_lon, last.trajectory_lon) == (
        4.0,
        None,
        None,
        None,
    )
