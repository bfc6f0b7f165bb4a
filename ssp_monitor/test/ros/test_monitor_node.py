"""The recorder as a process: ready in time, loss-free, readable after SIGTERM and SIGKILL."""

from __future__ import annotations

import array
import json
import os
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import rclpy
from builtin_interfaces.msg import Time
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import CameraInfo, CompressedImage

from ssp_core import names, ros
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.seal import REPORT_NAME
from ssp_core.errors import InputError
from ssp_core.run_file.verdict import RecordedVerdict, read_verdict
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import Verdict
from ssp_monitor.recorder.recorder import OFFERED
from ssp_monitor.ros.conversions import PUBLISHED, recording_profile
from ssp_msgs.msg import (
    ObjectState,
    RecorderStatus,
    SafetyEvent,
    SessionState,
    TriggerEvent,
    WorldTick,
)
from tests.support.bags.recorder_said import without_a_busy_disk
from tests.support.processes.children import end
from tests.support.processes.waiting import DEADLINE_S, until

pytestmark = pytest.mark.ros
STEP_NS = 10_000_000
STATES = ("vut/state", "ot1/state", "walker/state")
CAMERA = (names.CAMERA_IMAGE, names.CAMERA_INFO)
KINDS = {
    names.WORLD_TICK: WorldTick,
    names.CAMERA_IMAGE: CompressedImage,
    names.CAMERA_INFO: CameraInfo,
}


class Session:
    """Plays the rest of a session: publishes what a run publishes and listens to the recorder."""

    def __init__(self, domain_id: int) -> None:
        self.context = Context()
        rclpy.init(context=self.context, domain_id=domain_id)
        self.node = rclpy.create_node("session", namespace=names.NAMESPACE, context=self.context)
        self.executor = SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.status: list[RecorderStatus] = []
        self.safety: list[SafetyEvent] = []
        self.publishers: dict[str, Any] = {}
        self.sent_topics: list[str] = []
        for cls, topic, qos, seen in (
            (RecorderStatus, names.RECORDER_STATUS, ros.STATE, self.status),
            (SafetyEvent, names.SAFETY_EVENT, ros.LATCHED, self.safety),
        ):
            self.node.create_subscription(cls, topic, seen.append, qos)

    def offer(self, *topics: tuple[type, str, Any]) -> None:
        for cls, topic, qos in topics:
            self.publishers[topic] = self.node.create_publisher(cls, topic, qos)

    def offer_all(self) -> None:
        self.offer(
            (Clock, names.CLOCK, ros.STATE),
            (WorldTick, names.WORLD_TICK, ros.STATE),
            (ObjectState, "vut/state", ros.STATE),
            (ObjectState, "ot1/state", ros.STATE),
            (ObjectState, "walker/state", ros.STATE),
            (SessionState, names.SESSION_STATE, ros.LATCHED),
            (CompressedImage, names.CAMERA_IMAGE, ros.SENSOR),
            (CameraInfo, names.CAMERA_INFO, ros.SENSOR),
        )

    def step(self, k: int) -> None:
        """Everything that a world publishes at step k; an image every tenth."""
        stamp = ros.stamp_from_ns(k * STEP_NS)
        self.publishers[names.CLOCK].publish(Clock(clock=stamp))
        for topic in STATES:
            self._send(topic, ObjectState(object_id=topic, sequence=k + 1, x=k / 8), stamp)
        self._send(names.WORLD_TICK, WorldTick(step=k, objects=[ObjectState()] * 4), stamp)
        if k % 10 == 0:
            image = CompressedImage(format="jpeg", data=array.array("B", bytes([k % 256]) * 90_000))
            self._send(names.CAMERA_IMAGE, image, stamp)

    def _send(self, topic: str, message: Any, stamp: Time) -> None:
        message.header.stamp = stamp
        self.publishers[topic].publish(message)

    def spin_until(self, condition: Callable[[], bool], what: str) -> None:
        until(condition, what, lambda: self.executor.spin_once(timeout_sec=0.05))

    def _know_each_other(self, topic: str) -> bool:
        """Tell whether a topic's publisher knows the recorder, and the recorder the publisher.

        What one knows alone may be lost.
        """
        known = {one.name: one.publishers for one in self.status[-1].topics} if self.status else {}
        readers = self.publishers[topic].get_subscription_count()
        return readers > 0 and known.get(names.absolute(topic), 0) > 0

    def speak(self, *topics: str) -> None:
        """Say what stands before the run, each topic once the recorder can hear it."""
        for topic in topics:
            self.spin_until(lambda t=topic: self._know_each_other(t), f"reader: {topic}")
            self._send(topic, KINDS.get(topic, ObjectState)(), ros.stamp_from_ns(0))
            self.sent_topics.append(topic)

    def wait_ready(self) -> None:
        early = (names.WORLD_TICK, *STATES, *CAMERA)
        self.speak(*(one for one in early if one not in self.sent_topics))
        self.spin_until(lambda: bool(self.status) and self.status[-1].ready, "readiness")

    def close(self) -> None:
        self.executor.shutdown()
        self.node.destroy_node()
        rclpy.shutdown(context=self.context)


@pytest.fixture
def session(domain):
    made = Session(domain)
    yield made
    made.close()


@pytest.fixture
def monitor(domain, run_file, tmp_path):
    """The recorder, recording into tmp_path/bag."""
    process = start(run_file, tmp_path / "bag")
    yield process
    end(process)


def start(run_file: Path, bag_dir: Path, *parameters: str) -> subprocess.Popen[str]:
    arguments = [sys.executable, "-m", "ssp_monitor.ros.monitor_node", "--ros-args"]
    arguments += [
        "-r",
        "__node:=monitor",
        "-p",
        f"run_file:={run_file}",
        "-p",
        f"bag_dir:={bag_dir}",
        *(word for parameter in parameters for word in ("-p", parameter)),
    ]
    return subprocess.Popen(
        arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, env=dict(os.environ)
    )


def test_an_ordinary_stop_leaves_a_complete_bag(session, monitor, run_file, tmp_path):
    session.offer_all()
    ended = SessionState(
        state=SessionState.STATE_FINISHED, verdict=SessionState.VERDICT_VALID, run_id="run_1"
    )
    session.publishers[names.SESSION_STATE].publish(ended)
    session.wait_ready()
    steps = 300
    for k in range(steps):
        session.step(k)
        time.sleep(0.002)
    sent = steps * 5 + steps // 10 + len(session.sent_topics) + 1
    session.spin_until(lambda: session.status[-1].messages >= sent, f"{sent} messages")
    monitor.send_signal(signal.SIGTERM)
    out, err = monitor.communicate(timeout=DEADLINE_S)
    assert monitor.returncode == 0, err
    # On a busy machine the middleware warns, and so may the recorder, of what was late.
    said = without_a_busy_disk(err.splitlines())
    assert [line for line in said if "[WARN]" not in line] == []
    assert f"{tmp_path / 'bag'}, 0 lost, counts and checksums checked" in out
    assert read_verdict(tmp_path / "bag") == RecordedVerdict(Verdict.VALID, ())

    assert check_bag(tmp_path / "bag").problems == ()
    with BagReader(tmp_path / "bag") as bag:
        assert bag.attachment("run.yaml") == run_file.read_bytes()
        counts = {name: info.count for name, info in bag.topics.items()}
        assert counts["/clock"] == steps
        for topic in ("/ssp/world/tick", "/ssp/vut/state", "/ssp/walker/state"):
            assert counts[topic] == steps + 1
        assert counts["/ssp/session_state"] == 1
        assert counts["/ssp/vut/front_camera/image/compressed"] == steps // 10 + 1
        assert counts["/ssp/recorder_status"] > 0
        before, *states = bag.messages(["/ssp/ot1/state"])
        assert before.log_time_ns == 0
        assert [m.log_time_ns for m in states] == [k * STEP_NS for k in range(steps)]
        assert [m.publish_time_ns for m in states] == [k * STEP_NS for k in range(steps)]
        assert [bag.decode(m).x for m in states] == [k / 8 for k in range(steps)]
        report = json.loads(bag.attachment(REPORT_NAME) or b"")
    assert (report["run_id"], report["lost"], report["dropped"]) == ("run_1", 0, 0)
    assert {t["name"]: t["written"] for t in report["topics"]} == counts
    assert {t["name"]: t["received"] for t in report["topics"]} == counts
    assert report["seals"].keys() == {"run.yaml"}


def test_a_kill_leaves_everything_up_to_the_last_flush(session, monitor, tmp_path):
    session.offer_all()
    session.wait_ready()
    steps = 50
    for k in range(steps):
        session.step(k)
    file = tmp_path / "bag" / "bag_0.mcap"
    # Five images of 90 kB: once they are in the file, so is what was taken with them.
    session.spin_until(lambda: file.stat().st_size > 5 * 90_000, "flush")
    session.spin_until(lambda: session.status[-1].messages >= steps * 5, "messages")
    flushed = file.stat().st_size
    session.spin_until(lambda: file.stat().st_size > flushed, "another flush")
    monitor.kill()
    monitor.wait(DEADLINE_S)
    with pytest.raises(InputError, match="no metadata"):
        BagReader(tmp_path / "bag")
    assert read_verdict(tmp_path / "bag") is None
    report = recover(tmp_path / "bag", tmp_path / "recovered")
    assert report.messages["/ssp/ot1/state"] == steps + 1
    assert report.messages["/ssp/vut/front_camera/image/compressed"] == 6
    assert report.attachments == ("run.yaml",)
    assert check_bag(tmp_path / "recovered").ok


@pytest.mark.parametrize("rival", [True, False])
def test_messages_of_two_publishers_in_turn_make_no_valid_recording(
    session, monitor, tmp_path, rival
):
    """A second publisher of states; or one that takes the place of one that ended before arming."""
    session.offer_all()
    session.wait_ready()
    first = session.publishers["ot1/state"]
    second = session.node.create_publisher(ObjectState, "ot1/state", ros.STATE)
    session.spin_until(lambda: second.get_subscription_count() > 0, "reader of the second")
    pub = session.publishers[names.SESSION_STATE]

    sent: Counter[str] = Counter(session.sent_topics)

    def record(publisher: Any, topic: str, message: Any) -> None:
        """Publishes, and waits until the recorder has it: topics have no order among them."""
        publisher.publish(message)
        sent[topic] += 1

        def has_it() -> bool:
            topics = {one.name: one.messages for one in session.status[-1].topics}
            return topics.get(names.absolute(topic), 0) >= sent[topic]

        session.spin_until(has_it, f"message {sent[topic]} of {topic}")

    def say(state: int, verdict: int = SessionState.VERDICT_NONE) -> None:
        message = SessionState(state=state, run_id="run_1", verdict=verdict)
        record(pub, names.SESSION_STATE, message)

    def speak(*publishers: Any) -> None:
        for publisher in publishers:
            record(publisher, "ot1/state", ObjectState(object_id="ot1"))

    speak(first)
    say(SessionState.STATE_ARMED)
    speak(second, second)
    assert list(session.status[-1].strangers) == []
    text = "/ssp/ot1/state has messages of two publishers in turn"
    if rival:
        speak(first)
        session.spin_until(lambda: list(session.status[-1].strangers) == [text], text)
    say(SessionState.STATE_FINISHED, SessionState.VERDICT_VALID)
    speak(first)
    end(monitor)
    found = read_verdict(tmp_path / "bag")
    reasons = (text,) if rival else ()
    verdict = Verdict.INVALID_HARNESS if rival else Verdict.VALID
    assert found == RecordedVerdict(verdict, reasons)


def test_the_sessions_last_word_is_waited_for(session, monitor, tmp_path):
    """A signal that stops all nodes at once stops a session that still has something to report."""
    session.offer_all()
    session.wait_ready()
    pub = session.publishers[names.SESSION_STATE]
    pub.publish(SessionState(state=SessionState.STATE_RUNNING, run_id="run_1"))
    before = session.status[-1].messages
    session.spin_until(lambda: session.status[-1].messages > before, "the state in the bag")
    monitor.send_signal(signal.SIGTERM)
    for state in (SessionState.STATE_ABORTING, SessionState.STATE_ABORTED):
        aborted = SessionState(
            state=state, verdict=SessionState.VERDICT_ABORTED, reasons=["rain"], run_id="run_1"
        )
        pub.publish(aborted)
    monitor.communicate(timeout=DEADLINE_S)
    assert read_verdict(tmp_path / "bag") == RecordedVerdict(Verdict.ABORTED, ("rain",))
    with BagReader(tmp_path / "bag") as bag:
        assert bag.topics["/ssp/session_state"].count == 3


def test_it_is_ready_only_when_every_required_topic_is_heard(session, monitor):
    session.offer(
        (WorldTick, names.WORLD_TICK, ros.STATE),
        (ObjectState, "vut/state", ros.STATE),
        (ObjectState, "ot1/state", ros.STATE),
        # Volatile, where the recorder wants what was said before it came: not compatible, which
        # counts for every topic.
        (SessionState, names.SESSION_STATE, ros.STATE),
        (TriggerEvent, names.TRIGGER_EVENT, ros.STATE),
    )
    expected = [
        "/ssp/walker/state",
        "/ssp/session_state",
        "/ssp/trigger_event",
        "/ssp/vut/front_camera/image/compressed",
        "/ssp/vut/front_camera/camera_info",
    ]

    def await_missing(*topics: str) -> None:
        session.spin_until(
            lambda: bool(session.status) and tuple(session.status[-1].missing_topics) == topics,
            f"status that misses {topics}",
        )

    # A publisher that is there may not know the recorder yet.
    await_missing("/ssp/world/tick", "/ssp/vut/state", "/ssp/ot1/state", *expected)
    session.speak(names.WORLD_TICK, "vut/state", "ot1/state")
    await_missing(*expected)
    assert not session.status[-1].ready
    for topic in (names.SESSION_STATE, names.TRIGGER_EVENT):
        session.node.destroy_publisher(session.publishers[topic])
    session.offer_all()
    # A camera may not know the recorder yet either: its picture of the start would be lost.
    session.speak(names.WORLD_TICK, *STATES)
    await_missing(*expected[-2:])
    session.wait_ready()
    assert list(session.status[-1].missing_topics) == []
    assert session.status[-1].bag == "bag"


def test_the_status_says_how_each_topic_is(session, monitor):
    session.offer_all()
    session.wait_ready()
    for k in range(20):
        session.step(k)

    def world() -> Any:
        return next(t for t in session.status[-1].topics if t.name == "/ssp/world/tick")

    session.spin_until(lambda: world().messages == 21, "ticks")
    assert any(s.topics[1].rate_hz > 0 for s in session.status if s.topics)
    status = session.status[-1]
    assert (world().publishers, world().type) == (1, "ssp_msgs/msg/WorldTick")
    assert (world().lost, world().dropped) == (0, 0)
    assert world().bytes > 0
    assert [t.name for t in status.topics].index("/clock") == 0
    assert status.messages >= sum(t.messages for t in status.topics) > 0
    assert (status.files, status.dropped, status.failure) == (1, 0, "")
    assert status.queue_limit_bytes > 0
    assert status.free_bytes > 0
    assert status.flush_age_s < 5.0


def test_what_strangers_say_is_recorded_beside_the_run(session, run_file, tmp_path):
    process = start(run_file, tmp_path / "bag", "all:=true", "exclude:=secret")
    try:
        session.offer_all()
        session.offer((ObjectState, "/lab/truth", ros.STATE), (ObjectState, "/lab/secret", 10))
        session.wait_ready()
        truth = session.publishers["/lab/truth"]
        session.spin_until(lambda: truth.get_subscription_count() > 0, "reader of /lab/truth")
        session.step(7)
        # What several publishers say at once arrives in any order.
        session.spin_until(
            lambda: [t.messages for t in session.status[-1].topics[:3]] == [1, 2, 2], "first step"
        )
        # Stamped by another clock: it must not turn the session's time.
        session._send("/lab/truth", ObjectState(), ros.stamp_from_ns(10**18))
        session.spin_until(
            lambda: any(t.name == "/lab/truth" and t.messages for t in session.status[-1].topics),
            "stranger in the bag",
        )
        session.step(8)
        session.spin_until(lambda: session.status[-1].topics[0].messages == 2, "second step")
        process.send_signal(signal.SIGTERM)
        process.communicate(timeout=DEADLINE_S)
    finally:
        end(process)
    with BagReader(tmp_path / "bag") as bag:
        assert "/lab/secret" not in bag.topics
        assert "/parameter_events" not in bag.topics
        assert [m.log_time_ns for m in bag.messages(["/lab/truth"])] == [7 * STEP_NS]
        assert bag.end_ns == 8 * STEP_NS


def test_a_disk_with_too_little_room_keeps_a_run_from_beginning_and_ends_one(
    session, run_file, tmp_path
):
    """The reserve is larger than any disk, so that every disk is too small."""
    process = start(run_file, tmp_path / "bag", "reserve_mb:=10000000")
    try:
        session.offer_all()
        session.speak(names.WORLD_TICK, *STATES, *CAMERA)
        session.spin_until(
            lambda: bool(session.status) and not session.status[-1].missing_topics, "topics"
        )
        status = session.status[-1]
        assert not status.ready
        assert "the reserve is 10000000.0 MB" in status.warnings[0]
        assert status.disk_left_s == 0.0
        assert session.safety == []
        pub = session.publishers[names.SESSION_STATE]
        pub.publish(SessionState(state=SessionState.STATE_RUNNING, run_id="run_1"))
        session.spin_until(lambda: bool(session.safety), "safety event")
        event = session.safety[0]
        assert (event.code, event.limit_name) == (SafetyCode.RECORDER, "disk_left")
        assert (event.measured, event.unit, event.reaction) == (0.0, "s", "abort")
        # Nothing is lost yet: the end of the run is still recorded.
        pub.publish(
            SessionState(
                state=SessionState.STATE_ABORTED,
                verdict=SessionState.VERDICT_INVALID_HARNESS,
                reasons=["disk"],
                run_id="run_1",
            )
        )
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=DEADLINE_S)
    finally:
        end(process)
    assert process.returncode == 0
    assert "the run is ended while there is room to record its end" in err
    assert read_verdict(tmp_path / "bag") == RecordedVerdict(Verdict.INVALID_HARNESS, ("disk",))
    assert check_bag(tmp_path / "bag").problems == ()


def test_a_publisher_of_another_type_keeps_the_recorder_from_being_ready(session, monitor):
    session.offer_all()
    session.wait_ready()
    other = Context()
    rclpy.init(context=other, domain_id=int(os.environ["ROS_DOMAIN_ID"]))
    node = rclpy.create_node("other", namespace=names.NAMESPACE, context=other)
    node.create_publisher(Clock, "ot1/state", ros.STATE)
    session.spin_until(lambda: not session.status[-1].ready, "status that is not ready")
    assert list(session.status[-1].missing_topics) == ["/ssp/ot1/state"]
    node.destroy_node()
    rclpy.shutdown(context=other)
    session.wait_ready()


def test_a_bag_that_vanishes_is_said_aloud(session, monitor, tmp_path):
    session.offer_all()
    session.wait_ready()
    (tmp_path / "bag" / "bag_0.mcap").unlink()
    session.spin_until(lambda: bool(session.safety), "safety event")
    assert session.safety[0].code == SafetyCode.RECORDER
    assert session.safety[0].limit_name == "recorder"
    session.spin_until(lambda: not session.status[-1].ready, "status that is not ready")
    before = session.status[-1].lost
    session.step(0)
    session.spin_until(lambda: session.status[-1].lost >= before + 6, "count of lost messages")
    monitor.send_signal(signal.SIGTERM)
    _, err = monitor.communicate(timeout=DEADLINE_S)
    assert monitor.returncode == 1
    assert "bag_0.mcap: writing failed" in err
    assert "Traceback" not in err


def test_wrong_input_is_one_message_and_exit_1(domain, run_mapping, tmp_path):
    """A folder that is taken, wrong or missing run files, and wrong parameters; all at once."""
    sound, empty = tmp_path / "run.yaml", tmp_path / "empty.yaml"
    sound.write_text(json.dumps(run_mapping))
    empty.write_text("{}")
    (tmp_path / "taken").mkdir()
    wrong = [
        (sound, "taken", (), "taken: exists already"),
        (empty, "bag", (), "empty.yaml: "),
        (tmp_path / "none.yaml", "bag", (), "none.yaml: can't be read"),
        (sound, "bag", ("include:=(",), "parameter include: is no regular expression"),
        (sound, "bag", ("video:=mpeg",), "video: is no codec"),
    ]
    started = [(start(run, tmp_path / bag, *given), says) for run, bag, given, says in wrong]
    for process, says in started:
        _, err = process.communicate(timeout=DEADLINE_S)
        assert process.returncode == 1, says
        assert says in err
        assert "Traceback" not in err
    assert not (tmp_path / "bag").exists()


def test_the_bag_states_the_profiles_that_publishers_have():
    for profile, qos in PUBLISHED.items():
        text = OFFERED[profile]
        assert f"depth: {qos.depth}\n" in text
        assert f"durability: {qos.durability.name.lower()}\n" in text
        assert f"reliability: {qos.reliability.name.lower()}\n" in text
        assert recording_profile(profile).depth > qos.depth
