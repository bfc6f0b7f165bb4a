"""States as they arrive: heard, counted, taken in, awaited; triggers before all else."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core import names
from ssp_core.cdr.states import StateArray, encode_states
from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.session.inputs import PendingStates, StateInput, StepInputs
from ssp_scenario_manager.session.supervision import LivenessMonitor

MS = 1_000_000
OT = "object_target"
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


def test_each_part_is_waited_for() -> None:
    inputs = StepInputs((OT,))
    assert not inputs.complete()
    inputs.on_tick(1, vut_states_sent=1)
    assert inputs.missing() == ["the answer of object_target", "states of the VUT (0 of 1)"]
    inputs.vut_states += 1
    assert not inputs.complete()
    inputs.on_answer(OT, 1, states_sent=2, acks_sent=1, events_sent=0)
    assert inputs.missing() == ["states of objects (0 of 2)", "acknowledgements (0 of 1)"]
    inputs.states += 2
    assert not inputs.complete()
    inputs.acks += 1
    assert inputs.complete()
    assert not inputs.missing()
    inputs.done_step = 1
    assert not inputs.complete()  # once


def test_an_old_answer_and_a_stranger_do_not_count() -> None:
    inputs = StepInputs((OT,))
    inputs.on_tick(2, vut_states_sent=0)
    inputs.on_answer(OT, 1, 0, 0, 0)
    inputs.on_answer("front_camera", 2, 0, 0, 0)
    assert not inputs.complete()
    inputs.on_answer(OT, 2, 0, 0, 0)
    assert inputs.complete()


def test_a_lost_state_is_not_waited_for() -> None:
    """The links lose states; only what was sent is counted."""
    inputs = StepInputs((OT,))
    inputs.on_tick(1, vut_states_sent=0)
    inputs.on_answer(OT, 1, states_sent=0, acks_sent=0, events_sent=0)
    assert inputs.complete()


@settings(max_examples=100, deadline=None)
@given(data=st.data())
def test_any_interleaving_completes_with_the_last_message(data: st.DataObject) -> None:
    """Topics are ordered in themselves, not against each other."""
    steps = data.draw(st.integers(1, 4))
    inputs = StepInputs((OT, "other"))
    vut = states = acks = 0
    for step in range(1, steps + 1):
        sent = {name: data.draw(st.integers(0, 3)) for name in ("vut", "states", "acks")}
        vut, states, acks = vut + sent["vut"], states + sent["states"], acks + sent["acks"]

        def tick(step: int = step, vut: int = vut) -> None:
            inputs.on_tick(step, vut)

        def answer(name: str, states: int, acks: int, step: int = step) -> Callable[[], None]:
            return lambda: inputs.on_answer(name, step, states, acks, 0)

        def count(name: str) -> Callable[[], None]:
            return lambda: setattr(inputs, name, getattr(inputs, name) + 1)

        messages = [tick, answer(OT, states, 0), answer("other", 0, acks)]
        messages += [count("vut_states")] * sent["vut"]
        messages += [count("states")] * sent["states"]
        messages += [count("acks")] * sent["acks"]
        for deliver in data.draw(st.permutations(messages)):
            assert not inputs.complete()
            deliver()
        assert inputs.complete()
        inputs.done_step = step


def test_a_safety_event_belongs_to_its_step() -> None:
    inputs = StepInputs((OT,))
    inputs.on_tick(1, 0)
    inputs.on_answer(OT, 1, states_sent=0, acks_sent=0, events_sent=1)
    assert not inputs.complete()
    inputs.safety_events += 1
    assert inputs.complete()


def test_a_dropped_participant_is_not_waited_for() -> None:
    inputs = StepInputs((OT, "another"))
    inputs.on_tick(1, 0)
    inputs.on_answer("another", 1, 0, 0, 0)
    assert not inputs.complete()
    inputs.forget(OT)
    assert inputs.complete()


def message(*states: Any) -> bytes:
    return encode_states(StateArray(states[-1].stamp_ns, "object_target", states))


def test_the_state_that_arrived_last_counts(state: Any) -> None:
    arrivals = PendingStates()
    arrivals.put(message(state("ot1", x_m=1.0), state("ot2")), 10)
    arrivals.put(message(state("ot1", x_m=2.0)), 20)
    arrivals.put(b"broken", 30)
    newest = arrivals.newest("ot1")
    assert newest is not None
    assert newest.x_m == 2.0
    assert arrivals.newest("ot2") == state("ot2")
    assert arrivals.newest("ot3") is None
    assert [steady_ns for _, steady_ns in arrivals.take()] == [10, 20, 30]
    assert arrivals.newest("ot1") is None
    assert arrivals.take() == []


def test_what_waits_covers_what_is_known_unless_it_is_older(state: Any) -> None:
    known = {name: state(name, stamp_ns=50 * MS) for name in ("ot1", "ot2", "ot3")}
    arrivals = PendingStates()
    assert arrivals.over(known) is known
    arrivals.put(message(state("ot1", stamp_ns=60 * MS), state("ot2", stamp_ns=40 * MS)), 0)
    over = arrivals.over(known)
    assert over["ot1"].stamp_ns == 60 * MS
    assert over["ot2"].stamp_ns == 50 * MS
    assert over.get("ot3") == known["ot3"]
    assert over.get("stranger") is None
    assert "ot3" in over
    assert "stranger" not in over
    arrivals.put(message(state("late")), 0)
    assert "late" in over
    assert list(over) == list(known)
    assert len(over) == 3


def near(driver: Any) -> None:
    """A run in which the next state of the VUT fires the trigger: the gap falls below 12 m."""
    driver.until("RUNNING")
    driver.acknowledge()
    for k in range(20):
        x_m = max(0.0, 22.8 - 2.5 * (19 - k))
        driver.move("vut", x_m=x_m, speed_mps=10.0 if x_m > 0.0 else 0.0)
        driver.step(250 * MS)
    driver.move("vut", x_m=23.0)
    driver.move("ot1", speed_mps=7.0)
    driver.step()
    assert driver.session.outbox == []
    driver.now_ns += 20 * MS


def test_a_trigger_is_judged_before_the_states_of_the_targets_are_taken_in(
    driver: Any, state: Any
) -> None:
    near(driver)
    driver.session.on_vut_state(
        state("vut", stamp_ns=driver.now_ns, x_m=23.2, speed_mps=10.0, sequence=9)
    )
    arrivals = PendingStates()
    waiting = state(
        "ot1", stamp_ns=driver.now_ns, x_m=39.0, speed_mps=7.0, control_state=ControlState.RUNNING
    )
    arrivals.put(message(waiting), 0)
    driver.session.outbox += driver.session.judge_triggers(
        driver.now_ns, arrivals.over(driver.session.targets)
    )
    # With the states that were taken in, the gap would be 12.3 m.
    dispatched, fired = driver.acknowledge()
    assert isinstance(dispatched, Reference)
    assert fired.samples[-1].value == pytest.approx(39.0 - 0.9 - 23.2 - 3.6)
    driver.session.on_target_state(waiting)
    driver.session.step(driver.now_ns)
    assert driver.session.outbox == []


def test_a_state_that_does_not_follow_from_the_last_one_fires_no_trigger(
    make_driver: Any, run: RunSpec, tools: Any
) -> None:
    limits = run.limits.model_copy(update={"jump_m": 1.0})
    driver = make_driver(run.model_copy(update={"limits": limits}))
    near(driver)
    driver.move("vut", x_m=26.0)
    driver.hear()
    driver.session.outbox += driver.session.judge_triggers(driver.now_ns)
    assert driver.session.outbox == []
    driver.session.step(driver.now_ns)
    assert tools.violations(driver.session.outbox) == [SafetyCode.POSITION_JUMP]
    assert not any(isinstance(fact, Reference) for fact in driver.session.outbox)


def test_a_limit_that_is_passed_with_a_trigger_still_ends_the_run(driver: Any, tools: Any) -> None:
    near(driver)
    driver.move("vut", x_m=23.8, speed_mps=99.0)
    driver.hear()
    driver.session.outbox += driver.session.judge_triggers(driver.now_ns)
    assert tools.violations(driver.session.outbox) == []
    driver.session.step(driver.now_ns)
    assert SafetyCode.OVER_SPEED in tools.violations(driver.session.outbox)
    assert driver.session.state is SessionPhase.ABORTING
