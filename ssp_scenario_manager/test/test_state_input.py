"""States as they arrive: heard, counted, taken in; strangers told of once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from ssp_core import names
from ssp_core.cdr.states import StateArray
from ssp_scenario_manager.session.inputs import StateInput, StepInputs
from ssp_scenario_manager.session.supervision import LivenessMonitor

S = 1_000_000_000


def input_of(
    driver: Any, decode: Any = None
) -> tuple[StateInput, LivenessMonitor, StepInputs, list[str]]:
    liveness, inputs, told = LivenessMonitor(), StepInputs(("object_target",)), []
    return StateInput(driver.session, liveness, inputs, decode, told.append), liveness, inputs, told


def test_states_of_the_run(driver: Any) -> None:
    driver.until("CONNECTED")
    state_input, liveness, inputs, told = input_of(driver)
    for sequence in (1, 1, 2, 4):
        assert state_input.vut(replace(driver.vut, sequence=sequence), 5 * S)
        state_input.target(replace(driver.targets["ot1"], sequence=sequence), 6 * S)
    # Those that the world repeats while it holds belong to no step.
    assert (inputs.vut_states, inputs.states) == (2, 2)
    assert (liveness.age_s(names.VUT_ID, 7 * S), liveness.age_s("ot1", 7 * S)) == (2.0, 1.0)
    assert (state_input.losses.of["ot1"].received, state_input.losses.of["ot1"].lost) == (4, 1)
    assert driver.session.targets["ot1"].sequence == 4
    assert told == []


def test_strangers_are_told_of_once_and_not_heard(driver: Any) -> None:
    driver.until("CONNECTED")
    state_input, liveness, inputs, told = input_of(driver)
    for _ in range(3):
        assert not state_input.vut(driver.state("ot9", sequence=3), S)
        state_input.target(driver.state("ot8", sequence=3), S)
    assert told == [
        "ot9 is not listened to: sends states as the vehicle under test",
        "ot8 is not listened to: sends states, but the run doesn't know it",
    ]
    assert liveness.age_s("ot8", S) == float("inf")
    assert set(driver.session.targets) == {"ot1"}
    # Their process counts them all the same, and the barrier waits for what it counts.
    assert (inputs.vut_states, inputs.states) == (0, 3)


def test_states_of_many_wait_until_they_are_wanted(driver: Any) -> None:
    driver.until("CONNECTED")
    array = StateArray(0, "object_target", (replace(driver.targets["ot1"], sequence=9),))
    state_input, liveness, _, _ = input_of(driver, {b"good": array, b"bad": None}.get)
    state_input.arrivals.put(b"bad", 2 * S)
    state_input.arrivals.put(b"good", 3 * S)
    assert driver.session.targets["ot1"].sequence == 0
    state_input.waiting()
    assert driver.session.targets["ot1"].sequence == 9
    assert liveness.age_s("ot1", 4 * S) == 1.0
    state_input.waiting()
    assert state_input.losses.of["ot1"].received == 1
