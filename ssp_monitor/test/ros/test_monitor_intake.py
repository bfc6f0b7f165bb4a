"""Reception against the real middleware: late topics, many publishers, losses that happen."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.topic_endpoint_info import TopicEndpointInfo
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String

from ssp_core import names, ros
from ssp_core.bag.metadata import offered_qos, parse_offered_qos
from ssp_core.bag.reading.reader import BagReader
from ssp_core.cdr.steps import Heartbeat, encode_heartbeat
from ssp_core.clock import NS_PER_S
from ssp_core.errors import HostError
from ssp_core.vocabulary import SessionPhase
from ssp_monitor.recorder.disk import DiskNeeds
from ssp_monitor.recorder.losses import SETTLED_S
from ssp_monitor.recorder.plan import RecordingPlan
from ssp_monitor.recorder.recorder import Recorder
from ssp_monitor.recorder.topics import Profile, Selection, TopicSpec
from ssp_monitor.ros.conversions import offered_profiles, recording_profile, why_not_recordable
from ssp_monitor.ros.graph_watch import ADDING_S
from ssp_monitor.ros.recording import Recording
from ssp_monitor.ros.recording_subscriptions import (
    BATCH_MESSAGES,
    QUIET_LOOKS,
    QUIET_PARTS,
    RecordingSubscriptions,
    SerializedTaker,
)
from ssp_msgs import msg
from tests.support.bags.messages import text
from tests.support.processes.waiting import DEADLINE_S, until

STRING = "std_msgs/msg/String"
BEST_EFFORT = ReliabilityPolicy.BEST_EFFORT

# Publishes messages of two megabytes, best effort, over UDP, until its input ends: more than the
# socket's buffer holds, so that some are lost on the way.
FLOOD = """
import sys, threading, rclpy
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import String
rclpy.init()
qos = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
publisher = rclpy.create_node("flood").create_publisher(String, "/flood", qos)
over = threading.Event()
threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
data, sent = bytes([0, 1, 0, 0]) + (1 << 21).to_bytes(4, "little") + bytes(1 << 21), 0
while not over.is_set():
    if publisher.get_subscription_count():
        publisher.publish(data)
        sent += 1
    over.wait(0.002)
print(sent)
"""


def topic(name: str, profile: Profile = Profile.STATE, msgtype: str = STRING) -> TopicSpec:
    return TopicSpec(name, msgtype, profile)


@pytest.fixture
def node(domain):
    """A node that publishes, in a domain of its own."""
    rclpy.init(domain_id=domain)
    node = rclpy.create_node("publishes")
    yield node
    node.destroy_node()
    rclpy.shutdown()


class Reception:
    """A recorder and what feeds it."""

    def __init__(
        self,
        bag: Path,
        *topics: TopicSpec,
        listen: Mapping[str, Callable[[bytes], None]] | None = None,
    ) -> None:
        self.bag = bag
        self.recorder = Recorder(bag, topics)
        self.intake = RecordingSubscriptions(topics, self.recorder, False, listen or {})

    def add(self, one: TopicSpec, profile: QoSProfile) -> None:
        self.recorder.add(one, offered_qos(50), False)
        self.intake.add(one, profile)

    def wait_for(self, name: str, count: int) -> None:
        until(lambda: self.intake.received_by_topic()[name] >= count, f"{count} of {name}")

    def stop(self) -> None:
        self.intake.stop()
        self.recorder.stop()

    def recorded(self, name: str) -> list[str]:
        with BagReader(self.bag) as bag:
            return [bag.decode(message).data for message in bag.messages([name])]


@pytest.fixture
def receive(tmp_path, node):
    made: list[Reception] = []

    def make(*topics: TopicSpec, **options: Any) -> Reception:
        made.append(Reception(tmp_path / "bag", *topics, **options))
        return made[-1]

    yield make
    for one in made:
        if one.intake._thread.is_alive():
            one.stop()


def publisher(node: Node, name: str, qos: QoSProfile, kind: type = String) -> Publisher:
    """A publisher that somebody hears."""
    made = node.create_publisher(kind, name, qos)
    until(lambda: made.get_subscription_count() > 0, f"subscription of {name}")
    return made


def acked(*publishers: Publisher) -> None:
    for one in publishers:
        assert one.wait_for_all_acked(Duration(seconds=DEADLINE_S))


def test_what_is_taken_is_what_rclpy_takes(node):
    sizes = (0, 1, 100, 70_000, 5, 300_000, 2)
    ours, theirs = (
        node.create_subscription(String, "/a", lambda _: None, ros.STATE, raw=True)
        for _ in range(2)
    )
    pubs = [node.create_publisher(String, "/a", ros.STATE) for _ in range(2)]
    for one in pubs:
        until(lambda one=one: one.get_subscription_count() == 2, "subscriptions")  # type: ignore[misc]
    for size in sizes:
        for one in pubs:
            one.publish(text("x" * size))
    acked(*pubs)
    taker = SerializedTaker()
    mine, expected = [], []

    def take_both() -> bool:
        with ours.handle, theirs.handle:
            mine.extend(taker.take(ours.handle.pointer)[0])
            while (one := theirs.handle.take_message(String, True)) is not None:
                expected.append(one)
        return len(mine) == len(expected) == 2 * len(sizes)

    until(take_both, "messages")
    taker.close()

    def order(one: tuple[bytes, int, int]) -> tuple[int, int]:
        return one[2], one[1]

    assert sorted([(data, at, n) for data, at, _, n, _ in mine], key=order) == sorted(
        [(d, i["source_timestamp"], i["publication_sequence_number"]) for d, i in expected],
        key=order,
    )
    assert all(abs(one[2] - time.time_ns()) < DEADLINE_S * NS_PER_S for one in mine)
    numbers: dict[bytes, list[int]] = {}
    for *_, sequence, who in mine:
        numbers.setdefault(who, []).append(sequence)
    assert list(numbers.values()) == [list(range(1, len(sizes) + 1))] * 2


def test_a_take_is_bounded_and_says_that_there_is_more(node):
    subscription = node.create_subscription(
        String, "/a", lambda _: None, recording_profile(Profile.STATE), raw=True
    )
    pub = publisher(node, "/a", ros.STATE)
    count = BATCH_MESSAGES + 20
    for k in range(count):
        pub.publish(text(str(k)))
        if k % 20 == 0:
            acked(pub)
    acked(pub)
    taker = SerializedTaker()
    with subscription.handle:
        first, more = taker.take(subscription.handle.pointer)
        rest, still_more = taker.take(subscription.handle.pointer)
        assert taker.take(subscription.handle.pointer) == ([], False)
    taker.close()
    assert (len(first), more, len(rest), still_more) == (BATCH_MESSAGES, True, 20, False)
    assert [one[0] for one in first + rest] == [text(str(k)) for k in range(count)]


def test_stop_takes_all_that_has_arrived(node, receive):
    reception = receive(topic("/a"), topic("/b"))
    pubs = [publisher(node, name, ros.STATE) for name in ("/a", "/b")]
    for k in range(40):
        for one in pubs:
            one.publish(text(str(k)))
    acked(*pubs)
    reception.stop()
    assert reception.intake.received_by_topic() == {"/a": 40, "/b": 40}
    assert reception.intake.lost_by_topic() == {"/a": 0, "/b": 0}
    assert reception.recorded("/a") == reception.recorded("/b") == [str(k) for k in range(40)]


def test_publishers_that_come_and_go_are_no_loss(node, receive):
    reception = receive(topic("/a"))
    lasting = publisher(node, "/a", ros.STATE)
    for _ in range(3):
        passing = publisher(node, "/a", ros.STATE)
        for k in range(10):
            passing.publish(text(str(k)))
            lasting.publish(text("again"))
        acked(passing, lasting)
        node.destroy_publisher(passing)
    reception.wait_for("/a", 60)
    assert reception.intake.lost_by_topic() == {"/a": 0}


def test_a_history_that_overflows_is_counted_of_each_publisher(node, receive):
    """Two publishers send while the reception is held up, more than the history keeps."""
    held, go_on = threading.Event(), threading.Event()

    def hold(_: bytes) -> None:
        held.set()
        go_on.wait(DEADLINE_S)

    reception = receive(topic("/gate"), listen={"/gate": hold})
    reception.add(topic("/a"), QoSProfile(depth=10))
    gate = publisher(node, "/gate", ros.STATE)
    pubs = [publisher(node, "/a", ros.STATE) for _ in range(2)]
    for one in pubs:
        one.publish(text("first"))
    reception.wait_for("/a", 2)
    gate.publish(text("wait"))
    assert held.wait(DEADLINE_S)
    for _ in range(30):
        for one in pubs:
            one.publish(text("many"))
    acked(*pubs)
    go_on.set()
    reception.wait_for("/a", 12)
    for one in pubs:
        one.publish(text("last"))
    reception.wait_for("/a", 14)
    assert reception.intake.received_by_topic()["/a"] == 14
    assert reception.intake.lost_by_topic() == {"/gate": 0, "/a": 50}


def test_what_the_middleware_loses_is_counted(node, receive):
    reception = receive()
    reception.add(topic("/flood"), QoSProfile(depth=50, reliability=BEST_EFFORT))
    # Through shared memory, which the settings of sessions prefer, none would be lost.
    env = {k: v for k, v in os.environ.items() if k != "FASTRTPS_DEFAULT_PROFILES_FILE"}
    with subprocess.Popen(
        [sys.executable, "-c", FLOOD],
        env={**env, "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            until(lambda: reception.intake._arrivals["/flood"].middleware_losses > 0, "loss")
            sent = int(process.communicate("", DEADLINE_S)[0])
        finally:
            process.kill()
    reception.stop()
    received = reception.intake.received_by_topic()["/flood"]
    assert 0 < reception.intake.lost_by_topic()["/flood"] <= sent - received


def test_a_late_topic_is_taken_and_one_that_cannot_be_does_no_harm(node, receive):
    reception = receive(topic("/a"))
    early = publisher(node, "/a", ros.STATE)
    latched = QoSProfile(depth=3, durability=DurabilityPolicy.TRANSIENT_LOCAL)
    before = node.create_publisher(String, "/late", latched)
    for k in range(5):
        before.publish(text(str(k)))
    with pytest.raises(HostError, match="nothing/msg/Such is not installed"):
        reception.intake.add(topic("/none", msgtype="nothing/msg/Such"), ros.STATE)
    with pytest.raises(ValueError, match="/a is taken already"):
        reception.intake.add(topic("/a"), ros.STATE)
    reception.add(topic("/late"), recording_profile(Profile.LATCHED))
    reception.wait_for("/late", 3)
    early.publish(text("on"))
    reception.wait_for("/a", 1)
    reception.stop()
    assert reception.recorded("/late") == ["2", "3", "4"]
    assert reception.intake.lost_by_topic() == {"/a": 0, "/late": 0}


def test_best_effort_publishers_are_heard(node, receive):
    reception = receive()
    offered = QoSProfile(depth=50, reliability=BEST_EFFORT)
    reception.add(topic("/a"), QoSProfile(depth=100, reliability=BEST_EFFORT))
    pub = publisher(node, "/a", offered)
    pub.publish(text("hello"))
    reception.wait_for("/a", 1)
    reception.stop()
    assert reception.recorded("/a") == ["hello"]


def test_a_topic_that_was_silent_is_taken_again(node, receive):
    spoken = [f"/a{k}" for k in range(QUIET_PARTS + 1)]
    reception = receive(*(topic(name) for name in spoken))
    pubs = [publisher(node, name, ros.STATE) for name in spoken]
    sources = reception.intake._sources
    until(lambda: all(source.quiet > QUIET_LOOKS for source in sources), "silence")
    for one in pubs:
        one.publish(text("again"))
    for name in spoken:
        reception.wait_for(name, 1)


def test_a_publishers_own_count_shows_a_missing_end(node, receive):
    heartbeat = names.absolute(names.HEARTBEAT)
    reference = names.absolute(names.reference_topic("ot1"))
    reception = receive(
        topic(heartbeat, msgtype="ssp_msgs/msg/Heartbeat"),
        topic(reference, Profile.COMMAND, "ssp_msgs/msg/Reference"),
    )
    references = publisher(node, reference, ros.COMMAND, msg.Reference)
    beats = publisher(node, heartbeat, ros.STATE, msg.Heartbeat)
    for _ in range(5):
        references.publish(msg.Reference())
    sent = {"ot1": 7, "never_heard": 3}
    beats.publish(encode_heartbeat(Heartbeat(0, "m", 1, 0, SessionPhase.RUNNING, sent)))
    acked(references, beats)
    reception.stop()
    assert reception.intake.lost_by_topic() == {heartbeat: 0, reference: 2}


def test_a_listener_that_fails_costs_no_message(node, receive, capfd):
    heard: list[bytes] = []

    def listen(data: bytes) -> None:
        heard.append(data)
        raise RuntimeError("no such message")

    reception = receive(topic("/a"), topic("/b"), listen={"/a": listen})
    one, other = publisher(node, "/a", ros.STATE), publisher(node, "/b", ros.STATE)
    for k in range(3):
        one.publish(text(str(k)))
        reception.wait_for("/a", k + 1)
    other.publish(text("on"))
    reception.wait_for("/b", 1)
    reception.stop()
    assert reception.intake.error is None
    assert (reception.recorded("/a"), reception.recorded("/b")) == (["0", "1", "2"], ["on"])
    assert heard == [text(str(k)) for k in range(3)]
    said = "/a: message recorded and not understood (more will be without a word): RuntimeError"
    assert capfd.readouterr().err.count(said) == 1


def test_what_was_taken_before_an_error_is_not_lost(node, monkeypatch):
    subscription = node.create_subscription(String, "/a", lambda _: None, ros.STATE, raw=True)
    pub = publisher(node, "/a", ros.STATE)
    for k in range(5):
        pub.publish(text(str(k)))
    acked(pub)
    taker = SerializedTaker()
    real, calls = taker._take, iter(range(100))
    monkeypatch.setattr(taker, "_take", lambda *args: 1 if next(calls) == 3 else real(*args))
    with subscription.handle:
        taken, more = taker.take(subscription.handle.pointer)
        assert [one[0] for one in taken] == [text(str(k)) for k in range(3)]
        assert more
        for _ in range(2):
            with pytest.raises(HostError, match="rcl answers 1"):
                taker.take(subscription.handle.pointer)
    taker.close()


def test_times_before_1970_are_no_times_of_a_bag(node, receive, monkeypatch):
    reception = receive(topic("/a"))
    real = reception.intake._taker.take

    def early(address: int) -> tuple[list[tuple[bytes, int, int, int, bytes]], bool]:
        taken, more = real(address)
        return [(data, -5, at, number, who) for data, _, at, number, who in taken], more

    monkeypatch.setattr(reception.intake._taker, "take", early)
    publisher(node, "/a", ros.STATE).publish(text("x"))
    reception.wait_for("/a", 1)
    reception.stop()
    with BagReader(reception.bag) as bag:
        assert [message.publish_time_ns for message in bag.messages()] == [0]


def offered(qos: QoSProfile) -> TopicEndpointInfo:
    return TopicEndpointInfo(node_name="n", node_namespace="/", topic_type=STRING, qos_profile=qos)


def test_offers_of_many_publishers_fit_into_a_bag():
    same = [offered(QoSProfile(depth=10))] * 1000
    assert len(parse_offered_qos(offered_profiles([*same, offered(QoSProfile(depth=20))]))) == 2
    different = [offered(QoSProfile(depth=k)) for k in range(1, 400)]
    profiles = parse_offered_qos(offered_profiles(different))
    assert [one["depth"] for one in profiles] == list(range(1, len(profiles) + 1))
    assert len(profiles) > 100
    assert offered_profiles([]) == ""


def test_a_reception_that_ends_is_a_problem_of_the_recording(node, tmp_path, monkeypatch):
    raised: list[BaseException | None] = []
    monkeypatch.setattr(threading, "excepthook", lambda args: raised.append(args.exc_value))
    plan = RecordingPlan(tmp_path / "bag", Selection(), DiskNeeds(0), (topic("/a"),))
    recording = Recording(node, plan, {})
    recording.poll()

    def refuse(_: int) -> tuple[list[Any], bool]:
        raise HostError("rcl answers 1")

    monkeypatch.setattr(recording.intake._taker, "take", refuse)
    until(lambda: recording.intake.error is not None, "end of the reception")
    closed = recording.close()
    assert len(raised) == 1
    assert closed.check is not None
    assert closed.check.problems == ()
    assert closed.problems == ("reception ended: rcl answers 1",)


def test_losses_beside_the_run_do_not_count_and_a_stranger_on_its_topics_does(node, tmp_path):
    plan = RecordingPlan(
        tmp_path / "bag", Selection(everything=True), DiskNeeds(0), (topic("/own"),)
    )
    plan = replace(plan, selection=replace(plan.selection, own=frozenset(["/own"])))
    own = node.create_publisher(String, "/own", ros.STATE)
    other = node.create_publisher(String, "/other", ros.STATE)
    recording = Recording(node, plan, {})

    def has_reader(one: Publisher) -> bool:
        recording.poll()
        return one.get_subscription_count() > 0

    until(lambda: has_reader(own) and has_reader(other), "readers")
    # Nothing was heard yet: what can't be heard keeps it from being ready, and is lost by nobody.
    early = node.create_publisher(String, "/own", QoSProfile(depth=1, reliability=BEST_EFFORT))
    until(lambda: has_reader(own) and not recording.status().ready, "stranger")
    assert recording.lost == 0
    node.destroy_publisher(early)
    until(lambda: has_reader(own) and recording.status().ready, "readiness")
    recording.intake._arrivals["/other"].middleware_losses = 3
    until(lambda: len(recording.recorder.records()) == 2, "announcement")
    status = recording.status()
    assert (status.lost, recording.lost) == (0, 0)
    assert {one.name: one.lost for one in status.topics} == {"/own": 0, "/other": 3}
    assert "3 messages of topics beside the run's are missing: /other" in status.warnings
    own.publish(text("x"))
    until(lambda: recording.intake.received_by_topic()["/own"] == 1, "message")
    node.create_publisher(String, "/own", QoSProfile(depth=1, reliability=BEST_EFFORT))
    until(lambda: has_reader(own) and recording.lost == 1, "count of the stranger")
    status = recording.status()
    assert (status.lost, status.ready) == (1, False)
    assert any(said.startswith("/own is not heard from publishes") for said in status.warnings)
    assert recording.close().lost == 1


def test_types_are_judged_within_the_time_that_a_poll_has(node, tmp_path, monkeypatch):
    judged: list[str] = []

    def slow(msgtype: str) -> str | None:
        judged.append(msgtype)
        time.sleep(ADDING_S)
        return why_not_recordable(msgtype)

    monkeypatch.setattr("ssp_monitor.ros.graph_watch.why_not_recordable", slow)
    kinds = (String, msg.Heartbeat, msg.Reference)
    for number, kind in enumerate(kinds):
        node.create_publisher(kind, f"/t{number}", ros.STATE)
    plan = RecordingPlan(
        tmp_path / "bag", Selection(named=frozenset(["/t0", "/t1", "/t2"])), DiskNeeds(0)
    )
    recording = Recording(node, plan, {})
    polls = [len(judged)]

    def complete() -> bool:
        recording.poll()
        polls.append(len(judged))
        return len(recording.recorder.records()) == len(kinds)

    until(complete, "topics")
    assert polls[0] <= 1
    assert all(now - before <= 1 for before, now in pairwise(polls))
    assert recording.close().topics == ("/t0", "/t1", "/t2")


def test_of_a_session_that_waits_few_pictures_are_kept_and_the_rest_is_counted(node, tmp_path):
    """Idle sessions filled the disk with a megabyte a second."""
    camera = topic("/camera", Profile.SENSOR, "sensor_msgs/msg/CompressedImage")
    plan = RecordingPlan(tmp_path / "bag", Selection(), DiskNeeds(0), (camera, topic("/state")))
    waiting = threading.Event()
    waiting.set()
    recording = Recording(node, plan, {}, waiting.is_set)
    pictures = node.create_publisher(CompressedImage, "/camera", ros.SENSOR)
    states = node.create_publisher(String, "/state", ros.STATE)
    received = recording.intake.received_by_topic
    until(lambda: pictures.get_subscription_count() and states.get_subscription_count(), "match")
    for count in (30, 60):
        for _ in range(30):
            pictures.publish(CompressedImage(format="jpeg", data=bytes(9)))
            states.publish(String(data="state"))
            until(lambda: received()["/camera"] == received()["/state"], "a picture and a state")
        until(lambda count=count: received()["/camera"] == count, f"{count} pictures")
        waiting.clear()
    closed = recording.close()
    assert closed.problems == ()
    with BagReader(tmp_path / "bag") as bag:
        kept = sum(1 for _ in bag.messages(["/camera"]))
        report = json.loads(bag.attachment("recording.json") or b"{}")
    by_name = {one["name"]: one for one in report["topics"]}
    assert by_name["/camera"]["received"] == 60
    assert by_name["/camera"]["passed_over"] == 60 - kept
    assert by_name["/camera"]["lost"] == by_name["/camera"]["dropped"] == 0
    assert 31 <= kept < 60
    assert by_name["/state"]["written"] == 60


def test_a_loss_before_a_session_is_armed_is_said_and_keeps_nothing_from_arming(
    node, tmp_path, monkeypatch
):
    clock = [100.0]
    steady = SimpleNamespace(monotonic=lambda: clock[0])
    monkeypatch.setattr("ssp_monitor.ros.recording.time", steady)
    plan = RecordingPlan(tmp_path / "bag", Selection(), DiskNeeds(0), (topic("/own"),))
    recording = Recording(node, plan, {})

    def lost_after(seconds: float) -> tuple[int, int]:
        clock[0] += seconds
        recording.poll()
        return recording.lost, recording.status().lost

    recording.session_is(SessionPhase.CONNECTED)
    recording.intake._arrivals["/own"].gaps = 3
    assert lost_after(0.5) == (3, 3)
    assert lost_after(SETTLED_S) == (0, 0)
    recording.session_is(SessionPhase.ARMED)
    recording.intake._arrivals["/own"].gaps = 5
    assert lost_after(10.0) == (2, 2)
    said = "3 messages were lost before the session was armed"
    assert said in recording.status().warnings
    assert recording.close().lost == 2
    with BagReader(tmp_path / "bag") as bag:
        report = json.loads(bag.attachment("recording.json"))
    assert (report["lost"], report["missing"], said in report["warnings"]) == (5, 2, True)
