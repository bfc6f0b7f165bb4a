"""ssp bag export: images, videos and tables that hold what the bag holds, and nothing elsewhere."""

from __future__ import annotations

import csv
import errno
import json
from pathlib import Path
from typing import Any
from unittest.mock import Mock

import av
import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage, TypeDefinition, serialize, store_from
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.images import COMPRESSED_TYPE, RAW_TYPE, VIDEO_TYPE
from ssp_core.cli import main
from ssp_core.clock import NS_PER_S
from ssp_monitor.bag_tools.export import FileNames
from ssp_monitor.bag_tools.tables import CsvFile
from ssp_monitor.recorder.video_encoder import VideoEncoder
from tests.support.bags.messages import header, message, picture

START_NS = 1_700_000_000 * NS_PER_S
IMAGE = "/ssp/cam/image"
# A camera that isn't regular: intervals of 40, 100 and 60 ms.
STAMPS_NS = [START_NS + ms * 1_000_000 for ms in (0, 40, 140, 200, 240, 340, 400)]


def export(
    capsys: pytest.CaptureFixture[str], source: Path, target: Path, *options: object
) -> tuple[int, str, str]:
    status = main(["bag", "export", str(source), "-o", str(target), *map(str, options)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def scene(number: int, width: int = 64, height: int = 48) -> np.ndarray[Any, np.dtype[np.uint8]]:
    image = np.full((height, width, 3), (180, 140, 90), np.uint8)
    cv2.rectangle(image, (number * 6, 8), (number * 6 + 14, 40), (10, 40, 220), -1)
    return image


def shows(image: Any) -> int:
    """Return the number of the scene that a picture shows."""
    likeness = [cv2.PSNR(image, scene(k)) for k in range(len(STAMPS_NS))]
    assert max(likeness) > 24.0
    return likeness.index(max(likeness))


def jpeg_of(number: int, **size: int) -> bytes:
    return bytes(cv2.imencode(".jpg", scene(number, **size))[1].tobytes())


def image_message(stamp_ns: int, data: bytes, form: str = "jpeg") -> bytes:
    return picture(data, stamp_ns, "map", form)


@pytest.fixture
def camera_bag(tmp_path):
    path = tmp_path / "camera"
    with BagWriter(path) as writer:
        writer.add_topic(IMAGE, COMPRESSED_TYPE)
        for k, stamp_ns in enumerate(STAMPS_NS):
            writer.write(IMAGE, image_message(stamp_ns, jpeg_of(k)), stamp_ns + 777, stamp_ns)
    return path


def object_state(name: str, x_m: float) -> Any:
    return message(
        "ssp_msgs/msg/ObjectState", header=header(START_NS + 5), object_id=name, object_class=1,
        role=1, control_state=4, sequence=1, x=x_m, y=0.0, yaw=0.0, speed=0.1, acceleration=0.0,
        yaw_rate=0.0, front=3.6, rear=0.9, width=1.8, height=1.5, position_std=0.0,
        reference_id="r,\"1\"", error_longitudinal=float("nan"), error_lateral=0.0, error_yaw=0.0,
    )  # fmt: skip


def states(names: list[str]) -> bytes:
    found = [object_state(name, 1.5 * k) for k, name in enumerate(names)]
    return serialize(
        message("ssp_msgs/msg/ObjectStates", header=header(START_NS), source="world", states=found)
    )


@pytest.fixture
def states_bag(tmp_path):
    path = tmp_path / "states"
    with BagWriter(path) as writer:
        writer.add_topic("/ssp/object_states", "ssp_msgs/msg/ObjectStates")
        for k, names in enumerate((["a", "b"], [], ["c"])):
            writer.write("/ssp/object_states", states(names), START_NS + k, START_NS, k + 3)
    return path


def test_jpegs_are_copied_byte_for_byte(camera_bag, tmp_path, capsys):
    status, shown, _ = export(capsys, camera_bag, tmp_path / "out", "--frames", "jpg")
    assert status == 0
    assert "ssp.cam.image/         7 frames" in shown
    index = table(tmp_path / "out" / "ssp.cam.image" / "index.csv")
    assert [int(row["stamp_ns"]) for row in index] == STAMPS_NS
    assert [int(row["log_time_ns"]) - 777 for row in index] == STAMPS_NS
    for k, row in enumerate(index):
        assert (tmp_path / "out" / "ssp.cam.image" / row["file"]).read_bytes() == jpeg_of(k)
    assert index[1]["file"] == f"000001_{STAMPS_NS[1]}.jpg"


def test_pngs_are_decoded_pictures(camera_bag, tmp_path, capsys):
    span = ("--start", f"{STAMPS_NS[2]}ns", "--end", f"{STAMPS_NS[4]}ns")
    assert export(capsys, camera_bag, tmp_path / "out", "--frames", "png", *span)[0] == 0
    files = sorted((tmp_path / "out" / "ssp.cam.image").glob("*.png"))
    assert [int(file.stem.split("_")[1]) for file in files] == STAMPS_NS[2:4]
    assert [shows(cv2.imread(str(file))) for file in files] == [2, 3]


def test_a_video_plays_at_the_recorded_times(camera_bag, tmp_path, capsys):
    status, shown, _ = export(capsys, camera_bag, tmp_path / "out", "--video")
    assert status == 0
    assert "ssp.cam.image.mp4         7 frames" in shown
    with av.open(str(tmp_path / "out" / "ssp.cam.image.mp4")) as container:
        frames = list(container.decode(video=0))
    passed_ms = [round(frame.time * 1000) for frame in frames if frame.time is not None]
    assert passed_ms == [0, 40, 140, 200, 240, 340, 400]
    assert [shows(frame.to_ndarray(format="bgr24")) for frame in frames] == list(range(7))


def test_video_topics_become_images_and_videos(tmp_path, capsys):
    encoder = VideoEncoder(COMPRESSED_TYPE)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(IMAGE, VIDEO_TYPE)
        for k, stamp_ns in enumerate(STAMPS_NS):
            given_ = BagMessage(IMAGE, stamp_ns, stamp_ns, image_message(stamp_ns, jpeg_of(k)))
            writer.write_all(encoder.encode(given_))
    out = tmp_path / "out"
    assert export(capsys, tmp_path / "bag", out, "--frames", "png", "--video")[0] == 0
    files = sorted((out / "ssp.cam.image").glob("*.png"))
    assert [int(file.stem.split("_")[1]) for file in files] == STAMPS_NS
    assert [shows(cv2.imread(str(file))) for file in files] == list(range(7))
    assert (out / "ssp.cam.image.mp4").stat().st_size > 500


def test_new_sizes_and_damaged_frames_are_said(tmp_path, capsys):
    frames = [jpeg_of(0), b"no picture", jpeg_of(2, width=81, height=33), jpeg_of(3)]
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(IMAGE, COMPRESSED_TYPE)
        for k, data in enumerate(frames):
            writer.write(IMAGE, image_message(START_NS, data), START_NS + k * NS_PER_S, START_NS)
    status, shown, notes = export(capsys, tmp_path / "bag", tmp_path / "out", "--video")
    assert status == 0
    assert "ssp.cam.image.mp4, ssp.cam.image.2.mp4, ssp.cam.image.3.mp4" in shown
    assert f"{IMAGE}: 1 frames left out that are no pictures; at {START_NS + NS_PER_S} ns" in notes
    assert "change their size" in notes


def test_stamps_that_stand_still_or_leap_fall_back_to_the_recorders_time(tmp_path, capsys):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic(IMAGE, COMPRESSED_TYPE)
        for k, stamp_ns in enumerate((9 * NS_PER_S, 9 * NS_PER_S, NS_PER_S, 2 * NS_PER_S)):
            log_ns = START_NS + k * NS_PER_S // 2
            writer.write(IMAGE, image_message(stamp_ns, jpeg_of(k)), log_ns, log_ns)
    status, _, notes = export(capsys, tmp_path / "bag", tmp_path / "out", "--video")
    assert status == 0
    with av.open(str(tmp_path / "out" / "ssp.cam.image.mp4")) as container:
        times = [frame.time for frame in container.decode(video=0)]
    assert times == [0.0, 0.5, 1.0, 1.5]
    assert f"{IMAGE}: 2 of 4 frames are shown at their times of receipt: their stamps leap" in notes


def test_raw_images_are_exported(tmp_path, capsys):
    image = scene(1)
    raw = message(
        RAW_TYPE,
        header=header(START_NS),
        height=48,
        width=64,
        encoding="rgb8",
        is_bigendian=0,
        step=192,
        data=np.ascontiguousarray(image[..., ::-1]).reshape(-1),
    )
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/raw", RAW_TYPE)
        writer.write("/raw", serialize(raw), START_NS, START_NS)
    assert export(capsys, tmp_path / "bag", tmp_path / "out", "--frames", "png", "--csv")[0] == 0
    (file,) = (tmp_path / "out" / "raw").glob("*.png")
    assert np.array_equal(cv2.imread(str(file)), image)
    (row,) = table(tmp_path / "out" / "raw.csv")
    assert (row["width"], row["encoding"], "data" in row) == ("64", "rgb8", False)


def test_an_array_of_messages_makes_a_row_of_each(states_bag, tmp_path, capsys):
    assert export(capsys, states_bag, tmp_path / "out", "--csv")[0] == 0
    rows = table(tmp_path / "out" / "ssp.object_states.csv")
    assert [r["states.object_id"] for r in rows] == ["a", "b", "", "c"]
    assert [r["states.index"] for r in rows] == ["0", "1", "", "0"]
    assert [r["states.x"] for r in rows] == ["0.0", "1.5", "", "0.0"]
    assert [r["publish_sequence"] for r in rows] == ["3", "3", "4", "5"]
    assert {r["source"] for r in rows} == {"world"}
    first = rows[0]
    assert first["log_time_ns"] == str(START_NS)
    assert first["states.header.stamp_ns"] == str(START_NS + 5)
    assert first["states.header.stamp_s"] == "1700000000.000000005"
    assert first["states.reference_id"] == 'r,"1"'
    assert first["states.error_longitudinal"] == "nan"


def test_types_of_every_shape(tmp_path, capsys):
    """A foreign type: scalars, lists, bytes, times, two arrays of messages, a field of our name."""
    definition = (
        b"float32 tenth\nbool yes\nuint64 large\nint32[] numbers\nstring[2] words\n"
        b"uint8[4] id\nuint8[] blob\nbuiltin_interfaces/Time[] times\nuint64[] larges\n"
        b"their_msgs/Part[] one\ntheir_msgs/Part[] two\nuint32 publish_sequence\n"
        + b"=" * 80
        + b"\nMSG: their_msgs/Part\nfloat64 z\n"
        + b"=" * 80
        + b"\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    store = store_from(TypeDefinition("their_msgs/msg/All", "ros2msg", definition.decode()))
    part = store.types["their_msgs/msg/Part"]
    time = store.types["builtin_interfaces/msg/Time"]
    value = store.types["their_msgs/msg/All"](
        tenth=0.1,
        yes=True,
        large=2**64 - 1,
        numbers=np.array([1, -2], np.int32),
        words=["a", "ü"],
        id=np.arange(4, dtype=np.uint8),
        blob=np.zeros(9, np.uint8),
        times=[time(1, 5)],
        larges=np.array([2**63], np.uint64),
        one=[part(0.5), part(1.0)],
        two=[],
        publish_sequence=7,
    )
    path = tmp_path / "x.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.LZ4)
        writer.start(profile="ros2")
        schema = writer.register_schema("their_msgs/msg/All", "ros2msg", definition)
        channel = writer.register_channel("/all", "cdr", schema, {})
        writer.add_message(
            channel, 2**63, bytes(store.serialize_cdr(value, "their_msgs/msg/All")), 5
        )
        writer.finish()
    status, _, notes = export(capsys, path, tmp_path / "out", "--csv")
    assert status == 0
    assert "/all: left out of the table: blob (bytes)" in notes
    (row,) = table(tmp_path / "out" / "all.csv")
    assert row == {
        "log_time_ns": str(2**63),
        "log_time_s": "9223372036.854775808",
        "publish_time_ns": "5",
        "publish_time_s": "0.000000005",
        "publish_sequence": "0",
        "tenth": "0.1",
        "yes": "true",
        "large": str(2**64 - 1),
        "numbers": "[1, -2]",
        "words": '["a", "\\u00fc"]',
        "id": "[0, 1, 2, 3]",
        "times_ns": "[1000000005]",
        "larges": f"[{2**63}]",
        "publish_sequence_": "7",
        "one": '[{"z": 0.5}, {"z": 1.0}]',
        "two": "[]",
    }


def test_a_bag_of_rosbags_is_exported(tmp_path, capsys):
    store = get_typestore(Stores.ROS2_HUMBLE)
    path = tmp_path / "theirs"
    with RosbagsWriter(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        text = store.types["std_msgs/msg/String"]
        connection = writer.add_connection("/chatter", text.__msgtype__, typestore=store)
        for k in range(5):
            writer.write(
                connection, k, store.serialize_cdr(text(data=f"=cmd{k}"), text.__msgtype__)
            )
    status, shown, _ = export(capsys, path, tmp_path / "out", "--csv", "--json")
    assert status == 0
    assert json.loads(shown)["written"] == [
        {"topic": "/chatter", "file": "chatter.csv", "count": 5, "unit": "rows"}
    ]
    assert [row["data"] for row in table(tmp_path / "out" / "chatter.csv")][4] == "=cmd4"


def test_more_topics_than_are_written_at_once(tmp_path, clock_cdr, capsys):
    with BagWriter(tmp_path / "bag") as writer:
        for k in range(150):
            writer.add_topic(f"/t{k}", "rosgraph_msgs/msg/Clock")
        for k in range(450):
            writer.write(f"/t{k % 150}", clock_cdr(k), k, k)
    status, shown, _ = export(capsys, tmp_path / "bag", tmp_path / "out", "--csv")
    assert (status, "150 exported" in shown) == (0, True)
    assert [row["clock_ns"] for row in table(tmp_path / "out" / "t149.csv")] == [
        "149",
        "299",
        "449",
    ]


def test_damaged_messages_are_counted_and_left_out(tmp_path, clock_cdr, capsys):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/clock", "rosgraph_msgs/msg/Clock")
        for k, data in enumerate((clock_cdr(1), b"\x00\x01\x00\x00\x01", clock_cdr(2))):
            writer.write("/clock", data, k, k)
    status, shown, notes = export(capsys, tmp_path / "bag", tmp_path / "out", "--csv")
    assert (status, "2 rows" in shown) == (0, True)
    assert "/clock: 1 messages left out; the first: " in notes


HOSTILE = [
    "/../../evil",
    "..",
    "/",
    "/a/../../b",
    "/etc/passwd\0.csv",
    "/ß",
    "/" + "x" * 300,
    "C:\\x",
]


def test_no_file_is_written_outside(tmp_path, clock_cdr, capsys):
    with BagWriter(tmp_path / "bag") as writer:
        for topic in HOSTILE:
            writer.add_topic(topic, "rosgraph_msgs/msg/Clock")
            writer.write(topic, clock_cdr(0), 0, 0)
    before = set(tmp_path.rglob("*"))
    status, _, _ = export(capsys, tmp_path / "bag", tmp_path / "a" / "out", "--csv")
    assert status == 0
    new = set(tmp_path.rglob("*")) - before - {tmp_path / "a", tmp_path / "a" / "out"}
    assert {path.parent for path in new} == {tmp_path / "a" / "out"}
    assert len(new) == len(HOSTILE)


@settings(deadline=None)
@given(st.lists(st.text(max_size=130) | st.sampled_from(HOSTILE), unique=True, max_size=20))
def test_names_are_safe_and_differ(topics):
    names = FileNames()
    found = [names.of(topic) for topic in topics]
    assert len({name.lower() for name in found}) == len(topics)
    for name in found:
        assert 0 < len(name) <= 120
        assert not name.startswith((".", "-"))
        assert name.isascii()
        assert not set(name) & set("/\\:\0 ")
        assert name not in (".", "..")


def test_what_was_there_stays_and_a_failure_leaves_nothing(
    camera_bag, tmp_path, capsys, monkeypatch
):
    (tmp_path / "there").mkdir()
    status, _, errors = export(capsys, camera_bag, tmp_path / "there", "--csv")
    assert (status, "exists already" in errors) == (1, True)
    before = sorted(tmp_path.iterdir())
    monkeypatch.setattr(CsvFile, "write", Mock(side_effect=OSError(errno.ENOSPC, "full")))
    status, _, errors = export(capsys, camera_bag, tmp_path / "out", "--csv")
    assert (status, "full" in errors) == (1, True)
    assert sorted(tmp_path.iterdir()) == before
    assert not list((tmp_path / "there").iterdir())


def test_nothing_asked_for_is_wrong_usage(camera_bag, tmp_path, capsys):
    status, _, errors = export(capsys, camera_bag, tmp_path / "out")
    assert status == 2
    assert "give --frames, --video or --csv" in errors
    status, _, errors = export(capsys, camera_bag, tmp_path / "out", "--csv", "--topics", "/x")
    assert (status, "fits no topic" in errors) == (1, True)


def test_a_choice_without_anything_to_export_is_one_message_and_no_folder(
    camera_bag, states_bag, tmp_path, capsys
):
    before = sorted(tmp_path.iterdir())
    status, _, errors = export(capsys, states_bag, tmp_path / "out", "--video")
    assert status == 1
    assert "nothing to export: none of the topics holds images" in errors
    assert "the bag holds no images; --csv exports a table" in errors
    assert sorted(tmp_path.iterdir()) == before
    with BagReader(camera_bag) as bag:
        topic = next(iter(bag.topics))
    both = tmp_path / "both"
    with BagWriter(both) as writer, BagReader(camera_bag) as bag:
        writer.add_topic("/other", "std_msgs/msg/String")
        writer.add_topic(topic, bag.topics[topic].msgtype)
        for found in bag.messages():
            writer.write(topic, found.data, found.log_time_ns, found.log_time_ns)
    for asked, can in (("--frames=png", f"images are in {topic};"), ("--csv", topic)):
        status, _, errors = export(capsys, both, tmp_path / "out", asked, "--topics", "/other")
        assert status == 1
        assert "nothing to export" in errors
        assert can in errors
        assert not (tmp_path / "out").exists()
