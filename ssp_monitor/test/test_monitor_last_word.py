"""The verdict that the recorder leaves beside its bag."""

from __future__ import annotations

import pytest

from ssp_core.vocabulary import SessionPhase as P
from ssp_core.vocabulary import Verdict as V
from ssp_monitor.recorder.report import RunOutcome

WAY = [P.IDLE, P.LOADED, P.CONNECTED, P.ARMED, P.RUNNING]


def heard(*words: P | tuple[P, V, tuple[str, ...]], run_id: str = "run-1") -> RunOutcome:
    last = RunOutcome("run-1")
    for word in words:
        state, verdict, reasons = word if isinstance(word, tuple) else (word, V.NONE, ())
        last.hear(state, verdict, reasons, run_id)
    return last


def test_a_run_that_ended_well():
    last = heard(*WAY, P.STOPPING, (P.FINISHED, V.VALID, ()))
    assert last.verdict(0) == (V.VALID, ())
    assert not last.is_due
    # A reset takes nothing back.
    last.hear(P.IDLE, V.NONE, (), "")
    assert last.verdict(0) == (V.VALID, ())


@pytest.mark.parametrize("verdict", [V.ABORTED, V.FAILED_SAFETY, V.INVALID_HARNESS])
def test_the_sessions_own_verdict_and_reasons_come_first(verdict):
    last = heard(*WAY, (P.ABORTING, verdict, ("one",)), (P.ABORTED, verdict, ("one", "two")))
    assert last.verdict(0) == (verdict, ("one", "two"))
    assert last.verdict(3) == (verdict, ("one", "two", "the recorder lost 3 messages"))


def test_losses_make_a_valid_run_invalid():
    last = heard(*WAY, P.STOPPING, (P.FINISHED, V.VALID, ()))
    assert last.verdict(1) == (V.INVALID_HARNESS, ("the recorder lost 1 messages",))


@pytest.mark.parametrize("state", WAY)
def test_a_recording_that_ends_too_early(state):
    last = heard(*WAY[: WAY.index(state) + 1])
    reason = f"the recording ends while the session is {state.name}"
    assert last.verdict(0) == (V.INVALID_HARNESS, (reason,))
    assert last.is_due == (state in (P.ARMED, P.RUNNING))


def test_an_abort_that_did_not_come_to_its_end():
    last = heard(*WAY, (P.ABORTING, V.FAILED_SAFETY, ("collision",)))
    assert last.is_due
    assert last.verdict(0) == (
        V.FAILED_SAFETY,
        ("collision", "the recording ends while the session is ABORTING"),
    )


def test_no_session_at_all():
    assert RunOutcome("run-1").verdict(0) == (V.INVALID_HARNESS, ("no session was heard",))


def test_two_runs_in_one_recording_are_none():
    well = (P.STOPPING, (P.FINISHED, V.VALID, ()))
    verdict, reasons = heard(*WAY, *well, *WAY, *well).verdict(0)
    assert (verdict, reasons) == (V.INVALID_HARNESS, ("2 runs are in one recording",))


def test_the_run_of_another_file():
    verdict, reasons = heard(*WAY, (P.FINISHED, V.VALID, ()), run_id="run-2").verdict(0)
    assert verdict is V.INVALID_HARNESS
    assert reasons == ("the session ran run-2, the recording is of run-1",)


def test_losses_within_the_limit_are_no_reason():
    last = heard(*WAY, P.STOPPING, (P.FINISHED, V.VALID, ()))
    assert last.verdict(5, lost_limit=5) == (V.VALID, ())
    reason = "the recorder lost 6 messages, limit 5"
    assert last.verdict(6, lost_limit=5) == (V.INVALID_HARNESS, (reason,))


def test_a_bag_that_is_not_as_it_must_be_makes_a_run_invalid():
    last = heard(*WAY, P.STOPPING, (P.FINISHED, V.VALID, ()))
    problems = ("/clock: 9 messages in the bag, 10 were received",)
    assert last.verdict(0, problems=problems) == (V.INVALID_HARNESS, problems)
