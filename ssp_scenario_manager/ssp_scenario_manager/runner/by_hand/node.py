"""Drives a run by the manager's services, as its action does, and holds it while it is armed."""

from __future__ import annotations

import time
from functools import partial
from typing import Any

from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_msgs.msg import ObjectState, ObjectStates, SessionState
from ssp_msgs.srv import LoadScenario, SessionCommand
from ssp_scenario_manager.core.command_answer import Answer
from ssp_scenario_manager.core.run_script import RunScript
from ssp_scenario_manager.core.session_machine import SessionEvent

WHO = "ssp run"
# A lost answer (the two ends may have just found each other) is asked for again after this time.
ANSWER_S = 2.0
# What keeps an armed session from starting is there by now; no use asking for longer.
START_PATIENCE_S = 5.0


class ByHand:
    """load, connect, arm and start, one at a time, each after the answer to the one before.

    Args:
        node: owns the clients.
        run: the run; its objects tell when they are armed.
        run_file: path on the manager's host.
    """

    def __init__(self, node: Node, run: RunSpec, run_file: str) -> None:
        self._script = RunScript(run_file, time.monotonic_ns())
        self._session = SessionPhase.IDLE
        self._armed = dict.fromkeys((t.id for t in run.targets), False)
        self._waiting: Any = None
        self._asked_at = 0.0
        self._start_asked_at: float | None = None
        self._refusal: tuple[str, ...] = ()
        self._load = node.create_client(LoadScenario, names.LOAD_SCENARIO)
        self._commands = {
            event: node.create_client(SessionCommand, event.value)
            for event in (
                SessionEvent.CONNECT,
                SessionEvent.ARM,
                SessionEvent.START,
                SessionEvent.DISARM,
            )
        }
        node.create_subscription(SessionState, names.SESSION_STATE, self._on_session, ros.LATCHED)
        if run.states_in_one:
            node.create_subscription(ObjectStates, names.OBJECT_STATES, self._on_states, ros.STATE)
        else:
            for target in run.targets:
                node.create_subscription(
                    ObjectState, names.state_topic(target.id), self._on_state, ros.STATE
                )

    @property
    def is_armed(self) -> bool:
        """The session and every object say that they are armed."""
        return self._session is SessionPhase.ARMED and all(self._armed.values())

    @property
    def problems(self) -> tuple[str, ...]:
        """Why the run can't start; empty while it may, or when it has."""
        asked = self._start_asked_at
        late = asked is not None and time.monotonic() - asked > START_PATIENCE_S
        if late and self._session is SessionPhase.ARMED and self._refusal:
            return self._refusal
        return self._script.problems

    def ready(self) -> bool:
        """The manager offers its services."""
        return all(c.service_is_ready() for c in (self._load, *self._commands.values()))

    def drive(self, may_start: bool) -> None:
        """Asks for the next step, unless an answer is still due.

        Args:
            may_start: False: an armed session is left as it is.
        """
        if self._waiting is not None and time.monotonic() - self._asked_at < ANSWER_S:
            return
        wish = self._script.next(self._session, time.monotonic_ns())
        if wish is None or (wish is SessionEvent.START and not may_start):
            return
        self._asked_at = time.monotonic()
        if wish is SessionEvent.START:
            self._start_asked_at = self._start_asked_at or self._asked_at
        if wish is SessionEvent.LOAD:
            request: Any = LoadScenario.Request(run_file=self._script.run_file)
            self._waiting = self._load.call_async(request)
        else:
            request = SessionCommand.Request(requested_by=WHO)
            self._waiting = self._commands[wish].call_async(request)
        self._waiting.add_done_callback(partial(self._on_answer, self._waiting))

    def give_up(self) -> None:
        """Disarms what can't be started."""
        if self._session is SessionPhase.ARMED:
            request = SessionCommand.Request(requested_by=WHO, reason="the run can't start")
            self._commands[SessionEvent.DISARM].call_async(request)

    # -- callbacks -------------------------------------------------------------------------------

    def _on_answer(self, asked: Any, future: Any) -> None:
        if asked is not self._waiting:
            return
        self._waiting = None
        answer = future.result()
        missing = tuple(getattr(answer, "missing", ()))
        self._refusal = () if answer.accepted else missing or (answer.error_msg,)
        self._script.on_answer(
            Answer(answer.accepted, answer.error_code, answer.error_msg, missing)
        )

    def _on_session(self, message: SessionState) -> None:
        self._session = SessionPhase(message.state)

    def _on_state(self, message: ObjectState) -> None:
        if message.object_id in self._armed:
            self._armed[message.object_id] = message.control_state == ControlState.ARMED

    def _on_states(self, message: ObjectStates) -> None:
        for state in message.states:
            self._on_state(state)
