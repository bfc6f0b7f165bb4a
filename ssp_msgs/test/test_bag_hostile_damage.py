"""Check and recover on bags with bytes changed, cut, doubled and moved.

Checking finds the damage, or what the bag says is unchanged. Recovering raises nothing but
InputError, leaves a whole bag or none, and what it keeps was in the bag, byte for byte.
"""

from __future__ import annotations

import shutil
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssp_core.bag.check import check_bag
from ssp_core.bag.metadata import offered_qos
from ssp_core.bag.reader import BagReader
from ssp_core.bag.repair import recover
from ssp_core.bag.split import Split
from ssp_core.bag.types import BagMessage
from ssp_core.bag.writer import BagWriter
from ssp_core.errors import InputError
from support.bags import text

STRING = "std_msgs/msg/String"


def write_bag(path: Path, split: Split | None = None) -> None:
    """A latched topic with two messages, another one with twenty, two attachments."""
    with BagWriter(path, split=split) as writer:
        writer.add_topic(
            "/map", STRING, offered_qos(2, transient_local=True), latched=split is not None
        )
        writer.add_topic("/text", STRING, offered_qos(5))
        writer.write("/map", text("old map"), 10**9, 7, 1)
        writer.write("/map", text("new map"), 10**9, 8, 2)
        for k in range(20):
            writer.write("/text", text(f"number {k}"), (k + 1) * 10**9, k, k)
            if k % 4 == 3:
                writer.flush()
            if k in (5, 13):
                writer.attach(f"{k}.yaml", b"seed: %d\n" % k, "application/yaml")


def contents(path: Path) -> tuple[Counter[BagMessage], Counter[tuple[str, bytes | None]]]:
    with BagReader(path) as reader:
        names = reader.attachments
        return Counter(reader.messages()), Counter((n, reader.attachment(n)) for n in names)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("damage") / "bag"
    write_bag(path)
    return path


Change = Callable[[bytes], bytes]
PLACE = st.floats(0, 1, exclude_max=True)


def flipped(place: float, mask: int) -> Change:
    def change(data: bytes) -> bytes:
        at = int(place * len(data))
        return data[:at] + bytes([data[at] ^ mask]) + data[at + 1 :]

    return change


def cut(place: float) -> Change:
    return lambda data: data[: int(place * len(data))]


def moved(source: float, length: int, place: float, *, over: bool) -> Change:
    """Some bytes once more at another place, in addition or over what is there."""

    def change(data: bytes) -> bytes:
        begin, at = int(source * len(data)), int(place * len(data))
        piece = data[begin : begin + length]
        return data[:at] + piece + data[at + (len(piece) if over else 0) :]

    return change


def without(place: float, length: int) -> Change:
    def change(data: bytes) -> bytes:
        at = int(place * len(data))
        return data[:at] + data[at + length :]

    return change


LENGTH = st.integers(1, 1500)
CHANGES = st.one_of(
    st.builds(flipped, PLACE, st.integers(1, 255)),
    st.builds(cut, PLACE),
    st.builds(moved, PLACE, LENGTH, PLACE, over=st.booleans()),
    st.builds(without, PLACE, LENGTH),
)
COMMON = {"deadline": None, "suppress_health_check": [HealthCheck.function_scoped_fixture]}


@settings(max_examples=120, **COMMON)
@given(change=CHANGES)
def test_check_finds_a_change_or_nothing_has_changed(
    bag: Path, tmp_path_factory: pytest.TempPathFactory, change: Change
) -> None:
    folder = tmp_path_factory.mktemp("check") / "bag"
    shutil.copytree(bag, folder)
    file = folder / "bag_0.mcap"
    file.write_bytes(change(file.read_bytes()))
    if check_bag(folder).ok:
        assert contents(folder) == contents(bag)


@settings(max_examples=120, **COMMON)
@given(change=CHANGES)
def test_recover_keeps_nothing_but_what_was_there(
    bag: Path, tmp_path_factory: pytest.TempPathFactory, change: Change
) -> None:
    folder = tmp_path_factory.mktemp("recover")
    (folder / "a.mcap").write_bytes(change((bag / "bag_0.mcap").read_bytes()))
    try:
        report = recover(folder / "a.mcap", folder / "new")
    except InputError:
        assert sorted(p.name for p in folder.iterdir()) == ["a.mcap"]
        return
    assert sorted(p.name for p in folder.iterdir()) == ["a.mcap", "new"]
    messages, attachments = contents(bag)
    kept, kept_attachments = contents(folder / "new")
    assert kept <= messages
    assert kept_attachments <= attachments
    assert report.count == kept.total()
    assert report.complete or report.damage
    assert check_bag(folder / "new").ok


@settings(max_examples=60, **COMMON)
@given(changes=st.lists(CHANGES, min_size=2, max_size=5))
def test_any_number_of_changes_gives_a_whole_bag_or_an_input_error(
    bag: Path, tmp_path_factory: pytest.TempPathFactory, changes: list[Change]
) -> None:
    folder = tmp_path_factory.mktemp("many")
    data = (bag / "bag_0.mcap").read_bytes()
    for change in changes:
        data = change(data) or b"\x89"
    (folder / "a.mcap").write_bytes(data)
    check_bag(folder / "a.mcap")
    try:
        report = recover(folder / "a.mcap", folder / "new")
    except InputError:
        assert not (folder / "new").exists()
        return
    assert contents(folder / "new")[0].total() == report.count


@pytest.mark.parametrize("keep_summary", [True, False])
def test_a_damaged_length_costs_its_own_chunk_alone(
    bag: Path, tmp_path: Path, keep_summary: bool
) -> None:
    data = bytearray((bag / "bag_0.mcap").read_bytes())
    second = data.index(b"\x06", data.index(text("number 3")))
    assert int.from_bytes(data[second + 1 : second + 9], "little") < 1000
    data[second + 6] = 0xFF  # of the length
    end = len(data) if keep_summary else data.rindex(text("number 19")) + 200
    (tmp_path / "a.mcap").write_bytes(data[:end])
    report = recover(tmp_path / "a.mcap", tmp_path / "new")
    kept = {m.data for m in contents(tmp_path / "new")[0] if m.topic == "/text"}
    assert kept == {text(f"number {k}") for k in range(20) if not 4 <= k < 6}
    assert f"damaged at byte {second}" in report.damage[0]


def test_repeated_latched_messages_are_recovered_once(tmp_path: Path) -> None:
    write_bag(tmp_path / "bag", Split(max_s=6.0))
    write_bag(tmp_path / "whole")
    assert len(list((tmp_path / "bag").glob("*.mcap"))) == 4
    assert check_bag(tmp_path / "bag").ok
    assert recover(tmp_path / "bag", tmp_path / "all").complete
    assert contents(tmp_path / "all")[0] == contents(tmp_path / "whole")[0]
    # Without the file that held them first, the repeated ones are all there is, and are kept once.
    (tmp_path / "bag" / "bag_0.mcap").unlink()
    recover(tmp_path / "bag", tmp_path / "rest")
    maps = [m.data for m in contents(tmp_path / "rest")[0] if m.topic == "/map"]
    assert maps == [text("old map"), text("new map")]


def test_recovering_a_large_file_takes_little_memory(
    limited: Callable[..., Any], tmp_path: Path
) -> None:
    with BagWriter(tmp_path / "bag") as writer:
        writer.add_topic("/text", STRING)
        for k in range(300):
            writer.write("/text", text("x" * (1 << 20)), k, k)
    ended = limited(
        "import sys\nfrom pathlib import Path\nfrom ssp_core.bag.repair import recover\n"
        "from ssp_core.bag.check import check_bag\n"
        "print(recover(sys.argv[1], sys.argv[2]).count, check_bag(Path(sys.argv[2])).problems)",
        tmp_path / "bag",
        tmp_path / "new",
    )
    assert ended.out == "300 ()\n"
    assert ended.peak_mb < 200
