"""The terminal's lines on a session's states, and on objects that may still refuse to arm."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from ssp_core import names
from ssp_core.ros import stamp_from_ns
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_msgs.msg import ObjectState, ObjectStates, SessionState
from ssp_scenario_manager.ros import session_events
from ssp_scenario_manager.ros.session_events import SessionEvents

# Between the steady and the system's clock.
EPOCH_NS = 1_700_000_000 * 10**9


class _Node:
    """Stands for the runner's node: what it subscribes to is called by the test."""

    def __init__(self) -> None:
        self.callbacks: dict[str, Callable[[Any], None]] = {}

    def create_subscription(
        self, _: type, topic: str, call: Callable[[Any], None], *__: Any
    ) -> str:
        self.callbacks[topic] = call
        return topic

    def destroy_subscription(self, topic: str) -> None:
        del self.callbacks[topic]


class _Run:
    """A run of two objects."""

    class _Target:
        def __init__(self, object_id: str) -> None:
            self.id = object_id

    targets = (_Target("ot1"), _Target("ot2"))

    def __init__(self, states_in_one: bool) -> None:
        self.states_in_one = states_in_one


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> list[float]:
    now = [100.0]
    monkeypatch.setattr(session_events.time, "monotonic", lambda: now[0])
    return now


def _states(node: _Node, in_one: bool, *control: ControlState) -> None:
    states = [
        ObjectState(object_id=f"ot{k}", control_state=int(one)) for k, one in enumerate(control, 1)
    ]
    if in_one:
        node.callbacks[names.OBJECT_STATES](ObjectStates(states=states))
    else:
        for state in states:
            node.callbacks[names.state_topic(state.object_id)](state)


@pytest.mark.parametrize("in_one", [False, True])
def test_a_session_is_armed_when_every_object_reports_it(in_one: bool, clock: list[float]) -> None:
    node, said = _Node(), list[str]()
    events = SessionEvents(node, _Run(in_one), said.append, lambda: None)
    usual = set(node.callbacks)
    events.say_state(SessionPhase.CONNECTED)
    events.say_armed()
    events.say_state(SessionPhase.ARMED)
    assert said == ["session CONNECTED", "session ARMING: an object may still refuse"]
    events.say_armed()
    _states(node, in_one, ControlState.ARMED, ControlState.DISARMED)
    events.say_armed()
    clock[0] += 6.0
    events.say_wait(SessionPhase.ARMED, "ot2 isn't armed")
    assert said[2:] == ["waiting in ARMING: ot2 isn't armed"]
    _states(node, in_one, ControlState.ARMED, ControlState.ARMED)
    events.say_armed()
    events.say_armed()
    assert said[3:] == ["session ARMED: every object reports it"]
    assert set(node.callbacks) == usual
    clock[0] += 6.0
    events.say_wait(SessionPhase.ARMED, "the start")
    assert said[4:] == ["waiting in ARMED: the start"]


def test_a_session_that_leaves_armed_is_said_so(clock: list[float]) -> None:
    node, said = _Node(), list[str]()
    events = SessionEvents(node, _Run(False), said.append, lambda: None)
    usual = set(node.callbacks)
    events.say_state(SessionPhase.ARMED)
    assert set(node.callbacks) > usual
    events.say_state(SessionPhase.CONNECTED)
    events.say_state(SessionPhase.CONNECTED)
    events.say_armed()
    assert said[1:] == ["session CONNECTED"]
    assert set(node.callbacks) == usual
    events.say_wait(SessionPhase.CONNECTED, "said a moment ago")
    assert said[2:] == []


@pytest.mark.parametrize("led_by_us", [False, True])
@pytest.mark.parametrize("stopped", ["at the start", "at the end"])
def test_a_runner_that_stood_still_states_how_long_the_run_took(
    stopped: str, led_by_us: bool, clock: list[float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A stopped runner reads messages late: it stated 40 s, or 1 s, for a run of 10 s."""
    monkeypatch.setattr(session_events.time, "time_ns", lambda: round(clock[0] * 1e9) + EPOCH_NS)
    node = _Node()
    events = SessionEvents(node, _Run(False), lambda _: None, lambda: None)
    events.is_led_by_us = led_by_us
    start_s, end_s = clock[0], clock[0] + 10.0

    def hear(state: SessionPhase, sent_s: float, at_s: float) -> None:
        clock[0] = at_s
        message = SessionState(state=state)
        message.header.stamp = stamp_from_ns(round(sent_s * 1e9))
        info = {"source_timestamp": round(sent_s * 1e9) + EPOCH_NS}
        node.callbacks[names.SESSION_STATE](message, info)

    def go_on(at_s: float) -> None:
        clock[0] = at_s
        events.times.go_on(at_s - start_s, events.end is not None)

    if stopped == "at the start":
        hear(SessionPhase.RUNNING, start_s, end_s - 1.0)
        go_on(end_s - 0.5)
        hear(SessionPhase.FINISHED, end_s, end_s)
    else:
        hear(SessionPhase.RUNNING, start_s, start_s)
        go_on(start_s + 5.0)
        hear(SessionPhase.FINISHED, end_s, start_s + 40.0)
    go_on(clock[0] + 0.1)
    assert (events.times.session_s, events.times.wall_s) == pytest.approx((10.0, 10.0))
