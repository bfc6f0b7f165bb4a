"""A step is judged when everything that belongs to it is here, in whatever order it came."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_scenario_manager.session.inputs import StepInputs

OT = "object_target"


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
