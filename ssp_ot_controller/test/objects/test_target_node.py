"""The object_target as a process: commands, references, silence, its lifecycle."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState

from ssp_core import names, ros
from ssp_core.geometry import Polyline
from ssp_core.host.environment import session_environment
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.motion.reference import Reference
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_msgs import msg
from ssp_msgs.srv import ObjectCommand
from ssp_ot_controller.objects.pool import TICK_SILENCE_S
from tests.support.bags.rclpy_messages import reference_to_msg, state_to_msg
from tests.support.processes.children import end
from tests.support.processes.patience import PATIENT_S, SILENCE_S, patient
from tests.support.processes.waiting import DEADLINE_S, answer_of, pause, until
from tests.support.states import object_state

pytestmark = pytest.mark.ros
# A reader may be found by this side before it has found this side.
TICK_AGAIN_S = TICK_SILENCE_S / 5.0
VERSION = "sha256:event"
Request = ObjectCommand.Request


@pytest.fixture
def heartbeat_s() -> float:
    """Silence of the manager after which the object stops by itself."""
    return PATIENT_S


@pytest.fixture
def run_file(
    tmp_path: Path, run_mapping: Callable[..., dict[str, Any]], heartbeat_s: float
) -> Path:
    path = tmp_path / "run.yaml"
    path.write_text(json.dumps(patient(run_mapping(), heartbeat_s=heartbeat_s)))
    return path


class Peers:
    """World and manager, played by the test; both act only on the test's request."""

    def __init__(self, others: Any) -> None:
        self.node, self.spin, self.spin_until = others.node, others.spin, others.spin_until
        self.states: list[Any] = []
        self.actuator: list[Any] = []
        self.acks: list[Any] = []
        self.safety: list[Any] = []
        self.rules: list[Any] = []
        self.replies: list[Any] = []
        self.sequence = 0
        pub, sub = self.node.create_publisher, self.node.create_subscription
        self.tick_pub = pub(msg.WorldTick, names.WORLD_TICK, ros.STATE)
        self.beat_pub = pub(msg.Heartbeat, names.HEARTBEAT, ros.STATE)
        self.reference_pub = pub(msg.Reference, names.reference_topic("ot1"), ros.COMMAND)
        sub(msg.ObjectState, names.state_topic("ot1"), self.states.append, ros.STATE)
        sub(
            msg.ActuatorCommands,
            names.ACTUATOR_COMMANDS,
            lambda message: self.actuator.extend(message.commands),
            ros.COMMAND,
        )
        sub(msg.ReferenceAck, names.ack_topic("ot1"), self.acks.append, ros.COMMAND)
        sub(msg.HeartbeatReply, names.HEARTBEAT_REPLY, self.replies.append, ros.STATE)
        sub(msg.SafetyEvent, names.SAFETY_EVENT, self.safety.append, ros.LATCHED)
        sub(msg.ObjectRules, names.rules_topic("ot1"), self.rules.append, ros.LATCHED)
        client = self.node.create_client
        self.commands = client(ObjectCommand, names.command_service("ot1"))
        self.lifecycle = client(ChangeState, f"{names.OBJECT_TARGET}/change_state")

    def connected(self) -> bool:
        """All topics have found their other end."""
        return self.commands.service_is_ready() and all(
            p.get_subscription_count() for p in (self.tick_pub, self.beat_pub, self.reference_pub)
        )

    def live_connected(self) -> bool:
        """Tell the same as ``connected`` for an object that hears no world."""
        return self.commands.service_is_ready() and all(
            p.get_subscription_count() for p in (self.beat_pub, self.reference_pub)
        )

    def beat(
        self, session: SessionPhase, sender: str = names.SCENARIO_MANAGER, sent: int = 0
    ) -> None:
        self.sequence += 1
        self.beat_pub.publish(
            msg.Heartbeat(
                sender=sender,
                sequence=self.sequence,
                sent=ros.stamp_from_ns(time.time_ns()),
                session_state=int(session),
                object_ids=["ot1"],
                references_sent=[sent],
            )
        )

    def tick_until(
        self, condition: Callable[[], object], what: str, before: Callable[[], object] = pause
    ) -> None:
        """Ticks until a condition holds, and says what it waited for and what the object states."""

        def lacks() -> str:
            states = [ControlState(state.control_state).name for state in self.states[-3:]]
            return f"{what}; the object's newest states are {states}"

        def go_on() -> None:
            before()
            self.tick()

        until(condition, lacks, go_on)

    @property
    def control(self) -> ControlState | None:
        """The newest control state that was heard."""
        return ControlState(self.states[-1].control_state) if self.states else None

    def tick(self) -> ControlState:
        """Ticks of a holding world, which repeats them, until the object reports a state."""
        state = object_state("ot1", x_m=40.0)
        count = len(self.states)
        tick = msg.WorldTick(step=0, running=False, lockstep=True, objects=[state_to_msg(state)])
        deadline = time.monotonic() + DEADLINE_S
        while len(self.states) == count:
            assert time.monotonic() < deadline, "a state did not happen in time"
            self.tick_pub.publish(tick)
            again = time.monotonic() + TICK_AGAIN_S
            while len(self.states) == count and time.monotonic() < again:
                self.spin()
        return ControlState(self.states[-1].control_state)

    def command(self, number: int, version: str = VERSION, rules: str | None = None) -> Any:
        """A manager's command; it knows what the object says to judge by."""
        self.spin_until(lambda: self.rules, "the object's rules")
        digest = self.rules[-1].digest if rules is None else rules
        request = Request(command=number, event_version=version, rules_digest=digest)
        return self.ask(self.commands, request)

    def ask(self, client: Any, request: Any) -> Any:
        return answer_of(client, request, self.spin_until)

    def change(self, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return bool(self.ask(self.lifecycle, request).success)

    def arm(self) -> None:
        """Beats and ticks are on topics of their own: the first beat may come after the tick."""
        refusals: list[str] = []

        def accepted() -> bool:
            self.beat(SessionPhase.ARMED)
            control = self.tick()
            assert control is ControlState.DISARMED, f"{control.name} before it is armed"
            answer = self.command(Request.COMMAND_ARM)
            assert answer.accepted or "no heartbeat" in answer.error_msg, answer.error_msg
            refusals.append(answer.error_msg)
            return bool(answer.accepted)

        until(accepted, lambda: f"arming; the newest refusal is {refusals[-1]!r}")
        self.beat(SessionPhase.ARMED)
        self.tick_until(
            lambda: self.control is ControlState.ARMED,
            "ARMED of an object that accepted to arm",
            lambda: self.beat(SessionPhase.ARMED),
        )


def start(domain: int, **parameters: object) -> subprocess.Popen[str]:
    arguments = [sys.executable, "-m", "ssp_ot_controller.ros.object_target", "--ros-args"]
    for name, value in parameters.items():
        arguments += ["-p", f"{name}:={value}"]
    return subprocess.Popen(
        arguments,
        env=session_environment(domain),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


@pytest.fixture
def target(domain: int, run_file: Path) -> Iterator[subprocess.Popen[str]]:
    process = start(domain, run_file=run_file)
    yield process
    end(process)


@pytest.fixture
def peers(others: Any, target: subprocess.Popen[str]) -> Peers:
    made = Peers(others)
    made.spin_until(made.connected, "discovery")
    return made


def test_commands_and_their_refusals(peers: Peers) -> None:
    assert peers.tick() is ControlState.DISARMED
    # 100 and up are the numbers of what the object notices by itself.
    for number in (0, 8, 99, 100, 101, 102, 103, 104, 255):
        answer = peers.command(number)
        assert not answer.accepted, number
        assert answer.error_code == ObjectCommand.Response.REFUSED_TRANSITION
        assert answer.error_msg
        assert answer.control_state == ControlState.DISARMED
    answer = peers.command(Request.COMMAND_START)
    assert (answer.accepted, answer.error_code) == (False, answer.REFUSED_TRANSITION)
    assert "START is not possible in DISARMED" in answer.error_msg
    for rules in ("", "sha256:another"):
        answer = peers.command(Request.COMMAND_ARM, rules=rules)
        assert (answer.accepted, answer.error_code) == (False, answer.REFUSED_VERSION)
        assert "this object judges by the rules sha256:" in answer.error_msg
    answer = peers.command(Request.COMMAND_ARM, "sha256:another")
    assert (answer.accepted, answer.error_code) == (False, answer.REFUSED_VERSION)
    assert peers.tick() is ControlState.DISARMED


def test_an_abort_that_is_still_queued_does_not_undo_all_clear(peers: Peers) -> None:
    """Heartbeats wait for the next tick, a service call doesn't."""
    peers.arm()
    peers.beat(SessionPhase.ABORTING)
    peers.beat(SessionPhase.ABORTED)
    assert peers.tick() is ControlState.ABORTING
    for _ in range(5):
        peers.beat(SessionPhase.ABORTED)
    # Time for the beats to arrive: an answered command behind them on a busy node.
    for _ in range(3):
        assert not peers.command(99).accepted
    assert peers.command(Request.COMMAND_ALL_CLEAR).accepted
    assert peers.tick() is ControlState.DISARMED
    peers.arm()


def test_a_reference_out_of_turn_is_answered(peers: Peers) -> None:
    assert peers.tick() is ControlState.DISARMED
    points = drive_along(Polyline([(40.0, 0.0), (90.0, 0.0)]), 0.0, 0.0, 5.0, 2.0, 2.0)
    second = 10**9
    reference = Reference("r1", "ot1", VERSION, "approach", 0, second, 2 * second, tuple(points))
    peers.reference_pub.publish(reference_to_msg(reference))
    peers.tick_until(lambda: peers.acks, "an answer to the reference")
    (ack,) = peers.acks
    assert (ack.reference_id, ack.accepted) == ("r1", False)
    assert ack.error_code == msg.ReferenceAck.REFUSED_STATE
    assert "DISARMED" in ack.error_msg


@pytest.mark.parametrize("heartbeat_s", [SILENCE_S])
def test_silence_of_the_manager_stops_an_armed_object(peers: Peers, heartbeat_s: float) -> None:
    peers.arm()
    silent_since = time.monotonic()
    peers.tick_until(lambda: peers.control is not ControlState.ARMED, "a stop for silence")
    assert peers.control is ControlState.ABORTING
    assert time.monotonic() - silent_since >= heartbeat_s
    peers.spin_until(lambda: peers.safety, "the safety event")
    (event,) = peers.safety
    assert (event.limit_name, event.reaction, event.object_id) == (
        "heartbeat_lost",
        "local_stop",
        "ot1",
    )
    assert event.measured > event.limit == heartbeat_s
    assert peers.actuator[-1].acceleration < 0.0


def test_a_malformed_heartbeat_is_dropped(peers: Peers, target: subprocess.Popen[str]) -> None:
    peers.arm()
    for session_state, counts in ((SessionPhase.ARMED, []), (77, [0])):
        peers.beat_pub.publish(
            msg.Heartbeat(
                sender=names.SCENARIO_MANAGER,
                sequence=99,
                session_state=int(session_state),
                object_ids=["ot1"],
                references_sent=counts,
            )
        )
    peers.beat(SessionPhase.ARMED)
    assert peers.tick() is ControlState.ARMED
    assert target.poll() is None


def test_a_heartbeat_is_answered_with_the_stamps_of_both_clocks(peers: Peers) -> None:
    before_ns = time.time_ns()
    peers.tick_until(
        lambda: peers.replies,
        "an answer to a heartbeat",
        lambda: peers.beat(SessionPhase.CONNECTED),
    )
    reply = peers.replies[0]
    assert (reply.participant, reply.object_ids) == (names.OBJECT_TARGET, ["ot1"])
    assert 1 <= reply.sequence <= peers.sequence
    stamps = (reply.heartbeat_sent, reply.heartbeat_received, reply.header.stamp)
    times_ns = [before_ns, *map(ros.ns_from_stamp, stamps), time.time_ns()]
    assert times_ns == sorted(times_ns)


def test_a_second_manager_stops_an_armed_object_and_keeps_it_from_arming(peers: Peers) -> None:
    peers.arm()
    peers.beat(SessionPhase.RUNNING, sender="somebody_else")

    def both_beat() -> None:
        peers.beat(SessionPhase.ARMED)
        peers.beat(SessionPhase.RUNNING, sender="somebody_else")

    peers.tick_until(
        lambda: peers.control is not ControlState.ARMED, "a stop for a second manager", both_beat
    )
    peers.spin_until(lambda: peers.safety, "the safety event")
    assert [event.limit_name for event in peers.safety] == ["foreign_manager"]
    assert not peers.command(Request.COMMAND_ALL_CLEAR).accepted
    peers.tick_until(
        lambda: peers.command(Request.COMMAND_ALL_CLEAR).accepted,
        "all_clear after an abort",
        lambda: peers.beat(SessionPhase.ABORTED),
    )
    peers.beat(SessionPhase.ARMED)
    peers.beat(SessionPhase.ARMED, sender="somebody_else")
    assert peers.tick() is ControlState.DISARMED
    answer = peers.command(Request.COMMAND_ARM)
    assert not answer.accepted
    assert answer.error_code == answer.REFUSED_CONDITION


@pytest.fixture
def body() -> Iterator[str]:
    """A body behind the body protocol; its address."""
    module = "ssp_ot_controller.bodies.simulated"
    process = subprocess.Popen(
        [sys.executable, "-m", module, "--object", "ot1", "--x", "40"],
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    yield process.stdout.readline().split()[-1]
    process.terminate()
    process.communicate(timeout=DEADLINE_S)


def test_live_an_object_of_hardware_drives_and_stops_by_itself(
    domain: int,
    others: Any,
    tmp_path: Path,
    run_mapping: Callable[..., dict[str, Any]],
    body: str,
) -> None:
    """No world, the system's clock, and datagrams to a body in a process of its own.

    A stop after its limits of silence must end inside the fence.
    """
    run, run_file = run_mapping(mode="live"), tmp_path / "run.yaml"
    run["limits"] |= {"heartbeat_s": 3.0, "state_age_s": SILENCE_S, "error_longitudinal_m": 9.0}
    run_file.write_text(json.dumps(run))
    process = start(domain, run_file=run_file, bodies=f"ot1={body}")
    peers = Peers(others)
    try:
        peers.spin_until(peers.live_connected, "discovery")
        beating = peers.node.create_timer(0.05, lambda: peers.beat(phase, sent=len(sent)))
        phase, sent = SessionPhase.ARMED, []

        def control() -> ControlState | None:
            return ControlState(peers.states[-1].control_state) if peers.states else None

        peers.spin_until(lambda: control() is ControlState.DISARMED, "a first reading")
        peers.spin_until(lambda: peers.command(Request.COMMAND_ARM).accepted, "arming")
        peers.spin_until(lambda: control() is ControlState.ARMED, "armed")
        phase = SessionPhase.RUNNING
        peers.spin_until(lambda: control() is ControlState.RUNNING, "running")
        points = drive_along(Polyline([(40.0, 0.0), (90.0, 0.0)]), 0.0, 0.0, 5.0, 2.0, 2.0)
        now_ns = time.time_ns()
        second = 10**9
        sent.append(
            Reference(
                "r1",
                "ot1",
                VERSION,
                "approach",
                now_ns,
                now_ns + second,
                now_ns + 3 * second,
                tuple(points),
            )
        )
        peers.reference_pub.publish(reference_to_msg(sent[0]))
        peers.spin_until(lambda: peers.acks, "an answer")
        assert peers.acks[0].accepted, peers.acks[0].error_msg
        peers.spin_until(lambda: peers.states[-1].speed > 2.0, "driving")
        assert peers.states[-1].x > 40.0
        peers.node.destroy_timer(beating)
        peers.spin_until(lambda: control() is ControlState.ABORTING, "its own stop")
        peers.spin_until(lambda: peers.states[-1].speed == 0.0, "standstill")
        # It has a topic of its own, and may be read after the states.
        peers.spin_until(lambda: peers.safety, "the safety event")
        assert [event.limit_name for event in peers.safety] == ["heartbeat_lost"]
        numbers = [state.sequence for state in peers.states]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    finally:
        end(process)


def test_lifecycle(peers: Peers) -> None:
    """Deactivating stops; configuring again leaves one node, not two in one."""
    peers.arm()
    assert peers.change(Transition.TRANSITION_DEACTIVATE)
    peers.beat(SessionPhase.ARMED)
    assert peers.tick() is ControlState.ABORTING
    for command in (Request.COMMAND_ALL_CLEAR, Request.COMMAND_ARM):
        answer = peers.command(command)
        assert (answer.accepted, answer.error_code) == (False, answer.REFUSED_CONDITION)
        assert "not active" in answer.error_msg
    assert peers.command(Request.COMMAND_ABORT).accepted
    answered = len(peers.replies)
    for _ in range(3):
        peers.beat(SessionPhase.ARMED)
        assert peers.tick() is ControlState.ABORTING
        # A busy node would have answered the beats before this command.
        assert not peers.command(99).accepted
    assert len(peers.replies) == answered
    assert peers.change(Transition.TRANSITION_CLEANUP)
    peers.spin_until(lambda: not peers.commands.service_is_ready(), "the end of its services")
    assert peers.change(Transition.TRANSITION_CONFIGURE)
    assert peers.change(Transition.TRANSITION_ACTIVATE)
    peers.spin_until(peers.connected, "discovery")
    assert peers.node.count_publishers(names.state_topic("ot1")) == 1
    peers.states.clear()
    assert peers.tick() is ControlState.DISARMED
    assert peers.tick() is ControlState.DISARMED
    assert len(peers.states) == 2
    peers.arm()


def test_what_it_cannot_work_with_ends_it(domain: int, run_file: Path) -> None:
    wrong = {
        "/nowhere/run.yaml: can't be read": {"run_file": "/nowhere/run.yaml"},
        "parameter object_ids: not in the run (got 'ot9')": {
            "run_file": str(run_file),
            "object_ids": "ot1,ot9",
        },
    }
    started = {says: start(domain, **given) for says, given in wrong.items()}
    for says, process in started.items():
        _, err = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == 1
        assert says in err
        assert "Traceback" not in err
