"""Cut and damaged bags: an InputError that names the file, and all that is whole recovered."""

from __future__ import annotations

import shutil
import signal
import subprocess
import sys
import tracemalloc
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from rosbags.highlevel import AnyReader

from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.split import Split
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import InputError
from tests.support.bags.messages import CLOCK, STRING, clock, text

CHUNKS, PER_CHUNK = 4, 5


def at_second(k: int) -> bytes:
    return clock(k * 10**9)


# Writes two flushed chunks and a third that was not, then is killed the hard way.
KILLED = """
import os, signal, sys
from ssp_core.bag.writing.split import Split
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.bag.types import serialize, typestore
types = typestore().types
writer = BagWriter(sys.argv[1])
writer.attach("run.yaml", b"seed: 1\\n", "application/yaml")
writer.add_topic("/clock", "rosgraph_msgs/msg/Clock")
for k in range(250):
    stamp = types["builtin_interfaces/msg/Time"](sec=k, nanosec=0)
    cdr = serialize(types["rosgraph_msgs/msg/Clock"](clock=stamp))
    writer.write("/clock", cdr, k * 10**9, k * 10**9)
    if k in (99, 199):
        writer.flush()
os.kill(os.getpid(), signal.SIGKILL)
"""


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Four chunks of five messages each, and an attachment."""
    path = tmp_path_factory.mktemp("damage") / "bag"
    with BagWriter(path) as writer:
        writer.add_topic("/clock", CLOCK)
        writer.attach("run.yaml", b"seed: 1\n" * 20, "application/yaml")
        for k in range(CHUNKS * PER_CHUNK):
            writer.write("/clock", at_second(k), k, k)
            if k % PER_CHUNK == PER_CHUNK - 1:
                writer.flush()
    return path


def read_everything(path: Path) -> list[int]:
    """Seconds of all clock messages, after reading the attachments too."""
    with BagReader(path) as reader:
        for name in reader.attachments:
            reader.attachment(name)
        return [reader.decode(message).clock.sec for message in reader.messages()]


def test_a_killed_writer_loses_only_what_came_after_the_last_flush(tmp_path: Path) -> None:
    source, target = tmp_path / "killed", tmp_path / "repaired"
    done = subprocess.run([sys.executable, "-c", KILLED, str(source)], check=False, timeout=600)
    assert done.returncode == -signal.SIGKILL
    with pytest.raises(InputError, match=r"no metadata\.yaml.*ssp bag recover"):
        BagReader(source)
    with pytest.raises(InputError, match=r"was not closed.*ssp bag recover"):
        BagReader(source / "killed_0.mcap")
    report = recover(source, target)
    assert report.messages == {"/clock": 200}
    assert report.attachments == ("run.yaml",)
    assert not report.complete
    assert "not closed" in report.damage[0]
    assert read_everything(target) == list(range(200))
    with AnyReader([target]) as reader:
        assert reader.message_count == 200


def test_recovering_a_whole_bag_keeps_everything(bag: Path, tmp_path: Path) -> None:
    report = recover(bag, tmp_path / "copy")
    assert report.complete
    assert report.bytes_read == report.bytes_total
    with BagReader(bag) as before, BagReader(tmp_path / "copy") as after:
        assert list(before.messages()) == list(after.messages())
        assert before.topics == after.topics
        assert before.attachment("run.yaml") == after.attachment("run.yaml")


def test_a_damaged_chunk_is_left_out_and_the_rest_kept(bag: Path, tmp_path: Path) -> None:
    data = bytearray((bag / "bag_0.mcap").read_bytes())
    second = data.index(at_second(PER_CHUNK))
    data[second + 5] ^= 0x10
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    with pytest.raises(InputError, match=r"damaged\.mcap: is damaged: crc"):
        read_everything(damaged)
    report = recover(damaged, tmp_path / "repaired")
    assert len(report.damage) == 1
    assert "crc validation failed in a chunk" in report.damage[0]
    expected = [k for k in range(20) if not PER_CHUNK <= k < 2 * PER_CHUNK]
    assert read_everything(tmp_path / "repaired") == expected


def test_a_damaged_attachment_is_noticed(bag: Path, tmp_path: Path) -> None:
    data = (bag / "bag_0.mcap").read_bytes().replace(b"seed: 1\nseed", b"seed: 9\nseed", 1)
    damaged = tmp_path / "damaged.mcap"
    damaged.write_bytes(data)
    with pytest.raises(InputError, match="an attachment's CRC is wrong"):
        read_everything(damaged)
    report = recover(damaged, tmp_path / "repaired")
    assert report.attachments == ()
    assert report.count == 20


def test_recover_refuses_what_is_no_bag(tmp_path: Path) -> None:
    (tmp_path / "text.mcap").write_text("not an mcap")
    with pytest.raises(InputError, match=r"text\.mcap: is no MCAP file"):
        recover(tmp_path / "text.mcap", tmp_path / "out")
    with pytest.raises(InputError, match="is not there"):
        recover(tmp_path / "nowhere", tmp_path / "out")
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"no \.mcap file"):
        recover(tmp_path / "empty", tmp_path / "out")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["empty", "text.mcap"]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("[]", "must hold a mapping"),
        ("rosbag2_bagfile_information: 3", "is missing or no mapping"),
        ("rosbag2_bagfile_information: {storage_identifier: sqlite3}", "not read here"),
        (
            "rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: [x]}",
            "names x, which is not there",
        ),
        (
            "rosbag2_bagfile_information: {storage_identifier: mcap, relative_file_paths: []}",
            "must list the bag's files",
        ),
        (
            "rosbag2_bagfile_information: {storage_identifier: mcap, compression_mode: file}",
            "compressed bags",
        ),
        (
            "rosbag2_bagfile_information: {storage_identifier: mcap,"
            " relative_file_paths: [../a.mcap], message_count: x, topics_with_message_count: []}",
            "counts are missing or malformed",
        ),
    ],
)
def test_bad_metadata_names_the_file(tmp_path: Path, text: str, match: str) -> None:
    (tmp_path / "a.mcap").write_bytes(b"")
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(InputError, match=match) as caught:
        BagReader(tmp_path)
    assert caught.value.file == str(tmp_path / "metadata.yaml")


def test_a_folder_with_a_bag_in_it_names_the_bag(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no closed bag; name a folder with"):
        BagReader(tmp_path)
    (tmp_path / "open.mcap").write_bytes(b"")
    with pytest.raises(InputError, match="no closed bag; `ssp bag recover`"):
        BagReader(tmp_path)
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/clock", CLOCK)
    with pytest.raises(InputError, match="no closed bag; there is one in it: ") as caught:
        BagReader(tmp_path)
    assert str(tmp_path / "bag") in str(caught.value)


def test_a_message_that_is_not_of_its_type_names_the_topic(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/clock", CLOCK)
        writer.write("/clock", b"\x00\x01\x00\x00\x01", 3, 3)
    with BagReader(tmp_path / "bag") as reader:
        (message,) = reader.messages()
        with pytest.raises(InputError, match=r"/clock.*at 3 ns that is no rosgraph"):
            reader.decode(message)


@settings(
    max_examples=100,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(fraction=st.floats(0, 1, exclude_max=True))
def test_any_cut_is_an_input_error_and_recovers_whole_chunks(
    bag: Path, tmp_path_factory: pytest.TempPathFactory, fraction: float
) -> None:
    data = (bag / "bag_0.mcap").read_bytes()
    cut = int(fraction * len(data))
    folder = tmp_path_factory.mktemp("cut")
    (folder / "cut.mcap").write_bytes(data[:cut])
    with pytest.raises(InputError, match=r"cut\.mcap"):
        BagReader(folder / "cut.mcap")
    if cut < 8:
        with pytest.raises(InputError, match="is no MCAP file"):
            recover(folder / "cut.mcap", folder / "out")
        return
    report = recover(folder / "cut.mcap", folder / "out")
    seconds = read_everything(folder / "out")
    assert seconds == list(range(report.count))
    assert report.count % PER_CHUNK == 0
    ends = [data.index(at_second(k)) + len(at_second(k)) for k in range(4, 20, 5)]
    assert report.count == PER_CHUNK * sum(end <= cut for end in ends)


# -- bytes changed, cut and moved -----------------------------------------------------------------


def write_bag(path: Path, split: Split | None = None) -> None:
    """A latched topic with two messages, another one with twenty, two attachments."""
    with BagWriter(path, split=split) as writer:
        writer.add_topic(
            "/map", STRING, offered_qos(2, transient_local=True), latched=split is not None
        )
        writer.add_topic("/text", STRING, offered_qos(5))
        writer.write("/map", text("old map"), 10**9, 7, 1)
        writer.write("/map", text("new map"), 10**9, 8, 2)
        for k in range(20):
            writer.write("/text", text(f"number {k}"), (k + 1) * 10**9, k, k)
            if k % 4 == 3:
                writer.flush()
            if k in (5, 13):
                writer.attach(f"{k}.yaml", b"seed: %d\n" % k, "application/yaml")


def contents(path: Path) -> tuple[Counter[BagMessage], Counter[tuple[str, bytes | None]]]:
    with BagReader(path) as reader:
        names = reader.attachments
        return Counter(reader.messages()), Counter((n, reader.attachment(n)) for n in names)


@pytest.fixture(scope="module")
def varied(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("varied") / "bag"
    write_bag(path)
    return path


Change = Callable[[bytes], bytes]
PLACE = st.floats(0, 1, exclude_max=True)


def flipped(place: float, mask: int) -> Change:
    def change(data: bytes) -> bytes:
        at = int(place * len(data))
        return data[:at] + bytes([data[at] ^ mask]) + data[at + 1 :]

    return change


def cut(place: float) -> Change:
    return lambda data: data[: int(place * len(data))]


def over(source: float, length: int, place: float) -> Change:
    """Some bytes over those of another place."""

    def change(data: bytes) -> bytes:
        begin, at = int(source * len(data)), int(place * len(data))
        piece = data[begin : begin + length]
        return data[:at] + piece + data[at + len(piece) :]

    return change


def without(place: float, length: int) -> Change:
    def change(data: bytes) -> bytes:
        at = int(place * len(data))
        return data[:at] + data[at + length :]

    return change


LENGTH = st.integers(1, 1500)
CHANGES = st.one_of(
    st.builds(flipped, PLACE, st.integers(1, 255)),
    st.builds(cut, PLACE),
    st.builds(over, PLACE, st.integers(1, 100), PLACE),
    st.builds(without, PLACE, LENGTH),
)
COMMON = {
    "deadline": None,
    "suppress_health_check": [HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
}


@settings(max_examples=120, **COMMON)
@given(change=CHANGES)
def test_check_finds_a_change_or_nothing_has_changed(
    varied: Path, tmp_path_factory: pytest.TempPathFactory, change: Change
) -> None:
    folder = tmp_path_factory.mktemp("check") / "bag"
    shutil.copytree(varied, folder)
    file = folder / "bag_0.mcap"
    file.write_bytes(change(file.read_bytes()))
    if check_bag(folder).ok:
        assert contents(folder) == contents(varied)


@settings(max_examples=120, **COMMON)
@given(change=CHANGES)
def test_recover_keeps_nothing_but_what_was_there(
    varied: Path, tmp_path_factory: pytest.TempPathFactory, change: Change
) -> None:
    folder = tmp_path_factory.mktemp("recover")
    (folder / "a.mcap").write_bytes(change((varied / "bag_0.mcap").read_bytes()))
    try:
        report = recover(folder / "a.mcap", folder / "new")
    except InputError:
        assert sorted(p.name for p in folder.iterdir()) == ["a.mcap"]
        return
    assert sorted(p.name for p in folder.iterdir()) == ["a.mcap", "new"]
    messages, attachments = contents(varied)
    kept, kept_attachments = contents(folder / "new")
    assert kept <= messages
    assert kept_attachments <= attachments
    assert report.count == kept.total()
    assert report.complete or report.damage
    assert check_bag(folder / "new").ok


@pytest.mark.parametrize("keep_summary", [True, False])
def test_a_damaged_length_costs_its_own_chunk_alone(
    varied: Path, tmp_path: Path, keep_summary: bool
) -> None:
    data = bytearray((varied / "bag_0.mcap").read_bytes())
    seal = data.index(b"digest", data.index(text("number 3")))
    second = data.index(b"\x06", seal + len("digest") + 4 + 64)
    assert int.from_bytes(data[second + 1 : second + 9], "little") < 1000
    data[second + 6] = 0xFF  # of the length
    end = len(data) if keep_summary else data.rindex(text("number 19")) + 200
    (tmp_path / "a.mcap").write_bytes(data[:end])
    report = recover(tmp_path / "a.mcap", tmp_path / "new")
    kept = {m.data for m in contents(tmp_path / "new")[0] if m.topic == "/text"}
    assert kept == {text(f"number {k}") for k in range(20) if not 4 <= k < 6}
    assert f"damaged at byte {second}" in report.damage[0]


def test_repeated_latched_messages_are_recovered_once(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", Split(max_s=6.0))
    write_bag(tmp_path / "whole")
    assert len(list((tmp_path / "bag").glob("*.mcap"))) == 4
    assert check_bag(tmp_path / "bag").ok
    assert recover(tmp_path / "bag", tmp_path / "all").complete
    assert contents(tmp_path / "all")[0] == contents(tmp_path / "whole")[0]
    # Without the file that held them first, the repeated ones are all there is, and are kept once.
    (tmp_path / "bag" / "bag_0.mcap").unlink()
    recover(tmp_path / "bag", tmp_path / "rest")
    maps = [m.data for m in contents(tmp_path / "rest")[0] if m.topic == "/map"]
    assert maps == [text("old map"), text("new map")]


def test_recovering_a_large_file_takes_little_memory(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/text", STRING)
        for k in range(40):
            writer.write("/text", text("x" * (1 << 20)), k, k)
    tracemalloc.start()
    try:
        assert recover(tmp_path / "bag", tmp_path / "new").count == 40
        assert check_bag(tmp_path / "new").problems == ()
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("left", [40, 500, 900])
def test_a_torn_last_chunk_is_not_searched(tmp_path: Path, left: int) -> None:
    """A message may hold a bag itself, of which nothing is kept."""
    write_bag(tmp_path / "inner")
    inner = (tmp_path / "inner" / "inner_0.mcap").read_bytes()
    writer = BagWriter(tmp_path / "bag")
    writer.add_topic("/ours", STRING)
    for message in (b"one", inner + bytes(1000)):
        writer.write("/ours", message, 1, 1)
        writer.flush()
    end = writer.file.stat().st_size - left
    (tmp_path / "torn.mcap").write_bytes(writer.file.read_bytes()[:end])
    writer.close()
    recover(tmp_path / "torn.mcap", tmp_path / "new")
    assert [m.data for m in contents(tmp_path / "new")[0]] == [b"one"]
