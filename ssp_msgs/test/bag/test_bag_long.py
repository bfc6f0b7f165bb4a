"""Recordings that outgrow one file's index, and what of latched topics stands in later files."""

from __future__ import annotations

from pathlib import Path

import pytest
from rosbags.highlevel import AnyReader

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.mcap_file import McapFile
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.writing.latched import KEPT_BYTES, MOST_KEPT, UNTOLD_DEPTH
from ssp_core.bag.writing.split import Split
from ssp_core.bag.writing.writer import BagWriter
from tests.support.bags.messages import text

STRING = "std_msgs/msg/String"
ENTRY_BYTES = 73 + 10  # of a chunk with one channel
# As a graph tells it of another process's publisher.
UNTOLD = "- {durability: transient_local, history: unknown, depth: 0}"


@pytest.fixture
def small_index(monkeypatch: pytest.MonkeyPatch) -> None:
    """Files may have an index of ten chunks."""
    monkeypatch.setattr("ssp_core.bag.writing.file_turn.INDEX_BYTES", 10 * ENTRY_BYTES)


def record(path: Path) -> BagWriter:
    """Sixty chunks of one topic, after a latched message."""
    with BagWriter(path) as writer:
        writer.add_topic("/map", STRING, offered_qos(1, transient_local=True), latched=True)
        writer.add_topic("/text", STRING)
        writer.write("/map", text("map"), 0, 0)
        for k in range(1, 61):
            writer.write("/text", text(f"number {k}"), k, k)
            writer.flush()
    return writer


def assert_whole(path: Path, files: int) -> None:
    """All is there, for others the latched message in each file, and each can be read alone."""
    expected = [text("map"), *(text(f"number {k}") for k in range(1, 61))]
    assert check_bag(path).problems == ()
    with BagReader(path) as reader:
        assert [m.data for m in reader.messages()] == expected
        parts = reader.files
    assert len(parts) == files
    for part in parts:
        assert len(McapFile(part).summary.chunk_indexes) <= 12
        with BagReader(part) as reader:
            assert reader.topics["/map"].count == 1
    with AnyReader([path]) as others:
        found = [bytes(data) for connection, _, data in others.messages()]
    assert [data for data in found if data != text("map")] == expected[1:]
    assert found.count(text("map")) == files


@pytest.mark.usefixtures("small_index")
def test_a_recording_goes_on_in_a_new_file_before_its_index_is_too_large(tmp_path: Path) -> None:
    writer = record(tmp_path / "bag")
    assert len(writer.files) == 6
    assert_whole(tmp_path / "bag", 6)


def test_recovering_a_long_recording_makes_several_files_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert len(record(tmp_path / "bag").files) == 1
    monkeypatch.setattr("ssp_core.bag.writing.file_turn.INDEX_BYTES", 10 * ENTRY_BYTES)
    monkeypatch.setattr("ssp_core.bag.writing.writer.CHUNK_BYTES", 1)
    assert recover(tmp_path / "bag", tmp_path / "new").complete
    assert_whole(tmp_path / "new", 7)


def later_file(path: Path, qos: str, sizes: list[int]) -> list[int]:
    """Numbers of the latched messages of those sizes that the second file begins with."""
    with BagWriter(path, split=Split(max_s=1.0)) as writer:
        writer.add_topic("/tf_static", STRING, qos, latched=True)
        writer.add_topic("/end", STRING)
        for k, size in enumerate(sizes):
            writer.write("/tf_static", k.to_bytes(4, "little") + bytes(size), k, k)
        writer.write("/end", b"end", 2 * 10**9, 0)
    with BagReader(writer.files[1]) as reader:
        return [int.from_bytes(m.data[:4], "little") for m in reader.messages(["/tf_static"])]


@pytest.mark.parametrize(
    ("qos", "kept"),
    [
        (UNTOLD, UNTOLD_DEPTH),  # each of several publishers' last messages may be among them
        (UNTOLD.replace("depth: 0", "depth: 1"), UNTOLD_DEPTH),
        ("", UNTOLD_DEPTH),
        (UNTOLD + "\n" + offered_qos(3, transient_local=True), UNTOLD_DEPTH),
        (offered_qos(1, transient_local=True), 1),
        (offered_qos(1, transient_local=True) + offered_qos(2, transient_local=True), 3),
        ("- {durability: 1, history: 2, depth: 0}", MOST_KEPT),
        ("- {durability: 1, depth: 99999999999999999999}", MOST_KEPT),
    ],
)
def test_what_a_later_file_begins_with(tmp_path: Path, qos: str, kept: int) -> None:
    count = MOST_KEPT + 5
    assert later_file(tmp_path / "bag", qos, [0] * count) == list(range(count - kept, count))


def test_what_is_repeated_is_bounded_in_bytes(tmp_path: Path) -> None:
    two = UNTOLD + "\n" + UNTOLD
    quarter = KEPT_BYTES // 4
    assert later_file(tmp_path / "a", UNTOLD, [quarter] * 6) == [3, 4, 5]
    # The last message of each publisher is kept, whatever its size.
    assert later_file(tmp_path / "b", UNTOLD, [5, KEPT_BYTES, KEPT_BYTES]) == [2]
    assert later_file(tmp_path / "c", two, [5, KEPT_BYTES, KEPT_BYTES]) == [1, 2]


def cut_off(path: Path) -> tuple[Path, ...]:
    """Twelve files with a latched message in the seventh; none of them is closed with the bag."""
    writer = BagWriter(path, split=Split(max_s=1.0))
    writer.add_topic("/map", STRING, offered_qos(1, transient_local=True), latched=True)
    writer.add_topic("/x", STRING)
    for k in range(12):
        writer.write("/x", bytes([k]), k * 10**9, 0)
        if k == 6:
            writer.write("/map", b"map", k * 10**9 + 1, 0)
    writer.flush()
    return writer.files


def test_files_are_read_by_their_number(tmp_path: Path) -> None:
    assert len(cut_off(tmp_path / "bag")) == 12
    recover(tmp_path / "bag", tmp_path / "whole")
    with BagReader(tmp_path / "whole") as reader:
        found = [(m.data, m.log_time_ns) for m in reader.messages()]
    expected = [(bytes([k]), k * 10**9) for k in range(12)]
    assert found == [*expected[:7], (b"map", 6 * 10**9 + 1), *expected[7:]]


@pytest.mark.parametrize("left", [0, 3])
def test_a_file_that_was_only_begun_costs_nothing_else(tmp_path: Path, left: int) -> None:
    files = cut_off(tmp_path / "bag")
    with files[-1].open("rb+") as stream:
        stream.truncate(left)
    report = recover(tmp_path / "bag", tmp_path / "whole")
    assert report.messages == {"/x": 11, "/map": 1}
    assert "bag_11.mcap: has no content" in report.damage
    assert not report.complete


def test_a_latched_message_beyond_the_limit_doesnt_fill_the_disk(tmp_path: Path) -> None:
    large = bytes(100_000)
    with BagWriter(tmp_path / "bag", split=Split(max_bytes=10_000)) as writer:
        writer.add_topic("/map", STRING, offered_qos(1, transient_local=True), latched=True)
        writer.add_topic("/x", STRING)
        writer.write("/map", large, 0, 0)
        for k in range(500):
            writer.write("/x", bytes(1_000), k, k)
    total = sum(file.stat().st_size for file in writer.files)
    assert len(writer.files) > 2
    assert total < 2.2 * (len(large) + 500 * 1_000) + len(large)
    with BagReader(writer.files[-1]) as reader:
        assert reader.topics["/map"].count == 1
