"""Every folder beside this file: scores worked out by hand (see README.md)."""

import json
from pathlib import Path

import pytest

from ssp_eval.labels.model import load_labels
from ssp_eval.records import load_records
from ssp_eval.score import CellScore, score_cell

CASES = sorted(path.parent for path in Path(__file__).parent.glob("*/expected.json"))
KEYS = [
    "n",
    "matched",
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
    "rsr",
    "rl_s",
    "ivcs",
    "denominators",
]


def scored(case: Path) -> CellScore:
    return score_cell(load_labels(case / "labels.json"), load_records(case / "records.jsonl"))


def expected(case: Path) -> dict:
    return json.loads((case / "expected.json").read_text())


def test_the_cases_are_found():
    assert len(CASES) >= 55


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_score_is_as_worked_out_by_hand(case):
    want, got = expected(case)["score"], scored(case).to_json()
    assert list(got) == KEYS
    assert list(want) == KEYS
    nulls = {key for key, value in want.items() if value is None}
    assert {key for key, value in got.items() if value is None} == nulls
    assert got.pop("denominators") == want.pop("denominators")
    numbers = {key: value for key, value in want.items() if key not in nulls}
    assert {key: got[key] for key in numbers} == pytest.approx(numbers, rel=0, abs=1e-12)


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_judgements_are_as_worked_out_by_hand(case):
    judgements = scored(case).details.judgements
    for name, want in expected(case)["per_label"].items():
        assert [getattr(item, name) for item in judgements] == want, name
