"""Scores made from files without records between: the same columns, the same refusals."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from ssp_core.errors import InputError
from ssp_eval.data.labels import load_labels
from ssp_eval.data.records import load_records
from ssp_eval.score import columns
from ssp_eval.score import columns as load
from ssp_eval.score.columns import Columns, load_columns
from ssp_eval.score.engine import score_columns

TESTS = Path(__file__).parents[3] / "tests"
GOLDEN = sorted(path.parent for path in (TESTS / "golden").glob("*/expected.json"))


def files(folder):
    return folder / "labels.json", folder / "records.jsonl"


def from_objects(folders):
    return columns.encode(
        [(load_labels(labels), load_records(records)) for labels, records in map(files, folders)]
    )


def test_the_columns_are_those_of_the_records():
    found = load_columns(map(files, GOLDEN))
    assert isinstance(found, Columns)
    assert found.records.answer.dtype == from_objects(GOLDEN).records.answer.dtype == np.int64
    assert len(found.record_start) == len(GOLDEN) + 1
    scores = score_columns(found).cells()
    assert scores == score_columns(from_objects(GOLDEN)).cells()


def test_many_long_answers_are_no_error(tmp_path):
    shutil.copytree(GOLDEN[0], tmp_path / "long")
    labels, records = files(tmp_path / "long")
    line = json.loads(records.read_text().splitlines()[0])
    lines = [json.dumps({**line, "t_s": t_s, "text": "z" * (1 << 20)}) for t_s in range(9)]
    records.write_text("\n".join(lines))
    assert load_columns([(labels, records)]).records.text_valid.tolist() == [True] * 9


def test_labels_that_cells_share_are_read_once(tmp_path, monkeypatch):
    calls = []

    def counted(text, path):
        calls.append(path)
        return load_labels(path)

    monkeypatch.setattr(load, "parse_labels_text", counted)
    case = GOLDEN[0]
    shutil.copytree(case, tmp_path / "again")
    load_columns([files(case), files(tmp_path / "again"), files(GOLDEN[1])])
    assert len(calls) == 2


@pytest.mark.parametrize("block", [1, 8])
def test_what_is_wrong_is_said_as_ever(tmp_path, monkeypatch, block):
    monkeypatch.setattr(load, "_BLOCK", block)
    shutil.copytree(GOLDEN[1], tmp_path / "bad")
    labels, records = files(tmp_path / "bad")
    value = json.loads(records.read_text().splitlines()[0])
    value["slots"]["position"]["value"] = "above"
    records.write_text(json.dumps(value))
    with pytest.raises(InputError) as caught:
        load_columns([files(GOLDEN[0]), (labels, records)])
    with pytest.raises(InputError) as direct:
        load_records(records)
    assert str(caught.value) == str(direct.value)
    labels.write_text("{}")
    with pytest.raises(InputError, match=r"labels\.json: schema: must be ssp.labels/1"):
        load_columns([(labels, records)])
