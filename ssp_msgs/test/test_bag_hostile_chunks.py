"""Chunks, lengths and indexes that lie: an error that names the place, in bounded time and memory.

Whatever a file claims, reading, checking and recovering it take a fixed amount of memory above what
it really holds. Each case runs in a child, so that a hang or a flood fails instead of taking the
test session with it.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lz4.frame  # type: ignore[import-untyped]
import pytest
import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    McapRecord,
    Message,
    Schema,
    Statistics,
)

from ssp_core.bag.check import check_bag
from ssp_core.bag.mcap_file import ANY_RATIO_BYTES, MAX_CHUNK_BYTES
from ssp_core.bag.mcap_output import record_bytes
from ssp_core.bag.reader import BagReader
from ssp_core.bag.repair import recover
from ssp_core.bag.types import definition
from ssp_core.errors import InputError

STRING = "std_msgs/msg/String"
SCHEMA = Schema(1, definition(STRING).text.encode(), "ros2msg", STRING)
CHANNEL = Channel(1, "/text", "cdr", {}, 1)
TEXT = b"\0\1\0\0\5\0\0\0text\0"
MIB = 1 << 20

# What a person would do with a bag, each with its outcome on a line; nothing else may escape.
USE = """
import sys
from pathlib import Path
from ssp_core.bag.reader import BagReader
from ssp_core.bag.repair import recover
from ssp_core.bag.check import check_bag
from ssp_core.errors import InputError
path = Path(sys.argv[1])
try:
    with BagReader(path) as reader:
        print("READ", sum(1 for _ in reader.messages()))
except InputError as error:
    print("READ", error)
print("CHECK", check_bag(path).problems)
try:
    report = recover(path, path.parent / "new")
    print("RECOVER", report.count, report.damage)
except InputError as error:
    print("RECOVER", error)
"""

Build = Callable[..., bytes]
Limited = Callable[..., Any]


def message(k: int = 0, data: bytes = TEXT) -> bytes:
    return record_bytes(Message(1, k, data, k, k))


def chunk(data: bytes, size: int, compression: str = "", first: int = 0, last: int = 0) -> Chunk:
    return Chunk(compression, data, last, first, 0, size)


def index(chunk_at: int, record: Chunk) -> ChunkIndex:
    length = len(record_bytes(record))
    return ChunkIndex(
        chunk_length=length,
        chunk_start_offset=chunk_at,
        compression=record.compression,
        compressed_size=len(record.data),
        message_end_time=record.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=record.message_start_time,
        uncompressed_size=record.uncompressed_size,
    )


def file_of(build: Build, record: Chunk, *, indexes: int = 1) -> bytes:
    """A closed file with one chunk, indexed once or more often."""
    names: list[McapRecord] = [SCHEMA, CHANNEL]
    at = build([*names, record]).index(record_bytes(record))
    return build([*names, record], [*names, *[index(at, record)] * indexes])


def use(limited: Limited, folder: Path, data: bytes) -> Any:
    (folder / "a.mcap").write_bytes(data)
    return limited(USE, folder / "a.mcap")


@pytest.fixture(scope="module")
def plain_mb(
    limited: Limited, tmp_path_factory: pytest.TempPathFactory, mcap_bytes: Build
) -> float:
    """Peak memory of the same program over a sound file of three messages."""
    record = chunk(b"".join(map(message, range(3))), 3 * len(message()), last=2)
    ended = use(limited, tmp_path_factory.mktemp("plain"), file_of(mcap_bytes, record))
    assert "READ 3" in ended.out
    assert "CHECK ()" in ended.out
    assert "RECOVER 3" in ended.out
    return float(ended.peak_mb)


@pytest.mark.parametrize("compression", ["zstd", "lz4"])
@pytest.mark.parametrize("claimed", [1000, MAX_CHUNK_BYTES, MAX_CHUNK_BYTES + 1, 1 << 62])
def test_a_bomb_unpacks_no_further_than_it_is_believed(
    compression: str, claimed: int, limited: Limited, tmp_path: Path, mcap_bytes: Build,
    plain_mb: float,
) -> None:  # fmt: skip
    zeros = bytes(512 * MIB)
    packed = zstandard.compress(zeros) if compression == "zstd" else lz4.frame.compress(zeros)
    ended = use(limited, tmp_path, file_of(mcap_bytes, chunk(packed, claimed, compression)))
    assert "READ" in ended.out
    assert "a.mcap" in ended.out.partition("CHECK")[0]
    assert "record at byte" in ended.out.partition("RECOVER")[2]
    # lz4 reaches 255 times, so that half a GiB of it is believed where it claims as much.
    limit_mb = 1200 if (compression, claimed) == ("lz4", MAX_CHUNK_BYTES) else 64
    assert ended.peak_mb < plain_mb + limit_mb


def test_a_well_packed_message_of_100_mb_is_read(
    limited: Limited, tmp_path: Path, mcap_bytes: Build
) -> None:
    size = 100 * MIB
    black = b"\0\1\0\0" + struct.pack("<I", size) + b" " * (size - 1) + b"\0"
    content = message(0, black)
    assert len(content) < ANY_RATIO_BYTES
    packed = zstandard.compress(content)
    assert len(packed) * 1000 < len(content)
    ended = use(limited, tmp_path, file_of(mcap_bytes, chunk(packed, len(content), "zstd")))
    assert "READ 1" in ended.out
    assert "CHECK ()" in ended.out
    assert "RECOVER 1" in ended.out
    assert ended.peak_mb < 1200


def test_a_chunk_indexed_a_hundred_thousand_times_is_refused(
    limited: Limited, tmp_path: Path, mcap_bytes: Build
) -> None:
    content = b"".join(map(message, range(1000)))
    data = file_of(mcap_bytes, chunk(content, len(content), last=999), indexes=100_000)
    ended = use(limited, tmp_path, data)
    assert "two chunk indexes for the bytes from" in ended.out
    assert "RECOVER 1000" in ended.out


@pytest.mark.parametrize(
    ("record", "match"),
    [
        (chunk(message(), 7), "a chunk claims 7 bytes"),
        (chunk(message()[:-1], len(message()) - 1), "a record of"),
        (chunk(message() + b"\5\0", len(message()) + 2), "ends within a record"),
        (chunk(message(), len(message()), "brotli"), "compression 'brotli' is unknown"),
        (chunk(message(), len(message()), "\x1b[2J"), "is unknown"),
        (chunk(message(), len(message()), "zstd"), "doesn't unpack"),
        (chunk(message(), len(message()), "lz4"), "doesn't unpack"),
        (chunk(record_bytes(Message(7, 0, TEXT, 0, 0)), len(message())), "channel 7"),
    ],
)
def test_a_chunk_that_lies_is_named(
    record: Chunk, match: str, tmp_path: Path, mcap_bytes: Build
) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(file_of(mcap_bytes, record))
    report = check_bag(path)
    assert not report.ok
    assert "a.mcap" in report.problems[0]
    kept = recover(path, tmp_path / "new")
    assert len(kept.damage) >= 1
    assert "record at byte" in kept.damage[0]
    assert match in kept.damage[0]


@pytest.mark.parametrize(
    ("opcode", "length"),
    [(Opcode.CHUNK, 1 << 40), (Opcode.ATTACHMENT, (1 << 64) - 1), (0xFF, (1 << 64) - 1)],
)
def test_an_absurd_length_is_not_read(
    opcode: int, length: int, limited: Limited, tmp_path: Path, mcap_bytes: Build, plain_mb: float
) -> None:
    content = b"".join(map(message, range(3)))
    whole = chunk(content, len(content), last=2)
    data = mcap_bytes([SCHEMA, CHANNEL, struct.pack("<BQ", opcode, length), whole])
    ended = use(limited, tmp_path, data)
    assert "READ" in ended.out
    assert "no summary section" in ended.out
    assert ended.peak_mb < plain_mb + 64


def test_an_attachment_beyond_the_file_is_refused(tmp_path: Path, mcap_bytes: Build) -> None:
    places = [(8, 1 << 40), (1 << 63, 10), ((1 << 64) - 1, (1 << 64) - 1), (8, 0)]
    for number, (offset, length) in enumerate(places):
        path = tmp_path / f"{number}.mcap"
        path.write_bytes(mcap_bytes([], [AttachmentIndex(offset, length, 0, 0, 5, "a", "b")]))
        with pytest.raises(InputError, match=rf"{number}\.mcap.*points beyond the data"):
            BagReader(path)


def test_counts_of_a_file_without_statistics_take_one_pass(
    limited: Limited, tmp_path: Path, mcap_bytes: Build
) -> None:
    # 20,000 channels times 300 chunks would be six million passes through a chunk.
    content = b"".join(map(message, range(100)))
    chunks = [chunk(content, len(content), last=99)] * 300
    names: list[McapRecord] = [SCHEMA, *(Channel(k, f"/t{k}", "cdr", {}, 1) for k in range(20_000))]
    at = len(mcap_bytes(names)) - len(mcap_bytes([])) + len(mcap_bytes([]).partition(b"\x0f")[0])
    length = len(record_bytes(chunks[0]))
    indexes = [index(at + k * length, one) for k, one in enumerate(chunks)]
    (tmp_path / "a.mcap").write_bytes(mcap_bytes([*names, *chunks], [*names, *indexes]))
    code = (
        "import sys\nfrom ssp_core.bag.reader import BagReader\n"
        "print('COUNT', BagReader(sys.argv[1]).count)"
    )
    assert "COUNT 30000" in limited(code, tmp_path / "a.mcap").out


def test_a_claim_of_messages_that_are_not_there_is_found(tmp_path: Path, mcap_bytes: Build) -> None:
    record = chunk(message(), len(message()))
    names: list[McapRecord] = [SCHEMA, CHANNEL]
    at = mcap_bytes([*names, record]).index(record_bytes(record))
    claim = Statistics(0, 1, {1: 10**15}, 1, 10**15, 2**64 - 1, 0, 0, 1)
    path = tmp_path / "a.mcap"
    path.write_bytes(mcap_bytes([*names, record], [*names, claim, index(at, record)]))
    assert check_bag(path).problems == (
        "/text: 1 messages stored, 1000000000000000 in the summary",
    )
