"""ssp bag cut: a part of a bag that can be understood without the rest."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.rosbag2 import Reader as RosbagsReader

from ssp_core.bag.metadata import is_latched, offered_qos
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.cut import cut_bag
from ssp_core.bag.pictures.frames import Frames
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage, definition
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cdr.images import COMPRESSED_TYPE, VIDEO_TYPE
from ssp_core.cli import main
from ssp_core.clock import NS_PER_S
from ssp_core.errors import InputError
from ssp_monitor.bag_tools.selection import parse_time
from ssp_monitor.recorder.video_encoder import VideoEncoder
from tests.support.bags.messages import picture, text, without_index

CLOCK = "rosgraph_msgs/msg/Clock"
STRING = "std_msgs/msg/String"
START_NS = 1_700_000_000 * NS_PER_S
IMAGE = "/cam/image"
LATCHED = offered_qos(2, transient_local=True)


def at(seconds: float) -> int:
    return START_NS + round(seconds * NS_PER_S)


def video_messages(count: int) -> list[BagMessage]:
    """Frames at 10 Hz, a keyframe each second."""
    encoder = VideoEncoder(COMPRESSED_TYPE)
    found = []
    for k in range(count):
        image = np.full((48, 64, 3), 60, np.uint8)
        cv2.rectangle(image, (k % 50, 10), (k % 50 + 12, 40), (0, 0, 250), -1)
        data = picture(cv2.imencode(".jpg", image)[1].tobytes(), at(k / 10))
        found += encoder.encode(BagMessage(IMAGE, at(k / 10), at(k / 10), data, k + 1))
    return found + encoder.finish()


@pytest.fixture
def session(tmp_path, clock_cdr):
    """10 s: /clock at 10 Hz, a latched state that changes at 1, 2, 3 and 6 s, video at 10 Hz."""
    messages = [BagMessage("/clock", at(k / 10), at(k / 10), clock_cdr(k), k) for k in range(101)]
    messages += [
        BagMessage("/state", at(s), at(s) - 5, text(f"state {s}"), s) for s in (1, 2, 3, 6)
    ]
    messages += video_messages(101)
    path = tmp_path / "session"
    with BagWriter(path) as writer:
        writer.attach("run.yaml", b"seed: 1\n", "application/yaml")
        writer.attach("task.json", b"{}", "application/json")
        writer.add_topic("/clock", CLOCK, offered_qos(50))
        writer.add_topic("/state", STRING, LATCHED)
        writer.add_topic("/never", STRING, offered_qos(1))
        writer.add_topic(IMAGE, VIDEO_TYPE, offered_qos(20))
        writer.write_all(sorted(messages, key=lambda m: m.log_time_ns))
    return path


def run(capsys: pytest.CaptureFixture[str], *args: object) -> tuple[int, str, str]:
    status = main(["bag", "cut", *map(str, args)])
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def read(path: Path, *topics: str) -> list[BagMessage]:
    with BagReader(path) as bag:
        return list(bag.messages(topics or None))


def test_a_span_keeps_state_video_and_attachments(session, tmp_path, capsys):
    target = tmp_path / "cut"
    status, shown, notes = run(capsys, session, "--start", "4.5", "--end", "7", "-o", target)
    assert status == 0
    assert "2 attachments" in shown
    assert "/state: 2 latched from before the span" in notes
    assert f"{IMAGE}: 5 frames from the keyframe before the span on" in notes
    assert check_bag(target).problems == ()
    clock = read(target, "/clock")
    assert [m.log_time_ns for m in clock] == [at(k / 10) for k in range(45, 71)]
    # Whole messages: what comes out is what went in.
    assert clock == [m for m in read(session, "/clock") if at(4.5) <= m.log_time_ns <= at(7)]
    # As many as its publisher offers to a late joiner, at the beginning, as they were sent.
    state = read(target, "/state")
    assert [m.data for m in state] == [text("state 2"), text("state 3"), text("state 6")]
    assert [m.log_time_ns for m in state] == [at(4), at(4), at(6)]
    assert [m.publish_time_ns for m in state] == [at(2) - 5, at(3) - 5, at(6) - 5]
    assert [m.sequence for m in state] == [2, 3, 6]
    with BagReader(target) as bag, BagReader(session) as source:
        assert bag.attachment("run.yaml") == b"seed: 1\n"
        for name, info in bag.topics.items():
            assert info.offered_qos == source.topics[name].offered_qos
            assert bag.definition(name) == source.definition(name)
        pictures = list(Frames(bag, IMAGE).pictures(at(4.5)))
        whole = list(Frames(source, IMAGE).pictures(at(4.5), at(7) + 1))
    assert [p.stamp_ns for p in pictures] == [p.stamp_ns for p in whole]
    assert all(np.array_equal(a.image, b.image) for a, b in zip(pictures, whole, strict=True))


def test_others_read_the_cut(session, tmp_path):
    cut_bag(session, tmp_path / "cut", ["/clock", "/state"], at(2.05), None)
    with RosbagsReader(tmp_path / "cut") as reader:
        assert reader.message_count == 80 + 2 + 2
        assert {c.topic for c in reader.connections} == {"/clock", "/state"}


def test_everything_without_a_span_is_the_same_bag(session, tmp_path):
    report = cut_bag(session, tmp_path / "copy", ["/clock", "/state", "/never", IMAGE])
    assert (report.repeated, report.led_in) == ({}, {})
    assert report.messages == {"/clock": 101, "/state": 4, "/never": 0, IMAGE: 101}
    assert read(tmp_path / "copy") == read(session)


def test_topics_are_chosen_by_pattern(session, tmp_path, capsys):
    status, shown, _ = run(
        capsys,
        session,
        "--topics",
        "/c*",
        "--topics",
        "/state",
        "--exclude",
        "/cam/*",
        "-o",
        tmp_path / "a",
        "--json",
    )
    assert status == 0
    assert json.loads(shown)["messages"] == {"/clock": 101, "/state": 4}
    for wrong in (["--topics", "/nowhere"], ["--exclude", "*"]):
        status, _, errors = run(capsys, session, *wrong, "-o", tmp_path / "b")
        assert status == 1
        assert "fits no topic" in errors or "leave no topic over" in errors
        assert not (tmp_path / "b").exists()


def test_times_from_the_end_and_absolute(session, tmp_path, capsys):
    run(capsys, session, "--topics", "/clock", "--start", "-1", "-o", tmp_path / "a")
    assert [m.log_time_ns for m in read(tmp_path / "a")] == [at(k / 10) for k in range(90, 101)]
    absolute = ["--start", f"{at(9.9)}ns", "--end", f"{at(10)}ns"]
    run(capsys, session, "--topics", "/clock", *absolute, "-o", tmp_path / "b")
    assert [m.log_time_ns for m in read(tmp_path / "b")] == [at(9.9), at(10)]


@pytest.mark.parametrize(
    ("given", "code", "problem"),
    [
        (("--start", "soon"), 2, "--start: is no time (got 'soon')"),
        (("--start", "1e3"), 2, "--start: is no time"),
        (("--end", "nan"), 2, "--end: is no time"),
        (("--start", "5", "--end", "4"), 1, "--end: lies before --start"),
        (("--start", "11"), 1, "lies behind the end of the bag (got '11'); it is 10.000 s long"),
        (("--end", "5ns"), 1, "lies before the beginning of the bag"),
    ],
)
def test_impossible_spans_are_one_message(session, tmp_path, capsys, given, code, problem):
    status, _, errors = run(capsys, session, *given, "-o", tmp_path / "cut")
    assert status == code
    assert problem in errors
    assert not (tmp_path / "cut").exists()


def test_times_are_exact_to_the_nanosecond():
    assert parse_time("0.000000001", "t", START_NS, 0) == START_NS + 1
    assert parse_time("-0.000000001 s", "t", 0, START_NS) == START_NS - 1
    assert parse_time("12345678901.123456789", "t", 0, 0) == 12345678901123456789
    assert parse_time("-99", "t", 0, NS_PER_S) == 0


def test_a_target_that_exists_stays_as_it_is(session, tmp_path, capsys):
    (tmp_path / "there").mkdir()
    (tmp_path / "there" / "mine.txt").write_text("keep")
    status, _, errors = run(capsys, session, "-o", tmp_path / "there")
    assert (status, "exists already" in errors) == (1, True)
    assert (tmp_path / "there" / "mine.txt").read_text() == "keep"


def test_a_damaged_source_leaves_nothing_behind(session, tmp_path):
    file = session / "session_0.mcap"
    data = bytearray(file.read_bytes())
    data[data.index(text("state 2"))] ^= 1
    file.write_bytes(data)
    before = sorted(tmp_path.iterdir())
    with pytest.raises(InputError, match=r"session_0\.mcap"):
        cut_bag(session, tmp_path / "cut", ["/clock", "/state"], at(2.5), None)
    assert sorted(tmp_path.iterdir()) == before


def test_a_foreign_bag_keeps_its_own_definition(tmp_path, capsys):
    """The bag is a compressed file without metadata.yaml; its type isn't installed here."""
    path = tmp_path / "foreign.mcap"
    written = b"# theirs\nuint8 level\n"
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD)
        writer.start(profile="ros2")
        schema = writer.register_schema("their_msgs/msg/Level", "ros2msg", written)
        channel = writer.register_channel("/level", "cdr", schema, {})
        for k in range(5):
            writer.add_message(channel, k, b"\x00\x01\x00\x00" + bytes([k]), k)
        writer.finish()
    assert run(capsys, path, "--start", "0.000000002", "-o", tmp_path / "cut")[0] == 0
    with BagReader(tmp_path / "cut") as bag:
        assert bag.definition("/level").text == written.decode()
        assert [bag.decode(m).level for m in bag.messages()] == [2, 3, 4]


@pytest.mark.parametrize(
    ("qos", "latched"),
    [
        (LATCHED, True),
        (offered_qos(1), False),
        ("", False),
        ("- {durability: 1, depth: 1}", True),  # as before Jazzy
        ("- {durability: 2, depth: 1}", False),
        ("{", False),
    ],
)
def test_latched_topics_are_known_by_their_qos(qos, latched):
    assert is_latched(qos) is latched


@pytest.mark.parametrize(
    ("qos", "kept"),
    [
        ("- {durability: transient_local, depth: x}", 6),
        ("- {durability: transient_local, depth: -3}", 6),
        # As a graph tells it of other processes' publishers.
        ("- {durability: transient_local, history: unknown, depth: 0}", 6),
        ("- {durability: transient_local, history: unknown, depth: 1}", 6),
        ("- {durability: transient_local, history: keep_last, depth: 1}", 1),
        ("- {durability: transient_local, depth: 99999999999999999999}", 6),
        ("- {durability: transient_local, history: keep_all, depth: 0}", 6),
        ("- {durability: 1, depth: 2}\n- {durability: 1, depth: 3}", 5),
    ],
)
def test_any_depth_is_taken_with_sense(tmp_path, qos, kept):
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/state", STRING, qos)
        for k in range(8):
            writer.write("/state", text(str(k)), k, k)
    report = cut_bag(tmp_path / "bag", tmp_path / "cut", ["/state"], 6, None)
    assert report.repeated == {"/state": kept}


def test_the_type_of_video_is_kept(session, tmp_path):
    cut_bag(session, tmp_path / "cut", [IMAGE], at(3.0), at(3.05))
    with BagReader(tmp_path / "cut") as bag:
        assert bag.topics[IMAGE].type_hash == definition(VIDEO_TYPE).type_hash
        assert bag.count == 1


def test_folders_above_are_made_unless_a_file_is_in_the_way(session, tmp_path, capsys):
    status, _, errors = run(capsys, session, "-o", tmp_path / "new" / "deep" / "cut")
    assert status == 0, errors
    (tmp_path / "file").write_text("mine")
    status, _, errors = run(capsys, session, "-o", tmp_path / "file" / "cut")
    assert status == 1
    assert f"{tmp_path / 'file'} is no folder" in errors


def test_every_command_takes_a_bag_without_an_index(session, tmp_path, capsys):
    fast = without_index(session, tmp_path / "fast")
    for bag, name in ((session, "indexed"), (fast, "plain")):
        assert main(["bag", "info", str(bag), "--json"]) == 0
        assert main(["bag", "check", str(bag)]) == 0
        span = ("--start", f"{at(2)}ns", "--end", f"{at(5)}ns")
        assert main(["bag", "cut", str(bag), *span, "--out", str(tmp_path / name)]) == 0
        out = tmp_path / f"{name}_tables"
        assert main(["bag", "export", str(bag), "--csv", "--out", str(out)]) == 0
    with BagReader(tmp_path / "indexed") as ours, BagReader(tmp_path / "plain") as theirs:
        assert list(ours.messages()) == list(theirs.messages())
    tables = [file.relative_to(tmp_path / "plain_tables") for file in out.iterdir()]
    assert tables
    for file in tables:
        assert (out / file).read_bytes() == (tmp_path / "indexed_tables" / file).read_bytes()
