"""Bags that others wrote: compressed, without chunks, indexes or statistics, in any order."""

from __future__ import annotations

import itertools
import random
import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC, CompressionType, IndexType, Writer

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.index import ChunkRun, ContentCache, Selection, merged
from ssp_core.bag.reading.mcap_file import McapFile, UnpackBudget
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import BagMessage, definition
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import InputError
from tests.support.bags.messages import text

STRING = "std_msgs/msg/String"
BUDGET = UnpackBudget(1 << 30)
KINDS: dict[str, dict[str, Any]] = {
    "plain": {"compression": CompressionType.NONE},
    "zstd": {"compression": CompressionType.ZSTD},
    "lz4": {"compression": CompressionType.LZ4},
    "no CRC": {"enable_crcs": False},
    "no message index": {"index_types": IndexType.ATTACHMENT | IndexType.CHUNK},
    "no chunk index": {"index_types": IndexType.ATTACHMENT},
    "no chunks": {"use_chunking": False, "enable_data_crcs": True},
    "no statistics": {"use_statistics": False},
    "no chunks, no statistics": {"use_chunking": False, "use_statistics": False},
    "no topics in the summary": {"repeat_channels": False},
    "no types in the summary": {"repeat_schemas": False},
    "no summary": {
        "index_types": IndexType.NONE,
        "use_statistics": False,
        "use_summary_offsets": False,
        "repeat_channels": False,
        "repeat_schemas": False,
    },
}


def some_messages() -> list[BagMessage]:
    """Out of order by up to twenty places, many at equal times, two topics."""
    chance = random.Random(4)
    return [
        BagMessage(
            chance.choice(["/a", "/b"]),
            (k + chance.randrange(20)) // 3,
            chance.randrange(1000),
            chance.randbytes(chance.randrange(400)),
            k,
        )
        for k in range(500)
    ]


def write(path: Path, messages: list[BagMessage], chunk_size: int = 2000, **options: Any) -> None:
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=chunk_size, **options)
        writer.start(profile="ros2")
        schema = writer.register_schema(STRING, "ros2msg", definition(STRING).text.encode())
        channels = {
            topic: writer.register_channel(topic, "cdr", schema)
            for topic in dict.fromkeys(m.topic for m in messages)
        }
        for m in messages:
            writer.add_message(
                channels[m.topic], m.log_time_ns, m.data, m.publish_time_ns, m.sequence
            )
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare


@pytest.mark.parametrize("kind", KINDS)
def test_messages_of_any_kind_of_file_come_in_order(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "file.mcap"
    messages = some_messages()
    write(path, messages, **KINDS[kind])
    expected = sorted(messages, key=lambda m: m.log_time_ns)
    with BagReader(path) as reader:
        assert list(reader.messages()) == expected
        assert {t: info.count for t, info in reader.topics.items()} == {
            t: sum(m.topic == t for m in messages) for t in ("/a", "/b")
        }
        times = [m.log_time_ns for m in messages]
        assert (reader.start_ns, reader.end_ns) == (min(times), max(times))
        part = [m for m in expected if m.topic == "/b" and 40 <= m.log_time_ns < 60]
        assert list(reader.messages(["/b"], 40, 60)) == part
        assert list(reader.messages(["/c"])) == []


@pytest.mark.parametrize("kind", KINDS)
def test_any_kind_of_file_is_sound_and_recovered_whole(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "file.mcap"
    messages = [m._replace(data=text(f"number {m.sequence}")) for m in some_messages()]
    write(path, messages, **KINDS[kind])
    assert check_bag(path).problems == ()
    assert recover(path, tmp_path / "bag").complete
    with BagReader(tmp_path / "bag") as reader:
        assert list(reader.messages()) == sorted(messages, key=lambda m: m.log_time_ns)


@pytest.mark.parametrize("kind", ["plain", "no summary", "no chunks"])
def test_attachments_of_any_kind_of_file_are_found(tmp_path: Path, kind: str) -> None:
    path = tmp_path / "file.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, **KINDS[kind])
        writer.start(profile="ros2")
        writer.add_attachment(1, 2, "a.yaml", "text/plain", b"data")
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare
    with BagReader(path) as reader:
        assert reader.attachments == ("a.yaml",)
        assert reader.attachment("a.yaml") == b"data"


@pytest.mark.parametrize("kind", KINDS)
def test_an_empty_file_of_any_kind_is_empty(tmp_path: Path, kind: str) -> None:
    write(tmp_path / "file.mcap", [], **KINDS[kind])
    with BagReader(tmp_path / "file.mcap") as reader:
        assert (reader.count, reader.start_ns, list(reader.messages())) == (0, None, [])


def test_only_chunks_with_wanted_messages_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    loaded = []
    load = ChunkRun.load

    def counted(run: ChunkRun) -> memoryview:
        loaded.append(run.start_ns)
        return load(run)

    monkeypatch.setattr(ChunkRun, "load", counted)
    with BagWriter(tmp_path / "bag") as writer:
        for topic in ("/rare", "/often"):
            writer.add_topic(topic, STRING)
        for k in range(100):
            writer.write("/often", bytes(50), k, k)
            if k in (22, 71):
                writer.write("/rare", bytes(50), k, k)
            if k % 10 == 9:
                writer.flush()
    with BagReader(tmp_path / "bag") as reader:
        assert [m.log_time_ns for m in reader.messages(["/rare"])] == [22, 71]
        assert loaded == [20, 70]
        # The chunk overlaps the times and has the topic, but nothing of it in them.
        assert list(reader.messages(["/rare"], 23, 30)) == []
        assert len(list(reader.messages(start_ns=38, stop_ns=42))) == 4
    assert loaded == [20, 70, 30, 40]


def test_a_chunk_is_read_when_its_time_comes_and_dropped_behind_it(tmp_path: Path) -> None:
    messages = [BagMessage("/a", k, k, bytes(1000), k) for k in range(200)]
    path = tmp_path / "file.mcap"
    write(path, messages, compression=CompressionType.NONE)
    file, cache = McapFile(path), ContentCache(BUDGET)
    wanted = Selection({1: "/a"}, None, None)
    chunks = [ChunkRun(file, index, wanted, cache) for index in file.summary.chunk_indexes]
    assert len(chunks) > 50
    assert {len(cache) for _ in merged(chunks)} == {1}
    assert len(cache) == 0


def test_chunks_that_all_overlap_are_read_in_bounded_memory(tmp_path: Path) -> None:
    # Each chunk begins at time 0, so all are open at once.
    messages = [BagMessage("/a", (k % 20) * 1000 + k, k, bytes(1000), k) for k in range(200)]
    path = tmp_path / "file.mcap"
    write(path, messages, chunk_size=20_000, compression=CompressionType.ZSTD)
    file, cache = McapFile(path), ContentCache(BUDGET, limit_bytes=70_000)
    chunks = [
        ChunkRun(file, index, Selection({1: "/a"}, None, None), cache)
        for index in file.summary.chunk_indexes
    ]
    held, found = [], []
    for message in merged(chunks):
        found.append(message)
        held.append(len(cache))
    assert found == sorted(messages, key=lambda m: m.log_time_ns)
    assert max(held) == 3


def damage_index(data: bytes, change: Callable[[bytearray, int], None]) -> bytes:
    """A file's bytes with something changed at the first MessageIndex record."""
    head = struct.pack("<BQH", 7, 6 + 16 * 3, 1)
    changed = bytearray(data)
    change(changed, data.index(head))
    return bytes(changed)


def set_bytes(at: int, value: bytes) -> Callable[[bytearray, int], None]:
    def change(data: bytearray, begin: int) -> None:
        data[begin + at : begin + at + len(value)] = value

    return change


@pytest.mark.parametrize(
    ("change", "match"),
    [
        (set_bytes(0, b"\x08"), "the message index of channel 1 is damaged"),
        (set_bytes(9, b"\x02"), "the message index of channel 1 is damaged"),
        (set_bytes(11, b"\x20"), "the message index of channel 1 is damaged"),
        (set_bytes(15, b"\x01"), "no message of 1 ns where the index has one"),
        (set_bytes(15, b"\x09"), "outside the times of its index"),
        (set_bytes(23, b"\x01"), "no message of 0 ns where the index has one"),
        (set_bytes(29, b"\xff"), "no message of 0 ns|unpack_from requires"),
    ],
)
def test_a_wrong_message_index_is_noticed(
    tmp_path: Path, change: Callable[[bytearray, int], None], match: str
) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/x", STRING)
        for k in range(3):
            writer.write("/x", b"x", k, k)
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damage_index(writer.file.read_bytes(), change))
    with (
        BagReader(path) as reader,
        pytest.raises(InputError, match=rf"damaged\.mcap: is damaged: .*({match})"),
    ):
        list(reader.messages())


def test_a_wrong_crc_of_a_file_without_chunks_is_noticed(tmp_path: Path) -> None:
    path = tmp_path / "file.mcap"
    write(path, [BagMessage("/a", 1, 1, b"hello")], use_chunking=False, enable_data_crcs=True)
    path.write_bytes(path.read_bytes().replace(b"hello", b"hallo"))
    with pytest.raises(InputError, match="the CRC of the data is wrong"):
        BagReader(path)


@pytest.mark.parametrize("kind", ["no summary", "no chunks, no statistics"])
def test_what_is_wrong_in_a_file_without_an_index_is_named_with_its_record(
    tmp_path: Path, kind: str
) -> None:
    path = tmp_path / "file.mcap"
    write(path, [BagMessage("/a", 1, 1, b"hello")], **KINDS[kind])
    data = bytearray(path.read_bytes())
    opcode = Opcode.CHUNK if kind == "no summary" else Opcode.MESSAGE
    at = len(MCAP0_MAGIC)
    while data[at] != opcode:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    data[at + 7] = 1  # of the length
    path.write_bytes(data)
    match = rf"file\.mcap: is damaged: record at byte {at}: the file ends within a record"
    with pytest.raises(InputError, match=match):
        BagReader(path)


def test_messages_of_a_topic_that_no_record_names_are_no_bag(tmp_path: Path) -> None:
    path = tmp_path / "file.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream, use_chunking=False)
        writer.start(profile="ros2")
        writer.add_message(7, 1, b"hello", 1)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare
    with pytest.raises(InputError, match="channel 7 has messages and no topic"):
        BagReader(path)


def test_a_file_that_vanishes_while_it_is_read_is_an_input_error(tmp_path: Path) -> None:
    path = tmp_path / "file.mcap"
    write(path, some_messages())
    with BagReader(path) as reader:
        messages = reader.messages()
        first = list(itertools.islice(messages, 3))
        assert len(first) == 3
        path.unlink()
        with pytest.raises(InputError, match=r"file\.mcap: can't be read: No such file"):
            list(messages)


def test_a_bag_of_many_files_keeps_none_open(tmp_path: Path) -> None:
    for kind in ("plain", "no chunks"):
        write(tmp_path / f"{kind}.mcap", some_messages(), **KINDS[kind])
        with BagReader(tmp_path / f"{kind}.mcap") as reader:
            messages = reader.messages()
            next(messages)
            del messages
            open_files = [f.resolve() for f in Path("/proc/self/fd").iterdir() if f.exists()]
            assert not [f for f in open_files if tmp_path in f.parents]
