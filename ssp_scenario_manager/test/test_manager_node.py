"""The scenario_manager as a process: what its services answer, and that abort always works."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import rclpy
from rclpy.action import ActionClient
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor

from ssp_core import names, ros
from ssp_core.conversions import state_to_msg
from ssp_core.domains import free_domain
from ssp_core.processes import remove_shared_ports, remove_stale_shared_memory, session_environment
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState, ObjectClass, SessionPhase, Verdict
from ssp_msgs import msg
from ssp_msgs.action import RunScenario
from ssp_msgs.srv import LoadScenario, ObjectCommand, SessionCommand

pytestmark = pytest.mark.ros
DEADLINE_S = 20.0
DISARMED, ARMED = ControlState.DISARMED, ControlState.ARMED


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
        self.obeys = True
        self.seen: list[Any] = []
        self.safety: list[Any] = []
        self.beats: list[Any] = []
        self.commands: list[int] = []
        pub, sub = self.node.create_publisher, self.node.create_subscription
        self.tick = pub(msg.WorldTick, names.WORLD_TICK, ros.STATE)
        self.vut_pub = pub(msg.ObjectState, names.state_topic("vut"), ros.STATE)
        self.ot1_pub = pub(msg.ObjectState, names.state_topic("ot1"), ros.STATE)
        self.status = pub(msg.RecorderStatus, names.RECORDER_STATUS, ros.STATE)
        sub(msg.SessionState, names.SESSION_STATE, self.seen.append, ros.LATCHED)
        sub(msg.SafetyEvent, names.SAFETY_EVENT, self.safety.append, ros.LATCHED)
        sub(msg.Heartbeat, names.HEARTBEAT, self.beats.append, ros.STATE)
        self.node.create_service(ObjectCommand, names.command_service("ot1"), self._on_command)
        self.node.create_timer(0.02, self._publish)
        client = self.node.create_client
        self.services = {c: client(SessionCommand, c) for c in names.SESSION_COMMANDS}
        self.loading = client(LoadScenario, names.LOAD_SCENARIO)
        self.action = ActionClient(self.node, RunScenario, names.RUN_SCENARIO)

    def _publish(self) -> None:
        self.tick.publish(msg.WorldTick(step=0, running=False, lockstep=True))
        if self.vut is not None:
            self.vut_pub.publish(state_to_msg(self.vut))
        if self.ot1 is not None:
            self.ot1_pub.publish(state_to_msg(self.ot1))
        if self.recorder is not None:
            self.status.publish(self.recorder)

    def _on_command(self, request: Any, response: Any) -> Any:
        self.commands.append(request.command)
        response.accepted = self.obeys
        response.error_msg = "" if self.obeys else "the key is out"
        armed = request.command == ObjectCommand.Request.COMMAND_ARM
        if self.obeys:
            self.appear(ARMED if armed else DISARMED)
        return response

    def appear(self, control_state: ControlState = DISARMED) -> None:
        """Everybody is there, in place, and recorded."""
        self.vut = self.make_state("vut")
        self.ot1 = self.make_state("ot1", x_m=40.0, y_m=3.5, control_state=control_state)
        self.recorder = msg.RecorderStatus(ready=True)

    def spin_until(self, condition: Callable[[], Any], what: str) -> None:
        deadline = time.monotonic() + DEADLINE_S
        while not condition():
            assert time.monotonic() < deadline, f"{what} did not happen in time"
            self.executor.spin_once(timeout_sec=0.05)

    def ask(self, client: Any, request: Any) -> Any:
        self.spin_until(client.service_is_ready, f"{client.srv_name} is there")
        future = client.call_async(request)
        self.spin_until(future.done, f"{client.srv_name} answers")
        return future.result()

    def command(self, name: str) -> Any:
        return self.ask(self.services[name], SessionCommand.Request(requested_by="test"))

    def load(self, run_file: Path | str) -> Any:
        return self.ask(self.loading, LoadScenario.Request(run_file=str(run_file)))

    def obtain(self, name: str) -> None:
        """Asks until it is accepted: what was published needs a moment to arrive."""
        self.spin_until(lambda: self.command(name).accepted, name)

    def wait_for(self, state: SessionPhase) -> None:
        self.spin_until(lambda: self.seen and self.seen[-1].state == state, state.name)

    def run(self, run_file: Path | str) -> Any:
        """Sends a goal and returns its result."""
        self.spin_until(self.action.server_is_ready, "the action server")
        goal = self.action.send_goal_async(RunScenario.Goal(run_file=str(run_file)))
        self.spin_until(goal.done, "the goal's answer")
        assert goal.result().accepted
        result = goal.result().get_result_async()
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
    process = subprocess.Popen(
        [sys.executable, "-m", "ssp_scenario_manager.node"],
        env=session_environment(domain),
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    yield process
    process.kill()
    process.communicate(timeout=10)


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
    path.write_text(json.dumps(run_mapping))
    return path


def bring(peers: Peers, run_file: Path, phase: str) -> None:
    """Any state that can be reached while the world holds."""
    if phase == "IDLE":
        return
    assert peers.load(run_file).accepted
    if phase == "LOADED":
        return
    peers.appear()
    for command, reached in (("connect", "CONNECTED"), ("arm", "ARMED"), ("start", "RUNNING")):
        peers.obtain(command)
        if reached == phase:
            return
    if phase in ("ABORTING", "ABORTED"):
        if phase == "ABORTING":
            assert peers.vut is not None
            peers.vut = peers.make_state("vut", speed_mps=1.0)
            spin = partial(peers.executor.spin_once, timeout_sec=0.02)
            for _ in range(20):
                spin()
        peers.command("abort")
    else:
        peers.command("stop")
    peers.wait_for(SessionPhase[phase])


def test_refusals_say_why(peers: Peers, run_file: Path, tmp_path: Path) -> None:
    answer = peers.command("arm")
    assert (answer.accepted, answer.error_code) == (False, answer.REFUSED_TRANSITION)
    assert answer.error_msg == "arm is not possible in state IDLE; possible are: load, abort"
    assert answer.session_state == SessionPhase.IDLE

    answer = peers.load(tmp_path / "none.yaml")
    assert not answer.accepted
    assert answer.error_code != 0
    assert "none.yaml: can't be read" in answer.error_msg

    assert peers.load(run_file).event_version == "sha256:event"
    answer = peers.command("connect")
    assert (answer.accepted, answer.error_code) == (False, answer.REFUSED_CONDITION)
    assert list(answer.missing) == ["no state of the VUT arrives", "no state of ot1 arrives"]

    # Both are heard, but nothing is as it must be for arming.
    peers.vut = peers.make_state("vut", x_m=-8.0)
    peers.ot1 = peers.make_state("ot1", x_m=40.0, y_m=3.5, speed_mps=2.0)
    peers.obtain("connect")
    answer = peers.command("arm")
    assert (answer.accepted, answer.error_code) == (False, answer.REFUSED_CONDITION)
    assert list(answer.missing) == [
        "the recorder is silent",
        "vut is 8.00 m from its start, limit 1.5 m",
        "ot1 is OFF, not DISARMED",
        "ot1 moves at 2.00 m/s",
    ]
    for missing in answer.missing:
        assert missing in answer.error_msg


def test_abort_from_every_state(peers: Peers, run_file: Path) -> None:
    """Also while the world holds: it ends in ABORTED, and all_clear leads out of it."""
    for phase in (
        *("IDLE", "LOADED", "CONNECTED", "ARMED", "RUNNING", "FINISHED", "ABORTING", "ABORTED"),
        "ARMED",  # once more: the way out leads back to where a run can start
    ):
        peers.safety.clear()
        peers.commands.clear()
        bring(peers, run_file, phase)
        assert peers.command("abort").accepted, phase
        if phase == "ABORTING":
            assert peers.seen[-1].state != SessionPhase.ABORTED
            peers.appear(ControlState.ABORTING)
        peers.wait_for(SessionPhase.ABORTED)
        assert any(event.limit_name == "operator" for event in peers.safety), phase
        peers.obtain("all_clear")
        peers.wait_for(SessionPhase.IDLE)
        if phase != "IDLE":  # before a load there are no objects to clear
            clear = ObjectCommand.Request.COMMAND_ALL_CLEAR
            peers.spin_until(lambda: clear in peers.commands, "the objects are cleared")  # noqa: B023 (waited for at once)
    # Every transition was announced once, and each begins where the one before ended.
    states = [SessionPhase(s.state) for s in peers.seen]
    before = [SessionPhase(s.previous) for s in peers.seen]
    assert before == [SessionPhase.IDLE, *states[:-1]]


def test_the_start_reaches_the_objects_with_its_references_counted(
    peers: Peers, run_file: Path
) -> None:
    """The first heartbeat that says RUNNING says how many references go with it."""
    bring(peers, run_file, "RUNNING")
    running = SessionPhase.RUNNING
    peers.spin_until(lambda: any(b.session_state == running for b in peers.beats), "a beat")
    first = next(b for b in peers.beats if b.session_state == running)
    assert dict(zip(first.object_ids, first.references_sent, strict=True)) == {"ot1": 1}
    sequences = [b.sequence for b in peers.beats]
    assert sequences == list(range(sequences[0], sequences[0] + len(sequences)))


def test_an_object_that_does_not_arm_takes_the_session_back(peers: Peers, run_file: Path) -> None:
    bring(peers, run_file, "CONNECTED")
    peers.obeys = False
    peers.obtain("arm")
    peers.spin_until(lambda: peers.seen[-1].event == "arm_failed", "the way back")
    assert peers.seen[-1].reason == "ot1 refused: the key is out"
    assert peers.seen[-1].state == SessionPhase.CONNECTED


def test_a_number_without_a_name_does_not_kill_it(
    peers: Peers, run_file: Path, manager: subprocess.Popen[str]
) -> None:
    bring(peers, run_file, "CONNECTED")
    strange = state_to_msg(peers.make_state("vut", object_class=ObjectClass.CAR))
    strange.object_class = 99
    for _ in range(5):
        peers.vut_pub.publish(strange)
    peers.obtain("arm")
    assert manager.poll() is None


def test_a_goal_is_for_an_idle_session(peers: Peers, run_file: Path, tmp_path: Path) -> None:
    """It must not be given the verdict of the run before it."""
    result = peers.run(tmp_path / "none.yaml")
    assert result.error_code != 0
    assert "can't be read" in result.error_msg
    bring(peers, run_file, "FINISHED")
    result = peers.run(run_file)
    assert (result.verdict, result.run_id) == (Verdict.NONE, "")
    assert "the session is FINISHED already" in result.error_msg
    assert peers.seen[-1].state == SessionPhase.FINISHED


def test_sigterm_aborts_before_it_goes(
    peers: Peers, run_file: Path, manager: subprocess.Popen[str]
) -> None:
    bring(peers, run_file, "ARMED")
    manager.send_signal(signal.SIGTERM)
    peers.spin_until(lambda: peers.seen[-1].event == "abort", "the abort")
    assert "shuts down" in peers.seen[-1].reason
    assert manager.wait(timeout=DEADLINE_S) == 0
