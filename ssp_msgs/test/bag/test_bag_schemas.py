"""Topics whose messages or types aren't understood: they block nothing else, and are kept."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from mcap.writer import Writer

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.cut import cut_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import TypeDefinition, definition, store_from
from ssp_core.cli import main
from ssp_core.errors import InputError
from tests.support.bags.messages import STRING, text

LINE = "=" * 80 + "\n"
IDL = (
    f"{LINE}IDL: vendor_msgs/msg/Lateral\n"
    "// generated\n"
    '#include "builtin_interfaces/msg/Time.idl"\n\n'
    "module vendor_msgs {\n  module msg {\n    struct Lateral {\n"
    '      @verbatim (language="comment", text="of the #1 wheel")\n'
    "      builtin_interfaces::msg::Time stamp;\n"
    "      float angle;\n    };\n  };\n};\n"
    f"{LINE}IDL: builtin_interfaces/msg/Time\n"
    "module builtin_interfaces { module msg {\n"
    "struct Time { int32 sec; uint32 nanosec; };\n}; };\n"
)
TWELVE = b"\0\1\0\0" + bytes(12)
# Name and encoding of the type, its definition, encoding of the message, the message.
READ = {
    "CRLF": (
        "vendor_msgs/msg/Lateral",
        "ros2msg",
        b"int64 stamp\r\nfloat32 angle\r\n",
        "cdr",
        TWELVE,
    ),
    "ros2idl": ("vendor_msgs/msg/Lateral", "ros2idl", IDL.encode(), "cdr", TWELVE),
    "ros2idl, CRLF": (
        "vendor_msgs/msg/Lateral",
        "ros2idl",
        IDL.replace("\n", "\r\n").encode(),
        "cdr",
        TWELVE,
    ),
    "none, but known": (STRING, "", b"", "cdr", text("hello")),
}
UNREAD = {
    "JSON": ("vendor.Lateral", "jsonschema", b'{"type": "object"}', "json", b"{}"),
    "JSON without a type": ("", "", b"", "json", b"{}"),
    "protobuf": ("vendor.Lateral", "protobuf", b"\n\xff\xfe\x80", "protobuf", b"\x08\x01"),
    "unknown, as rosbag2 says it": ("vendor_msgs/msg/Lateral", "unknown", b"", "cdr", TWELVE),
    "nonsense": ("vendor_msgs/msg/Lateral", "ros2msg", b"= = =\n", "cdr", TWELVE),
}


def write(path: Path, kind: tuple[str, str, bytes, str, bytes], **options: bool) -> Path:
    """A file with a text on /text, and one message of a strange kind on /vendor."""
    name, encoding, written, message_encoding, data = kind
    with path.open("wb") as stream:
        writer = Writer(stream, **options)
        writer.start(profile="ros2")
        known = writer.register_schema(STRING, "ros2msg", definition(STRING).data)
        own = writer.register_schema(name, encoding, written) if name else 0
        channels = [
            writer.register_channel("/text", "cdr", known),
            writer.register_channel("/vendor", message_encoding, own),
        ]
        for channel, message in zip(channels, (text("hello"), data), strict=True):
            writer.add_message(channel, 5, message, 5, 1)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare
    return path


@pytest.mark.parametrize("kind", READ)
def test_a_definition_of_any_spelling_is_read(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "a.mcap", READ[kind])
    with BagReader(path) as reader:
        assert reader.unreadable() == {}
        messages = {m.topic: reader.decode(m) for m in reader.messages()}
    assert messages["/text"].data == "hello"
    assert getattr(messages["/vendor"], "angle", 0.0) == 0.0
    report = check_bag(path)
    assert (report.problems, report.undecoded, report.count) == ((), {}, 2)


@pytest.mark.parametrize("chunks", [True, False])
@pytest.mark.parametrize("kind", UNREAD)
def test_what_cannot_be_decoded_is_listed_and_blocks_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str, chunks: bool
) -> None:
    path = write(tmp_path / "a.mcap", UNREAD[kind], use_chunking=chunks)
    with BagReader(path) as reader:
        one, other = sorted(reader.messages(), key=lambda m: m.topic)
        assert reader.decode(one).data == "hello"
        assert list(reader.unreadable()) == ["/vendor"]
        with pytest.raises(InputError):
            reader.decode(other)
    assert main(["bag", "check", str(path)]) == 0
    said = " ".join(capsys.readouterr().out.split())
    assert "/vendor: 1 messages not decoded: " in said
    assert "sound, 1 messages decoded" in said
    assert main(["bag", "check", str(path), "--json"]) == 0
    assert "/vendor" in json.loads(capsys.readouterr().out)["undecoded"]


@pytest.mark.parametrize("kind", [*READ, *UNREAD])
def test_a_cut_keeps_messages_and_types_as_they_are(tmp_path: Path, kind: str) -> None:
    path = write(tmp_path / "a.mcap", (READ | UNREAD)[kind])
    cut_bag(path, tmp_path / "cut", ["/text", "/vendor"])
    with BagReader(path) as before, BagReader(tmp_path / "cut") as after:
        assert list(after.messages()) == list(before.messages())
        for topic in ("/text", "/vendor"):
            assert after.definition(topic) == before.definition(topic)
    assert check_bag(tmp_path / "cut").ok


@pytest.mark.parametrize("named", [STRING, "std_msgs/msg/Int32"])
def test_a_topic_of_two_types_blocks_no_other(tmp_path: Path, named: str) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        known = writer.register_schema(STRING, "ros2msg", definition(STRING).data)
        for topic in ("/text", "/vendor"):
            channel = writer.register_channel(topic, "cdr", known)
            writer.add_message(channel, 5, text("hello"), 5, 1)
        other = writer.register_schema(named, "ros2msg", b"int32 data\n")
        writer.register_channel("/vendor", "cdr", other)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare
    with BagReader(path) as reader:
        assert [reader.decode(m).data for m in reader.messages(["/text"])] == ["hello"]
        assert list(reader.unreadable()) == ["/vendor"]
        with pytest.raises(
            InputError, match=f"/vendor: has messages of two (types|definitions).*{named}"
        ):
            reader.definition("/vendor")


def test_definitions_that_differ_in_their_comments_alone_are_one(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        for written in (b"string data\n", b"# said\r\nstring data # what\r\n"):
            schema = writer.register_schema(STRING, "ros2msg", written)
            channel = writer.register_channel("/text", "cdr", schema)
            writer.add_message(channel, 5, text("hello"), 5, 1)
        writer.finish()  # type: ignore[no-untyped-call]  # mcap leaves it bare
    with BagReader(path) as reader:
        assert [reader.decode(m).data for m in reader.messages()] == ["hello", "hello"]


def test_a_type_that_no_definition_names_is_unknown() -> None:
    with pytest.raises(InputError, match="unknown encoding"):
        store_from(TypeDefinition("nowhere_msgs/msg/X", "", ""))
