"""The scenario_manager as a process: what its services answer, and that abort always works."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import rclpy

from ssp_core import names, ros
from ssp_core.ros.conversions import rules_to_msg
from ssp_core.run_file.model import load_run
from ssp_core.safety.object_rules import rules_of
from ssp_core.safety.publishers import NAMELESS
from ssp_core.vocabulary import ControlState, ObjectClass, SessionPhase, Verdict
from ssp_msgs import msg
from ssp_msgs.srv import ObjectCommand
from tests.support.bags.rclpy_messages import state_to_msg
from tests.support.processes.patience import patient
from tests.support.processes.waiting import DEADLINE_S

pytestmark = pytest.mark.ros
Peers = Any  # see conftest.py


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
    # Its world steps, and nobody but the manager has answered.
    waits = "the simulated world waits for object_target and monitor: no answer to its first step"
    peers.spin_until(
        lambda: list(peers.command("connect").missing) == [waits, "no state of ot1 arrives"],
        "what the world waits for",
    )

    # Both are heard, but nothing is as it must be for arming.
    peers.clock_offset_ns = 2_000_000_000
    peers.vut = peers.make_state("vut", x_m=-8.0)
    peers.ot1 = peers.make_state("ot1", x_m=40.0, y_m=3.5, speed_mps=2.0)
    peers.obtain("connect")
    answers: list[Any] = []

    def clock_is_measured() -> bool:
        answers.append(peers.command("arm"))
        return "the clock of ot1 is off" in answers[-1].error_msg

    peers.spin_until(clock_is_measured, "a measured clock")
    answer = answers[-1]
    assert (answer.accepted, answer.error_code) == (False, answer.REFUSED_CONDITION)
    silent, offset, *others = answer.missing
    assert silent == "the recorder is silent"
    assert re.fullmatch(r"the clock of ot1 is off by [12]\.\d{3} s, limit 0\.\d+ s", offset)
    assert others == [
        "vut is 8.00 m from its start, limit 1.5 m",
        "ot1 is OFF, not DISARMED or ARMED",
        "ot1 moves at 2.00 m/s, limit 0.05 m/s",
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
            assert peers.session_states[-1].state != SessionPhase.ABORTED
            peers.appear(ControlState.ABORTING)
        peers.wait_for(SessionPhase.ABORTED)
        assert any(event.limit_name == "operator" for event in peers.safety), phase
        peers.obtain("all_clear")
        peers.wait_for(SessionPhase.IDLE)
        if phase != "IDLE":  # before a load there are no objects to clear
            clear = ObjectCommand.Request.COMMAND_ALL_CLEAR
            peers.spin_until(lambda: clear in peers.commands, "the objects are cleared")  # noqa: B023 (waited for at once)
    # Every transition was announced once, and each begins where the one before ended.
    states = [SessionPhase(s.state) for s in peers.session_states]
    before = [SessionPhase(s.previous) for s in peers.session_states]
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
    peers.spin_until(lambda: peers.session_states[-1].event == "arm_failed", "the way back")
    assert peers.session_states[-1].reason == "ot1 refused: the key is out"
    assert peers.session_states[-1].state == SessionPhase.CONNECTED


def test_an_object_that_refuses_to_arm_is_asked_once_a_second_and_not_at_all_for_a_lasting_reason(
    peers: Peers, run_file: Path
) -> None:
    peers.appear()
    peers.obeys = False
    goal = peers.send(run_file)

    def arms() -> list[float]:
        asked = zip(peers.commands, peers.request_times_s, strict=True)
        return [at for command, at in asked if command == ObjectCommand.Request.COMMAND_ARM]

    peers.spin_until(lambda: len(arms()) == 3, "the third command to arm")
    assert min(after - before for before, after in pairwise(arms())) > 0.9
    waits = "ot1 has just refused to arm: the key is out"
    peers.spin_until(lambda: peers.feedback[-1].waits_for == waits, "the reason in the feedback")
    peers.refusal_code = ObjectCommand.Response.REFUSED_LASTING
    result = goal.get_result_async()
    peers.spin_until(result.done, "the result")
    assert list(result.result().result.reasons) == ["ot1 refused: the key is out"]
    asked = len(arms())
    assert asked <= 5


def test_others_are_not_armed_and_disarmed_all_the_time_while_one_refuses(
    peers: Peers, tmp_path: Path, run_mapping: dict[str, Any]
) -> None:
    """One of several objects refuses for good: the others follow it once a second at most."""
    start = {"x_m": 70.0, "y_m": 3.5, "yaw_rad": 0.0}
    second = {"id": "ot2", "object_class": "car", "start": start}
    path = tmp_path / "run.yaml"
    targets = [*run_mapping["targets"], second]
    path.write_text(json.dumps(patient({**run_mapping, "targets": targets})))
    run, arm = load_run(path), ObjectCommand.Request.COMMAND_ARM
    told: list[int] = []
    controls = [ControlState.DISARMED]

    def on_command(request: Any, response: Any) -> Any:
        told.append(request.command)
        controls.append(ControlState.ARMED if request.command == arm else ControlState.DISARMED)
        response.accepted = True
        return response

    node, topic = peers.node, names.state_topic("ot2")
    states = node.create_publisher(msg.ObjectState, topic, ros.STATE)
    rules = node.create_publisher(msg.ObjectRules, names.rules_topic("ot2"), ros.LATCHED)
    node.create_publisher(msg.ReferenceAck, names.ack_topic("ot2"), ros.COMMAND)
    node.create_service(ObjectCommand, names.command_service("ot2"), on_command)

    def publish() -> None:
        place = {"x_m": start["x_m"], "y_m": start["y_m"], "control_state": controls[-1]}
        states.publish(state_to_msg(peers.make_state("ot2", **place)))

    node.create_timer(0.02, publish)
    rules.publish(rules_to_msg(rules_of(run, "ot2"), "ot2", "peers"))
    peers.object_ids = ["ot1", "ot2"]
    peers.appear()
    peers.obeys = False
    goal = peers.send(path)
    peers.spin_until(lambda: peers.commands.count(arm) == 3, "the third command to arm")
    # A stall may let another one come in between, and a late answer a disarm be repeated.
    assert told.count(arm) <= 5
    assert len(told) <= 20
    peers.refusal_code = ObjectCommand.Response.REFUSED_LASTING
    result = goal.get_result_async()
    peers.spin_until(result.done, "the result")
    assert list(result.result().result.reasons) == ["ot1 refused: the key is out"]
    assert told.count(arm) <= 8
    peers.spin_until(lambda: controls[-1] is ControlState.DISARMED, "ot2 disarmed again")


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
    assert peers.session_states[-1].state == SessionPhase.FINISHED


def test_a_goal_says_what_its_next_step_waits_for(peers: Peers, run_file: Path) -> None:
    goal = peers.send(run_file)
    peers.spin_until(lambda: peers.feedback and peers.feedback[-1].waits_for, "what is missing")
    assert "no state of ot1 arrives" in peers.feedback[-1].waits_for
    peers.appear()
    peers.spin_until(lambda: peers.session_states[-1].state == SessionPhase.RUNNING, "the start")
    peers.spin_until(lambda: not peers.feedback[-1].waits_for, "that nothing is missing")
    goal.cancel_goal_async()
    peers.wait_for(SessionPhase.ABORTED)


def test_sigterm_aborts_before_it_goes(
    peers: Peers, run_file: Path, manager: subprocess.Popen[str]
) -> None:
    bring(peers, run_file, "ARMED")
    manager.send_signal(signal.SIGTERM)
    peers.spin_until(lambda: peers.session_states[-1].event == "abort", "the abort")
    assert "shuts down" in peers.session_states[-1].reason
    assert manager.wait(timeout=DEADLINE_S) == 0


STRANGE = {
    names.SESSION_STATE: msg.SessionState,
    names.state_topic("vut"): msg.ObjectState,
    names.state_topic("ot1"): msg.ObjectState,
    names.reference_topic("ot1"): msg.Reference,
    names.ack_topic("ot1"): msg.ReferenceAck,
    names.rules_topic("ot1"): msg.ObjectRules,
    names.HEARTBEAT: msg.Heartbeat,
    names.HEARTBEAT_REPLY: msg.HeartbeatReply,
    names.STEP_DONE: msg.StepDone,
    names.ACTUATOR_COMMANDS: msg.ActuatorCommands,
    names.RECORDER_STATUS: msg.RecorderStatus,
}


def test_a_second_publisher_of_each_topic_is_named(peers: Peers, run_file: Path) -> None:
    """One session after the other: an intruder that is gone keeps none of them from arming."""
    # The graph may have no name for it in time; which process it is, it always has.
    whence = f"{NAMELESS} (process {os.getpid() & 0xFFFF} of this host)"
    bring(peers, run_file, "CONNECTED")
    intruder = rclpy.create_node("intruder", namespace=names.NAMESPACE, context=peers.context)
    acks = names.ack_topic("ot1")
    intruder.create_publisher(msg.ReferenceAck, acks, ros.LATCHED)
    # Before anything is armed page and terminal hear of it, and arming is refused for it.
    peers.spin_until(lambda: peers.links and peers.links[-1].strangers, "a report of the stranger")
    assert peers.links[-1].strangers[0].startswith(f"{acks} has ")
    refusal = peers.command("arm").error_msg
    assert f"1 publishers too many, limit 0: {acks} has " in refusal
    intruder.destroy_node()
    peers.spin_until(lambda: not peers.links[-1].strangers, "a report without it")
    peers.obtain("reset")
    for topic, kind in STRANGE.items():
        bring(peers, run_file, "ARMED")
        assert list(peers.session_states[-1].reasons) == [], topic
        intruder = rclpy.create_node("intruder", namespace=names.NAMESPACE, context=peers.context)
        intruder.create_publisher(kind, topic, ros.LATCHED)
        peers.spin_until(lambda: peers.session_states[-1].reasons, f"a reason for {topic}")
        last = peers.session_states[-1]
        assert last.verdict == msg.SessionState.VERDICT_INVALID_HARNESS
        assert last.reasons[0].startswith(f"foreign_manager: 1, limit 0 ({topic} has")
        assert "/ssp/intruder" in last.reasons[0] or whence in last.reasons[0]
        intruder.destroy_node()
        peers.wait_for(SessionPhase.ABORTED)
        peers.obtain("all_clear")
        peers.wait_for(SessionPhase.IDLE)


def test_an_object_with_another_run_file_is_not_armed(peers: Peers, run_file: Path) -> None:
    """Yesterday's file on its host; with its own stricter limit it is, and that is said."""
    bring(peers, run_file, "CONNECTED")
    peers.tell_rules(run_file, speed_mps=40.0)
    ours = json.loads(run_file.read_text())["limits"]["speed_mps"]
    text = f"ot1 judges by another limits.speed_mps: 40.0 on its host, {ours:.1f} here"
    peers.spin_until(lambda: text in peers.command("arm").error_msg, text)
    assert not peers.commands
    peers.tell_rules(run_file, speed_mps=0.5 * ours)
    peers.obtain("arm")
    peers.wait_for(SessionPhase.ARMED)
    own = f"ot1 has its own limits.speed_mps {0.5 * ours:.1f} instead of {ours:.1f}"
    assert any(own in state.reason for state in peers.session_states), [
        s.reason for s in peers.session_states
    ]
