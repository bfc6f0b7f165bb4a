"""The scenario_manager as a process, and everybody whom it meets, played by the test."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from tf2_msgs.msg import TFMessage

from ssp_core import names, ros
from ssp_core.errors import InputError
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.host.shared_memory import remove_shared_ports, remove_stale_shared_memory
from ssp_core.motion.state import ObjectState
from ssp_core.ros.conversions import rules_to_msg
from ssp_core.run_file.model import load_run
from ssp_core.safety.object_rules import rules_of
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_msgs import msg
from ssp_msgs.action import RunScenario
from ssp_msgs.srv import LoadScenario, ObjectCommand, SessionCommand
from tests.support.bags.rclpy_messages import state_to_msg
from tests.support.processes.children import end
from tests.support.processes.patience import patient, start_manager
from tests.support.processes.waiting import DEADLINE_S, answer_of, until

DISARMED, ARMED = ControlState.DISARMED, ControlState.ARMED
# The state that a command leads to.
REACHED = {
    "connect": SessionPhase.CONNECTED,
    "arm": SessionPhase.ARMED,
    "start": SessionPhase.RUNNING,
    "reset": SessionPhase.IDLE,
    "all_clear": SessionPhase.IDLE,
}


class Peers:
    """Everybody whom a manager meets, played by the test: world, object target, recorder."""

    def __init__(self, domain_id: int, state: Callable[..., ObjectState]) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.node = rclpy.create_node("peers", namespace=names.NAMESPACE, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.vut: ObjectState | None = None
        self.ot1: ObjectState | None = None
        self.recorder: msg.RecorderStatus | None = None
        self.make_state = state
        self.object_ids = ["ot1"]
        self.obeys = True
        self.refusal_code = ObjectCommand.Response.REFUSED_CONDITION
        self.session_states: list[Any] = []
        self.feedback: list[Any] = []
        self.safety: list[Any] = []
        self.beats: list[Any] = []
        self.links: list[Any] = []
        self.poses: list[Any] = []
        self.answers = True
        self.live = False
        self.counted = 0
        self.clock_offset_ns = 0
        self.commands: list[int] = []
        self.request_times_s: list[float] = []
        pub, sub = self.node.create_publisher, self.node.create_subscription
        self.tick = pub(msg.WorldTick, names.WORLD_TICK, ros.STATE)
        self.vut_pub = pub(msg.ObjectState, names.state_topic("vut"), ros.STATE)
        self.ot1_pub = pub(msg.ObjectState, names.state_topic("ot1"), ros.STATE)
        self.status = pub(msg.RecorderStatus, names.RECORDER_STATUS, ros.STATE)
        sub(msg.SessionState, names.SESSION_STATE, self.session_states.append, ros.LATCHED)
        sub(msg.SafetyEvent, names.SAFETY_EVENT, self.safety.append, ros.LATCHED)
        sub(msg.Heartbeat, names.HEARTBEAT, self._on_beat, ros.STATE)
        sub(msg.LinkStatus, names.LINK_STATUS, self.links.append, ros.STATE)
        sub(TFMessage, names.TF, self.poses.append, ros.TF)
        self.reply = pub(msg.HeartbeatReply, names.HEARTBEAT_REPLY, ros.STATE)
        # What an object's process offers beside that, as one that is asked nothing.
        pub(msg.ReferenceAck, names.ack_topic("ot1"), ros.COMMAND)
        pub(msg.StepDone, names.STEP_DONE, ros.STATE)
        pub(msg.ActuatorCommands, names.ACTUATOR_COMMANDS, ros.COMMAND)
        self.rules = pub(msg.ObjectRules, names.rules_topic("ot1"), ros.LATCHED)
        self.node.create_service(ObjectCommand, names.command_service("ot1"), self._on_command)
        self.node.create_timer(0.02, self._publish)
        client = self.node.create_client
        self.services = {c: client(SessionCommand, c) for c in names.SESSION_COMMANDS}
        self.loading = client(LoadScenario, names.LOAD_SCENARIO)
        self.action = ActionClient(self.node, RunScenario, names.RUN_SCENARIO)

    def _publish(self) -> None:
        if not self.live:
            self.tick.publish(msg.WorldTick(step=0, running=False, lockstep=True))
        if self.vut is not None:
            self.vut_pub.publish(state_to_msg(self._now(self.vut)))
        if self.ot1 is not None:
            self.ot1_pub.publish(state_to_msg(self._now(self.ot1)))
        if self.recorder is not None:
            self.status.publish(self.recorder)

    def _now(self, state: ObjectState) -> ObjectState:
        """Live, states are stamped with the system clock, and counted."""
        if not self.live:
            return state
        self.counted += 1
        return replace(state, stamp_ns=time.time_ns(), sequence=self.counted)

    def _on_beat(self, beat: Any) -> None:
        """The object answers each heartbeat, by its own clock, and heeds an abort."""
        self.beats.append(beat)
        ended = (SessionPhase.ABORTING, SessionPhase.ABORTED)
        if beat.session_state in ended and self.ot1 is not None and self.obeys:
            self.ot1 = replace(self.ot1, control_state=ControlState.ABORTING)
        if self.answers:
            now = ros.stamp_from_ns(time.time_ns() + self.clock_offset_ns)
            answer = msg.HeartbeatReply(
                participant="peers",
                object_ids=self.object_ids,
                sequence=beat.sequence,
                heartbeat_sent=beat.sent,
                heartbeat_received=now,
            )
            answer.header.stamp = now
            self.reply.publish(answer)

    def _on_command(self, request: Any, response: Any) -> Any:
        self.commands.append(request.command)
        self.request_times_s.append(time.monotonic())
        response.accepted = self.obeys
        response.error_msg = "" if self.obeys else "the key is out"
        response.error_code = 0 if self.obeys else self.refusal_code
        armed = request.command == ObjectCommand.Request.COMMAND_ARM
        if self.obeys:
            self.appear(ARMED if armed else DISARMED)
        return response

    def appear(self, control_state: ControlState = DISARMED) -> None:
        """Everybody is there, in place, and recorded."""
        self.vut = self.make_state("vut")
        self.ot1 = self.make_state("ot1", x_m=40.0, y_m=3.5, control_state=control_state)
        self.recorder = msg.RecorderStatus(ready=True)

    def tell_rules(self, run_file: Path | str, **limits: float) -> None:
        """The object judges by the run, or by other limits; a file that is none has no rules."""
        with suppress(InputError):
            run = load_run(run_file)
            other = run.model_copy(update={"limits": run.limits.model_copy(update=limits)})
            self.rules.publish(rules_to_msg(rules_of(other, "ot1"), "ot1", "peers"))

    def spin_until(self, condition: Callable[[], Any], what: str) -> None:
        until(condition, what, lambda: self.executor.spin_once(timeout_sec=0.05))

    def ask(self, client: Any, request: Any) -> Any:
        return answer_of(client, request, self.spin_until)

    def command(self, name: str) -> Any:
        request = SessionCommand.Request(requested_by="test", session_token=self.token)
        return self.ask(self.services[name], request)

    @property
    def token(self) -> str:
        """The session's token, as the manager's newest heartbeat says."""
        return self.beats[-1].session_token if self.beats else ""

    def load(self, run_file: Path | str) -> Any:
        self.tell_rules(run_file)
        request = LoadScenario.Request(run_file=str(run_file), session_token=self.token)
        return self.ask(self.loading, request)

    def obtain(self, name: str) -> None:
        """Asks until it is accepted: what was published needs a moment to arrive."""
        deadline = time.monotonic() + DEADLINE_S
        reached = REACHED[name]
        while not (answer := self.command(name)).accepted and answer.session_state != reached:
            assert time.monotonic() < deadline, f"{name} is refused: {answer.error_msg}"
            if name == "start" and answer.session_state == SessionPhase.CONNECTED:
                # The object's answer to arm was late on a busy machine, which takes arm back.
                self.command("arm")
            self.executor.spin_once(timeout_sec=0.05)

    def wait_for(self, state: SessionPhase) -> None:
        self.spin_until(
            lambda: self.session_states and self.session_states[-1].state == state, state.name
        )

    def send(self, run_file: Path | str) -> Any:
        """Sends a goal; it is accepted."""
        self.tell_rules(run_file)
        self.spin_until(self.action.server_is_ready, "the action server")
        goal = self.action.send_goal_async(
            RunScenario.Goal(run_file=str(run_file), session_token=self.token),
            feedback_callback=lambda told: self.feedback.append(told.feedback),
        )
        self.spin_until(goal.done, "the goal's answer")
        assert goal.result().accepted
        return goal.result()

    def run(self, run_file: Path | str) -> Any:
        """Sends a goal and returns its result."""
        result = self.send(run_file).get_result_async()
        self.spin_until(result.done, "the result")
        return result.result().result

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def domain() -> Iterator[int]:
    with free_domain() as domain_id:
        yield domain_id
        remove_shared_ports(domain_id)
    remove_stale_shared_memory()


@pytest.fixture
def manager(domain: int) -> Iterator[subprocess.Popen[str]]:
    process = start_manager(session_environment(domain))
    yield process
    end(process)


@pytest.fixture
def peers(
    domain: int,
    manager: subprocess.Popen[str],
    state: Callable[..., ObjectState],
    monkeypatch: pytest.MonkeyPatch,
) -> Iterator[Peers]:
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    made = Peers(domain, state)
    yield made
    made.close()


@pytest.fixture
def run_file(tmp_path: Path, run_mapping: dict[str, Any]) -> Path:
    path = tmp_path / "run.yaml"
    path.write_text(json.dumps(patient(run_mapping)))
    return path
