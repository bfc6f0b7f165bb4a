"""The model of a driver's node: what is kept of its answers, and how an abort ends it."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from pathlib import Path

import pytest

from ssp_core.errors import PeerError
from ssp_core.vocabulary import SessionPhase
from ssp_core.world.driver import (
    Answer,
    DriveMode,
    DriveReport,
    EgoSample,
    GivenAnswer,
    LatencyParts,
    Question,
    repeated_answer,
)
from ssp_core.world.driver_answers import given_answers
from ssp_ot_controller.driving.kept import CUT_OFF, KeptModel

ENDED = GivenAnswer(None, LatencyParts(7), "its process was ended by SIGKILL")


class Model:
    """A model that is never asked here, and says when it is closed."""

    privileged = False
    frame_span_s, history_s, problem = 0.0, 0.0, ""

    def __init__(self) -> None:
        self.is_closed = threading.Event()

    def give(self, question: Question) -> GivenAnswer:
        raise PeerError(f"question {question.number} isn't asked")

    def choose(self, stamps_ns: Sequence[int]) -> Sequence[int]:
        return range(len(stamps_ns))

    def close(self) -> None:
        self.is_closed.set()


def question(number: int) -> Question:
    return Question(number, number * 100_000_000, (EgoSample(0.0, 0.0, 0.0, 0.0, 9.0, 0.0),), ())


def report(number: int, given: GivenAnswer) -> DriveReport:
    asked = question(number)
    return DriveReport(DriveMode.PLAN, question=asked, answer=given, died=given.ended)


def test_a_question_that_an_abort_cut_off_has_an_answer_without_a_plan(tmp_path: Path) -> None:
    """The run in one process asks it too, and hears of the abort behind it."""
    kept = KeptModel(Model(), tmp_path / "answers.jsonl")
    given = GivenAnswer(Answer(None, text="I think."))
    kept.keep(report(1, given))
    kept.keep(DriveReport(DriveMode.PLAN))
    kept.take_phase(SessionPhase.RUNNING)
    kept.take_phase(SessionPhase.ABORTING)
    kept.keep(report(2, ENDED))
    recorded = given_answers(tmp_path / "answers.jsonl")
    assert repeated_answer(recorded, question(1)) == given
    cut_off = repeated_answer(recorded, question(2))
    assert cut_off == GivenAnswer(Answer(None, refused=CUT_OFF), ENDED.latency)
    assert kept.ending(report(2, ENDED)) == ""


def test_a_model_that_ended_by_itself_is_kept_as_it_ended(tmp_path: Path) -> None:
    kept = KeptModel(Model(), tmp_path / "answers.jsonl")
    kept.keep(report(1, ENDED))
    assert [one.given for one in given_answers(tmp_path / "answers.jsonl")] == [ENDED]
    assert kept.ending(report(1, ENDED)) == ENDED.ended


@pytest.mark.parametrize("phase", [SessionPhase.ARMED, SessionPhase.RUNNING])
def test_an_abort_ends_a_model_that_is_not_asked_just_then(
    tmp_path: Path, phase: SessionPhase
) -> None:
    model = Model()
    kept = KeptModel(model, tmp_path / "answers.jsonl")
    kept.take_phase(phase)
    assert not model.is_closed.is_set()
    kept.take_phase(SessionPhase.ABORTING)
    model.is_closed.wait()
