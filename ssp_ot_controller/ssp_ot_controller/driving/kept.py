"""The model of a driver's node: it ends with an abort, and its answers are kept for the judgement.

The run in one process, by which a session of several processes is judged, asks what the session
asked and repeats what is kept here. It reaches the step of an abort, and the question of that step,
before it hears of the abort: so a question that the abort cut off has an answer as well, without a
plan.
"""

from __future__ import annotations

import threading
from pathlib import Path

from ssp_core.vocabulary import SessionPhase
from ssp_core.world.driver import Answer, DriveReport, GivenAnswer, RecordedAnswer, SeeingDriver
from ssp_core.world.driver_answers import append_answer

CUT_OFF = "the session was aborted while it was asked"


class KeptModel:
    """A model that drives as a node, up to the session's end.

    Args:
        driver: the model.
        answers: file of its answers, one line each.
    """

    def __init__(self, driver: SeeingDriver, answers: Path) -> None:
        self._driver, self._answers = driver, answers
        self._is_aborted = False

    def take_phase(self, phase: SessionPhase) -> None:
        """End the model with the session: an answer is of no use any more."""
        if phase is SessionPhase.ABORTING and not self._is_aborted:
            self._is_aborted = True
            # A server may take its time to end; the node goes on to say that it waits.
            threading.Thread(target=self._driver.close, daemon=True).start()

    def keep(self, report: DriveReport) -> None:
        """Keep the answer to the question of a step, if there is one.

        Raises:
            HostError: the disk doesn't take it.
        """
        question, answer = report.question, report.answer
        if question is None or answer is None:
            return
        if self._is_aborted and answer.ended:
            answer = GivenAnswer(Answer(None, refused=CUT_OFF), answer.latency)
        append_answer(self._answers, RecordedAnswer(question.sha256, answer))

    def ending(self, report: DriveReport) -> str:
        """Return why the model has ended by itself; empty: it goes on, or an abort ended it."""
        return "" if self._is_aborted else report.died
