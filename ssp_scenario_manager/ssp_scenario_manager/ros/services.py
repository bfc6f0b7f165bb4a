"""Services that command a session, and the action server of ``run_scenario``."""

from __future__ import annotations

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from ssp_core import names
from ssp_core.vocabulary import SessionPhase
from ssp_msgs.action import RunScenario
from ssp_msgs.msg import SessionState
from ssp_msgs.srv import LoadScenario, SessionCommand
from ssp_scenario_manager.session.run_script import RunScript
from ssp_scenario_manager.session.session import Session
from ssp_scenario_manager.session.state_machine import Answer, SessionEvent

WHO = "run_scenario"


class SessionServices:
    """Answers commands, and has at most one goal of ``run_scenario`` done at a time.

    Args:
        node: owns services and action.
        session: that they command.
        load: loads a run file into the session.
        command: gives the session a command (event, who asks, reason).
    """

    def __init__(
        self,
        node: Node,
        session: Session,
        load: Callable[[str], Answer],
        command: Callable[[SessionEvent, str, str], Answer],
    ) -> None:
        self._session = session
        self._load = load
        self._command = command
        self._goal: Any = None
        self._script: RunScript | None = None
        node.create_service(LoadScenario, names.LOAD_SCENARIO, self._on_load)
        for word in names.SESSION_COMMANDS:
            node.create_service(SessionCommand, word, partial(self._on_command, SessionEvent(word)))
        self._server = ActionServer(
            node,
            RunScenario,
            names.RUN_SCENARIO,
            execute_callback=self._result,
            goal_callback=self._on_goal,
            handle_accepted_callback=self._on_accepted,
            cancel_callback=self._on_cancel,
            callback_group=ReentrantCallbackGroup(),
        )

    def drive(self, now_ns: int) -> None:
        """Moves the goal on: load, connect, arm, start, wait for the end."""
        if self._goal is None or self._script is None:
            return
        wish = self._script.next(self._session.state, time.monotonic_ns())
        if wish is SessionEvent.LOAD:
            self._script.on_answer(self._load(self._script.run_file))
        elif wish is not None:
            self._script.on_answer(self._command(wish, WHO, ""))
        feedback = RunScenario.Feedback()
        feedback.session_state = int(self._session.state)
        feedback.phase = int(self._session.phase)
        feedback.elapsed = self._session.elapsed_s(now_ns)
        feedback.waits_for = self._script.waits_for
        self._goal.publish_feedback(feedback)
        if self._script.finished:
            if self._script.problems and self._session.state is SessionPhase.ARMED:
                self._command(SessionEvent.DISARM, WHO, "the run can't start")
            goal, self._goal = self._goal, None
            goal.execute()

    def give_up(self, reason: str) -> None:
        """No waiting lets the session go on."""
        if self._script is not None:
            self._script.give_up((reason,))

    def on_setback(self, reason: str) -> None:
        """The session lost ground (an object didn't arm); why, if the goal has to give up."""
        if self._script is not None:
            self._script.on_setback(reason)

    def on_standstill_unconfirmed(self, now_ns: int) -> None:
        """The session aborts and nobody is left to report a standstill: ends whoever led it."""
        self._session.give_up_on_standstill(now_ns)
        if self._script is not None:
            self._script.standstill_unconfirmed()

    def _on_goal(self, request: RunScenario.Goal) -> GoalResponse:
        return GoalResponse.ACCEPT if self._goal is None else GoalResponse.REJECT

    def _on_accepted(self, goal: Any) -> None:
        self._goal = goal
        self._script = RunScript(goal.request.run_file, time.monotonic_ns())

    def _on_cancel(self, _: Any) -> CancelResponse:
        self._command(SessionEvent.ABORT, WHO, "goal cancelled")
        return CancelResponse.ACCEPT

    def _result(self, goal: Any) -> RunScenario.Result:
        script = self._script
        problems = script.problems if script else ()
        result = RunScenario.Result()
        if script is not None and script.begun:
            # Otherwise the session is somebody else's, and so is its verdict.
            result.verdict = int(self._session.verdict)
            result.reasons = list(self._session.reasons)
            result.run_id = self._session.spec.run_id if self._session.spec else ""
        result.reasons = list(result.reasons) or list(problems)
        if problems:
            result.error_code = 1
            result.error_msg = "; ".join(problems)
        elif result.verdict != SessionState.VERDICT_VALID:
            result.error_code = 2
            result.error_msg = "; ".join(result.reasons)
        if goal.is_cancel_requested:
            goal.canceled()
        elif result.error_code:
            goal.abort()
        else:
            goal.succeed()
        return result

    def _on_load(
        self, request: LoadScenario.Request, response: LoadScenario.Response
    ) -> LoadScenario.Response:
        answer = self._load(request.run_file)
        response.accepted = answer.accepted
        response.error_code = answer.error_code
        response.error_msg = answer.error_msg
        spec = self._session.spec
        response.event_version = spec.event_version if answer.accepted and spec else ""
        return response

    def _on_command(
        self,
        event: SessionEvent,
        request: SessionCommand.Request,
        response: SessionCommand.Response,
    ) -> SessionCommand.Response:
        answer = self._command(event, request.requested_by or "unknown", request.reason)
        response.accepted = answer.accepted
        response.error_code = answer.error_code
        response.error_msg = answer.error_msg
        response.missing = list(answer.missing)
        response.session_state = int(self._session.state)
        return response
