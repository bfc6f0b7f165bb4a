"""Bags that go on over several files: what repeats cost, and recovery."""

from __future__ import annotations

from pathlib import Path

import pytest

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.reader import BagReader
from ssp_core.bag.repair import recover
from ssp_core.bag.split import Split
from ssp_core.bag.writer import BagWriter
from ssp_core.errors import InputError

STRING = "std_msgs/msg/String"


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


def test_a_file_that_is_something_else_is_refused(tmp_path: Path) -> None:
    files = cut_off(tmp_path / "bag")
    files[-1].write_bytes(b"PK\x03\x04 and more than eight bytes")
    with pytest.raises(InputError, match=r"bag_11\.mcap: is no MCAP file"):
        recover(tmp_path / "bag", tmp_path / "whole")


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
