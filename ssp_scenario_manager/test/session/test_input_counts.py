"""Inputs that a step waits for, and the one of two states that counts."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ssp_core.cdr.states import StateArray, encode_states
from ssp_scenario_manager.session.inputs import PendingStates, StateInput, StepInputs
from ssp_scenario_manager.session.supervision import LivenessMonitor

MS = 1_000_000
S = 1_000_000_000
OT = "object_target"


def test_what_a_participant_sent_before_it_was_dropped_is_not_waited_for() -> None:
    inputs = StepInputs((OT, "another"))
    inputs.on_tick(1, 0)
    inputs.on_answer(OT, 1, states_sent=2, acks_sent=1, events_sent=1)
    inputs.on_answer("another", 1, states_sent=1, acks_sent=0, events_sent=0)
    inputs.states += 1
    assert not inputs.complete()
    inputs.forget(OT)
    assert inputs.missing() == []
    assert inputs.complete()


def test_the_first_step_may_have_the_number_0() -> None:
    inputs = StepInputs((OT,))
    inputs.on_tick(0, 0)
    assert inputs.missing() == ["the answer of object_target"]
    inputs.on_answer(OT, 0, states_sent=0, acks_sent=0, events_sent=0)
    assert inputs.complete()


def test_of_two_states_with_one_stamp_the_one_that_arrived_last_counts(state: Any) -> None:
    arrivals = PendingStates()
    waiting = state("ot1", stamp_ns=50 * MS, x_m=2.0)
    arrivals.put(encode_states(StateArray(50 * MS, OT, (waiting,))), 0)
    over = arrivals.over({"ot1": state("ot1", stamp_ns=50 * MS, x_m=1.0)})
    assert over["ot1"].x_m == 2.0


def test_the_lost_states_of_the_vut_are_counted_as_its_own(driver: Any) -> None:
    driver.until("CONNECTED")
    strangers: list[str] = []
    state_input = StateInput(
        driver.session, LivenessMonitor(), StepInputs((OT,)), lambda _: None, strangers.append
    )
    for sequence in (1, 2, 5):
        assert state_input.vut(replace(driver.vut, sequence=sequence), S)
    assert strangers == []
    losses = state_input.losses.of
    assert set(losses) == {"vut"}
    assert (losses["vut"].received, losses["vut"].lost) == (3, 2)
