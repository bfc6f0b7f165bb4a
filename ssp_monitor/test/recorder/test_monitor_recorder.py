"""The recorder's thread: topics that come later, pictures that can't be encoded, report, check."""

from __future__ import annotations

import hashlib
import json
import struct
import threading

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.seal import REPORT_NAME
from ssp_core.bag.types import BagMessage, serialize, typestore
from ssp_core.bag.writing.split import Split
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.codec import START
from ssp_core.cdr.messages import leading_stamp_ns
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_core.world.transforms import TF_TYPE, Transform, encode_transforms
from ssp_monitor.recorder.encoding import video_choice
from ssp_monitor.recorder.losses import SimulatedTime, stamp_at
from ssp_monitor.recorder.recorder import Recorder
from ssp_monitor.recorder.report import (
    TopicCounts,
    check_closed,
    report_attachment,
    seals,
)
from ssp_monitor.recorder.topics import (
    CLOCK_TYPE,
    Profile,
    TopicSpec,
    bag_topics,
    uses_simulated_time,
)
from ssp_monitor.ros.parameters import topic_rules
from tests.support.processes.waiting import DEADLINE_S, until

CLOCK = TopicSpec("/clock", CLOCK_TYPE, Profile.STATE)
IMAGE = TopicSpec("/camera", "sensor_msgs/msg/CompressedImage", Profile.ADAPTED)
VIDEO = "foxglove_msgs/msg/CompressedVideo"


class FakeEncoder:
    """Stands for a codec: refuses what begins with ``x``, breaks at ``!``, holds one back."""

    msgtype = VIDEO

    def __init__(self) -> None:
        self.threads: set[str] = set()
        self._queue: list[BagMessage] = []

    def encode(self, message: BagMessage) -> list[BagMessage]:
        self.threads.add(threading.current_thread().name)
        if message.data.startswith(b"!"):
            raise RuntimeError("codec broke")
        if message.data.startswith(b"x"):
            raise ValueError("no picture")
        done, self._queue = self._queue, [message._replace(data=b"v" + message.data)]
        return done

    def finish(self) -> list[BagMessage]:
        done, self._queue = self._queue, []
        return done


def test_topics_may_come_while_it_writes(tmp_path, clock_cdr):
    recorder = Recorder(tmp_path / "bag", [CLOCK], split=Split(max_bytes=40_000))
    for k in range(50):
        recorder.put_all([BagMessage("/clock", k, k, clock_cdr(k), k)])
        recorder.add(TopicSpec(f"/late{k}", CLOCK_TYPE, Profile.ADAPTED), "", latched=False)
        recorder.put_all([BagMessage(f"/late{k}", k, k, clock_cdr(k), 1)] * 30)
    state = recorder.stop()
    assert (state.messages, state.dropped, state.failure) == (1550, 0, None)
    assert state.files > 1
    with BagReader(tmp_path / "bag") as bag:
        assert {name: info.count for name, info in bag.topics.items()} == {
            "/clock": 50,
            **{f"/late{k}": 30 for k in range(50)},
        }


def test_an_unknown_type_is_refused_at_once(tmp_path):
    recorder = Recorder(tmp_path / "bag", [CLOCK])
    with pytest.raises(InputError, match="is no known message type"):
        recorder.add(TopicSpec("/x", "nowhere_msgs/msg/X", Profile.ADAPTED), "", latched=False)
    assert recorder.stop().failure is None


def test_what_the_codec_refuses_is_recorded_as_it_came(tmp_path):
    encoder = FakeEncoder()
    recorder = Recorder(tmp_path / "bag", [], encoder=lambda topic, msgtype: encoder)
    recorder.add(IMAGE, "", latched=False)
    pictures = [b"a", b"x1", b"b", b"!2", b"c"]
    for k, data in enumerate(pictures):
        recorder.put_all([BagMessage("/camera", k, k, data, k)])
    state = recorder.stop()
    assert (state.messages, state.dropped, state.failure) == (5, 0, None)
    assert encoder.threads == {"bag-writer"}
    assert state.warnings == (
        "/camera: 2 pictures could not be encoded and are recorded as they came on "
        "/camera/original: RuntimeError: codec broke",
    )
    with BagReader(tmp_path / "bag") as bag:
        assert [(m.topic, m.data) for m in bag.messages()] == [
            ("/camera", b"va"),
            ("/camera/original", b"x1"),
            ("/camera", b"vb"),
            ("/camera/original", b"!2"),
            ("/camera", b"vc"),
        ]
        assert bag.topics["/camera"].msgtype == VIDEO
        assert bag.topics["/camera/original"].msgtype == IMAGE.msgtype
    assert recorder.originals == {"/camera": "/camera/original"}
    assert check_closed(tmp_path / "bag", {"/camera": 5}, recorder.originals).problems == ()


@pytest.mark.parametrize("refused", [True, False])
def test_a_real_topic_with_the_name_of_originals_stays_what_it_is(refused, tmp_path, clock_cdr):
    real = TopicSpec("/camera/original", CLOCK_TYPE, Profile.ADAPTED)
    recorder = Recorder(
        tmp_path / "bag", [], encoder=lambda topic, _: FakeEncoder() if topic == "/camera" else None
    )
    for one in (IMAGE, real):
        recorder.add(one, "", latched=False)
    recorder.put_all([BagMessage("/camera", 1, 1, b"x" if refused else b"a", 1)])
    recorder.put_all([BagMessage(real.name, k, k, clock_cdr(k), k) for k in range(3)])
    assert recorder.stop().failure is None
    assert recorder.originals == ({"/camera": "/camera/original_2"} if refused else {})
    with BagReader(tmp_path / "bag") as bag:
        assert bag.topics[real.name].msgtype == CLOCK_TYPE
    expected = {"/camera": 1, real.name: 3}
    assert check_closed(tmp_path / "bag", expected, recorder.originals).problems == ()


def test_the_name_of_originals_is_not_given_away_twice(tmp_path):
    recorder = Recorder(tmp_path / "bag", [], encoder=lambda _topic, _msgtype: FakeEncoder())
    recorder.add(IMAGE, "", latched=False)
    recorder.put_all([BagMessage("/camera", 1, 1, b"x", 1)])
    until(lambda: bool(recorder.originals), "refused picture")
    late = TopicSpec("/camera/original", CLOCK_TYPE, Profile.ADAPTED)
    with pytest.raises(InputError, match="holds pictures of another topic"):
        recorder.add(late, "", latched=False)
    assert recorder.stop().failure is None


def test_offers_that_no_bag_can_hold_are_left_out(tmp_path, clock_cdr):
    recorder = Recorder(tmp_path / "bag", [])
    recorder.add(CLOCK, "- depth: 1\n" * 10_000, latched=False)
    recorder.put_all([BagMessage("/clock", 1, 1, clock_cdr(1), 1)])
    state = recorder.stop()
    assert (state.messages, state.failure) == (1, None)
    with BagReader(tmp_path / "bag") as bag:
        assert bag.topics["/clock"].offered_qos == ""


def test_whatever_ends_the_writing_all_that_comes_is_counted(tmp_path, clock_cdr, monkeypatch):
    raised: list[BaseException | None] = []
    monkeypatch.setattr(threading, "excepthook", lambda args: raised.append(args.exc_value))
    recorder = Recorder(tmp_path / "bag", [CLOCK])
    # The second of a batch has a time that no bag can hold.
    recorder.put_all([BagMessage("/clock", t, t, clock_cdr(1), 1) for t in (1, -1, 2, 3)])
    until(lambda: recorder.state().failure is not None, "failure")
    recorder.put_all([BagMessage("/clock", 5, 5, clock_cdr(5), 5)] * 4)
    until(lambda: recorder.state().dropped == 7, "count of the rest")
    state = recorder.stop()
    assert (state.messages, state.dropped) == (1, 7)
    assert len(raised) == 1
    assert state.failure == f"{type(raised[0]).__name__}: {raised[0]}"


def test_a_slow_encoder_does_not_hold_up_what_is_encoded(tmp_path, monkeypatch):
    monkeypatch.setattr("ssp_monitor.recorder.recorder.FLUSH_S", 0.0)
    held, go_on = threading.Event(), threading.Event()

    class Slow(FakeEncoder):
        def encode(self, message: BagMessage) -> list[BagMessage]:
            if message.data == b"slow":
                held.set()
                assert go_on.wait(DEADLINE_S)
            return [message]

    recorder = Recorder(tmp_path / "bag", [], encoder=lambda _topic, _msgtype: Slow())
    recorder.add(IMAGE, "", latched=False)
    recorder.put_all([BagMessage("/camera", k, k, d, k) for k, d in enumerate((b"quick", b"slow"))])
    try:
        assert held.wait(DEADLINE_S)
        assert b"quick" in (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    finally:
        go_on.set()
        assert recorder.stop().messages == 2


def test_a_disk_that_is_behind_is_said(tmp_path, monkeypatch):
    recorder = Recorder(tmp_path / "bag", [CLOCK])
    with monkeypatch.context() as patch:
        patch.setattr(BagWriter, "sync_age_s", property(lambda _: 30.0))
        state = recorder.state()
    assert state.flush_age_s == 30.0
    assert state.warnings == ("the last 30.0 s isn't on disk yet; a power cut would lose it",)
    assert recorder.stop().warnings == ()


def test_video_is_chosen_by_type_and_name():
    assert video_choice("", "x") is None
    choice = video_choice("h264", "front")
    assert choice is not None
    encoder = choice.encoder("/front/image", "sensor_msgs/msg/CompressedImage")
    assert encoder is not None
    assert encoder.msgtype == VIDEO
    assert choice.encoder("/rear/image", "sensor_msgs/msg/CompressedImage") is None
    assert choice.encoder("/front/points", "sensor_msgs/msg/PointCloud2") is None
    with pytest.raises(InputError, match="is no codec"):
        video_choice("mpeg2", "")
    with pytest.raises(InputError, match="video_topics"):
        video_choice("h265", "(")


def test_the_bag_says_what_is_in_it_and_what_is_missing(tmp_path, clock_cdr):
    attachments = [("run.yaml", "application/yaml", b"x")]
    size = 256 + len(clock_cdr(0))
    recorder = Recorder(tmp_path / "bag", [CLOCK], attachments, queue_bytes=3 * size)
    recorder.put_all([BagMessage("/clock", k, k, clock_cdr(k), k) for k in range(100)])

    def seal() -> tuple[str, str, bytes]:
        return report_attachment(
            recorder.records(),
            TopicCounts({"/clock": 100}, {"/clock": 7}, recorder.dropped_by_topic),
            run_id="r",
            missing=6,
            lost_limit=5,
            warnings=["w"],
            sealed=seals(attachments),
        )

    state = recorder.stop(seal)
    assert state.messages + state.dropped == 100
    assert state.dropped > 0
    with BagReader(tmp_path / "bag") as bag:
        report = json.loads(bag.attachment(REPORT_NAME) or b"")
        written = list(bag.messages())
    assert (report["schema"], report["sealed"]) == ("ssp.recording/1", True)
    assert report["seals"] == {"run.yaml": f"sha256:{hashlib.sha256(b'x').hexdigest()}"}
    assert (report["received"], report["lost"], report["dropped"]) == (100, 7, state.dropped)
    assert (report["run_id"], report["lost_limit"], report["warnings"]) == ("r", 5, ["w"])
    assert report["topics"] == [
        {
            "name": "/clock",
            "type": CLOCK_TYPE,
            "received": 100,
            "written": len(written),
            "bytes": sum(len(m.data) for m in written),
            "lost": 7,
            "dropped": state.dropped,
            "passed_over": 0,
            "first_ns": written[0].log_time_ns,
            "last_ns": written[-1].log_time_ns,
        }
    ]


def test_a_bag_that_lacks_something_is_found_out(small_bag):
    found = check_closed(small_bag, {"/clock": 10})
    assert (found.problems, found.read, found.messages) == ((), 10, 10)
    assert found.text == "counts and checksums checked"
    assert check_closed(small_bag, {"/clock": 11, "/x": 1}).problems == (
        "/clock: 10 messages in the bag, 11 were received",
        "/x: 0 messages in the bag, 1 were received",
    )
    # A quiet topic is no problem.
    assert check_closed(small_bag, {"/clock": 10, "/y": 0}).problems == ()


def test_a_flipped_byte_is_found_out(small_bag, clock_cdr):
    file = small_bag / "small_0.mcap"
    data = bytearray(file.read_bytes())
    data[data.index(clock_cdr(5_000_000_000)) + 6] ^= 1
    file.write_bytes(data)
    found = check_closed(small_bag, {"/clock": 10})
    assert len(found.problems) == 1
    assert "the bag can't be read" in found.problems[0]
    assert found.text.startswith("problems: ")


def test_a_large_bag_is_read_for_a_while_and_says_so(tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/clock", CLOCK_TYPE)
        for k in range(1000):
            writer.write("/clock", b"\x00\x01\x00\x00" + struct.pack("<II", k, 0), k, k)
    found = check_closed(tmp_path / "bag", {"/clock": 1000}, most_s=0.0)
    assert found.problems == ()
    assert found.read < found.messages == 1000
    assert found.text == f"counts checked, checksums of the first {found.read} messages"


def test_a_bag_holds_every_topic_of_every_object(run_mapping):
    topics = {t.name: t for t in bag_topics(RunSpec.model_validate(run_mapping))}
    assert len(topics) == 25
    for object_id in ("ot1", "walker"):
        for kind in ("state", "reference", "reference_ack", "rules"):
            assert f"/ssp/{object_id}/{kind}" in topics
    assert {name for name, t in topics.items() if t.required} == {
        "/ssp/world/tick",
        "/ssp/vut/state",
        "/ssp/ot1/state",
        "/ssp/walker/state",
        "/ssp/session_state",
        "/ssp/vut/front_camera/image/compressed",
        "/ssp/vut/front_camera/camera_info",
    }
    assert all(t.msgtype in typestore().types for t in topics.values())


def test_the_states_of_many_objects_come_on_one_topic(run_mapping):
    targets = [{**run_mapping["targets"][0], "id": f"ot{k}"} for k in range(1, 6)]
    run = RunSpec.model_validate({**run_mapping, "targets": targets})
    assert run.states_in_one
    topics = {t.name: t for t in bag_topics(run)}
    assert topics["/ssp/object_states"].required
    assert topics["/ssp/vut/state"].required
    assert "/ssp/ot1/state" not in topics
    assert {"/ssp/ot1/reference", "/ssp/ot5/reference_ack"} <= topics.keys()


def test_a_live_session_has_no_world(run_mapping):
    run = RunSpec.model_validate({**run_mapping, "domain": "physical", "mode": "live"})
    topics = {t.name: t for t in bag_topics(run)}
    assert "/ssp/world/tick" not in topics
    assert topics["/ssp/vut/state"].required
    assert topics["/ssp/ot1/state"].required
    assert topics["/ssp/vut/front_camera/image/compressed"].speaks_early
    assert not topics["/ssp/vut/front_camera/camera_info"].required
    # An object that doesn't speak ISO 22133 has no frames, and nobody waits for them.
    assert not topics["/ssp/ot1/iso_frames"].required
    assert stamp_at(topics["/ssp/ot1/iso_frames"].msgtype) == START


def test_stamps_of_another_clock_are_not_taken_for_session_time(run_mapping):
    topics = bag_topics(RunSpec.model_validate(run_mapping))
    assert {t.name for t in topics if not t.session_time} == {
        "/ssp/manager/heartbeat_reply",
        "/ssp/manager/link_status",
        "/ssp/ot1/rules",
        "/ssp/walker/rules",
        "/tf_static",
    }


def test_a_run_without_a_camera_waits_for_none(run_mapping):
    run = RunSpec.model_validate({**run_mapping, "camera": None})
    assert not [t.name for t in bag_topics(run) if "camera" in t.name]


def test_only_a_live_session_uses_the_system_clock(run_mapping):
    run = RunSpec.model_validate(run_mapping)
    for domain, stand_in in (("simulation", False), ("physical", False), ("physical", True)):
        one = run.model_copy(update={"domain": domain, "stand_in": stand_in})
        assert uses_simulated_time(one)
        assert not uses_simulated_time(one.model_copy(update={"mode": "live"}))


def test_every_recorded_type_begins_with_a_stamp(run_mapping):
    for topic in bag_topics(RunSpec.model_validate(run_mapping)):
        assert stamp_at(topic.msgtype) == (START + 4 if topic.msgtype == TF_TYPE else START), topic
    assert stamp_at("ssp_msgs/msg/StepDone") is None
    assert stamp_at("std_msgs/msg/Empty") is None


@given(seconds=st.integers(0, 2**31 - 1), nanoseconds=st.integers(0, NS_PER_S - 1))
def test_the_leading_stamp_is_that_of_the_message(seconds, nanoseconds):
    types = typestore().types
    stamp = types["builtin_interfaces/msg/Time"](sec=seconds, nanosec=nanoseconds)
    header = types["std_msgs/msg/Header"](stamp=stamp, frame_id="map")
    expected = seconds * NS_PER_S + nanoseconds
    message = types["std_msgs/msg/Header"]
    assert isinstance(header, message)
    for little_endian in (True, False):
        cdr = bytes(
            typestore().serialize_cdr(header, "std_msgs/msg/Header", little_endian=little_endian)
        )
        assert leading_stamp_ns(cdr) == expected
    assert leading_stamp_ns(serialize(types[CLOCK_TYPE](clock=stamp))) == expected


def test_short_or_negative_stamps_are_none():
    assert leading_stamp_ns(b"\x00\x01\x00\x00\x00\x00\x00\x00") is None
    assert leading_stamp_ns(b"\x00\x01\x00\x00" + struct.pack("<iI", -1, 0)) is None


def test_a_message_without_a_stamp_takes_the_newest_one(clock_cdr):
    simulated = SimulatedTime()
    assert simulated.of(b"\x00\x01\x00\x00", None) == 0
    assert simulated.of(clock_cdr(50), START) == 50
    assert simulated.of(clock_cdr(30), START) == 30
    assert simulated.of(clock_cdr(99), None) == 50
    transforms = [Transform("map", "a", stamp, (0.0,) * 3, (0.0,) * 4) for stamp in (70, 60)]
    assert simulated.of(encode_transforms(transforms), stamp_at(TF_TYPE)) == 70
    assert simulated.of(encode_transforms([]), stamp_at(TF_TYPE)) == 70
    # A stamp before 0 is none: a bag has no such time.
    before = b"\x00\x01\x00\x00" + struct.pack("<iI", -1, 0)
    assert simulated.of(before, START) == 70


def test_the_recorder_writes_what_it_was_given(tmp_path, clock_cdr):
    recorder = Recorder(tmp_path / "bag", [CLOCK], [("run.yaml", "application/yaml", b"x")])
    sent = [BagMessage("/clock", k, k + 1, clock_cdr(k), k) for k in range(1000)]
    for message in sent:
        recorder.put_all([message])
    state = recorder.stop()
    assert (state.messages, state.dropped, state.failure) == (1000, 0, None)
    with BagReader(tmp_path / "bag") as reader:
        assert list(reader.messages()) == sent
        assert reader.attachment("run.yaml") == b"x"


def test_a_slow_bag_is_on_disk_soon_after_each_message(tmp_path, clock_cdr):
    recorder = Recorder(tmp_path / "bag", [CLOCK])
    try:
        file = tmp_path / "bag" / "bag_0.mcap"
        before = file.stat().st_size
        recorder.put_all([BagMessage("/clock", 1, 1, clock_cdr(1))])
        until(lambda: file.stat().st_size > before)
    finally:
        recorder.stop()


def test_too_much_waiting_is_dropped_and_counted(tmp_path):
    recorder = Recorder(tmp_path / "bag", [CLOCK], queue_bytes=100)
    recorder.put_all([BagMessage("/clock", 0, 0, bytes(101))])
    state = recorder.stop()
    assert (state.messages, state.dropped) == (0, 1)
    assert recorder.dropped_by_topic == {"/clock": 1}


def test_a_removed_bag_is_a_failure_that_counts_what_is_lost(tmp_path, clock_cdr):
    recorder = Recorder(tmp_path / "bag", [CLOCK])
    (tmp_path / "bag" / "bag_0.mcap").unlink()
    until(lambda: recorder.state().failure is not None)
    for k in range(5):
        recorder.put_all([BagMessage("/clock", k, k, clock_cdr(k))])
    state = recorder.stop()
    assert state.failure is not None
    assert "bag_0.mcap: writing failed" in state.failure
    assert (state.messages, state.dropped) == (0, 5)


def test_topics_are_renamed_and_nodes_are_not():
    given = ["-m", "--ros-args", "-r", "__node:=monitor", "-p", "a:=b", "-r", "x:=/y"]
    given += ["--remap", "other:__ns:=/z"]
    assert topic_rules(given) == ["--ros-args", "-r", "x:=/y"]
    assert topic_rules(["-m", "--ros-args", "-r", "__node:=monitor"]) == []
