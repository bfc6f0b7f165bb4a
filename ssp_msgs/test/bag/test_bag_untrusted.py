"""Bags from elsewhere: lengths and sizes that lie are named errors.

Whatever a file claims, reading, checking and recovering it take bounded memory and time. What could
flood or hang runs in a child with limits.
"""

from __future__ import annotations

import struct
from pathlib import Path

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    Message,
    Schema,
    Statistics,
)
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.operations import repair
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading import mcap_file
from ssp_core.bag.reading.mcap_file import (
    ANY_RATIO_BYTES,
    ANY_TOTAL_BYTES,
    MAX_CHUNK_BYTES,
    MAX_CHUNK_RECORDS,
    MAX_RATIO,
    MAX_RECORD_BYTES,
    UnpackBudget,
    check_summary,
)
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.writing.chain import record_bytes
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import InputError
from tests.support.bags.messages import STRING
from tests.support.bags.untrusted import (
    CHANNEL,
    MESSAGE,
    SCHEMA,
    TEXT,
    ZEROS,
    file_bytes,
    file_of,
    use,
    use_file,
)

# -- lengths --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("content", "claimed", "compression", "match"),
    [
        (MESSAGE, 7, "", "a chunk claims 7 bytes"),
        (MESSAGE[:-1], len(MESSAGE) - 1, "", "a record of"),
        (MESSAGE + b"\5\0", len(MESSAGE) + 2, "", "ends within a record"),
        (MESSAGE, len(MESSAGE), "brotli", "compression 'brotli' is unknown"),
        (MESSAGE, len(MESSAGE), "\x1b[2J", "is unknown"),
        (MESSAGE, len(MESSAGE), "zstd", "doesn't unpack"),
        (MESSAGE, len(MESSAGE), "lz4", "doesn't unpack"),
        (zstandard.compress(ZEROS), 1000, "zstd", "unpacks to more than the 1000 bytes"),
        (lz4.frame.compress(ZEROS), 1000, "lz4", "unpacks to more than the 1000 bytes"),
        (zstandard.compress(ZEROS), 1 << 21, "zstd", "unpacks to less"),
        (zstandard.compress(ZEROS), MAX_CHUNK_BYTES, "zstd", "more than 1000 times as many"),
        (zstandard.compress(ZEROS), MAX_CHUNK_BYTES + 1, "zstd", "are not read"),
        (zstandard.compress(ZEROS), 1 << 62, "zstd", "are not read"),
        (record_bytes(Message(7, 0, TEXT, 0, 0)), len(MESSAGE), "", "channel 7"),
    ],
)
def test_a_chunk_that_lies_is_named(
    content: bytes, claimed: int, compression: str, match: str, tmp_path: Path
) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(file_of(Chunk(compression, content, 0, 0, 0, claimed)))
    report = check_bag(path)
    assert not report.ok
    assert "a.mcap" in report.problems[0]
    kept = recover(path, tmp_path / "new")
    assert "record at byte" in kept.damage[0]
    assert match in kept.damage[0]


@pytest.mark.parametrize(
    ("opcode", "length"),
    [(Opcode.CHUNK, 1 << 40), (Opcode.ATTACHMENT, (1 << 64) - 1), (0xFF, (1 << 64) - 1)],
)
def test_an_absurd_length_is_not_read(opcode: int, length: int, tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(file_bytes([SCHEMA, CHANNEL, struct.pack("<BQ", opcode, length), MESSAGE]))
    with pytest.raises(InputError, match="record at byte 130: the file ends within a record"):
        BagReader(path)
    assert "the file ends within a record" in recover(path, tmp_path / "new").damage[0]


def test_an_attachment_beyond_the_file_is_refused(tmp_path: Path) -> None:
    places = [(8, 1 << 40), (1 << 62, 10), ((1 << 64) - 1, (1 << 64) - 1), (8, 0)]
    for number, (offset, length) in enumerate(places):
        path = tmp_path / f"{number}.mcap"
        index = AttachmentIndex(offset, length, 0, 0, 5, "a", "b")
        path.write_bytes(file_bytes([], [Statistics(1, 0, {}, 0, 0, 0, 0, 0, 0), index]))
        with pytest.raises(InputError, match=rf"{number}\.mcap.*points beyond the data"):
            BagReader(path)


# -- what would flood or hang ---------------------------------------------------------------------

# What a person would do with a bag, each with its outcome on a line; nothing else may escape.


@pytest.fixture(scope="module")
def plain_mb(tmp_path_factory: pytest.TempPathFactory) -> float:
    """Peak memory of the same program over a sound bag."""
    path = tmp_path_factory.mktemp("plain") / "bag"
    with BagWriter(path) as writer:
        writer.add_topic("/text", STRING)
        writer.write("/text", TEXT, 1, 1)
    used = use(path)
    assert used[:3] == ("READ 1", "CHECK ()", "RECOVER 1 ()")
    return used.peak_mb


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("claimed", [1000, MAX_CHUNK_BYTES])
def test_a_bomb_unpacks_no_further_than_it_is_believed(
    compression: str, claimed: int, tmp_path: Path, plain_mb: float
) -> None:
    zeros = bytes(512 << 20)
    packed = zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)
    used = use_file(tmp_path, file_of(Chunk(compression, packed, 0, 0, 0, claimed)))
    assert "a.mcap" in used.read
    assert "record at byte" in used.recovered
    # lz4 reaches 255 times, so that half a GiB of it is believed where it claims as much.
    limit_mb = 600 if (compression, claimed) == ("lz4", MAX_CHUNK_BYTES) else 64
    assert used.peak_mb < plain_mb + limit_mb


def test_the_record_of_a_bomb_is_named(tmp_path: Path) -> None:
    packed = zstandard.compress(bytes(MAX_CHUNK_BYTES // 64)) * 64
    data = file_of(Chunk("zstd", packed, 0, 0, 0, MAX_CHUNK_BYTES))
    path = tmp_path / "a.mcap"
    path.write_bytes(data)
    at = data.index(packed) - 53
    why = rf"claims to unpack from {len(packed)} to {MAX_CHUNK_BYTES} bytes, more than 1000 times"
    with pytest.raises(InputError, match=rf"a\.mcap: is damaged: record at byte {at}: .*{why}"):
        BagReader(path)
    assert f"record at byte {at} " in recover(path, tmp_path / "new").damage[0]


def test_a_well_packed_message_of_100_mb_is_read(tmp_path: Path) -> None:
    size = 100 << 20
    black = b"\0\1\0\0" + struct.pack("<I", size) + b" " * (size - 1) + b"\0"
    content = record_bytes(Message(1, 0, black, 0, 0))
    assert len(content) < ANY_RATIO_BYTES
    packed = zstandard.compress(content)
    assert len(packed) * MAX_RATIO < len(content)
    used = use_file(tmp_path, file_of(Chunk("zstd", packed, 0, 0, 0, len(content))))
    assert "RECOVER 1 ()" in used.recovered
    assert used.peak_mb < 1200


def test_a_chunk_indexed_a_hundred_thousand_times_is_refused(tmp_path: Path) -> None:
    content = MESSAGE * 1000
    used = use_file(tmp_path, file_of(Chunk("", content, 0, 0, 0, len(content)), indexes=100_000))
    assert "two chunk indexes for the bytes from" in used.read
    assert "RECOVER 1000" in used.recovered


def test_what_looks_like_chunks_is_not_searched_for_ever(tmp_path: Path) -> None:
    # 250,000 beginnings of a chunk that each claim the rest of the file.
    count = 250_000
    size = count * 49
    pieces = [
        struct.pack(
            "<BQQQQIIQ",
            Opcode.CHUNK,
            size - k * 49 - 9,
            0,
            0,
            size - k * 49 - 49,
            1,
            0,
            size - k * 49 - 49,
        )
        for k in range(count)
    ]
    data = file_bytes([SCHEMA, CHANNEL, b"\x40" * 9, *pieces])
    tail = len(data) - len(MCAP0_MAGIC) - 29 - 13
    (tmp_path / "a.mcap").write_bytes(data[:tail])
    used = use(tmp_path / "a.mcap")
    assert "found no record behind it" in used.recovered


def test_of_very_many_damaged_places_the_first_are_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(repair, "_MAX_DAMAGE", 3)
    unknown = record_bytes(Message(7, 0, TEXT, 0, 0))
    (tmp_path / "a.mcap").write_bytes(file_bytes([SCHEMA, CHANNEL, *[unknown] * 10]))
    damage = recover(tmp_path / "a.mcap", tmp_path / "new").damage
    assert len(damage) == 4
    assert damage[-1] == "7 more places"


def test_names_in_the_data_are_bounded_together(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_file, "MAX_SUMMARY_BYTES", 1000)
    many = [Channel(k, "/" + "x" * 100, "cdr", {}, 1) for k in range(2, 20)]
    (tmp_path / "a.mcap").write_bytes(file_bytes([SCHEMA, CHANNEL, MESSAGE, *many]))
    report = recover(tmp_path / "a.mcap", tmp_path / "new")
    assert report.count == 1
    assert "topics and types of more than 1000 bytes" in report.damage[0]


DATA_END = 1 << 40


def summary(*chunks: ChunkIndex) -> Summary:
    made = Summary()
    made.chunk_indexes += chunks
    return made


def chunk_index(offset: int, unpacked: int, index_bytes: int = 0) -> ChunkIndex:
    packed = -(-unpacked // MAX_RATIO)
    return ChunkIndex(packed + 41, offset, "zstd", packed, 0, index_bytes, {}, 0, unpacked)


def test_what_all_chunks_unpack_to_is_bounded_by_the_file() -> None:
    chunks = [chunk_index(8 + (k << 30), MAX_CHUNK_BYTES) for k in range(5)]
    check_summary(summary(*chunks[:4]), DATA_END, 0)
    fifth = f"record at byte {8 + (4 << 30)}: .* unpack to more than {ANY_TOTAL_BYTES} bytes"
    with pytest.raises(ValueError, match=fifth):
        check_summary(summary(*chunks), DATA_END, 0)
    check_summary(summary(*chunks), DATA_END, 1 + (1 << 30) // MAX_RATIO)
    budget = UnpackBudget(10, ratio=2)
    budget.take(ANY_TOTAL_BYTES + 20)
    with pytest.raises(ValueError, match="unpack to more than"):
        budget.take(1)


def test_the_sum_is_bounded_in_check_and_recover_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(mcap_file, "ANY_TOTAL_BYTES", 1 << 20)
    content = struct.pack("<BQ", 0x80, len(ZEROS) * 2) + ZEROS * 2
    chunk = Chunk("zstd", zstandard.compress(content), 0, 0, 0, len(content))
    empty = Statistics(1, 0, {}, 0, 0, 0, 0, 0, 0)
    data = file_bytes([chunk] * 8, [empty])
    (tmp_path / "a.mcap").write_bytes(data)
    (problem,) = check_bag(tmp_path / "a.mcap").problems
    assert "record at byte" in problem
    assert "the chunks up to here unpack to more than" in problem
    damage = recover(tmp_path / "a.mcap", tmp_path / "new").damage
    assert "the chunks up to here unpack to more than" in damage[-1]


def test_an_index_of_messages_belongs_to_one_chunk() -> None:
    one = chunk_index(8, 1000, index_bytes=100)
    check_summary(summary(one, chunk_index(8 + one.chunk_length + 100, 1000)), DATA_END, 0)
    with pytest.raises(ValueError, match="two chunk indexes for the bytes from"):
        check_summary(summary(one, chunk_index(8 + one.chunk_length + 99, 1000)), DATA_END, 0)


def test_a_chunk_has_no_more_messages_than_can_be_put_in_order(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    check_summary(summary(chunk_index(8, 1000, 16 * MAX_CHUNK_RECORDS)), DATA_END, 0)
    with pytest.raises(ValueError, match=f"more than {MAX_CHUNK_RECORDS} messages"):
        check_summary(summary(chunk_index(8, 1000, 16 * MAX_CHUNK_RECORDS + 1)), DATA_END, 0)
    monkeypatch.setattr(mcap_file, "MAX_CHUNK_RECORDS", 5)
    assert len(list(mcap_file.inner_records(memoryview(MESSAGE * 5)))) == 5
    with pytest.raises(ValueError, match="a chunk of more than 5 records"):
        list(mcap_file.inner_records(memoryview(MESSAGE * 6)))


def test_attachments_and_definitions_have_sizes_that_are_read(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made = summary()
    made.attachment_indexes.append(AttachmentIndex(8, MAX_RECORD_BYTES, 0, 0, 9, "video", "a/b"))
    check_summary(made, DATA_END, 0)
    made.attachment_indexes[0].length += 1
    with pytest.raises(ValueError, match="attachment 'video' has"):
        check_summary(made, DATA_END, 0)
    monkeypatch.setattr(mcap_file, "MAX_SCHEMAS_BYTES", 10)
    made = summary()
    made.schemas |= {k: Schema(k, b"12345", "ros2msg", "a/msg/B") for k in (1, 2)}
    check_summary(made, DATA_END, 0)
    made.schemas[3] = Schema(3, b"1", "ros2msg", "a/msg/C")
    with pytest.raises(ValueError, match="11 bytes of message definitions, more than 10"):
        check_summary(made, DATA_END, 0)
