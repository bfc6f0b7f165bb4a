"""Bags from elsewhere: lengths, names, texts and definitions that lie are named errors.

Whatever a file claims, reading, checking and recovering it take bounded memory and time. What could
flood or hang runs in a child with limits.
"""

from __future__ import annotations

import os
import resource
import struct
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import lz4.frame  # type: ignore[import-untyped]
import pytest
import yaml
import zstandard
from mcap.opcode import Opcode
from mcap.records import (
    AttachmentIndex,
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    Schema,
    Statistics,
)
from mcap.summary import Summary
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag import mcap_file, repair
from ssp_core.bag.chain import record_bytes
from ssp_core.bag.check import check_bag
from ssp_core.bag.mcap_file import (
    ANY_RATIO_BYTES,
    ANY_TOTAL_BYTES,
    MAX_CHUNK_BYTES,
    MAX_CHUNK_RECORDS,
    MAX_RATIO,
    MAX_RECORD_BYTES,
    UnpackBudget,
    check_summary,
)
from ssp_core.bag.metadata import MAX_TEXT, parse_offered_qos
from ssp_core.bag.reader import BagReader
from ssp_core.bag.repair import recover
from ssp_core.bag.types import (
    MAX_DECODED_BYTES,
    MAX_TEXT_BYTES,
    TypeDefinition,
    definition,
    growth_of,
    store_from,
    typestore,
)
from ssp_core.bag.writer import BagWriter
from ssp_core.cli import main
from ssp_core.errors import InputError
from support.bags import STRING, text

SCHEMA = Schema(1, definition(STRING).text.encode(), "ros2msg", STRING)
CHANNEL = Channel(1, "/text", "cdr", {}, 1)
TEXT = text("text")
MESSAGE = record_bytes(Message(1, 0, TEXT, 0, 0))
ZEROS = bytes(1 << 20)


def file_bytes(data: Sequence[McapRecord | bytes], summary: Sequence[McapRecord] = ()) -> bytes:
    """A closed file of these records, whatever they claim; without CRCs."""
    head = MCAP0_MAGIC + record_bytes(Header("ros2", "hostile"))
    head += b"".join(d if isinstance(d, bytes) else record_bytes(d) for d in data)
    head += record_bytes(DataEnd(0))
    start = len(head) if summary else 0
    return head + record_bytes(*summary) + record_bytes(Footer(start, 0, 0)) + MCAP0_MAGIC


def file_of(record: Chunk, *, indexes: int = 1) -> bytes:
    """A closed file with one chunk, indexed once or more often."""
    names: list[McapRecord] = [SCHEMA, CHANNEL]
    offset = file_bytes([*names, record]).index(record_bytes(record))
    index = ChunkIndex(
        chunk_length=len(record_bytes(record)),
        chunk_start_offset=offset,
        compression=record.compression,
        compressed_size=len(record.data),
        message_end_time=record.message_end_time,
        message_index_length=0,
        message_index_offsets={},
        message_start_time=record.message_start_time,
        uncompressed_size=record.uncompressed_size,
    )
    return file_bytes([*names, record], [*names, *[index] * indexes])


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
# Of this process alone: what getrusage says begins with the peak of the process that started it.
print("PEAK", open("/proc/self/status").read().split("VmHWM:")[1].split()[0])
"""


class Used(NamedTuple):
    read: str
    checked: str
    recovered: str
    peak_mb: float


def use(path: Path) -> Used:
    """Reads, checks and recovers a bag in a child that has a minute and 4 GiB of addresses."""
    done = subprocess.run(
        [sys.executable, "-c", USE, path],
        capture_output=True,
        text=True,
        timeout=60,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30)),
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    read, checked, recovered, peak = done.stdout.splitlines()
    return Used(read, checked, recovered, int(peak.removeprefix("PEAK ")) / 1024)


def use_file(folder: Path, data: bytes) -> Used:
    (folder / "a.mcap").write_bytes(data)
    return use(folder / "a.mcap")


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


# -- names and texts ------------------------------------------------------------------------------

NAMES = [
    "/../../etc/passwd",
    "../../outside",
    "/nul\0byte",
    "/clear\x1b[2J\x1b]0;owned\x07",
    "/turned\u202eround",
    "/line\nbreak",
    "[red]markup[/]",
    "/" + "long" * 20_000,
    "",
    "/\ufeff\ufffe\x85\u2028",
    "&a *a !!python/object:os.system",
]


@pytest.fixture(scope="module")
def named(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag whose topics and attachments have those names."""
    path = tmp_path_factory.mktemp("named") / "bag"
    with BagWriter(path) as writer:
        for name in NAMES:
            writer.add_topic(name, STRING)
            writer.write(name, TEXT, 1, 1)
            writer.attach(name, b"data", "text/plain")
    return path


def test_any_name_is_a_name(named: Path, tmp_path: Path) -> None:
    assert check_bag(named).ok
    assert recover(named, tmp_path / "new").complete
    assert check_bag(tmp_path / "new").ok
    with BagReader(tmp_path / "new") as reader:
        assert set(reader.topics) == set(NAMES)
        assert list(reader.attachments) == NAMES
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["metadata.yaml", "new", "new_0.mcap"]


@pytest.mark.parametrize("verb", ["info", "check"])
def test_no_name_steers_the_terminal(
    named: Path, verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["bag", verb, str(named)]) == 0
    printed = "".join(capsys.readouterr())
    assert not set(printed) & {"\x1b", "\x07", "\0", "\u202e"}
    if verb == "info":
        assert "/clear\\x1b[2J\\x1b]0;owned\\x07" in printed
        assert "[red]markup[/]" in printed


def metadata_of(folder: Path, *names: str) -> None:
    information = {
        "storage_identifier": "mcap",
        "relative_file_paths": list(names),
        "message_count": 0,
        "topics_with_message_count": [],
    }
    (folder / "metadata.yaml").write_text(
        yaml.safe_dump({"rosbag2_bagfile_information": information})
    )


def test_the_metadata_of_a_bag_names_no_file_outside_its_folder(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "outside") as writer:
        writer.add_topic("/secret", STRING)
    secret = tmp_path / "outside" / "outside_0.mcap"
    folder = tmp_path / "bag"
    folder.mkdir()
    os.mkfifo(folder / "b.mcap")
    wrong = ("../outside/outside_0.mcap", str(secret), "", "..", "/", "a\0", "b.mcap")
    for name in wrong:
        metadata_of(folder, name)
        with pytest.raises(InputError, match=r"metadata\.yaml: names .*which is no"):
            BagReader(folder)
    # Who may put a link into the folder may put the file there too: links are followed.
    os.symlink(secret, folder / "a.mcap")
    metadata_of(folder, "a.mcap")
    with BagReader(folder) as reader:
        assert list(reader.topics) == ["/secret"]
    metadata_of(folder, *["a.mcap"] * 1000)
    with pytest.raises(InputError, match=r"names a\.mcap twice"):
        BagReader(folder)


@pytest.mark.parametrize(
    "text",
    ["- &a {x: *a}", "- !!python/object/apply:os.system ['false']", "- {a: 1}\n" * (MAX_TEXT // 8)],
)
def test_hostile_qos_is_no_qos(text: str) -> None:
    with pytest.raises(ValueError, match="offered_qos_profiles"):
        parse_offered_qos(text)


def test_recover_writes_nowhere_but_into_its_target(named: Path, tmp_path: Path) -> None:
    os.symlink(tmp_path / "elsewhere", tmp_path / "link")
    for target in (tmp_path / "link", named, tmp_path / ("x" * 300)):
        with pytest.raises(InputError):
            recover(named, target)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is no folder"):
        recover(named, tmp_path / "file" / "new")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link"]


def test_what_is_no_cdr_is_left_out_and_a_broken_qos_is_none(tmp_path: Path) -> None:
    for name, metadata, encoding, kept in (
        ("alias", {"offered_qos_profiles": "- &a {x: *a}"}, "cdr", 1),
        ("json", {}, "json", 0),
    ):
        channel = Channel(1, "/text", encoding, metadata, 1)
        chunk = Chunk("", MESSAGE, 0, 0, 0, len(MESSAGE))
        (tmp_path / f"{name}.mcap").write_bytes(file_bytes([SCHEMA, channel, chunk]))
        report = recover(tmp_path / f"{name}.mcap", tmp_path / name)
        assert report.count == kept
        assert kept or "encoded as 'json', not cdr" in report.damage[0]
        assert check_bag(tmp_path / name).ok


# -- definitions ----------------------------------------------------------------------------------

SEPARATOR = "=" * 80 + "\n"
IDL = "module a {{ module msg {{ {} struct B {{ {} }}; }}; }};"


def sections(*texts: str) -> str:
    first, *rest = texts
    return first + "".join(f"{SEPARATOR}MSG: a/C{k}\n{text}" for k, text in enumerate(rest))


def refused(encoding: str, text: str, match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        store_from(TypeDefinition("a/msg/B", encoding, text))
    assert caught.value.field == "a/msg/B"
    assert len(str(caught.value)) < 500


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("B b\n", "a/msg/B contains itself"),
        (sections("C0 c\n", "C1 c\n", "C0 c\n"), "contains itself"),
        (sections(*(f"C{k} c\n" for k in range(501)), "uint8 x\n"), "nest deeper than 32"),
        ("float64[99999999999] x\n", "a/msg/B.x has 99999999999 items"),
        ("float64[-8] x\n", "a/msg/B.x has -8 items"),
        (sections("C0[0] c\n", "uint8 x\n"), "a/msg/B.c has 0 items"),
        ("string[100000] x\n", "arrays of 100000 messages and strings"),
        (sections("C0[4000] c\n", "C1[4000] c\n", "uint8 x\n"), "arrays of 8000 messages"),
        ("uint8[" + "9" * 5000 + "] x\n", "can't be used"),
        ("float64 X=1e999\n", "a/msg/B.X is no finite number"),
        ("C c\n", "can't be used"),
        ("uint8 x\nuint8 x\n", "conflicting"),
        ("string S='\n" * 9000, "can't be used"),
        ("\n" * 20_000 + "uint8 x\n", "lines"),
        ("x" * (MAX_TEXT_BYTES + 1), f"more than {MAX_TEXT_BYTES} are not read"),
        ("__import__('os').system('false')\n", "can't be used"),
    ],
)
def test_a_definition_that_is_none_is_refused_by_name(text: str, match: str) -> None:
    refused("ros2msg", text, match)


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (IDL.format("const long A = 1 << 99999999999;", "long x;"), "operator <<"),
        (IDL.format("const long A = 9 * 9;", "long x;"), r"operator \*"),
        (IDL.format("const long A = " + "(" * 30 + "1" + ")" * 30 + ";", "long x;"), "nested"),
        (IDL.format("", "sequence<" * 40 + "long" + ">" * 40 + " x;"), "nested"),
        (IDL.format("const long A = " + "1+" * 3000 + "1;", "long x;"), "can't be used"),
        (IDL.format("typedef C D; typedef D C;", "C x;"), "can't be used"),
        ("/*" * 50_000, "can't be used"),
        ("struct dataclass { long x; };", "is no name of a type"),
    ],
)
def test_an_idl_definition_that_is_none_is_refused_by_name(text: str, match: str) -> None:
    refused("ros2idl", text, match)


def test_a_name_can_not_smuggle_in_code() -> None:
    for name in ('a/msg/B"""\nimport os', "a/msg/B:\n  pass\nraise SystemExit", "a/msg/B(object)"):
        with pytest.raises(InputError, match="can't be used"):
            store_from(TypeDefinition(name, "ros2msg", "uint8 x\n"))


def test_every_known_type_is_within_the_limits() -> None:
    for msgtype in typestore().fielddefs:
        store = store_from(definition(msgtype))
        # A message of 10 MB of any usual type is decoded.
        assert growth_of(store.fielddefs, msgtype) * 10e6 < MAX_DECODED_BYTES


def write_bag(path: Path, text: str, data: bytes, topics: int = 1) -> None:
    with BagWriter(path) as writer:
        for k in range(topics):
            topic, written = f"/t{k}", TypeDefinition("a/msg/B", "ros2msg", text)
            writer.add_topic(topic, "a/msg/B", written=written)
            writer.write(topic, data, k, k)


def test_a_definition_is_parsed_once_whoever_uses_it(tmp_path: Path) -> None:
    # Each of these takes some tenths of a second to parse; 800 times would be minutes.
    sound = "".join(f"string s{k}\n" for k in range(1000))
    write_bag(tmp_path / "sound", sound, b"\0\1\0\0", topics=400)
    write_bag(tmp_path / "broken", sound + "oh no", b"\0\1\0\0", topics=400)
    for name in ("sound", "broken"):
        assert use(tmp_path / name).read == "READ 400"


def test_a_flood_of_tiny_items_is_refused_before_it_is_made(tmp_path: Path) -> None:
    count = 60_000_000  # items of a byte, each an object of 190 bytes
    data = b"\0\1\0\0" + struct.pack("<I", count) + bytes(count)
    write_bag(tmp_path / "bag", sections("C0[] c\n", ""), data)
    used = use(tmp_path / "bag")
    assert "/t0: holds a message at 0 ns" in used.checked
    assert "GiB of memory once decoded" in used.checked
    assert used.peak_mb < 600


@pytest.mark.parametrize("size", [4_000_000_000, 0xFFFFFFFF, 1 << 31, 1000])
@pytest.mark.parametrize("before", [(), (1, 5, 0x61616161, 0), (1, 1, 0)])
def test_a_sequence_longer_than_its_message_is_refused(
    size: int, before: tuple[int, ...], tmp_path: Path
) -> None:
    data = b"\0\1\0\0\1\0\0\0" + struct.pack(f"<{len(before) + 1}I", *before, size)
    nested = sections("uint8 k\nC0[] c\n", "string s\nC1[] d\n", "uint8[] x\n")
    write_bag(tmp_path / "bag", nested, data)
    with BagReader(tmp_path / "bag") as reader:
        (message,) = reader.messages()
        with pytest.raises(InputError, match=r"/t0: holds a message at 0 ns that is no a/msg/B"):
            reader.decode(message)
    assert not check_bag(tmp_path / "bag").ok
    # Recovering doesn't look into messages: they are kept as they are.
    assert recover(tmp_path / "bag", tmp_path / "new").complete


def test_two_definitions_of_one_topic_are_refused(tmp_path: Path) -> None:
    for name, fields in (("one", "uint8 x\n"), ("two", "uint16 x\n")):
        write_bag(tmp_path / name, fields, b"\0\1\0\0\1")
    files = tmp_path / "bag"
    files.mkdir()
    (tmp_path / "one" / "one_0.mcap").rename(files / "a.mcap")
    (tmp_path / "two" / "two_0.mcap").rename(files / "b.mcap")
    report = recover(files, tmp_path / "new")
    assert report.messages == {"/t0": 1}
    assert "/t0 has messages of two definitions of a/msg/B" in report.damage[0]
