"""Services of the manager: load_scenario and one per session command, each with an answer."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

from rclpy.node import Node

from ssp_core import names
from ssp_msgs.srv import LoadScenario, SessionCommand
from ssp_scenario_manager.core.command_answer import Answer
from ssp_scenario_manager.core.session import Session
from ssp_scenario_manager.core.session_machine import SessionEvent


class CommandServices:
    """The services.

    Args:
        node: owns them.
        session: whose state the answers give.
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
        node.create_service(LoadScenario, names.LOAD_SCENARIO, self._on_load)
        for word in names.SESSION_COMMANDS:
            node.create_service(SessionCommand, word, partial(self._on_command, SessionEvent(word)))

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
