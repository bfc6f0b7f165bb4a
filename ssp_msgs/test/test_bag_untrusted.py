"""Bags from elsewhere: lengths, names, texts and definitions that lie are named errors."""

from __future__ import annotations

import os
import struct
from collections.abc import Sequence
from pathlib import Path

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
from mcap.writer import MCAP0_MAGIC

from ssp_core.bag.check import check_bag
from ssp_core.bag.mcap_file import MAX_CHUNK_BYTES
from ssp_core.bag.mcap_output import record_bytes
from ssp_core.bag.metadata import MAX_TEXT, parse_offered_qos
from ssp_core.bag.reader import BagReader
from ssp_core.bag.repair import recover
from ssp_core.bag.types import (
    MAX_TEXT_BYTES,
    TypeDefinition,
    definition,
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


def file_of(record: Chunk) -> bytes:
    """A closed file with one chunk, indexed."""
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
    return file_bytes([*names, record], [*names, index])


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
        (zstandard.compress(ZEROS), MAX_CHUNK_BYTES, "zstd", "unpacks to less"),
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
    with pytest.raises(InputError, match="no summary section"):
        BagReader(path)
    assert "the file ends within a record" in recover(path, tmp_path / "new").damage[0]


def test_an_attachment_beyond_the_file_is_refused(tmp_path: Path) -> None:
    places = [(8, 1 << 40), (1 << 62, 10), ((1 << 64) - 1, (1 << 64) - 1), (8, 0)]
    for number, (offset, length) in enumerate(places):
        path = tmp_path / f"{number}.mcap"
        index = AttachmentIndex(offset, length, 0, 0, 5, "a", "b")
        path.write_bytes(file_bytes([], [Statistics(1, 0, {}, 0, 0, 0, 0, 0, 0), index]))
        with BagReader(path) as reader, pytest.raises(InputError, match=rf"{number}\.mcap"):
            reader.attachment("a")


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


@pytest.mark.parametrize(
    ("encoding", "text", "match"),
    [
        ("ros2msg", sections("C0 c\n", "C1 c\n", "C0 c\n"), "can't be used"),
        ("ros2msg", "string[100000] x\n", "arrays of 100000 messages and strings"),
        ("ros2msg", "uint8[" + "9" * 5000 + "] x\n", "can't be used"),
        ("ros2msg", "C c\n", "can't be used"),
        ("ros2msg", "uint8 x\nuint8 x\n", "conflicting"),
        ("ros2msg", "x" * (MAX_TEXT_BYTES + 1), f"more than {MAX_TEXT_BYTES} characters"),
        ("ros2msg", "__import__('os').system('false')\n", "can't be used"),
        ("ros2idl", IDL.format("typedef C D; typedef D C;", "C x;"), "can't be used"),
        ("ros2idl", "struct dataclass { long x; };", "is no name of a type"),
    ],
)
def test_a_definition_that_is_none_is_refused_by_name(encoding: str, text: str, match: str) -> None:
    with pytest.raises(InputError, match=match) as caught:
        store_from(TypeDefinition("a/msg/B", encoding, text))
    assert caught.value.field == "a/msg/B"
    assert len(str(caught.value)) < 500


def test_a_name_can_not_smuggle_in_code() -> None:
    for name in ('a/msg/B"""\nimport os', "a/msg/B:\n  pass\nraise SystemExit", "a/msg/B(object)"):
        with pytest.raises(InputError, match="can't be used"):
            store_from(TypeDefinition(name, "ros2msg", "uint8 x\n"))


def test_every_known_type_is_within_the_limits() -> None:
    for msgtype in typestore().fielddefs:
        store_from(definition(msgtype))


def write_bag(path: Path, text: str, data: bytes) -> None:
    with BagWriter(path) as writer:
        writer.add_topic("/t0", "a/msg/B", written=TypeDefinition("a/msg/B", "ros2msg", text))
        writer.write("/t0", data, 0, 0)


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
