"""What the recorder decides: which topics and which times."""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.bag.reader import BagReader
from ssp_core.bag.types import BagMessage, serialize, typestore
from ssp_core.cdr.codec import START
from ssp_core.cdr.messages import leading_stamp_ns
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_core.world.transforms import TF_TYPE, Transform, encode_transforms
from ssp_monitor.recorder.losses import SimulatedTime, stamp_at
from ssp_monitor.recorder.recorder import Recorder
from ssp_monitor.recorder.topics import (
    CLOCK_TYPE,
    Profile,
    TopicSpec,
    bag_topics,
    uses_simulated_time,
)
from ssp_monitor.ros.parameters import topic_rules
from support.waiting import until

CLOCK = TopicSpec("/clock", CLOCK_TYPE, Profile.STATE)


def test_a_bag_holds_every_topic_of_every_object(run_mapping: dict[str, Any]) -> None:
    topics = {t.name: t for t in bag_topics(RunSpec.model_validate(run_mapping))}
    assert len(topics) == 23
    for object_id in ("ot1", "walker"):
        for kind in ("state", "reference", "reference_ack"):
            assert f"/ssp/{object_id}/{kind}" in topics
    assert {name for name, t in topics.items() if t.required} == {
        "/ssp/world/tick", "/ssp/vut/state", "/ssp/ot1/state", "/ssp/walker/state",
        "/ssp/session_state", "/ssp/vut/front_camera/image/compressed",
    }  # fmt: skip
    assert all(t.msgtype in typestore().types for t in topics.values())


def test_the_states_of_many_objects_come_on_one_topic(run_mapping: dict[str, Any]) -> None:
    targets = [{**run_mapping["targets"][0], "id": f"ot{k}"} for k in range(1, 6)]
    run = RunSpec.model_validate({**run_mapping, "targets": targets})
    assert run.states_in_one
    topics = {t.name: t for t in bag_topics(run)}
    assert topics["/ssp/object_states"].required
    assert topics["/ssp/vut/state"].required
    assert "/ssp/ot1/state" not in topics
    assert {"/ssp/ot1/reference", "/ssp/ot5/reference_ack"} <= topics.keys()


def test_a_live_session_has_no_world(run_mapping: dict[str, Any]) -> None:
    run = RunSpec.model_validate({**run_mapping, "domain": "physical", "mode": "live"})
    required = {t.name for t in bag_topics(run) if t.required}
    assert "/ssp/world/tick" not in {t.name for t in bag_topics(run)}
    assert {"/ssp/vut/state", "/ssp/ot1/state"} <= required


def test_stamps_of_another_clock_are_not_taken_for_session_time(
    run_mapping: dict[str, Any],
) -> None:
    topics = bag_topics(RunSpec.model_validate(run_mapping))
    assert {t.name for t in topics if not t.session_time} == {
        "/ssp/manager/heartbeat_reply",
        "/ssp/manager/link_status",
        "/tf_static",
    }


def test_a_run_without_a_camera_waits_for_none(run_mapping: dict[str, Any]) -> None:
    run = RunSpec.model_validate({**run_mapping, "camera": None})
    assert not [t.name for t in bag_topics(run) if "camera" in t.name]


def test_only_a_physical_session_without_stand_in_uses_the_system_clock(
    run_mapping: dict[str, Any],
) -> None:
    run = RunSpec.model_validate(run_mapping)
    assert uses_simulated_time(run)
    assert not uses_simulated_time(run.model_copy(update={"domain": "physical"}))
    stand_in = {"domain": "physical", "stand_in": True}
    assert uses_simulated_time(run.model_copy(update=stand_in))
    assert not uses_simulated_time(run.model_copy(update={**stand_in, "mode": "live"}))


def test_every_recorded_type_begins_with_a_stamp(run_mapping: dict[str, Any]) -> None:
    for topic in bag_topics(RunSpec.model_validate(run_mapping)):
        assert stamp_at(topic.msgtype) == (START + 4 if topic.msgtype == TF_TYPE else START), topic
    assert stamp_at("ssp_msgs/msg/StepDone") is None
    assert stamp_at("std_msgs/msg/Empty") is None


@given(seconds=st.integers(0, 2**31 - 1), nanoseconds=st.integers(0, NS_PER_S - 1))
def test_the_leading_stamp_is_that_of_the_message(seconds: int, nanoseconds: int) -> None:
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


def test_short_or_negative_stamps_are_none() -> None:
    assert leading_stamp_ns(b"\x00\x01\x00\x00\x00\x00\x00\x00") is None
    assert leading_stamp_ns(b"\x00\x01\x00\x00" + struct.pack("<iI", -1, 0)) is None


def test_a_message_without_a_stamp_takes_the_newest_one(
    clock_cdr: Callable[[int], bytes],
) -> None:
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


def test_the_recorder_writes_what_it_was_given(
    tmp_path: Path, clock_cdr: Callable[[int], bytes]
) -> None:
    recorder = Recorder(tmp_path / "bag", [CLOCK], [("run.yaml", "application/yaml", b"x")])
    sent = [BagMessage("/clock", k, k + 1, clock_cdr(k), k) for k in range(1000)]
    for message in sent:
        recorder.put_all([message])
    state = recorder.stop()
    assert (state.messages, state.dropped, state.failure) == (1000, 0, None)
    with BagReader(tmp_path / "bag") as reader:
        assert list(reader.messages()) == sent
        assert reader.attachment("run.yaml") == b"x"


def test_a_slow_bag_is_on_disk_soon_after_each_message(
    tmp_path: Path, clock_cdr: Callable[[int], bytes]
) -> None:
    recorder = Recorder(tmp_path / "bag", [CLOCK])
    try:
        file = tmp_path / "bag" / "bag_0.mcap"
        before = file.stat().st_size
        recorder.put_all([BagMessage("/clock", 1, 1, clock_cdr(1))])
        until(lambda: file.stat().st_size > before)
    finally:
        recorder.stop()


def test_too_much_waiting_is_dropped_and_counted(tmp_path: Path) -> None:
    recorder = Recorder(tmp_path / "bag", [CLOCK], queue_bytes=100)
    recorder.put_all([BagMessage("/clock", 0, 0, bytes(101))])
    state = recorder.stop()
    assert (state.messages, state.dropped) == (0, 1)
    assert recorder.dropped_by_topic == {"/clock": 1}


def test_a_removed_bag_is_a_failure_that_counts_what_is_lost(
    tmp_path: Path, clock_cdr: Callable[[int], bytes]
) -> None:
    recorder = Recorder(tmp_path / "bag", [CLOCK])
    (tmp_path / "bag" / "bag_0.mcap").unlink()
    until(lambda: recorder.state().failure is not None)
    for k in range(5):
        recorder.put_all([BagMessage("/clock", k, k, clock_cdr(k))])
    state = recorder.stop()
    assert state.failure is not None
    assert "bag_0.mcap: writing failed" in state.failure
    assert (state.messages, state.dropped) == (0, 5)


def test_the_recorder_refuses_a_directory_that_exists(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="exists already"):
        Recorder(tmp_path, [CLOCK])


def test_topics_are_renamed_and_nodes_are_not() -> None:
    given = ["-m", "--ros-args", "-r", "__node:=monitor", "-p", "a:=b", "-r", "x:=/y"]
    given += ["--remap", "other:__ns:=/z"]
    assert topic_rules(given) == ["--ros-args", "-r", "x:=/y"]
    assert topic_rules(["-m", "--ros-args", "-r", "__node:=monitor"]) == []
