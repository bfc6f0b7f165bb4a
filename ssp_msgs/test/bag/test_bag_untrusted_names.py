"""Names and texts of bags from elsewhere: they steer neither the terminal nor a path."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import yaml
from mcap.records import (
    Channel,
    Chunk,
)

from ssp_core.bag.metadata import MAX_TEXT, parse_offered_qos
from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.operations.repair import recover
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cli import main
from ssp_core.errors import InputError
from tests.support.bags.messages import STRING
from tests.support.bags.untrusted import (
    MESSAGE,
    SCHEMA,
    TEXT,
    file_bytes,
)

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
