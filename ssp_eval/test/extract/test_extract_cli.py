"""``ssp extract`` as a user meets it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from ssp_core.cli import main
from ssp_eval.extract.cli import extract

LINES = '{"id": "a", "text": "I slow down."}\n\n{"id": 7, "text": ""}\n'


def _run(path: Path, capsys: pytest.CaptureFixture[str]) -> tuple[int, str, str]:
    code = main(["extract", str(path)])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


def test_each_text_gives_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "texts.jsonl"
    path.write_text(LINES, encoding="utf-8")
    code, out, _ = _run(path, capsys)
    first, second = [json.loads(line) for line in out.splitlines()]
    nothing = {"slots": [], "withdrawn": []}
    assert first.pop("reader") == second.pop("reader") == nothing
    empty = dict.fromkeys(["objects", "position", "motion", "conflict", "lon_action", "lat_action"])
    assert code == 0
    assert first == {
        "id": "a",
        "slots": {**empty, "lon_action": {"value": "decelerate", "evidence": [[2, 11]]}},
    }
    assert second == {"id": 7, "slots": empty}


@pytest.mark.parametrize(
    ("before", "after", "note"),
    [
        ("<think>A pedestrian crosses from the left, I stop.</think>", "", "reasoning"),
        ("", "<|im_end|>\nHuman: Now a truck cuts in from the left. Brake!", "own turn"),
    ],
)
def test_of_an_output_the_answer_alone_is_read(
    before: str, after: str, note: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = "A cyclist is ahead. I keep my speed."
    path = tmp_path / "texts.jsonl"
    lines = [{"id": 1, "text": answer}, {"id": 2, "text": before + answer + after}]
    path.write_text("".join(json.dumps(line) + "\n" for line in lines))
    assert main(["extract", str(path)]) == 0
    plain, whole = map(json.loads, capsys.readouterr().out.splitlines())
    assert plain["slots"]["objects"]["value"] == ["cyclist"]
    assert whole["slots"] == plain["slots"]
    assert whole["answer"] == answer
    assert note in whole["notes"][0]
    assert "answer" not in plain


def test_the_review_shows_the_answer_alone(tmp_path: Path) -> None:
    path = tmp_path / "texts.jsonl"
    text = "<think>A bus, I stop.</think>A cyclist is ahead."
    path.write_text(json.dumps({"id": 1, "text": text}) + "\n")
    assert main(["extract", str(path), "--review", str(tmp_path / "review"), "--n", "1"]) == 0
    form = (tmp_path / "review" / "reviewer_1" / "form.html").read_text()
    assert "A cyclist is ahead." in form
    assert "A bus" not in form


def test_standard_input() -> None:
    result = CliRunner().invoke(extract, ["-"], input=LINES)
    assert result.exit_code == 0
    assert len(result.stdout.splitlines()) == 2
    assert result.stderr == "reader: filled 0 of 1 slots, took back 0 of the rules\n"


def test_the_rules_can_be_asked_alone() -> None:
    result = CliRunner().invoke(extract, ["-", "--rules-only"], input=LINES)
    assert result.exit_code == 0
    assert result.stderr == ""
    assert [set(json.loads(line)) for line in result.stdout.splitlines()] == [{"id", "slots"}] * 2


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ('{"id": "a"}', "text"),
        ('{"id": "a", "text": 3}', "text"),
        ('{"id": null, "text": ""}', "id"),
        ('{"id": true, "text": ""}', "id"),
        ('{"id": "a", "text": "", "label": "car"}', "label"),
        ('["a"]', "dictionary"),
        ("{", "JSON"),
        ('{"id": 1, "text": "Go."}', "stands in line 1 already"),
    ],
)
def test_a_bad_line_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], line: str, told: str
) -> None:
    path = tmp_path / "texts.jsonl"
    path.write_text('{"id": 1, "text": "Stop."}\n' + line + "\n", encoding="utf-8")
    code, _, err = _run(path, capsys)
    assert code == 1
    assert f"{path.name}:2" in err
    assert told in err


def test_other_encodings_and_missing_files(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "latin.jsonl"
    path.write_bytes('{"id": 1, "text": "é"}\n'.encode("latin-1"))
    code, _, err = _run(path, capsys)
    assert code == 1
    assert "UTF-8" in err
    code, _, err = _run(tmp_path / "none.jsonl", capsys)
    assert code == 1
    assert "none.jsonl" in err
    assert main(["extract"]) == 2
