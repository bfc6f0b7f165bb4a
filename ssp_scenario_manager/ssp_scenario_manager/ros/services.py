"""Services that command a session, and the action server of ``run_scenario``."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from rclpy.action import ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.node import Node

from ssp_core import names, ros
from ssp_core.clock import seconds_to_ns
from ssp_core.run_file.session_token import token_problem
from ssp_core.vocabulary import SessionPhase
from ssp_msgs.action import RunScenario
from ssp_msgs.msg import SessionState
from ssp_msgs.srv import LoadScenario, SessionCommand
from ssp_scenario_manager.session.run_script import RunScript
from ssp_scenario_manager.session.session import Session
from ssp_scenario_manager.session.state_machine import (
    REFUSED_OUTDATED,
    REFUSED_SESSION,
    REFUSED_TRANSITION,
    Answer,
    SessionEvent,
)

WHO = "run_scenario"
# What a person's word may last at most, whatever a goal says of it and whatever clocks do.
LONGEST_WORD_S = 60.0


@dataclass(slots=True)
class OwnSession:
    """The identity that a command must name to be for this manager's session.

    Args:
        token: of the session; empty before the first run of a manager that was given none.
        mode: of its run file.
        state: that was published last.
        since_ns: stamp of that.
        run_file: that is loaded; empty: none.
    """

    token: str = ""
    mode: str = ""
    state: SessionPhase = SessionPhase.UNKNOWN
    since_ns: int = 0
    run_file: str = ""

    def problem(self, token: str) -> str:
        """Give the reason why a command with this token isn't for the session.

        Empty where it is.
        """
        return token_problem(self.token, token, self.mode) if self.token else ""

    def outdated(self, shown_state: int, shown_since_ns: int) -> str:
        """Give the reason why a press isn't for the present state.

        Empty where it is, or no state was shown.
        """
        if not shown_state or (shown_state, shown_since_ns) == (self.state, self.since_ns):
            return ""
        is_state = shown_state in tuple(SessionPhase)
        state_name = SessionPhase(shown_state).name if is_state else str(shown_state)
        again = ", which came after it" if state_name == self.state.name else ""
        return (
            f"pressed for {state_name}, and the session is {self.state.name}{again}: look again, "
            "then press again"
        )


class SessionServices:
    """Answers commands, and has at most one goal of ``run_scenario`` done at a time.

    Args:
        node: owns services and action.
        session: that they command.
        own: what commands must name.
        load: loads a run file into the session.
        command: gives the session a command (event, who asks, reason).
    """

    def __init__(
        self,
        node: Node,
        session: Session,
        own: OwnSession,
        load: Callable[[str], Answer],
        command: Callable[[SessionEvent, str, str], Answer],
    ) -> None:
        self._session = session
        self._own = own
        self._load = load
        self._command = command
        self._goal: Any = None
        self._script: RunScript | None = None
        # Of goals that wait for their result: why one was refused, or the script that has ended.
        self._refused: dict[bytes, str] = {}
        self._ended: dict[bytes, RunScript] = {}
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
        """Move the goal on: load, connect, arm, start, wait for the end."""
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
            self._ended[bytes(goal.goal_id.uuid)] = self._script
            goal.execute()

    def give_up(self, reason: str) -> None:
        """Give up a goal that no waiting can help any more."""
        if self._script is not None:
            self._script.give_up((reason,))

    def on_setback(self, reason: str) -> None:
        """Take the reason of a setback (an object didn't arm), for a goal that gives up."""
        if self._script is not None:
            self._script.on_setback(reason)

    def on_standstill_unconfirmed(self, now_ns: int) -> None:
        """End an abort whose standstill no participant can report, and the goal with it."""
        self._session.give_up_on_standstill(now_ns)
        if self._script is not None:
            self._script.standstill_unconfirmed()

    def _on_goal(self, request: RunScenario.Goal) -> GoalResponse:
        """Take another session's goal too, for a rejection has no room for the reason."""
        busy = self._goal is not None and not self._own.problem(request.session_token)
        return GoalResponse.REJECT if busy else GoalResponse.ACCEPT

    def _on_accepted(self, goal: Any) -> None:
        request = goal.request
        if problem := self._own.problem(request.session_token):
            self._refused[bytes(goal.goal_id.uuid)] = problem
            goal.execute()
            return
        now_ns, start_by_ns = time.monotonic_ns(), None
        not_after_ns = ros.ns_from_stamp(request.not_after)
        if not_after_ns:
            holds_ns = min(not_after_ns - time.time_ns(), seconds_to_ns(LONGEST_WORD_S))
            start_by_ns = now_ns + holds_ns
        self._goal = goal
        loaded, state = self._own.run_file, self._session.state
        self._script = RunScript(request.run_file, now_ns, start_by_ns, loaded, state)

    def _on_cancel(self, _: Any) -> CancelResponse:
        self._command(SessionEvent.ABORT, WHO, "goal cancelled")
        return CancelResponse.ACCEPT

    def _result(self, goal: Any) -> RunScenario.Result:
        result = RunScenario.Result()
        if foreign := self._refused.pop(bytes(goal.goal_id.uuid), ""):
            result.error_code = RunScenario.Result.FAILED_START
            result.error_msg, result.reasons = foreign, [foreign]
            goal.abort()
            return result
        script = self._ended.pop(bytes(goal.goal_id.uuid))
        problems = script.problems
        if script.has_begun:
            # Otherwise the session is somebody else's, and so is its verdict.
            result.verdict = int(self._session.verdict)
            result.reasons = list(self._session.reasons)
            result.run_id = self._session.spec.run_id if self._session.spec else ""
        result.reasons = list(result.reasons) or list(problems)
        if problems:
            codes = RunScenario.Result
            result.error_code = codes.NOT_IN_TIME if script.not_in_time else codes.FAILED_START
            result.error_msg = "; ".join(problems)
        elif result.verdict != SessionState.VERDICT_VALID:
            result.error_code = RunScenario.Result.NOT_VALID
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
        if problem := self._own.problem(request.session_token):
            answer = Answer(False, REFUSED_SESSION, problem)
        elif self._goal is not None:
            # A word that was given for one run must not start another.
            answer = Answer(
                False, REFUSED_TRANSITION, "a run_scenario goal is under way: cancel it"
            )
        else:
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
        answer = self._answer(event, request)
        response.accepted = answer.accepted
        response.error_code = answer.error_code
        response.error_msg = answer.error_msg
        response.missing = list(answer.missing)
        response.session_state = int(self._session.state)
        return response

    def _answer(self, event: SessionEvent, request: SessionCommand.Request) -> Answer:
        """Answer a command; an abort counts from any sender, and in any state that it saw."""
        if event is not SessionEvent.ABORT:
            if problem := self._own.problem(request.session_token):
                return Answer(False, REFUSED_SESSION, problem)
            shown_since_ns = ros.ns_from_stamp(request.shown_since)
            if problem := self._own.outdated(request.shown_state, shown_since_ns):
                return Answer(False, REFUSED_OUTDATED, problem)
        return self._command(event, request.requested_by or "unknown", request.reason)
