"""``ssp replay`` over real topics: what comes out, what doesn't, and who may stop it."""

from __future__ import annotations

import json
import os
import pty
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rclpy
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock
from std_msgs.msg import String
from std_srvs.srv import Trigger

import ssp_core
from ssp_core import names, ros
from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage, TypeDefinition, serialize
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.references import encode_reference
from ssp_core.cdr.states import encode_state
from ssp_core.clock import NS_PER_S
from ssp_core.host.domains import free_domain
from ssp_core.host.environment import session_environment
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.camera import Mounting
from ssp_core.world.transforms import TF_TYPE, encode_transforms, of_camera, of_state
from ssp_monitor.recorder.recorder import Recorder
from ssp_monitor.recorder.topics import Profile, TopicSpec
from ssp_monitor.ros.recording_subscriptions import RecordingSubscriptions
from ssp_msgs.msg import SessionState
from tests.support.bags.messages import header, message, picture, text
from tests.support.processes.children import end
from tests.support.processes.waiting import DEADLINE_S, answer_of, until
from tests.support.states import make_reference

pytestmark = [pytest.mark.ros, pytest.mark.system]

START_NS = 1_000 * NS_PER_S
STATE, IMAGE = "/ssp/vut/state", "/ssp/vut/front_camera/image/compressed"
TF, TF_STATIC = "/tf", "/tf_static"
SESSION, REFERENCE, PLAIN = "/ssp/session_state", "/ssp/ot1/reference", "/plain"
BEST_EFFORT = offered_qos(10).replace("reliability: reliable", "reliability: best_effort")


def _image(ns: int, k: int) -> bytes:
    noise = np.random.default_rng(k).integers(0, 256, 100_000 + 4 * k, dtype=np.uint8)
    return picture(noise.tobytes(), ns, "map")


def _session(ns: int, state: int) -> bytes:
    named = {"event": "test", "reason": "", "run_id": "r", "scenario": "s", "event_version": ""}
    facts = {"state": state, "previous": 0, "verdict": 0, "reasons": []}
    return serialize(message("ssp_msgs/msg/SessionState", header=header(ns), **named, **facts))


def _state(ns: int, k: int) -> ObjectState:
    size = DEFAULT_SIZES[ObjectClass.CAR]
    motion = (0.1 * k, 0.0, 0.0, 10.0, 0.0, 0.0)
    return ObjectState("vut", ObjectClass.CAR, Role.VUT, ns, *motion, size, k + 1)


def _text(words: str) -> bytes:
    # As the middleware hands on and records a short message: filled up to a multiple of four.
    data = text(words)
    return data + bytes(-len(data) % 4)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four seconds: states at 100 Hz, frames at 20 Hz, a latched topic, a best-effort one, a
    command."""
    path = tmp_path_factory.mktemp("replay") / "bag"
    with BagWriter(path) as writer:
        writer.add_topic(STATE, "ssp_msgs/msg/ObjectState", offered_qos(50))
        writer.add_topic(IMAGE, "sensor_msgs/msg/CompressedImage", offered_qos(20))
        latched = offered_qos(20, transient_local=True)
        writer.add_topic(SESSION, "ssp_msgs/msg/SessionState", latched)
        writer.add_topic(REFERENCE, "ssp_msgs/msg/Reference", offered_qos(50))
        writer.add_topic(TF, TF_TYPE, offered_qos(100))
        writer.add_topic(TF_STATIC, TF_TYPE, offered_qos(1, transient_local=True))
        fixed = encode_transforms(of_camera(Mounting(2.0, 1.4, 0.05)))
        writer.write(TF_STATIC, fixed, START_NS, START_NS)
        writer.add_topic(PLAIN, "std_msgs/msg/String", BEST_EFFORT)
        for k in range(400):
            ns = START_NS + k * NS_PER_S // 100
            state = _state(ns, k)
            writer.write(STATE, bytes(encode_state(state)), ns, ns)
            writer.write(TF, encode_transforms([of_state(state)]), ns, ns)
            if k % 5 == 0:
                writer.write(IMAGE, _image(ns, k), ns, ns)
                writer.write(PLAIN, _text(f"word {k}"), ns, ns)
            if k in (0, 50, 150, 399):
                writer.write(SESSION, _session(ns, k // 50 + 1), ns, ns)
            if k == 200:
                writer.write(REFERENCE, encode_reference(make_reference(dispatched_ns=ns)), ns, ns)
    return path


@dataclass
class Stage:
    """A ROS domain of its own with a listener in it."""

    node: Node
    started: list[subprocess.Popen[str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.executor = ros.make_executor()
        self.executor.add_node(self.node)

    def replay(self, *arguments: str, **options: Any) -> subprocess.Popen[str]:
        command = [sys.executable, "-m", "ssp_core.cli", "replay", *arguments]
        pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True} | options
        process: subprocess.Popen[str] = subprocess.Popen(command, **pipes)
        self.started.append(process)
        return process

    def spin_until(self, condition: Callable[[], bool], what: str) -> None:
        until(condition, what, lambda: self.executor.spin_once(timeout_sec=0.02))

    def ask(self, service: str, kind: Any, request: Any) -> Any:
        client = self.node.create_client(kind, service)
        answer = answer_of(client, request, self.spin_until)
        self.node.destroy_client(client)
        return answer


@pytest.fixture
def stage(monkeypatch: pytest.MonkeyPatch) -> Iterator[Stage]:
    profile = Path(ssp_core.__file__).parent / "config" / "fastdds_one_host.xml"
    with free_domain() as domain_id:
        for name, value in session_environment(domain_id, profile).items():
            monkeypatch.setenv(name, value)
        rclpy.init(domain_id=domain_id)
        stage = Stage(rclpy.create_node("listener"))
        yield stage
        for process in stage.started:
            end(process)
        stage.executor.shutdown()
        stage.node.destroy_node()
        rclpy.shutdown()


def _by_topic(path: Path) -> dict[str, list[BagMessage]]:
    with BagReader(path) as reader:
        found: dict[str, list[BagMessage]] = {name: [] for name in reader.topics}
        for message in reader.messages():
            found[message.topic].append(message)
    return found


class Recording:
    """The monitor's own recorder over the bag's topics."""

    def __init__(self, path: Path) -> None:
        specs = (
            TopicSpec(STATE, "ssp_msgs/msg/ObjectState", Profile.STATE),
            TopicSpec(IMAGE, "sensor_msgs/msg/CompressedImage", Profile.SENSOR),
            TopicSpec(SESSION, "ssp_msgs/msg/SessionState", Profile.LATCHED),
            TopicSpec(REFERENCE, "ssp_msgs/msg/Reference", Profile.COMMAND),
            TopicSpec(TF, TF_TYPE, Profile.TF),
            TopicSpec(TF_STATIC, TF_TYPE, Profile.TF_STATIC),
        )
        plain = TopicSpec(PLAIN, "std_msgs/msg/String", Profile.STATE)
        self.path = path
        self.recorder = Recorder(path, specs)
        self.intake = RecordingSubscriptions(specs, self.recorder, False, {})
        self.recorder.add(plain, BEST_EFFORT, False)
        self.intake.add(
            plain,
            QoSProfile(
                history=HistoryPolicy.KEEP_LAST,
                depth=4000,
                reliability=ReliabilityPolicy.BEST_EFFORT,
            ),
        )

    def finish(self) -> dict[str, list[BagMessage]]:
        self.intake.stop()
        self.recorder.stop()
        assert not any(self.intake.lost_by_topic().values())
        return _by_topic(self.path)


def test_what_is_replayed_and_recorded_again_has_the_same_messages(
    bag: Path, stage: Stage, tmp_path: Path
) -> None:
    recording = Recording(tmp_path / "again")
    process = stage.replay(
        str(bag), "--rate", "4", "--commands", "--wait-for", "1", "--clock", "0", "--json"
    )
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    again, first = recording.finish(), _by_topic(bag)
    assert {name: len(found) for name, found in again.items()} == {
        STATE: 400,
        IMAGE: 80,
        SESSION: 4,
        REFERENCE: 1,
        TF: 400,
        TF_STATIC: 1,
        PLAIN: 80,
    }
    for name, messages in first.items():
        assert [m.data for m in again[name]] == [m.data for m in messages], name
    told = json.loads(out)
    assert (told["messages"], told["ended"], told["unacknowledged"]) == (966, "end", [])
    with BagReader(tmp_path / "again") as reader, BagReader(bag) as source:
        for name, info in source.topics.items():
            assert reader.topics[name].msgtype == info.msgtype
            assert reader.topics[name].type_hash == info.type_hash


def test_a_start_in_the_middle_gives_first_what_latched_publishers_kept(
    bag: Path, stage: Stage, tmp_path: Path
) -> None:
    recording = Recording(tmp_path / "again")
    process = stage.replay(
        str(bag),
        *("--rate", "10", "--wait-for", "1", "--start", "1", "--end", "3"),
    )
    _, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    again, first = recording.finish(), _by_topic(bag)

    def stretch(name: str) -> list[bytes]:
        inside = range(START_NS + NS_PER_S, START_NS + 3 * NS_PER_S + 1)
        return [m.data for m in first[name] if m.log_time_ns in inside]

    for name in (STATE, IMAGE, PLAIN):
        assert [m.data for m in again[name]] == stretch(name), name
    # Two of before the start, then the one of the stretch; not that of the end.
    assert [m.data for m in again[SESSION]] == [m.data for m in first[SESSION][:3]]


def test_what_may_move_objects_is_left_out_and_said(bag: Path, stage: Stage) -> None:
    heard: list[Any] = []
    stage.node.create_subscription(SessionState, SESSION, heard.append, ros.LATCHED)
    process = stage.replay(str(bag), "--rate", "0.5", "--json")
    stage.spin_until(lambda: len(heard) >= 2, "session states")
    topics = dict(stage.node.get_topic_names_and_types())
    assert REFERENCE not in topics
    assert STATE in topics
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    told = json.loads(out)
    assert [one["topic"] for one in told["left_out"]] == [REFERENCE]
    assert REFERENCE not in told["topics"]
    assert REFERENCE in err
    assert "--commands" in err


def test_a_domain_with_a_session_in_it_is_refused(bag: Path, stage: Stage) -> None:
    """A node of it, or a service of a node by another name."""
    from ssp_msgs.srv import ObjectCommand

    def refused(other: Node, sign: str) -> None:
        process = stage.replay(str(bag))
        _, err = process.communicate(timeout=DEADLINE_S)
        other.destroy_node()
        assert process.returncode == 1
        assert "a session is under way" in err
        assert sign in err

    renamed = rclpy.create_node("renamed")
    renamed.create_service(ObjectCommand, "/ssp/ot1/command", lambda _, answer: answer)
    refused(renamed, "/ssp/ot1/command")
    node = rclpy.create_node(names.OBJECT_TARGET, namespace=names.NAMESPACE)
    refused(node, names.OBJECT_TARGET)


def test_a_session_that_comes_later_ends_the_replay(bag: Path, stage: Stage) -> None:
    heard: list[Any] = []
    stage.node.create_subscription(SessionState, SESSION, heard.append, ros.LATCHED)
    process = stage.replay(str(bag), "--loop")
    stage.spin_until(lambda: bool(heard), "session state")
    other = rclpy.create_node(names.SCENARIO_MANAGER, namespace=names.NAMESPACE)
    _, err = process.communicate(timeout=DEADLINE_S)
    other.destroy_node()
    assert process.returncode == 1
    assert "a session is under way" in err


def test_types_that_are_missing_or_differ_are_named(tmp_path: Path, stage: Stage) -> None:
    bag = tmp_path / "foreign"
    with BagWriter(bag) as writer:
        unknown = TypeDefinition("odd_msgs/msg/Odd", "ros2msg", "int32 a\n")
        other = TypeDefinition("std_msgs/msg/Int32", "ros2msg", "int64 data\n", "RIHS01_00")
        writer.add_topic("/odd", "odd_msgs/msg/Odd", written=unknown)
        writer.add_topic("/changed", "std_msgs/msg/Int32", written=other)
        writer.add_topic("/fine", "std_msgs/msg/String")
        for topic in ("/odd", "/changed"):
            writer.write(topic, b"\0\1\0\0\1\0\0\0", 0, 0)
        writer.write("/fine", _text("well"), NS_PER_S // 10, 0)
    process = stage.replay(str(bag), "--json")
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    told = json.loads(out)
    assert told["topics"] == {"/fine": 1}
    why = {one["topic"]: one["why"] for one in told["left_out"]}
    assert "odd_msgs/msg/Odd is not installed" in why["/odd"]
    assert "another definition of std_msgs/msg/Int32" in why["/changed"]


def test_services_pause_step_and_change_the_rate(bag: Path, stage: Stage) -> None:
    words: list[str] = []
    clock: list[int] = []
    plain = QoSProfile(depth=100, reliability=ReliabilityPolicy.BEST_EFFORT)
    stage.node.create_subscription(String, PLAIN, lambda m: words.append(m.data), plain)
    stage.node.create_subscription(
        Clock, names.CLOCK, lambda m: clock.append(ros.ns_from_stamp(m.clock)), ros.STATE
    )
    process = stage.replay(str(bag), "--paused", "--topics", "plain", "--topics", STATE)
    stage.spin_until(lambda: len(clock) > 20, "/clock")
    assert set(clock) == {START_NS}
    assert words == []
    # The first state and the first word have the same time; the order of the bag is kept.
    for _ in range(2):
        answer = stage.ask("/ssp/replay/step", Trigger, Trigger.Request())
        assert answer.success
        assert "paused" in answer.message
    stage.spin_until(lambda: words == ["word 0"], "one word")
    fast = SetParameters.Request(parameters=[Parameter("rate", value=50.0).to_parameter_msg()])
    stage.ask("/ssp/replay/set_parameters", SetParameters, fast)
    wrong = SetParameters.Request(parameters=[Parameter("rate", value=-1.0).to_parameter_msg()])
    (refused,) = stage.ask("/ssp/replay/set_parameters", SetParameters, wrong).results
    assert not refused.successful
    assert "rate out of range Min: 0.01, Max: 1000.0" in refused.reason
    assert words == ["word 0"]
    stage.ask("/ssp/replay/resume", Trigger, Trigger.Request())
    _, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    stage.spin_until(lambda: len(words) == 80, "all words")
    assert words == [f"word {k}" for k in range(0, 400, 5)]
    assert clock == sorted(clock)
    assert clock[-1] <= START_NS + 4 * NS_PER_S


def test_a_terminal_shows_the_progress_and_no_key_ends_the_replay(bag: Path, stage: Stage) -> None:
    mine, its = pty.openpty()
    process = stage.replay(str(bag), "--loop", stdin=its, stdout=its, stderr=its, text=False)
    os.close(its)
    seen = b""

    def wait_for(mark: bytes) -> None:
        nonlocal seen
        deadline = time.monotonic() + DEADLINE_S
        while mark not in seen:
            assert time.monotonic() < deadline, seen[-500:]
            seen += os.read(mine, 4096)

    os.write(mine, b"q +")
    wait_for(b"x1 ")
    process.send_signal(signal.SIGINT)
    wait_for(b"messages of")
    assert process.wait(timeout=DEADLINE_S) == 0
    os.close(mine)


def test_topics_that_swap_names_are_renamed_once(tmp_path: Path, stage: Stage) -> None:
    bag = tmp_path / "two"
    with BagWriter(bag) as writer:
        for name in ("/left", "/right"):
            writer.add_topic(name, "std_msgs/msg/String", offered_qos(10, transient_local=True))
            writer.write(name, _text(f"was {name}"), 0, 0)
    heard: dict[str, set[str]] = {"/left": set(), "/right": set()}
    # One parameter each: to a callback with two, rclpy gives facts about the message as well.
    stage.node.create_subscription(
        String, "/left", lambda m: heard["/left"].add(m.data), ros.LATCHED
    )
    stage.node.create_subscription(
        String, "/right", lambda m: heard["/right"].add(m.data), ros.LATCHED
    )
    swap = ("--remap", "/left:=/right", "--remap", "/right:=/left")
    process = stage.replay(str(bag), *swap, "--wait-for", "1", "--clock", "0", "--json")
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    assert json.loads(out)["topics"] == {"/left": 1, "/right": 1}
    stage.spin_until(lambda: bool(heard["/left"] and heard["/right"]), "both topics")
    assert heard == {"/left": {"was /right"}, "/right": {"was /left"}}


def test_ctrl_c_is_a_regular_end(bag: Path, stage: Stage) -> None:
    heard: list[Any] = []
    stage.node.create_subscription(SessionState, SESSION, heard.append, ros.LATCHED)
    process = stage.replay(str(bag), "--loop", "--json")
    stage.spin_until(lambda: bool(heard), "session state")
    process.send_signal(signal.SIGINT)
    out, err = process.communicate(timeout=DEADLINE_S)
    assert process.returncode == 0, err
    assert json.loads(out)["ended"] == "SIGINT"
