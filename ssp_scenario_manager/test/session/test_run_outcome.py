"""The end of a run whose event missed that of K*, and the last word of its goal."""

from __future__ import annotations

import pytest

from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_scenario_manager.session.run_script import RunOutcome, RunScript
from ssp_scenario_manager.session.state_machine import Answer, SessionEvent

S = 1_000_000_000
MISSES = ["gap at the trigger: 14 m, not 12 m", "conflict after 3 s, not 2 s"]


def test_a_sound_run_whose_event_misses_that_of_k_star_is_off_spec_for_each_miss() -> None:
    outcome = RunOutcome(Verdict.VALID, ()).with_misses(MISSES)
    assert outcome == RunOutcome(Verdict.OFF_SPEC, tuple(MISSES))
    assert not outcome.ok


def test_a_sound_run_without_a_miss_stays_valid() -> None:
    outcome = RunOutcome(Verdict.VALID, ())
    assert outcome.with_misses([]) == outcome


@pytest.mark.parametrize("verdict", [one for one in Verdict if one is not Verdict.VALID])
def test_a_run_that_failed_for_another_reason_is_not_measured_by_its_event(
    verdict: Verdict,
) -> None:
    outcome = RunOutcome(verdict, ("why",))
    assert outcome.with_misses(MISSES) == outcome


@pytest.mark.parametrize(
    ("state", "event"),
    [
        (SessionPhase.LOADED, SessionEvent.CONNECT),
        (SessionPhase.CONNECTED, SessionEvent.ARM),
        (SessionPhase.ARMED, SessionEvent.START),
    ],
)
def test_a_word_that_ran_out_without_a_refusal_names_the_step_that_was_due(
    state: SessionPhase, event: SessionEvent
) -> None:
    script = RunScript("run.yaml", 0, 10 * S, "run.yaml")
    assert script.next(state, 0) is event
    script.on_answer(Answer(True))
    assert script.next(state, 10 * S + 1) is None
    assert script.problems == (f"{event.value} was not possible in time",)


def test_a_goal_that_has_tried_nothing_waits_for_nothing_and_knows_its_file() -> None:
    script = RunScript("run.yaml", 0)
    assert (script.run_file, script.waits_for) == ("run.yaml", "")
