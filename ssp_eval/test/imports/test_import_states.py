"""ssp import-video --states: a table of states is checked against itself and the frames' times."""

from __future__ import annotations

import csv
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from foreign_recordings import (
    TrackDay,
    imported,
    picture,
    read,
    starts,
    truth,
    write_frames,
    write_table,
    write_video,
)

from ssp_core.bag.reading.reader import BagReader
from ssp_core.cli import main
from ssp_core.hashing import sha256_file

LANE_EDGES = 'index="{}" speed="13.9" length="400.00" width="3.50"'
# The boulevard's own direction as SUMO writes it: lanes from right to left.
NET = """<?xml version="1.0" encoding="UTF-8"?>
<net version="1.20">
  <edge id="main" from="a" to="b" type="highway.residential">
    <lane id="main_0" {} shape="0.00,0.00 400.00,0.00"/>
    <lane id="main_1" {} shape="0.00,3.50 400.00,3.50"/>
  </edge>
  <edge id="back" from="b" to="a" type="highway.residential">
    <lane id="back_0" {} shape="400.00,10.50 0.00,10.50"/>
    <lane id="back_1" {} shape="400.00,7.00 0.00,7.00"/>
  </edge>
</net>
""".format(*(LANE_EDGES.format(k) for k in (0, 1, 0, 1)))


@pytest.fixture(scope="module")
def video(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Ten seconds at 10 frames per second."""
    return write_video(tmp_path_factory.mktemp("video") / "clip.avi", 101)


@pytest.fixture
def table(day: TrackDay, tmp_path: Path) -> Path:
    """The states of the same ten seconds, 25 a second."""
    return write_table(tmp_path / "states.csv", day.states, every=2)


def rows_of(table: Path) -> list[dict[str, str]]:
    with table.open(newline="") as stream:
        return list(csv.DictReader(stream))


def changed(table: Path, change: Callable[[list[dict[str, Any]]], None]) -> Path:
    """The table with its rows changed in place."""
    rows: list[dict[str, Any]] = [dict(row) for row in rows_of(table)]
    change(rows)
    with table.open("w", newline="") as stream:
        writer = csv.DictWriter(stream, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return table


def scaled(column: str, factor: float) -> Callable[[list[dict[str, Any]]], None]:
    def change(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row[column] = float(row[column]) * factor

    return change


def named(name: str) -> Callable[[list[dict[str, Any]]], None]:
    def change(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row["id"] = name if row["id"] == "ot1" else row["id"]

    return change


def run(video: Path, table: Path, out: Path, *options: object) -> int:
    given = ("--states", str(table), *map(str, options), "--out", str(out))
    return main(["import-video", str(video), *given])


@pytest.mark.parametrize("named", [(), ("--vut", "vut", "--object", "ot1=ot1")])
def test_the_event_is_the_sources_own(
    day: TrackDay, video: Path, table: Path, tmp_path: Path, named: tuple[str, ...]
) -> None:
    out = tmp_path / "rec"
    assert run(video, table, out, *named, "--site", "boulevard", "--domain", "simulation") == 0
    event, provenance = imported(out)
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.1)
    assert provenance.ego == "measured"
    assert provenance.road is not None
    assert len(provenance.road.lanes) == 4
    with BagReader(out) as reader:
        record = json.loads(reader.attachment("import.json") or b"")
        assert reader.attachment("states.csv") == table.read_bytes()
    assert record["states"]["sha256"] == sha256_file(table)
    assert record["states"]["objects"] == {"ot1": "car"}


def test_the_clips_own_crop_is_time_zero(
    day: TrackDay, video: Path, table: Path, tmp_path: Path
) -> None:
    out = tmp_path / "rec"
    assert run(video, table, out, "--start", 2, "--end", 9) == 0
    event, _ = imported(out)
    assert starts(event, zero_s=2.0) == pytest.approx(starts(truth(day)), abs=0.1)


def test_offset_and_rigid_motion_bring_the_table_into_the_videos_time_and_the_maps_frame(
    day: TrackDay, video: Path, table: Path, tmp_path: Path
) -> None:
    def moved(rows: list[dict[str, Any]]) -> None:
        """Times 100 s later; axes turned by -90 degrees about the origin, then moved."""
        for row in rows:
            x, y = float(row["x_m"]), float(row["y_m"])
            row["t_s"] = float(row["t_s"]) + 100.0
            row["x_m"], row["y_m"] = y + 30.0, -x - 50.0
            row["yaw_rad"] = float(row["yaw_rad"]) - math.pi / 2.0

    changed(table, moved)
    out = tmp_path / "rec"
    # x = -(y' + 50), y = x' - 30: turned by 90 degrees, then moved.
    given = ("--time-offset", -100, "--transform", "all=-50,-30,90", "--site", "boulevard")
    assert run(video, table, out, *given) == 0
    event, provenance = imported(out)
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.1)
    assert provenance.road is not None


def test_a_sumo_network_gives_the_same_lanes_as_the_site(
    video: Path, table: Path, tmp_path: Path
) -> None:
    net = tmp_path / "town.net.xml"
    net.write_text(NET)
    roads = []
    for k, site in enumerate((net, "boulevard")):
        out = tmp_path / f"rec{k}"
        assert run(video, table, out, "--site", site) == 0
        _, provenance = imported(out)
        assert provenance.road is not None
        roads.append([(x.y_m, x.width_m, x.direction) for x in provenance.road.lanes])
        with BagReader(out) as reader:
            record = json.loads(reader.attachment("import.json") or b"")
    assert roads[0] == roads[1]
    assert record["site"]["kind"] == "site"
    with BagReader(tmp_path / "rec0") as reader:
        site = json.loads(reader.attachment("import.json") or b"")["site"]
        assert reader.attachment(site["attachment"]) == net.read_bytes()
    assert (site["kind"], site["block"], site["road_type"]) == (
        "sumo",
        "edge main forward",
        "urban",
    )
    assert site["sha256"] == sha256_file(net)
    assert site["right_boundary"] == "unresolved"  # SUMO says nothing of kerbs


def test_left_hand_traffic_of_the_map_is_noted(video: Path, table: Path, tmp_path: Path) -> None:
    net = tmp_path / "town.net.xml"
    net.write_text(NET.replace('version="1.20"', 'version="1.20" lefthand="true"'))
    assert run(video, table, tmp_path / "rec", "--site", net) == 0
    _, provenance = imported(tmp_path / "rec")
    with BagReader(tmp_path / "rec") as reader:
        record = json.loads(reader.attachment("import.json") or b"")
    assert "edge main forward: left-hand traffic" in record["states"]["notes"]
    assert provenance.road is not None


WRONG: list[tuple[str, Callable[[list[dict[str, Any]]], None], str]] = [
    ("km/h", scaled("speed_mps", 3.6), "speeds 3.6 times those of its positions"),
    (
        "no speed for a while",
        lambda rows: [r.update(speed_mps=0.0) for r in rows[75:125]] and None,
        ":77: id vut: states 0.00 m/s from 3.00 s to 4.96 s after its first sample, while its "
        "positions go at 10.00 m/s",
    ),
    ("degrees", scaled("yaw_rad", math.degrees(1)), "a heading of more than one turn: degrees?"),
    (
        "milliseconds since 1970",
        lambda rows: [r.update(t_s=1.7e12 + 1000 * float(r["t_s"])) for r in rows] and None,
        "is no time in s: ms or ns?",
    ),
    ("an id of digits", named("12"), "name the event's objects, as in --object 'ot1=12'"),
    ("an id of two words", named("Car 7"), "is no id of a recording's object: a-z"),
    (
        "many objects",
        lambda rows: rows.extend(
            [{**r, "id": f"ot{k}"} for k in range(2, 72) for r in rows if r["id"] == "ot1"]
        ),
        "holds 71 objects beside the VUT, more than 64",
    ),
    ("milliseconds", scaled("t_s", 1000.0), "has 1 rows within the clip, from 0.000"),
    (
        "another run's time",
        lambda rows: [r.update(t_s=float(r["t_s"]) + 60) for r in rows] and None,
        "has 0 rows within the clip, from 0.000 to 10.000 s",
    ),
    (
        "half a run",
        lambda rows: rows.__delitem__(slice(150, 251)),
        "covers the clip from 0.00 s after its first frame to 4.04 s before its last one",
    ),
]


@pytest.mark.parametrize(("change", "match"), [w[1:] for w in WRONG], ids=[w[0] for w in WRONG])
def test_a_table_that_contradicts_itself_or_the_video_is_refused(
    video: Path,
    table: Path,
    tmp_path: Path,
    refused: Callable[..., str],
    change: Callable[[list[dict[str, Any]]], None],
    match: str,
) -> None:
    changed(table, change)
    message = refused("import-video", video, "--states", table, "--out", tmp_path / "rec")
    assert "states.csv:" in message
    assert match in message


def test_many_columns_that_are_not_read_are_counted(
    video: Path, table: Path, tmp_path: Path
) -> None:
    def widen(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row.update({f"a_further_column_{k}": k for k in range(40)})

    assert run(video, changed(table, widen), tmp_path / "rec") == 0
    _, provenance = imported(tmp_path / "rec")
    assert provenance.imported is not None
    assert provenance.imported.states is not None
    note = provenance.imported.states.notes[0]
    assert note.startswith("columns that are not read: 40, such as a_further_column_0, ")


def test_headings_are_judged_as_they_are_stated(video: Path, table: Path, tmp_path: Path) -> None:
    """A heading of 6 rad is sound, and stays it where a transform adds a quarter turn."""

    def turn(rows: list[dict[str, Any]]) -> None:
        c, s = math.cos(6.0), math.sin(6.0)
        for row in rows:
            x, y = float(row["x_m"]), float(row["y_m"])
            row.update(x_m=c * x - s * y, y_m=s * x + c * y, yaw_rad=6.0 + float(row["yaw_rad"]))

    assert run(video, changed(table, turn), tmp_path / "rec", "--transform", "all=0,0,90") == 0


def with_text(old: str, new: str, line: int | None = None) -> Callable[[str], str]:
    """A text with one place changed: the first, or the first in a line (from 1)."""

    def change(text: str) -> str:
        if line is None:
            return text.replace(old, new, 1)
        lines = text.splitlines(keepends=True)
        lines[line - 1] = lines[line - 1].replace(old, new, 1)
        return "".join(lines)

    return change


WRONG_TEXTS: list[tuple[str, Callable[[str], str], str]] = [
    (
        "a column missing",
        with_text("speed_mps", "speed_kmh"),
        "states.csv:1: speed_mps: is missing",
    ),
    (
        "its unit named",
        with_text("speed_mps", "speed_kmh"),
        "speed_kmh isn't read, convert and rename it",
    ),
    (
        "a column by another name",
        with_text("speed_mps", "speed"),
        "states.csv:1: speed_mps: is missing",
    ),
    ("a column twice", with_text("speed_mps", "yaw_rad"), "states.csv:1: yaw_rad: stands twice"),
    ("no number", with_text(",10.0,", ",fast,", 9), "states.csv:9: speed_mps: is no number"),
    ("not finite", with_text(",10.0,", ",nan,", 9), "states.csv:9: speed_mps: is no number"),
    ("grouped digits", with_text(",10.0,", ",1_0.0,", 9), "states.csv:9: speed_mps: is no number"),
    (
        "an unknown class",
        with_text("car", "lorry", 300),
        "states.csv:300: class: is no class [table] (got 'lorry'); known: car, truck",
    ),
    (
        "a class that changes",
        with_text("car", "truck", 300),
        "states.csv:300: class: ot1 was a car until line 299: one id must be one object",
    ),
    (
        "a size that changes",
        with_text("4.5", "12.0", 300),
        "states.csv:300: length_m: was 4.5 in line 253: one id must be one object [table] "
        "(got 12.0)",
    ),
    (
        "a size of nobody",
        with_text(",4.5,1.8", ",4.5,0", 300),
        "states.csv:300: width_m: is no extent of a road user",
    ),
    ("no id", with_text("ot1", "", 300), "states.csv:300: id: is empty"),
    (
        "a value too many",
        with_text("car", "car,1", 300),
        "states.csv:300: has 10 values, the header 9",
    ),
    (
        "time that goes back",
        with_text("4.0,", "3.0,", 102),
        "states.csv:102: id vut: goes back in time by 0.960 s",
    ),
    (
        "two objects of one id",
        with_text("\n", "\n0.0,vut,car,90.0,0.0,0.0,10.0,4.5,1.8\n"),
        "states.csv:3: id vut: has two positions at one time",
    ),
    ("nothing", lambda text: text.splitlines()[0], "states.csv: holds no row"),
    ("no header", lambda text: text.split("\n", 1)[1], "states.csv:1: t_s: is missing"),
    (
        "nobody else",
        lambda text: "".join(text.splitlines(keepends=True)[:252]),
        "states.csv: id: holds no object beside the VUT",
    ),
]


@pytest.mark.parametrize(
    ("change", "match"), [w[1:] for w in WRONG_TEXTS], ids=[w[0] for w in WRONG_TEXTS]
)
def test_a_wrong_table_is_named_by_file_line_and_column(
    video: Path,
    table: Path,
    tmp_path: Path,
    refused: Callable[..., str],
    change: Callable[[str], str],
    match: str,
) -> None:
    text = table.read_text()
    table.write_text(change(text))
    assert table.read_text() != text
    message = refused("import-video", video, "--states", table, "--out", tmp_path / "rec")
    assert match in message


def test_ids_that_switch_are_refused_where_they_do(
    video: Path, table: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    def switched(rows: list[dict[str, Any]]) -> None:
        """Exchange the ids of VUT and object from 6 s on."""
        for row in rows:
            if float(row["t_s"]) >= 6.0:
                row["id"] = {"vut": "ot1", "ot1": "vut"}[row["id"]]

    changed(table, switched)
    with table.open(newline="") as stream:
        header, *rows = csv.reader(stream)
    rows.sort(key=lambda row: (row[1], float(row[0])))
    with table.open("w", newline="") as stream:
        csv.writer(stream).writerows([header, *rows])
    message = refused("import-video", video, "--states", table, "--out", tmp_path / "rec")
    assert re.search(r"states.csv:\d+: id (vut|ot1): jumps by 1\d\.\d m within 0.04 s", message)


def test_all_that_is_wrong_in_a_table_is_listed_at_once(
    video: Path, table: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    def wrong(rows: list[dict[str, Any]]) -> None:
        rows[7]["speed_mps"] = rows[9]["speed_mps"] = rows[11]["speed_mps"] = "fast"
        rows[20]["x_m"] = "1_0"
        rows[30]["width_m"] = "0"
        rows[40]["id"] = ""
        rows[300]["class"] = "lorry"
        rows[310]["class"] = "truck"

    message = changed(table, wrong).read_text().splitlines(keepends=True)
    message[60] = message[60].replace("car", "car,1")
    table.write_text("".join(message))
    text = refused("import-video", video, "--states", table, "--out", tmp_path / "rec")
    assert "has 7 errors" in text
    for one in (
        "states.csv:61: has 10 values, the header 9 [table]",
        "states.csv:42: id: is empty [table]",
        "states.csv:302: class: is no class [table] (got 'lorry')",
        "states.csv:312: class: ot1 was a car until line 311: one id must be one object [table]",
        "states.csv:22: x_m: is no number [table] (got '1_0')",
        "states.csv:9: speed_mps: is no number, and so in 2 further rows [table] (got 'fast')",
        "states.csv:32: width_m: is no extent of a road user [table] (got '0')",
    ):
        assert one in text


@pytest.mark.parametrize("change", [with_text("x_m,y_m", "x,y"), with_text("x_m,y_m", "x_m,x_m")])
def test_all_columns_that_are_missing_are_named_at_once(
    video: Path,
    table: Path,
    tmp_path: Path,
    refused: Callable[..., str],
    change: Callable[[str], str],
) -> None:
    table.write_text(change(table.read_text()))
    text = refused("import-video", video, "--states", table, "--out", tmp_path / "rec")
    assert "has 2 errors" in text
    assert "y_m: is missing [table]" in text


@pytest.mark.parametrize(
    ("options", "status", "match"),
    [
        (
            ("--vut", "ego", "--object", "ot1=9"),
            1,
            "--object ot1: is no id of the table [table] (got '9')",
        ),
        (
            ("--vut", "ego"),
            1,
            "--vut: is no id of the table [table] (got 'ego'); its ids are vut, ot1",
        ),
        (("--object", "ot1=9"), 1, "--object ot1: is no id of the table [table] (got '9')"),
        (("--object", "ot1=vut"), 1, "--object: is named twice (got 'vut')"),
        (
            ("--time-offset", "-9.9"),
            1,
            "covers the clip from 0.02 s after its first frame to 9.90 s before its last",
        ),
        (("--ego-unknown",), 2, "give exactly one of --states FILE.csv"),
        (("--site", "north_track"), 1, "no block lies under the VUT's way, which goes by x"),
    ],
)
def test_wrong_use_of_a_table_is_explained(
    video: Path,
    table: Path,
    tmp_path: Path,
    refused: Callable[..., str],
    options: tuple[str, ...],
    status: int,
    match: str,
) -> None:
    given = ("import-video", video, "--states", table, *options, "--out", tmp_path / "rec")
    assert match in refused(*given, status=status)


def test_options_about_states_need_a_table(
    video: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    given = ("import-video", video, "--ego-unknown", "--site", "boulevard")
    message = refused(*given, "--out", tmp_path / "rec", status=2)
    assert "of no use without --states" in message


def test_a_motion_across_the_heading_is_refused_and_can_be_taken_for_the_heading(
    day: TrackDay, video: Path, table: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Some simulators move a car sideways and keep its heading."""

    def straight(rows: list[dict[str, Any]]) -> None:
        for row in rows:
            row["yaw_rad"] = 0.0

    changed(table, straight)
    assert run(video, table, tmp_path / "refused") == 1
    said = capsys.readouterr().err
    assert "id ot1: moves across its heading by 2." in said
    assert "--heading ot1=motion takes the heading from the motion" in said
    assert run(video, table, tmp_path / "kept", "--accept", "sideways") == 0
    _, provenance = read(tmp_path / "kept")
    assert provenance.imported is not None
    (one,) = provenance.imported.accepted
    assert one.name == "sideways"
    assert run(video, table, tmp_path / "taken", "--heading", "ot1=motion") == 0
    event, _ = imported(tmp_path / "taken")
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.15)


def test_a_vut_that_stands_where_the_frames_move_is_another_runs(
    table: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    """The video stands for 4 s, then moves on; one table does the reverse, the other that."""
    video = tmp_path / "clip.avi"
    write_frames(video, [picture(0)] * 41 + [picture(k) for k in range(60)])

    def driving(from_s: float, to_s: float) -> Callable[[list[dict[str, Any]]], None]:
        def change(rows: list[dict[str, Any]]) -> None:
            for row in rows:
                if row["id"] == "vut":
                    t_s = float(row["t_s"])
                    row["x_m"] = 20.0 + 5.0 * (min(max(t_s, from_s), to_s) - from_s)
                    row["speed_mps"] = 5.0 if from_s <= t_s <= to_s else 0.0

        return change

    changed(table, driving(0.0, 4.0))
    message = refused("import-video", video, "--states", table, "--out", tmp_path / "rec")
    assert "id vut: says that the VUT stands where the frames change" in message
    assert "another run's table, or another time base?" in message
    changed(table, driving(4.0, 10.0))
    assert run(video, table, tmp_path / "rec") == 0
