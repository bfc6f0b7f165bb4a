"""Recovering bags whose payloads hold the bytes of another bag: of that one nothing is kept."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from ssp_core.bag.reader import BagReader
from ssp_core.bag.repair import recover
from ssp_core.bag.writer import BagWriter

STRING = "std_msgs/msg/String"
FRONT = b"front of the payload"


def inner_bag(folder: Path) -> bytes:
    """A bag of another topic, with its types in the chunks as rosbag2 has them."""
    with (folder / "inner.mcap").open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        schema = writer.register_schema(STRING, "ros2msg", b"string data\n")
        for topic in ("/theirs", "/theirs2"):
            channel = writer.register_channel(topic, "cdr", schema, {})
            writer.add_message(channel, 5, b"\x00\x01\x00\x00\x02\x00\x00\x00x\x00", 5)
        writer.finish()
    return (folder / "inner.mcap").read_bytes()


@pytest.fixture
def outer(tmp_path: Path) -> tuple[bytes, int, int]:
    """A bag's bytes, and where its second chunk, which holds another bag, begins and ends."""
    inner = inner_bag(tmp_path)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/ours", STRING)
        writer.write("/ours", b"one", 1, 1)
        writer.flush()
        begin = writer.file.stat().st_size
        writer.write("/ours", FRONT + inner + bytes(1000), 2, 2)
        writer.flush()
        end = writer.file.stat().st_size
        writer.write("/ours", b"three", 3, 3)
    data = (tmp_path / "bag" / "bag_0.mcap").read_bytes()
    assert data[begin] == 6
    assert inner in data[begin:end]
    return data, begin, end


def kept(folder: Path, data: bytes) -> list[tuple[str, bytes]]:
    (folder / "damaged.mcap").write_bytes(data)
    report = recover(folder / "damaged.mcap", folder / "new")
    assert not report.complete
    with BagReader(folder / "new") as reader:
        return [(m.topic, m.data) for m in reader.messages()]


@pytest.mark.parametrize("left", [40, 500, 900])
def test_a_torn_last_chunk_is_not_searched(
    tmp_path: Path, outer: tuple[bytes, int, int], left: int
) -> None:
    data, _, end = outer
    assert kept(tmp_path, data[: end - left]) == [("/ours", b"one")]


def test_a_torn_attachment_is_not_searched(tmp_path: Path) -> None:
    inner = inner_bag(tmp_path)
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/ours", STRING)
    writer.write("/ours", b"one", 1, 1)
    writer.attach("their.mcap", inner + bytes(1000), "application/mcap")
    data = writer.file.read_bytes()
    writer.close()
    assert kept(tmp_path, data[:-500]) == [("/ours", b"one")]


@pytest.mark.parametrize("summary", [True, False])
@pytest.mark.parametrize(
    "at",
    [0, 1, 6, 60],
    ids=["opcode", "length", "length beyond the file", "data"],
)
def test_a_damaged_record_is_not_searched_when_its_end_can_be_told(
    tmp_path: Path, outer: tuple[bytes, int, int], at: int, summary: bool
) -> None:
    whole, begin, end = outer
    data = bytearray(whole if summary else whole[: whole.index(b"three", end) + 5 + 31])
    data[begin + at] ^= 0x70
    assert kept(tmp_path, bytes(data)) == [("/ours", b"one"), ("/ours", b"three")]


def test_a_chunk_that_nothing_vouches_for_is_not_taken(
    tmp_path: Path, outer: tuple[bytes, int, int]
) -> None:
    """The head is gone, so that the payload is searched; the inner chunk's index doesn't fit."""
    whole, begin, end = outer
    data = bytearray(whole[:end])
    inner = data.index(b"/theirs2", begin)
    index = data.index(b"\x07", inner + 60)
    for k in range(begin, begin + 60):
        data[k] = 0xFF
    data[index + 9] ^= 0x40  # the channel of the first MessageIndex
    assert kept(tmp_path, bytes(data)) == [("/ours", b"one")]
