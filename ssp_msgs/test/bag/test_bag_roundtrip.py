"""The bags of BagWriter, read back by our reader and rosbags from the bag alone."""

from __future__ import annotations

import resource
from pathlib import Path

import numpy as np
import pytest
import yaml
from rosbags.highlevel import AnyReader

from ssp_core.bag.metadata import ROOT_KEY, offered_qos
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import definition, serialize, typestore
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import HostError, InputError
from tests.support.bags.messages import header

STATE = "ssp_msgs/msg/ObjectState"
TICK = "ssp_msgs/msg/WorldTick"
IMAGE = "sensor_msgs/msg/CompressedImage"
STEP_NS = 10_000_000


def state(stamp_ns: int, sequence: int) -> object:
    return typestore().types[STATE](
        header=header(stamp_ns), object_id="ot1", object_class=1, role=2, control_state=4,
        sequence=sequence, x=1.5 * sequence, y=-2.0, yaw=0.25, speed=10.0, acceleration=0.5,
        yaw_rate=0.0, front=3.6, rear=0.9, width=1.8, height=1.5, position_std=0.0,
        reference_id="r1", error_longitudinal=0.01, error_lateral=-0.02, error_yaw=0.0,
    )  # fmt: skip


def tick(stamp_ns: int, step: int) -> object:
    cls = typestore().types[TICK]
    values = {
        "header": header(stamp_ns),
        "step": step,
        "running": True,
        "lockstep": True,
        "objects": [state(stamp_ns, step), state(stamp_ns, step + 1)],
    }
    fields = {name: values.get(name, 7) for name, _ in typestore().fielddefs[TICK][1]}
    return cls(**fields)


@pytest.fixture
def bag(tmp_path: Path) -> Path:
    """100 states, 100 ticks and 10 images of 300 kB, so that there are several chunks."""
    path = tmp_path / "run_1"
    noise = np.random.default_rng(1).integers(0, 256, 300_000, dtype=np.uint8)
    image = typestore().types[IMAGE]
    with BagWriter(path) as writer:
        writer.add_topic("/ssp/ot1/state", STATE, offered_qos(50))
        writer.add_topic("/ssp/world/tick", TICK, offered_qos(50))
        writer.add_topic("/ssp/image", IMAGE, offered_qos(20, transient_local=True))
        writer.add_topic("/ssp/never", IMAGE)
        writer.attach("run.yaml", b"schema: ssp.run/1\n", "application/yaml")
        for k in range(100):
            stamp = k * STEP_NS
            writer.write("/ssp/world/tick", serialize(tick(stamp, k)), stamp, stamp)
            writer.write("/ssp/ot1/state", serialize(state(stamp, k + 1)), stamp, stamp, k + 1)
            if k % 10 == 0:
                message = image(header=header(stamp, "cam"), format="jpeg", data=noise)
                writer.write("/ssp/image", serialize(message), stamp, stamp)
    return path


def test_rosbags_decodes_custom_types_from_the_bag_alone(bag: Path) -> None:
    with AnyReader([bag]) as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
        assert counts == {
            "/ssp/ot1/state": 100,
            "/ssp/world/tick": 100,
            "/ssp/image": 10,
            "/ssp/never": 0,
        }
        seen = 0
        for connection, stamp, raw in reader.messages():
            message = reader.deserialize(raw, connection.msgtype)
            k = stamp // STEP_NS
            if connection.topic == "/ssp/world/tick":
                assert message.step == k
                assert [o.x for o in message.objects] == [1.5 * k, 1.5 * (k + 1)]
            elif connection.topic == "/ssp/ot1/state":
                assert (message.sequence, message.reference_id) == (k + 1, "r1")
                assert (message.yaw, message.error_lateral) == (0.25, -0.02)
            seen += 1
        assert seen == 210


def test_rosbags_reads_the_offered_qos(bag: Path) -> None:
    with AnyReader([bag]) as reader:
        by_topic = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert by_topic["/ssp/image"][0].durability.name == "TRANSIENT_LOCAL"
    assert by_topic["/ssp/image"][0].depth == 20
    assert by_topic["/ssp/ot1/state"][0].reliability.name == "RELIABLE"
    assert by_topic["/ssp/never"] == []


def test_metadata_agrees_with_the_file_and_has_every_key(bag: Path) -> None:
    information = yaml.safe_load((bag / "metadata.yaml").read_text())[ROOT_KEY]
    assert set(information) == {
        "version",
        "storage_identifier",
        "duration",
        "starting_time",
        "message_count",
        "topics_with_message_count",
        "compression_format",
        "compression_mode",
        "relative_file_paths",
        "files",
        "custom_data",
        "ros_distro",
    }
    assert information["version"] == 9
    assert information["relative_file_paths"] == ["run_1_0.mcap"]
    assert information["duration"]["nanoseconds"] == 99 * STEP_NS
    with BagReader(bag) as reader:
        assert information["message_count"] == reader.count == 210
        assert (reader.start_ns, reader.end_ns) == (0, 99 * STEP_NS)
        for entry in information["topics_with_message_count"]:
            topic = entry["topic_metadata"]
            info = reader.topics[topic["name"]]
            assert entry["message_count"] == info.count
            assert topic["type"] == info.msgtype
            assert topic["type_description_hash"] == info.type_hash
            assert topic["serialization_format"] == "cdr"


def test_type_hashes_are_those_of_ros(bag: Path) -> None:
    # From the type descriptions that the ROS wheels ship.
    assert definition("std_msgs/msg/Header").type_hash == (
        "RIHS01_f49fb3ae2cf070f793645ff749683ac6b06203e41c891e17701b1cb597ce6a01"
    )
    with BagReader(bag) as reader:
        assert reader.topics["/ssp/image"].type_hash == definition(IMAGE).type_hash


def test_definitions_keep_the_comments_that_give_units() -> None:
    text = definition(TICK).text
    assert "float64 yaw                  # rad, counter-clockwise from east" in text
    assert text.count("=" * 80) == 3
    assert "MSG: ssp_msgs/ObjectState\n" in text
    assert "MSG: std_msgs/Header\n" in text


def test_reader_selects_topics_and_times(bag: Path) -> None:
    with BagReader(bag) as reader:
        some = list(reader.messages(["/ssp/ot1/state"], 10 * STEP_NS, 20 * STEP_NS))
        assert [m.log_time_ns for m in some] == [k * STEP_NS for k in range(10, 20)]
        assert [reader.decode(m).sequence for m in some] == list(range(11, 21))
        assert [m.sequence for m in some] == list(range(11, 21))
        assert list(reader.messages(["/not/there"])) == []
        assert list(reader.messages(start_ns=5, stop_ns=5)) == []
        with pytest.raises(ValueError, match="lies before"):
            reader.messages(start_ns=6, stop_ns=5)


def test_the_mcap_file_alone_is_readable(bag: Path) -> None:
    with BagReader(bag / "run_1_0.mcap") as reader:
        assert reader.count == 210
        assert reader.attachments == ("run.yaml",)
        assert reader.attachment("run.yaml") == b"schema: ssp.run/1\n"
        assert reader.attachment("other") is None


def test_the_same_messages_give_the_same_bytes(tmp_path: Path) -> None:
    contents = []
    for name in ("a", "b"):
        with BagWriter(tmp_path / name, name="same") as writer:
            writer.add_topic("/ssp/ot1/state", STATE, offered_qos(50))
            for k in range(20):
                writer.write("/ssp/ot1/state", serialize(state(k, k)), k, k)
        contents.append((tmp_path / name / "same.mcap").read_bytes())
    assert contents[0] == contents[1]


def test_writer_refuses_what_the_caller_got_wrong(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        with pytest.raises(InputError, match="no known message type"):
            writer.add_topic("/x", "nowhere/msg/Nothing")
        with pytest.raises(ValueError, match="no list"):
            writer.add_topic("/x", STATE, "history: keep_last")
        writer.add_topic("/x", STATE)
        with pytest.raises(ValueError, match="added before"):
            writer.add_topic("/x", STATE)
        with pytest.raises(ValueError, match="negative"):
            writer.write("/x", b"", -1, 0)
        with pytest.raises(KeyError):
            writer.write("/y", b"", 0, 0)


def test_an_exception_in_the_block_still_closes_the_bag(tmp_path: Path) -> None:
    def interrupted() -> None:
        with BagWriter(tmp_path / "bag") as writer:
            writer.add_topic("/x", STATE)
            writer.write("/x", serialize(state(0, 1)), 0, 0)
            raise RuntimeError("stop")

    with pytest.raises(RuntimeError, match="stop"):
        interrupted()
    with BagReader(tmp_path / "bag") as reader:
        assert reader.count == 1


def test_a_removed_directory_is_an_error_not_silence(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/x", STATE)
    writer.write("/x", serialize(state(0, 1)), 0, 0)
    writer.file.unlink()
    writer.path.rmdir()
    with pytest.raises(HostError, match="writing failed"):
        writer.flush()
    writer.close()
    assert not writer.path.exists()


def test_a_disk_that_takes_no_more_is_an_error_that_names_the_file(tmp_path: Path) -> None:
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/x", STATE)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        writer.write("/x", bytes(200_000), 0, 0)
        with pytest.raises(HostError, match=r"bag_0\.mcap: writing failed: File too large"):
            writer.flush()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    writer.close()
    assert not (tmp_path / "bag" / "metadata.yaml").exists()
