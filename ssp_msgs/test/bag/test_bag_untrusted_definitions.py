"""Message definitions of bags from elsewhere: one that lies is refused by name."""

from __future__ import annotations

import struct
from pathlib import Path

import pytest

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.types import (
    MAX_DECODED_BYTES,
    MAX_TEXT_BYTES,
    TypeDefinition,
    definition,
    growth_of,
    store_from,
    typestore,
)
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.errors import InputError
from tests.support.bags.untrusted import (
    use,
)

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
