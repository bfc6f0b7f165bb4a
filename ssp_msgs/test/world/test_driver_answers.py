"""The answers that a driver's node leaves, line by line."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from ssp_core.errors import InputError
from ssp_core.motion.trajectory import Trajectory
from ssp_core.world.driver import Answer, GivenAnswer, LatencyParts, Raw, RecordedAnswer
from ssp_core.world.driver_answers import answers_in_event, append_answer, given_answers

PLAN = Trajectory((0.0, 0.5), (0.0, math.nan), (0.0, -0.25))
ANSWERS = (
    RecordedAnswer("sha256:1", GivenAnswer(Answer(PLAN, "I wait.\n…", raw=Raw("m")))),
    RecordedAnswer("sha256:2", GivenAnswer(Answer(None, refused="not_ready"))),
    RecordedAnswer("sha256:3", GivenAnswer(None, LatencyParts(5, 2, 1), "it left")),
)


def test_answers_are_read_as_they_were_given_but_for_one_that_was_cut_off(tmp_path: Path) -> None:
    path = tmp_path / "answers.jsonl"
    assert given_answers(path) == ()
    for one in ANSWERS:
        append_answer(path, one)
    assert repr(given_answers(path)) == repr(ANSWERS)
    text = path.read_text()
    path.write_text(text[:-20])
    assert repr(given_answers(path)) == repr(ANSWERS[:2])
    folder = {"event": [json.loads(line) for line in text.splitlines()], "free": []}
    (tmp_path / "answers.json").write_text(json.dumps(folder))
    assert repr(answers_in_event(tmp_path / "answers.json")) == repr(ANSWERS)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("{\n", r"answers.jsonl:1: is not valid JSON"),
        ('{"question": "a", "question": "b"}\n', r"answers.jsonl:1: question: stands twice"),
        ('{"question": "a"}\n', r"answers.jsonl: 1.given: Field required"),
        ('{"question": 1, "given": {"answer": null}}\n', r"answers.jsonl: 1.question"),
    ],
)
def test_a_line_that_is_no_answer_is_refused(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "answers.jsonl").write_text(text)
    with pytest.raises(InputError, match=said):
        given_answers(tmp_path / "answers.jsonl")


def test_a_file_without_answers_in_the_event_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "answers.json"
    for text, said in {"{}": "event: has no answers", "[]": "", "{": "can't be read"}.items():
        path.write_text(text)
        with pytest.raises(InputError, match=rf"answers.json: {said}"):
            answers_in_event(path)
