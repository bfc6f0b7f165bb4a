"""The steps of a run_scenario goal, that it always comes to an end, and what a run ended with."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ssp_core.run_file.verdict import RecordedVerdict
from ssp_core.vocabulary import SessionPhase as P
from ssp_core.vocabulary import Verdict as V
from ssp_scenario_manager.session.run_script import PATIENCE_S, RunOutcome, RunScript
from ssp_scenario_manager.session.state_machine import Answer
from ssp_scenario_manager.session.state_machine import SessionEvent as E

S = 1_000_000_000
YES = Answer(True)
LATE = int(PATIENCE_S * S)


def no(*missing: str) -> Answer:
    return Answer(False, 2, "; ".join(missing), missing)


def begun() -> RunScript:
    script = RunScript("run.yaml", 0)
    assert script.next(P.IDLE, 0) is E.LOAD
    script.on_answer(YES)
    return script


def test_the_whole_way() -> None:
    script = begun()
    assert script.next(P.LOADED, 1) is E.CONNECT
    script.on_answer(no("no state of ot1 arrives"))
    assert script.next(P.LOADED, 2) is E.CONNECT
    script.on_answer(YES)
    assert script.next(P.CONNECTED, 3) is E.ARM
    script.on_answer(YES)
    assert script.next(P.ARMED, 4) is E.START
    script.on_answer(YES)
    for state in (P.RUNNING, P.STOPPING, P.RUNNING, P.ABORTING):
        assert script.next(state, 1000 * S) is None
        assert not script.finished
    assert script.next(P.FINISHED, 1001 * S) is None
    assert (script.finished, script.problems, script.has_begun) == (True, (), True)
    assert script.next(P.IDLE, 1002 * S) is None


def test_a_loaded_session_gets_this_goals_own_file() -> None:
    assert RunScript("run.yaml", 0).next(P.LOADED, 0) is E.LOAD


@pytest.mark.parametrize("state", [p for p in P if p not in (P.UNKNOWN, P.IDLE, P.LOADED)])
def test_a_session_that_is_elsewhere_is_not_taken_over(state: P) -> None:
    """Most of all a finished one: its verdict belongs to another run."""
    script = RunScript("run.yaml", 0)
    assert script.next(state, 0) is None
    assert script.finished
    assert not script.has_begun
    assert script.problems == (
        f"the session is {state.name} already; reset it or clear its abort first",
    )


def test_a_file_that_cannot_be_loaded_is_final() -> None:
    script = RunScript("run.yaml", 0)
    script.next(P.IDLE, 0)
    script.on_answer(no("triggers[0]: …", "triggers[1]: …"))
    assert script.finished
    assert not script.has_begun
    assert script.problems == ("triggers[0]: …", "triggers[1]: …")


def test_patience_ends_with_what_was_missing_last() -> None:
    script = begun()
    assert script.next(P.LOADED, 0) is E.CONNECT
    script.on_answer(no("no state of the VUT arrives", "no state of ot1 arrives"))
    assert script.next(P.LOADED, LATE) is E.CONNECT
    script.on_answer(no("no state of ot1 arrives"))
    assert script.next(P.LOADED, LATE + 1) is None
    assert script.problems == ("no state of ot1 arrives",)


def test_patience_counts_anew_after_progress_only() -> None:
    script = begun()
    script.next(P.LOADED, 0)
    assert script.next(P.CONNECTED, LATE) is E.ARM
    # It arms and falls back, again and again.
    now_ns = LATE
    while not script.finished:
        now_ns += S
        script.on_answer(YES)
        if script.next(P.ARMED, now_ns) is E.START:
            script.on_answer(no("ot1 is PRE_ARMING, not ARMED"))
        now_ns += S
        script.on_setback("ot1 did not arm in 3 s")
        script.next(P.CONNECTED, now_ns)
        assert now_ns < 4 * LATE
    assert script.problems == ("ot1 did not arm in 3 s",)


def test_a_refusal_without_a_list_is_given_in_words() -> None:
    script = begun()
    script.next(P.LOADED, 0)
    script.on_answer(Answer(False, 1, "connect is not possible"))
    script.next(P.LOADED, LATE + 1)
    assert script.problems == ("connect is not possible",)
    script = RunScript("run.yaml", 0)
    script.on_answer(Answer(False, 2, "can't be read"))
    assert script.problems == ("can't be read",)


def test_without_any_answer_it_says_what_was_not_possible() -> None:
    script = begun()
    script.next(P.LOADED, 0)
    script.next(P.LOADED, LATE + 1)
    assert script.problems == (f"connect was not possible in {PATIENCE_S:g} s",)


def test_an_abort_ends_it_with_or_without_a_standstill() -> None:
    script = begun()
    assert script.next(P.ABORTING, 0) is None
    assert not script.finished
    script.standstill_unconfirmed()
    script.next(P.ABORTING, 1)
    assert script.finished
    script = begun()
    script.next(P.ABORTED, 0)
    assert script.finished


def test_a_reset_by_somebody_else_ends_it() -> None:
    script = begun()
    script.next(P.LOADED, 0)
    assert script.next(P.IDLE, 1) is None
    assert script.problems == ("the session was reset by somebody else",)


def test_a_disarm_by_somebody_else_ends_it() -> None:
    """The next look armed and started again what a person had just disarmed."""
    script = begun()
    assert script.next(P.CONNECTED, 1) is E.ARM
    script.on_answer(YES)
    assert script.next(P.ARMED, 2) is E.START
    script.on_answer(no("ot1 is PRE_ARMING, not ARMED"))
    assert script.next(P.CONNECTED, 3) is None
    assert script.problems == ("the session was disarmed by somebody else",)
    assert script.next(P.ARMED, 4) is None


def test_a_disarm_before_a_word_was_acted_on_ends_it() -> None:
    script = RunScript("run.yaml", 0, 10 * S, "run.yaml", P.ARMED)
    assert script.next(P.CONNECTED, 1) is None
    assert script.problems == ("the session was disarmed by somebody else",)


def test_it_says_what_it_waits_for() -> None:
    script = begun()
    assert script.next(P.CONNECTED, 0) is E.ARM
    assert script.waits_for == ""
    script.on_answer(no("no heartbeat of ot1", "no recorder"))
    assert script.waits_for == "no heartbeat of ot1; no recorder"
    assert script.next(P.ARMED, 1) is E.START
    assert script.waits_for == ""


def word(loaded: str = "") -> RunScript:
    """A goal that a person's word began, which holds for ten seconds."""
    return RunScript("run.yaml", 0, 10 * S, loaded)


def test_a_word_that_ran_out_starts_nothing() -> None:
    """Each step was tried for 45 s, so that objects drove off long after the word."""
    script = word()
    assert script.next(P.IDLE, 0) is E.LOAD
    script.on_answer(YES)
    assert script.next(P.LOADED, 1) is E.CONNECT
    assert script.next(P.CONNECTED, 5 * S) is E.ARM
    assert script.next(P.ARMED, 10 * S) is E.START
    script.on_answer(no("ot1 is PRE_ARMING, not ARMED"))
    assert script.next(P.ARMED, 10 * S + 1) is None
    assert (script.finished, script.not_in_time) == (True, True)
    assert script.problems == ("ot1 is PRE_ARMING, not ARMED",)
    assert script.next(P.ARMED, 11 * S) is None


def test_a_word_that_came_too_late_does_nothing_at_all() -> None:
    for state in (P.IDLE, P.LOADED, P.CONNECTED, P.ARMED):
        script = RunScript("run.yaml", 5, 4, "run.yaml")
        assert script.next(state, 5) is None
        assert (script.finished, script.not_in_time, script.has_begun) == (True, True, False)


def test_a_run_that_started_in_time_is_followed_to_its_end() -> None:
    script = word("run.yaml")
    assert script.next(P.ARMED, 1) is E.START
    script.on_answer(YES)
    assert script.next(P.RUNNING, 60 * S) is None
    assert not script.finished
    script.next(P.FINISHED, 61 * S)
    assert (script.finished, script.problems, script.not_in_time) == (True, (), False)


@pytest.mark.parametrize(("state", "event"), [(P.CONNECTED, E.ARM), (P.ARMED, E.START)])
def test_a_word_goes_on_from_where_its_own_run_stands(state: P, event: E) -> None:
    script = word("run.yaml")
    assert script.next(state, 0) is event
    assert script.has_begun
    other = word("another.yaml")
    assert other.next(state, 0) is None
    assert "already" in other.problems[0]


def test_a_word_for_a_run_that_is_over_begins_none() -> None:
    for state in (P.RUNNING, P.STOPPING, P.FINISHED, P.ABORTING, P.ABORTED):
        script = word("run.yaml")
        assert script.next(state, 0) is None
        assert not script.has_begun


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


def test_a_refusal_that_no_waiting_changes_ends_the_goal_at_once() -> None:
    script = begun()
    assert script.next(P.CONNECTED, 1) is E.ARM
    script.on_answer(replace(no("ot1: it has no probe report"), is_final=True))
    assert (script.finished, script.problems) == (True, ("ot1: it has no probe report",))
    script = begun()
    script.give_up(("ot1 refused: another K* version",))
    assert script.problems == ("ot1 refused: another K* version",)
    script.give_up(("later",))
    assert script.problems == ("ot1 refused: another K* version",)
