"""Bags of others: files that nothing names, log times that leap, and SQLite that is cut."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from ssp_core.bag.operations.check import check_bag
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.seal import read_seal
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writing.writer import BagWriter
from ssp_core.cli import main
from ssp_core.clock import NS_PER_S
from ssp_monitor.bag_tools.info import summarise_bag
from ssp_monitor.replay.player import Leap, Pause, Playback, Rest, Send, Timeline
from tests.support.bags.messages import text

STRING = "std_msgs/msg/String"
TYPES = get_typestore(Stores.ROS2_JAZZY)
NOW_NS = 1_700_000_000 * NS_PER_S


def write_texts(path: Path, times_s: list[float]) -> Path:
    with BagWriter(path) as writer:
        writer.add_topic("/text", STRING)
        for t_s in times_s:
            at_ns = NOW_NS + round(t_s * 1e9)
            writer.write("/text", text("-"), at_ns, at_ns)
    return path


def test_a_file_that_metadata_does_not_name_is_named(tmp_path: Path) -> None:
    bag = write_texts(tmp_path / "bag", [0.0, 1.0])
    assert check_bag(bag).ok
    assert summarise_bag(bag).notes == ()
    (file,) = bag.glob("*.mcap")
    shutil.copy(file, bag / "later.mcap")
    assert check_bag(bag).problems == ("metadata.yaml doesn't name later.mcap",)
    assert "later.mcap isn't named by metadata.yaml" in summarise_bag(bag).notes[0]


EARLY = [t_s / 10 - 1.69e9 for t_s in range(20)]


@pytest.mark.parametrize(
    ("times_s", "leaps"),
    [
        ([*EARLY, *(t_s / 10 for t_s in range(20))], 1),
        ([-1e9, -5e8, 0.0], 2),
        ([t_s / 10 for t_s in range(40)], 0),
        ([0.0, 3600.0, 80_000.0], 0),  # a recorder that was paused
        ([-NOW_NS / NS_PER_S + t_s for t_s in range(5)], 0),  # a simulator's time
    ],
)
def test_log_times_that_leap_are_said(tmp_path: Path, times_s: list[float], leaps: int) -> None:
    bag = write_texts(tmp_path / "bag", times_s)
    report = check_bag(bag)
    assert report.ok
    assert len(report.remarks) == leaps
    assert summarise_bag(bag).notes == report.remarks
    assert all("the recorder's clock was set" in remark for remark in report.remarks)


def test_replay_skips_a_leap_and_says_it() -> None:
    times_ns = [0, NS_PER_S, 10**9 * NS_PER_S, (10**9 + 1) * NS_PER_S]
    messages = [BagMessage("/text", at_ns, at_ns, b"", 0) for at_ns in times_ns]
    playback = Playback(iter(messages), Timeline(0, 0))
    assert isinstance(playback.act(0), Send)
    assert playback.act(0) == Rest(NS_PER_S)
    assert isinstance(playback.act(NS_PER_S), Send)
    assert playback.act(NS_PER_S) == Leap(NS_PER_S, 10**9 * NS_PER_S)
    assert isinstance(playback.act(NS_PER_S), Send)
    assert playback.act(NS_PER_S) == Rest(2 * NS_PER_S)


def test_replay_says_a_long_pause_once_and_waits_for_it() -> None:
    messages = [
        BagMessage("/text", t_s * NS_PER_S, t_s * NS_PER_S, b"", 0) for t_s in (0, 10, 3610)
    ]
    playback = Playback(iter(messages), Timeline(0, 0))
    assert isinstance(playback.act(0), Send)
    assert playback.act(0) == Rest(10 * NS_PER_S)
    assert isinstance(playback.act(10 * NS_PER_S), Send)
    assert playback.act(10 * NS_PER_S) == Pause(10 * NS_PER_S, 3610 * NS_PER_S)
    assert playback.act(10 * NS_PER_S) == Rest(3610 * NS_PER_S)
    assert isinstance(playback.act(3610 * NS_PER_S), Send)


def sqlite_bag(path: Path, topics: int = 2) -> Path:
    """Twenty texts a topic, ten a second; the first topic's come at whole tenths."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        made = [writer.add_connection(f"/text{k}", STRING, typestore=TYPES) for k in range(topics)]
        for step in range(20):
            for k, one in enumerate(made):
                data = TYPES.serialize_cdr(TYPES.types[STRING](data=f"{step}"), STRING)
                writer.write(one, NOW_NS + step * 10**8 + k, bytes(data))
    return path


@pytest.mark.parametrize("as_file", [False, True])
def test_a_bag_of_sqlite_is_cut(tmp_path: Path, as_file: bool) -> None:
    source = sqlite_bag(tmp_path / "bag")
    before = {file.name: file.read_bytes() for file in source.iterdir()}
    given = next(source.glob("*.db3")) if as_file else source
    out = tmp_path / "cut"
    options = ("--start", "0.5", "--end", "1.2", "--exclude", "/text1")
    assert main(["bag", "cut", str(given), *options, "-o", str(out)]) == 0
    with BagReader(out) as reader:
        found = [(m.log_time_ns, reader.decode(m).data) for m in reader.messages()]
        assert list(reader.topics) == ["/text0"]
        seal = read_seal(reader)
    (parent,) = seal.sources
    assert (seal.maker, parent.name, parent.state, parent.ends) == (
        "cut",
        given.name,
        "not sealed",
        (),
    )
    assert found == [(NOW_NS + step * 10**8, str(step)) for step in range(5, 13)]
    assert check_bag(out).ok
    assert {file.name: file.read_bytes() for file in source.iterdir()} == before


def test_what_is_no_sqlite_is_refused_and_leaves_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = sqlite_bag(tmp_path / "bag")
    (file,) = source.glob("*.db3")
    file.write_bytes(b"no database" * 100)
    assert main(["bag", "cut", str(source), "-o", str(tmp_path / "cut")]) == 1
    assert "can't be read as SQLite: file is not a database" in capsys.readouterr().err
    assert not (tmp_path / "cut").exists()
    file.unlink()
    assert main(["bag", "cut", str(source), "-o", str(tmp_path / "cut")]) == 1
    assert "is not there" in capsys.readouterr().err
