"""ssp bag info on bags of every make."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter
from rosbags.typesys import Stores, get_typestore

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.types import definition
from ssp_core.bag.writing.split import Split
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cli import main
from ssp_core.clock import NS_PER_S
from ssp_monitor.bag_tools.info import (
    qos_text,
    report_sentences,
    size_text,
    span_text,
    summarise_bag,
    survey_lines,
)

START_NS = 1_700_000_000 * NS_PER_S
CLOCK = "rosgraph_msgs/msg/Clock"


def info(capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, str, str]:
    status = main(["bag", "info", *map(str, args)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def mcap_file(
    path: Path, make: Callable[[int], bytes], compression: CompressionType, count: int = 400
) -> Path:
    """A bare file as another program writes it, in several chunks; /b begins late."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("wb") as stream:
        writer = Writer(stream, compression=compression, chunk_size=2000)
        writer.start(profile="ros2", library="other")
        schema = writer.register_schema(CLOCK, "ros2msg", definition(CLOCK).text.encode())
        channels = [writer.register_channel(topic, "cdr", schema, {}) for topic in ("/a", "/b")]
        for k in range(count):
            time_ns = START_NS + k * NS_PER_S // 100
            writer.add_message(channels[0], time_ns, make(time_ns), time_ns)
            if k >= count // 2 and k % 10 == 0:
                writer.add_message(channels[1], time_ns, make(time_ns), time_ns)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("compression", "name"),
    [
        (CompressionType.NONE, "none"),
        (CompressionType.ZSTD, "zstd"),
        (CompressionType.LZ4, "lz4"),
    ],
)
def test_compressed_chunks_and_rates_per_topic(tmp_path, clock_cdr, capsys, compression, name):
    path = mcap_file(tmp_path / "x.mcap", clock_cdr, compression)
    status, shown, _ = info(capsys, path, "--json")
    assert status == 0
    found = json.loads(shown)
    (file,) = found["files"]
    assert file["compression"] == [name]
    assert file["chunks"] > 5
    assert found["topics"]["/a"]["rate_hz"] == pytest.approx(100.0)
    # Its own rate, although it is silent for the first half of the bag.
    assert found["topics"]["/b"]["rate_hz"] == pytest.approx(10.0)
    assert found["topics"]["/b"]["first_ns"] == START_NS + 2 * NS_PER_S
    assert found["messages"] == 420
    status, shown, _ = info(capsys, path)
    assert "420 messages of 2 topics, 1 file" in shown
    assert "3.990 s from 2023-11-14 22:13:20.000 UTC" in shown
    assert (name in shown) == (name != "none")


def test_a_file_without_chunks_has_no_rates(tmp_path, clock_cdr):
    """A file without any index of chunks has no times per topic, and that is no rate of 0."""
    path = tmp_path / "x.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        schema = writer.register_schema(CLOCK, "ros2msg", definition(CLOCK).text.encode())
        channel = writer.register_channel("/a", "cdr", schema, {})
        for k in range(5):
            writer.add_message(channel, k, clock_cdr(k), k)
        writer.finish()
    found = summarise_bag(path)
    assert (found.count, found.start_ns, found.end_ns) == (5, 0, 4)
    assert found.topics["/a"].rate_hz is None


def test_a_bag_of_rosbags(tmp_path, capsys):
    store = get_typestore(Stores.ROS2_HUMBLE)
    path = tmp_path / "theirs"
    with RosbagsWriter(path, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        text = store.types["std_msgs/msg/String"]
        connection = writer.add_connection("/chatter", text.__msgtype__, typestore=store)
        for k in range(11):
            data = store.serialize_cdr(text(data=str(k)), text.__msgtype__)
            writer.write(connection, START_NS + k * NS_PER_S // 10, data)
    status, shown, _ = info(capsys, path)
    assert status == 0
    row = next(line for line in shown.splitlines() if line.startswith("/chatter"))
    assert row.split()[:4] == ["/chatter", "std_msgs/msg/String", "11", "10.0"]


def test_a_bag_of_several_files_counts_repeated_messages_once(tmp_path, clock_cdr, capsys):
    path = tmp_path / "bag"
    with BagWriter(path, split=Split(max_s=2.0)) as writer:
        writer.add_topic("/a", CLOCK, offered_qos(50))
        writer.add_topic("/map", CLOCK, offered_qos(1, transient_local=True), latched=True)
        writer.write("/map", clock_cdr(1), START_NS, START_NS)
        for k in range(50):
            writer.write("/a", clock_cdr(k), START_NS + k * NS_PER_S // 10, START_NS)
    found = summarise_bag(path)
    assert len(found.files) == 3
    assert found.count == 51
    assert [file.repeated for file in found.files] == [0, 1, 1]
    status, shown, _ = info(capsys, path)
    assert status == 0
    assert "51 messages of 2 topics, 3 files" in shown
    assert "(1 repeated)" in shown
    assert "+2.000 s" in shown
    assert "reliable, latched, depth 1" in shown


def test_files_without_metadata_are_shown_and_said_to_be_so(tmp_path, clock_cdr, capsys):
    folder = tmp_path / "bag"
    for k in (0, 2, 10):
        mcap_file(folder / f"bag_{k}.mcap", clock_cdr, CompressionType.NONE, 100)
    cut = folder / "bag_10.mcap"
    cut.write_bytes(cut.read_bytes()[:-50])
    status, shown, _ = info(capsys, folder)
    assert status == 0
    assert "there is no metadata.yaml" in shown
    assert [line.split()[0] for line in shown.splitlines() if line.startswith("bag_")] == [
        "bag_0.mcap",
        "bag_2.mcap",
        "bag_10.mcap",
    ]
    assert "was not closed by its recorder" in shown
    assert json.loads(info(capsys, folder, "--json")[1])["messages"] == 2 * 105


def test_folders_without_a_readable_bag_are_one_message(tmp_path, small_bag, capsys):
    empty = tmp_path / "empty"
    empty.mkdir()
    status, _, errors = info(capsys, empty)
    assert (status, "neither metadata.yaml nor an .mcap file" in errors) == (1, True)
    (small_bag / "small_0.mcap").rename(small_bag / "small_0.mcap.zstd")
    status, _, errors = info(capsys, small_bag)
    assert status == 1
    assert "compressed as a whole" in errors
    assert "`zstd -d small_0.mcap.zstd -o small_0.mcap`" in errors


@pytest.mark.parametrize(
    ("mode", "problem", "remedy"),
    [
        (CompressionMode.MESSAGE, "compressed bags are not read here", "`ros2 bag convert`"),
        (CompressionMode.FILE, "are compressed as a whole", "`zstd -d packed.mcap.zstd"),
    ],
)
def test_compression_by_rosbag2_is_refused_with_a_way_out(tmp_path, capsys, mode, problem, remedy):
    store = get_typestore(Stores.ROS2_HUMBLE)
    path = tmp_path / "packed"
    writer = RosbagsWriter(path, version=8, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        text = store.types["std_msgs/msg/String"]
        connection = writer.add_connection("/chatter", text.__msgtype__, typestore=store)
        writer.write(connection, 1, store.serialize_cdr(text(data="a" * 99), text.__msgtype__))
    status, _, errors = info(capsys, path)
    assert status == 1
    assert problem in errors
    assert remedy in errors


def test_a_foreign_encoding_is_shown(tmp_path, capsys):
    path = tmp_path / "x.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="")
        schema = writer.register_schema("Point", "jsonschema", b"{}")
        writer.add_message(writer.register_channel("/p", "json", schema, {}), 5, b"{}", 5)
        writer.finish()
    assert "Point (json/jsonschema)" in info(capsys, path)[1]


def test_what_the_recorder_said_is_told(tmp_path, clock_cdr, capsys):
    report = {
        "schema": "ssp.recording/1",
        "received": 9,
        "written": 7,
        "lost": 1,
        "dropped": 2,
        "lost_limit": 0,
        "warnings": ["the disk was slow"],
        "topics": [
            {"name": "/a", "lost": 1, "dropped": 2},
            {"name": "/b", "lost": 0, "dropped": 0},
        ],
    }
    with BagWriter(tmp_path / "bag") as writer:
        writer.attach("recording.json", json.dumps(report).encode(), "application/json")
    shown = info(capsys, tmp_path / "bag")[1].splitlines()
    at = next(i for i, line in enumerate(shown) if line.startswith("recording, of which"))
    assert shown[at + 1 :] == [
        "  1 lost and 2 dropped of 9 received, past the limit of 0",
        "  /a: 1 never received, 2 received and not written",
        "  the disk was slow",
    ]
    assert (
        report_sentences({**report, "missing": 0})[0]
        == "1 lost and 2 dropped of 9 received, within the limit of 0"
    )
    del report["topics"]
    with BagWriter(tmp_path / "bad") as writer:
        writer.attach("recording.json", json.dumps(report).encode(), "application/json")
    status, _, errors = info(capsys, tmp_path / "bad")
    assert (status, "recording.json: is no report of a recording" in errors) == (1, True)


def test_columns_are_aligned(small_bag, tmp_path):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/a", CLOCK, offered_qos(5))
        writer.add_topic("/a/much/longer/name", "ssp_msgs/msg/ObjectState", offered_qos(5))
    lines = survey_lines(summarise_bag(tmp_path / "bag"))
    at = lines[1].index("offered QoS")
    assert [line[at : at + 8] for line in lines[2:4]] == ["reliable", "reliable"]
    assert all(line == line.rstrip() for line in lines)


@pytest.mark.parametrize(
    ("profiles", "text"),
    [
        (None, "unreadable"),
        ([], ""),
        (
            [{"reliability": "best_effort", "durability": "volatile", "depth": 5}],
            "best effort, depth 5",
        ),
        (
            [{"reliability": 1, "durability": 1, "history": 2, "depth": 0}],
            "reliable, latched, depth all",
        ),
        ([{"reliability": "reliable", "depth": 1}] * 2 + [{}], "2 x reliable, depth 1; ?, depth ?"),
    ],
)
def test_quality_of_service_in_words(profiles, text):
    assert qos_text(profiles) == text


def test_sizes_and_times_in_words():
    assert [size_text(n) for n in (0, 999, 1000, 45_200_000, 10**16)] == [
        "0 B",
        "999 B",
        "1.0 kB",
        "45.2 MB",
        "10000.0 TB",
    ]
    assert span_text(None, None) == "no times"
    assert span_text(0, 1_500_000_000) == "1.500 s from 0.000 s"
    assert "2554-07-21" in span_text(2**64 - 2, 2**64 - 1)  # the last time that MCAP can hold


def test_damaged_indexes_are_one_message(tmp_path, clock_cdr, capsys):
    """Bytes of the indexes are spoiled one by one: an answer or an error, never a traceback."""
    path = mcap_file(tmp_path / "x.mcap", clock_cdr, CompressionType.NONE, 40)
    whole = path.read_bytes()
    assert summarise_bag(path).count == 42
    for at in range(len(whole) - 700, len(whole) - 20, 7):
        data = bytearray(whole)
        data[at] ^= 0x55
        path.write_bytes(data)
        status, _, errors = info(capsys, path)
        assert status == 0 or errors.startswith("error: ")


def test_topics_without_messages_are_counted_apart(tmp_path, capsys, clock_cdr):
    with BagWriter(tmp_path / "bag") as writer:
        for name in ("/clock", "/silent"):
            writer.add_topic(name, "rosgraph_msgs/msg/Clock")
        writer.write("/clock", clock_cdr(0), 0, 0)
    status, shown, _ = info(capsys, tmp_path / "bag")
    assert (status, "1 messages of 1 of 2 topics, " in shown) == (0, True)
    cut = tmp_path / "cut"
    assert main(["bag", "cut", str(tmp_path / "bag"), "-o", str(cut)]) == 0
    assert "1 messages of 1 of 2 topics, " in capsys.readouterr().out
    status, shown, _ = info(capsys, cut)
    assert (status, "1 messages of 1 of 2 topics, " in shown) == (0, True)
