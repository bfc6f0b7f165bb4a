"""Findings of an import: all are listed in one go; what a person accepts is said from then on."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from foreign_recordings import JPEG, TrackDay, jpeg, write_bag

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_core.errors import InputError
from ssp_eval.importers.findings import Finding, Findings

OBJECTS = ("--vut", "/vut/odom", "--object", "ot1=/ot1/odom:car", "--camera", "/cam")


def finding(name: str, acceptable: bool = True, file: str = "bag") -> Finding:
    return Finding(name, f"{name} at 1.0 s", "mend it", Path(file), "/cam", acceptable=acceptable)


def test_all_findings_and_the_error_that_ends_the_import_stand_in_one_message() -> None:
    findings = Findings({"a"})

    def add_findings() -> None:
        findings.add(finding("a"))
        findings.add(finding("b"))
        findings.add(finding("c", acceptable=False, file="table.csv"))
        raise InputError("no frames", file="bag", field="/cam")

    with pytest.raises(InputError) as caught, findings.listed(Path("bag")):
        add_findings()
    assert str(caught.value) == (
        "bag: has 3 errors:\n"
        "  /cam: b at 1.0 s [b]; mend it; --accept b takes it as it is\n"
        "  table.csv: /cam: c at 1.0 s [c]; mend it\n"
        "  /cam: no frames"
    )
    assert [one.name for one in findings.accepted] == ["a"]


def test_what_cannot_be_accepted_refuses_all_the_same() -> None:
    findings = Findings({"c"})
    findings.add(finding("c", acceptable=False))
    with pytest.raises(InputError, match=r"^bag: /cam: c at 1.0 s \[c\]; mend it$"):
        findings.check()


@pytest.fixture(scope="module")
def cut_bag(day: TrackDay, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag in which frames 20 to 29 are cut off."""
    made = 0

    def cut(ns: int, image: Any) -> Any:
        nonlocal made
        message = jpeg(ns, image)
        if 20 <= made < 30:
            message.data = message.data[:-30]
        made += 1
        return message

    return write_bag(tmp_path_factory.mktemp("cut") / "bag", day.messages(cut, JPEG))


def test_what_is_accepted_is_said_by_the_import_and_by_later_pages(
    cut_bag: Path, tmp_path: Path, refused: Callable[..., str], capsys: pytest.CaptureFixture[str]
) -> None:
    bags = {name: tmp_path / name for name in ("synthetic", "simulation", "physical")}
    out = bags["physical"]
    text = refused("import-bag", cut_bag, *OBJECTS, "--domain", "physical", "--out", out)
    assert "/cam: 10 of 101 JPEGs are cut off or damaged, the first at 2.000 s" in text
    assert "--accept cut_pictures takes it as it is" in text
    for domain, made in bags.items():
        options = ("--domain", domain, "--accept", "cut_pictures", "--out", str(made))
        assert main(["import-bag", str(cut_bag), *OBJECTS, *options]) == 0
    assert "accepted as it is, cut_pictures: /cam: 10 of 101" in capsys.readouterr().err
    with BagReader(out) as reader:
        record = json.loads(reader.attachment("import.json") or b"")
    (one,) = record["accepted"]
    assert one["name"] == "cut_pictures"
    assert one["text"].startswith("/cam: 10 of 101 JPEGs are cut off")
    assert main(["bag", "info", str(out)]) == 0
    assert "accepted at import, cut_pictures: /cam: 10 of 101 JPEGs" in capsys.readouterr().out
    main(["audit", *map(str, bags.values()), "--event", "cut_in", "--out", str(tmp_path / "audit")])
    assert "accepted at import: cut_pictures: /cam: 10 of 101 JPEGs" in capsys.readouterr().err


def test_all_topics_that_a_person_names_wrongly_are_listed_at_once(
    cut_bag: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    wrong = ("--vut", "/vut/odo", "--object", "ot1=/cam:car", "--camera", "/ot1/odom")
    text = refused(
        "import-bag",
        cut_bag,
        *wrong,
        "--camera-info",
        "/info",
        "--domain",
        "physical",
        "--out",
        tmp_path / "rec",
    )
    assert "has 4 errors" in text
    assert "/vut/odo: is no topic of this bag [topics]; of these types it has" in text
    assert "/cam: has messages of another type [topics]" in text
    assert "/ot1/odom: has messages of another type [topics]" in text
    assert "/info: is no topic of this bag [topics]" in text


def test_what_is_wrong_in_each_objects_poses_is_listed_at_once(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str]
) -> None:
    messages = day.messages()
    for message in (m for topic, *_, m in messages if topic == "/vut/odom"):
        message.pose.pose.orientation.w = message.pose.pose.orientation.z = 0.0
    for k, message in enumerate(m for topic, *_, m in messages if topic == "/ot1/odom"):
        message.header.frame_id = "map" if k % 2 else "odom"
    bag = write_bag(tmp_path / "bag", messages)
    text = refused("import-bag", bag, *OBJECTS, "--domain", "physical", "--out", tmp_path / "rec")
    assert "has 2 errors" in text
    assert "/vut/odom: message 1: " in text
    assert "/ot1/odom: changes its frames: map of base_link, odom of base_link [poses]" in text


@pytest.mark.parametrize("ahead_s", [18, -1_000_000_000])
def test_poses_on_another_clock_are_named_as_that_alone(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str], ahead_s: int
) -> None:
    """GPS's time is 18 s ahead; a device may count from when it was switched on."""
    messages = day.messages()
    for message in (m for topic, *_, m in messages if topic == "/vut/odom"):
        message.header.stamp.sec += ahead_s
    bag = write_bag(tmp_path / "bag", messages)
    text = refused("import-bag", bag, *OBJECTS, "--domain", "physical", "--out", tmp_path / "rec")
    assert "/vut/odom: its stamps lie " in text
    assert "those of /ot1/odom, by when both were received: two clocks [clocks]" in text
    assert "errors" not in text


def test_all_clocks_and_frames_that_do_not_agree_are_listed_at_once(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str]
) -> None:
    messages = day.messages()
    for topic, _, _, message in messages:
        if topic == "/ot1/odom":
            message.header.frame_id = "odom"
            message.header.stamp.sec = 0 if message.header.stamp.nanosec < 500_000_000 else 5
            message.header.stamp.nanosec *= message.header.stamp.sec > 0
        if topic == "/cam":
            message.header.stamp.sec += 9
    bag = write_bag(tmp_path / "bag", messages)
    text = refused(
        "import-bag", bag, *OBJECTS, "--domain", "physical", "--out", tmp_path / "rec", "--end", "4"
    )
    assert "/ot1/odom: its poses are in frame 'odom', the others' in 'map' [frames]" in text
    assert "messages have the stamp 0 [clocks]" in text
    assert "stamps go backwards, the first by" in text
    assert "/cam: its stamps lie 9.000 s after those of /vut/odom" in text
    assert "has 4 errors" in text


def test_a_twist_across_the_heading_is_no_speed_that_is_missing(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str]
) -> None:
    """Some inertial units have their y axis ahead."""
    messages = day.messages()
    for message in (m for topic, *_, m in messages if topic == "/vut/odom"):
        linear = message.twist.twist.linear
        linear.x, linear.y = 0.0, linear.x
    bag = write_bag(tmp_path / "bag", messages)
    text = refused("import-bag", bag, *OBJECTS, "--domain", "physical", "--out", tmp_path / "rec")
    assert "/vut/odom: has speeds 0 times those of its positions" in text
    assert "[speed]" in text
