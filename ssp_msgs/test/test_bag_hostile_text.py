"""Names and texts in bags that aim at terminals, paths and parsers."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from mcap.records import Channel, Chunk, Message, Schema

from ssp_core.bag.check import check_bag
from ssp_core.bag.mcap_output import record_bytes
from ssp_core.bag.metadata import MAX_TEXT, offered_qos, parse_offered_qos, read_metadata
from ssp_core.bag.reader import BagReader
from ssp_core.bag.repair import recover
from ssp_core.bag.types import definition, serialize, typestore
from ssp_core.bag.writer import BagWriter
from ssp_core.cli import main
from ssp_core.errors import InputError

STRING = "std_msgs/msg/String"
TEXT = serialize(typestore().types[STRING](data="text"))
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


def test_a_name_in_an_error_is_shown_harmless(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/clear\x1b[2J", STRING)
        writer.write("/clear\x1b[2J", b"\0\1\0\0\xff", 1, 1)
    assert main(["bag", "check", str(tmp_path / "bag")]) == 1
    printed = "".join(capsys.readouterr())
    assert "/clear\\x1b[2J: holds a message at 1 ns" in printed
    assert "\x1b" not in printed


BILLION = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{b}: &{b} [{','.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
ROOT = "rosbag2_bagfile_information:"
FACTS = "storage_identifier: mcap, message_count: 0, topics_with_message_count: []"


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (BILLION, r"metadata\.yaml:\d.*aliases"),
        ("rosbag2_bagfile_information: !!python/object/apply:os.system ['false']", "not valid"),
        ("rosbag2_bagfile_information: &a {x: *a}", "aliases"),
        ("[" * 100_000, "not valid"),
        ("a: " * 100_000, "not valid"),
        ("rosbag2_bagfile_information: 0x" + "f" * 100_000, "digits"),
        ("x" * (9 << 20), "larger than 8 MiB"),
        (
            f"rosbag2_bagfile_information: {{{FACTS}, relative_file_paths: ['']}}",
            "which is not there",
        ),
        (
            f"rosbag2_bagfile_information: {{{FACTS}, relative_file_paths: ['..']}}",
            "which is not there",
        ),
        (
            f"rosbag2_bagfile_information: {{{FACTS}, relative_file_paths: ['/']}}",
            "which is not there",
        ),
        (f'rosbag2_bagfile_information: {{{FACTS}, relative_file_paths: ["a\\0"]}}', "which is no"),
    ],
)
def test_hostile_metadata_is_refused(text: str, match: str, tmp_path: Path) -> None:
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(InputError, match=match) as caught:
        read_metadata(tmp_path)
    assert caught.value.file == str(tmp_path / "metadata.yaml")
    assert len(str(caught.value)) < 1000


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
    for name in ("../outside/outside_0.mcap", str(secret)):
        metadata_of(folder, name)
        with pytest.raises(InputError, match=r"names outside_0\.mcap, which is not"):
            BagReader(folder)
    # Who may put a link into the folder may put the file there too: links are followed.
    os.symlink(secret, folder / "a.mcap")
    metadata_of(folder, "a.mcap")
    with BagReader(folder) as reader:
        assert list(reader.topics) == ["/secret"]
    os.mkfifo(folder / "b.mcap")
    metadata_of(folder, "b.mcap")
    with pytest.raises(InputError, match=r"b\.mcap, which is not there"):
        BagReader(folder)


def test_a_file_named_twice_is_refused(tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/text", STRING)
    metadata_of(tmp_path / "bag", *["bag_0.mcap"] * 1000)
    with pytest.raises(InputError, match=r"names bag_0\.mcap twice"):
        BagReader(tmp_path / "bag")


@pytest.mark.parametrize(
    "text",
    [
        "- &a [*a]",
        "- {deadline: !!python/name:os.system }",
        "- {depth: 0x" + "f" * 9000 + "}",
        '- {history: "\\ud800"}',
        "[" * 2000,
        "- {a: 1}\n" * (MAX_TEXT // 8),
        "- {1: 2}",
    ],
)
def test_hostile_qos_is_no_qos(text: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="offered_qos_profiles"):
        parse_offered_qos(text)


def hostile_file(build: Callable[..., bytes], metadata: dict[str, str], encoding: str) -> bytes:
    known = definition(STRING)
    names = [
        Schema(1, known.text.encode(), "ros2msg", STRING),
        Channel(1, "/text", encoding, metadata, 1),
    ]
    content = record_bytes(Message(1, 5, TEXT, 5, 1), Message(1, 1 << 63, TEXT, 6, 1))
    return build([*names, Chunk("", content, 1 << 63, 5, 0, len(content))])


def test_recover_leaves_out_what_no_reader_would_take(
    tmp_path: Path, mcap_bytes: Callable[..., Any]
) -> None:
    for name, metadata, encoding, kept in (
        ("late", {"offered_qos_profiles": offered_qos(5)}, "cdr", 1),
        ("alias", {"offered_qos_profiles": "- &a {x: *a}"}, "cdr", 1),
        ("json", {}, "json", 0),
    ):
        (tmp_path / f"{name}.mcap").write_bytes(hostile_file(mcap_bytes, metadata, encoding))
        report = recover(tmp_path / f"{name}.mcap", tmp_path / name)
        assert report.count == kept
        assert "2262" in report.damage[0] or "encoded as 'json', not cdr" in report.damage[0]
        assert check_bag(tmp_path / name).ok


def test_recover_writes_nowhere_but_into_its_target(named: Path, tmp_path: Path) -> None:
    os.symlink(tmp_path / "elsewhere", tmp_path / "link")
    for target in (tmp_path / "link", named, tmp_path / ("x" * 300)):
        with pytest.raises(InputError):
            recover(named, target)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="is no folder"):
        recover(named, tmp_path / "file" / "new")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["file", "link"]
