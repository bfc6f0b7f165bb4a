"""ssp import-video --states: a table of states is checked against itself and the frames' times."""

from __future__ import annotations

import csv
import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from foreign_recordings import (
    TrackDay,
    imported,
    starts,
    truth,
    write_table,
    write_video,
)

from ssp_core.bag import BagReader
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


WRONG: list[tuple[str, Callable[[list[dict[str, Any]]], None], str]] = [
    ("km/h", scaled("speed_mps", 3.6), "speeds 3.6 times those of its positions"),
    ("degrees", scaled("yaw_rad", math.degrees(1)), "a heading of more than one turn: degrees?"),
    ("milliseconds", scaled("t_s", 1000.0), "has 1 rows within the clip, from 0.000"),
    ("another run's time", lambda rows: [r.update(t_s=float(r["t_s"]) + 60) for r in rows] and None,
     "has 0 rows within the clip, from 0.000 to 10.000 s"),
    ("half a run", lambda rows: rows.__delitem__(slice(150, 251)),
     "covers the clip from 0.00 s after its first frame to 4.04 s before its last one"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "match"), [w[1:] for w in WRONG], ids=[w[0] for w in WRONG])
def test_a_table_that_contradicts_itself_or_the_video_is_refused(
    video: Path, table: Path, tmp_path: Path, refused: Callable[..., str],
    change: Callable[[list[dict[str, Any]]], None], match: str,
) -> None:  # fmt: skip
    changed(table, change)
    message = refused("import-video", video, "--states", table, "--out", tmp_path / "rec")
    assert "states.csv:" in message
    assert match in message
