"""How a run ended: what the session said, and what runner and recorder know beside it."""

from __future__ import annotations

import pytest

from ssp_core.run_file.verdict import RecordedVerdict
from ssp_core.vocabulary import Verdict as V
from ssp_scenario_manager.session.run_script import RunOutcome


def test_the_first_verdict_that_says_more_than_valid_stays() -> None:
    outcome = RunOutcome(V.VALID, ()).with_reason(V.INVALID_HARNESS, "died")
    assert outcome == RunOutcome(V.INVALID_HARNESS, ("died",))
    assert outcome.with_reason(V.ABORTED, "late") == RunOutcome(V.INVALID_HARNESS, ("died", "late"))
    assert outcome.with_reason(V.ABORTED, "died") == outcome


@pytest.mark.parametrize("told", [None, RecordedVerdict(V.VALID, ())])
def test_a_recorder_that_has_nothing_to_add(told: RecordedVerdict | None) -> None:
    outcome = RunOutcome(V.VALID, ())
    assert outcome.with_word_of_recorder(told) == outcome


def test_what_the_recorder_alone_knows() -> None:
    told = RecordedVerdict(V.INVALID_HARNESS, ("the recorder lost 3 messages",))
    outcome = RunOutcome(V.VALID, ()).with_word_of_recorder(told)
    assert outcome == RunOutcome(V.INVALID_HARNESS, ("the recorder lost 3 messages",))
    assert not outcome.ok


def test_what_both_know_is_said_once() -> None:
    told = RecordedVerdict(V.FAILED_SAFETY, ("collision", "the recorder lost 3 messages"))
    outcome = RunOutcome(V.FAILED_SAFETY, ("collision",)).with_word_of_recorder(told)
    assert outcome.reasons == ("collision", "the recorder lost 3 messages")
