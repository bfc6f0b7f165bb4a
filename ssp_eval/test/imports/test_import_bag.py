"""ssp import-bag: what a track day's bag holds is measured, and nothing else (METHOD 4.3)."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from foreign_recordings import (
    FIX,
    INFO,
    JPEG,
    ODOMETRY,
    POSE,
    RAW,
    TF,
    TYPES,
    Message,
    TrackDay,
    camera_info,
    header,
    imported,
    jpeg,
    number_of,
    pose,
    raw,
    starts,
    transform,
    truth,
    write_bag,
)
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from track_day_changes import DECLARED, OBJECTS, framed, messages_of, moved, run

from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.seal import Seal, read_seal
from ssp_core.cdr.messages import stamp_ns
from ssp_core.cli import main
from ssp_core.hashing import sha256_file
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.log import read_log
from ssp_scenario_manager.maps.site import find_shipped
from ssp_vla_bridge.window import mounting_of
from tests.support.bags.messages import without_index
from tests.support.bags.seals import with_checksums

IMAGE = "/ssp/vut/front_camera/image/compressed"


@pytest.fixture(scope="module")
def bag(day: TrackDay, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The track day as an MCAP bag."""
    return write_bag(tmp_path_factory.mktemp("day") / "bag", day.messages())


@pytest.mark.parametrize("sqlite", [False, True])
@pytest.mark.parametrize(("make_image", "image_type"), [(jpeg, JPEG), (raw, RAW)])
def test_the_event_is_the_sources_own(
    day: TrackDay, tmp_path: Path, sqlite: bool, make_image: Any, image_type: str
) -> None:
    source = write_bag(tmp_path / "day", day.messages(make_image, image_type), sqlite=sqlite)
    out = tmp_path / "rec"
    assert run(source, out, *DECLARED, "--site", "boulevard") == 0
    event, provenance = imported(out)
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.02)
    assert provenance.participants is not None
    assert dict(provenance.participants.targets) == {"ot1": "car"}
    assert provenance.road is not None
    assert [(lane.y_m, lane.direction) for lane in provenance.road.lanes] == [
        (0.0, "forward"),
        (3.5, "forward"),
        (7.0, "backward"),
        (10.5, "backward"),
    ]
    assert provenance.domain_said_by == "declared by A. Engineer, 2026-03-01, north track"
    with BagReader(out) as reader:
        numbers = [
            number_of(cv2.imdecode(reader.decode(m).data, cv2.IMREAD_COLOR))
            for m in reader.messages([IMAGE])
        ]
    assert numbers == list(range(101))


def test_a_bag_without_an_index_is_imported_as_one_with(bag: Path, tmp_path: Path) -> None:
    assert run(bag, tmp_path / "indexed", *DECLARED) == 0
    assert run(without_index(bag, tmp_path / "fast"), tmp_path / "new", *DECLARED) == 0
    ours, same = (
        [m._replace(log_time_ns=0) for m in BagReader(next(folder.rglob("*.mcap"))).messages()]
        for folder in (tmp_path / "new", tmp_path / "indexed")
    )
    assert ours == same


def test_import_json_holds_sources_declarations_and_the_road_by_hash(
    bag: Path, tmp_path: Path
) -> None:
    out = tmp_path / "rec"
    log = (
        "--log-by",
        "B. Safety",
        "--log-on",
        "2026-03-02",
        "--safety-abort",
        "no",
        "--identity-switch",
        "no",
        "--site-change",
        "none",
    )
    assert run(bag, out, *DECLARED, *log, "--site", "boulevard", "--event", "cut_in") == 0
    with BagReader(out) as reader:
        record = json.loads(reader.attachment("import.json") or b"")
        site = reader.attachment("site.yaml")
        event = reader.attachment("event.yaml")
    (file,) = bag.glob("*.mcap")
    name, version = "cut_in", load_event("cut_in")[1]
    assert record["schema"] == "ssp.import/2"
    assert record["source"] == {
        "name": "bag",
        "sha256": sha256_file(file),
        "kind": "bag",
        "clock": "header",
        "topics": {"vut": "/vut/odom", "ot1": "/ot1/odom", "camera": "/cam"},
    }
    assert record["crop"] == {"start_s": 0.0, "end_s": 10.0}
    assert (record["scenario"], record["event_version"]) == (name, version)
    assert record["log"] == {
        "by": "B. Safety",
        "on": "2026-03-02",
        "safety_abort": False,
        "identity_switch": False,
        "site_changes": [],
    }
    assert record["site"]["sha256"] == sha256_file(find_shipped("boulevard", "site"))
    assert record["site"]["block"] == "main"
    assert site == find_shipped("boulevard", "site").read_bytes()
    assert event == find_shipped("cut_in", "event").read_bytes()
    (entry,) = read_log(tmp_path / "rec.log.jsonl")
    assert (entry.kind, entry.who, entry.subject) == ("source", "ssp import-bag", "cut_in")
    assert entry.details["declared"] == record["log"]


def test_what_nobody_declares_stays_unknown(bag: Path, tmp_path: Path) -> None:
    assert run(bag, tmp_path / "rec", "--domain", "physical") == 0
    _, provenance = imported(tmp_path / "rec")
    assert provenance.imported is not None
    assert (provenance.imported.log, provenance.imported.declaration) == (None, None)
    assert (provenance.road, provenance.camera) == (None, "unknown")
    assert provenance.domain_said_by == "not declared"


def test_the_camera_is_that_of_camera_info_and_static_transforms(
    day: TrackDay, tmp_path: Path
) -> None:
    level = (-0.5, 0.5, -0.5, 0.5)  # optical axes in a body frame, REP 103
    down = (0.0, math.sin(0.05), 0.0, math.cos(0.05))
    chain = TYPES.types[TF](
        transforms=[
            transform("base_link", "camera", (1.5, 0.1, 1.4), down),
            transform("camera", "camera_optical", (0.0, 0.0, 0.0), level),
        ]
    )
    more: list[Message] = [
        ("/info", INFO, day.zero_ns, camera_info(day.zero_ns, 32.0)),
        ("/tf_static", TF, day.zero_ns, chain),
    ]
    source = write_bag(tmp_path / "day", [*day.messages(), *more])
    out = tmp_path / "rec"
    assert (
        run(source, out, "--domain", "physical", "--camera-info", "/info", "--reference", "vut=0.5")
        == 0
    )
    with BagReader(out) as reader:
        mount = reader.decode(next(iter(reader.messages(["/ssp/vut/front_camera/mount"]))))
        info = reader.decode(next(iter(reader.messages(["/ssp/vut/front_camera/camera_info"]))))
        record = json.loads(reader.attachment("import.json") or b"")
        fixed = reader.decode(next(iter(reader.messages(["/tf_static"]))))
        moving = [reader.decode(message) for message in reader.messages(["/tf"])]
        vut = {
            stamp_ns(s.header.stamp): s
            for s in map(reader.decode, reader.messages(["/ssp/vut/state"]))
        }
    chain = [(one.header.frame_id, one.child_frame_id) for one in fixed.transforms]
    assert chain == [
        ("vut/base_link", "vut/front_camera"),
        ("vut/front_camera", "vut/front_camera_optical"),
    ]
    place = fixed.transforms[0].transform.translation
    assert (place.x, place.y, place.z) == (2.0, 0.1, 1.4)
    places = {
        stamp_ns(one.header.stamp): one.transform.translation
        for message in moving
        for one in message.transforms
        if one.child_frame_id == "vut/base_link"
    }
    assert {at: (v.x, v.y) for at, v in places.items()} == {at: (s.x, s.y) for at, s in vut.items()}
    found = mounting_of(mount.transform)
    # The poses are of a point half a metre ahead of the rear axle.
    assert (found.forward_m, found.left_m, found.height_m) == pytest.approx((2.0, 0.1, 1.4))
    assert found.pitch_down_rad == pytest.approx(0.1)
    assert info.k.tolist() == pytest.approx([32, 0, 32, 0, 32, 24, 0, 0, 1])
    assert record["camera"]["provenance"] == "measured"
    assert record["camera"]["hfov_deg"] == pytest.approx(90.0)


def sealed_as(path: Path) -> Seal:
    with BagReader(path) as reader:
        return read_seal(reader)


@pytest.mark.parametrize("sqlite", [False, True])
def test_a_bag_of_others_is_sealed_at_import(day: TrackDay, tmp_path: Path, sqlite: bool) -> None:
    source = write_bag(tmp_path / "day", day.messages(), sqlite=sqlite)
    assert run(source, tmp_path / "rec", *DECLARED) == 0
    seal = sealed_as(tmp_path / "rec")
    assert (seal.maker, seal.is_sound, bool(seal.end)) == ("import", True, True)
    (parent,) = seal.sources
    files = [p for p in source.iterdir() if p.suffix in (".mcap", ".db3")]
    assert (parent.name, parent.sha256) == ("day", sha256_file(files[0]))
    assert (parent.state, parent.ends) == ("not sealed", ())


def test_a_sealed_bag_keeps_its_lineage_at_import_unless_it_was_altered(
    bag: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    cut = tmp_path / "cut"
    assert main(["bag", "cut", str(bag), "--start", "0.5", "--end", "9", "-o", str(cut)]) == 0
    assert run(cut, tmp_path / "rec", *DECLARED) == 0
    parent, grandparent = sealed_as(tmp_path / "rec").sources
    assert (parent.name, parent.ends) == ("cut", sealed_as(cut).ends)
    assert (grandparent.name, grandparent.state) == ("bag", "not sealed")
    file = next(cut.glob("*.mcap"))
    data = bytearray(file.read_bytes())
    data[data.index(b"\xff\xd8\xff") + 20] ^= 1
    file.write_bytes(with_checksums(data))
    given = ("import-bag", cut, *OBJECTS, *DECLARED, "--out", tmp_path / "other")
    assert f"is altered since it was sealed: chunk 1 of {file.name}" in refused(*given)


def test_a_sealed_bag_that_another_program_converts_is_one_of_others(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A converter, here to SQLite, writes no seal."""
    cut, converted = tmp_path / "cut", tmp_path / "converted"
    assert main(["bag", "cut", str(bag), "--end", "9", "-o", str(cut)]) == 0
    with (
        Reader(cut) as reader,
        Writer(converted, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer,
    ):
        made = {
            c.id: writer.add_connection(c.topic, c.msgtype, typestore=TYPES)
            for c in reader.connections
        }
        for connection, received_ns, data in reader.messages():
            writer.write(made[connection.id], received_ns, data)
    assert run(converted, tmp_path / "rec", *DECLARED) == 0
    (parent,) = sealed_as(tmp_path / "rec").sources
    assert (parent.name, parent.state) == ("converted", "not sealed")
    capsys.readouterr()
    assert main(["bag", "check", str(tmp_path / "rec")]) == 0
    said = capsys.readouterr()
    assert "made of converted, not sealed" in " ".join((said.out + said.err).split())


def test_times_of_receipt_are_used_where_that_is_asked(day: TrackDay, tmp_path: Path) -> None:
    source = write_bag(
        tmp_path / "day",
        messages_of(day, lambda m: (*m[:3], replace(m[3], header=header(0, m[3].header.frame_id)))),
    )
    assert run(source, tmp_path / "rec", *DECLARED, "--clock", "receive") == 0
    event, provenance = imported(tmp_path / "rec")
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.02)
    assert provenance.imported is not None
    assert provenance.imported.states is not None
    assert "times are those of receipt" in provenance.imported.states.notes[0]


def test_poses_alone_give_speeds_and_headings_of_their_own(day: TrackDay, tmp_path: Path) -> None:
    def as_pose(m: Message) -> Message:
        if m[1] != ODOMETRY:
            return m
        return (m[0], POSE, m[2], TYPES.types[POSE](header=m[3].header, pose=m[3].pose.pose))

    source = write_bag(tmp_path / "day", messages_of(day, as_pose))
    assert run(source, tmp_path / "rec", *DECLARED) == 0
    event, provenance = imported(tmp_path / "rec")
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.1)
    assert provenance.imported is not None
    assert provenance.imported.states is not None
    said = " ".join(provenance.imported.states.notes)
    assert "ot1: speed derived from its positions, a line through the samples within 0.15 s" in said


LAT, LON = 57.7, 12.9


def geodetic(lat_deg: float) -> Callable[[Message], Message]:
    """Poses as fixes, north of a latitude and east of LON.

    One degree of latitude at 57.7 N is 111,358 m of the meridian, one of longitude 59,718 m.
    """
    status = TYPES.types["sensor_msgs/msg/NavSatStatus"](status=0, service=1)

    def as_fix(m: Message) -> Message:
        if m[1] != ODOMETRY:
            return m
        p = m[3].pose.pose.position
        fix = TYPES.types[FIX](
            header=header(m[3].header.stamp.sec * 10**9 + m[3].header.stamp.nanosec, "gps"),
            status=status,
            latitude=lat_deg + p.y / 111_358.0,
            longitude=LON + p.x / 59_718.0,
            altitude=0.0,
            position_covariance=np.zeros(9),
            position_covariance_type=0,
        )
        return (m[0], FIX, m[2], fix)

    return as_fix


def test_geodetic_positions_need_a_datum_and_lie_in_its_frame(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str]
) -> None:
    source = write_bag(tmp_path / "day", messages_of(day, geodetic(LAT)))
    given = ("import-bag", source, *OBJECTS, *DECLARED, "--out", tmp_path / "rec")
    assert "give the origin of the map's frame with --datum" in refused(*given)
    assert (
        run(source, tmp_path / "rec", *DECLARED, "--datum", f"{LAT},{LON}", "--site", "boulevard")
        == 0
    )
    event, _ = imported(tmp_path / "rec")
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.1)


@pytest.mark.parametrize(
    ("lat_deg", "datum", "text"),
    [
        (LAT, f"{-LAT},{LON}", "km from the datum, more than 50 km"),
        (LAT, f"{LAT + 0.5},{LON}", "lies up to 56 km from the datum"),
        (95.0, f"{LAT},{LON}", "must be from -90 to 90"),
    ],
)
def test_geodetic_positions_off_the_earth_or_far_from_the_datum_are_refused(
    lat_deg: float,
    datum: str,
    text: str,
    day: TrackDay,
    tmp_path: Path,
    refused: Callable[..., str],
) -> None:
    source = write_bag(tmp_path / "day", messages_of(day, geodetic(lat_deg)))
    given = ("import-bag", source, *OBJECTS, *DECLARED, f"--datum={datum}")
    assert text in refused(*given, "--out", tmp_path / "rec")


def test_an_object_in_its_own_frame_is_brought_into_the_others(
    day: TrackDay, tmp_path: Path
) -> None:
    away = moved(lambda x, y, yaw: (y + 30.0, -x - 50.0, yaw - math.pi / 2))
    source = write_bag(tmp_path / "day", messages_of(day, lambda m: framed("odom")(away(m))))
    assert run(source, tmp_path / "rec", *DECLARED, "--transform", "ot1=-50,-30,90") == 0
    event, _ = imported(tmp_path / "rec")
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.02)


def test_a_crop_begins_with_its_first_frame(day: TrackDay, bag: Path, tmp_path: Path) -> None:
    assert run(bag, tmp_path / "rec", *DECLARED, "--start", 2, "--end", 9) == 0
    event, provenance = imported(tmp_path / "rec")
    assert starts(event, zero_s=2.0) == pytest.approx(starts(truth(day)), abs=0.02)
    assert provenance.imported is not None
    assert provenance.imported.crop == {"start_s": 2.0, "end_s": 9.0}


def test_frames_and_gaps_are_said(day: TrackDay, tmp_path: Path) -> None:
    def silent(m: Message) -> Message | None:
        t_s = m[2] / 1e9 - 1_700_000_000
        lost = (m[0] == "/ot1/odom" and 2.0 < t_s < 2.6) or (m[0] == "/cam" and 7.0 < t_s < 7.5)
        late = m[0] == "/vut/odom" and t_s < 1.0
        return None if lost or late else m

    source = write_bag(tmp_path / "day", messages_of(day, silent))
    assert run(source, tmp_path / "rec", *DECLARED) == 0
    _, provenance = imported(tmp_path / "rec")
    assert provenance.imported is not None
    assert provenance.imported.states is not None
    said = "\n".join(provenance.imported.states.notes)
    assert "the VUT's poses begin" in said
    assert "ot1: 1 gaps of more than 0.3 s, the longest 0.6" in said
    assert "camera: 1 gaps of more than 0.3 s, the longest 0.6" in said


def test_speeds_in_the_poses_frame_are_turned_into_the_heading(
    day: TrackDay, tmp_path: Path
) -> None:
    def in_map(m: Message) -> Message:
        """The day turned by a quarter, speeds given along the map's axes."""
        if m[1] != ODOMETRY:
            return m
        p, twist = m[3].pose.pose, m[3].twist.twist
        yaw = 2 * math.atan2(p.orientation.z, p.orientation.w) + math.pi / 2
        speed = twist.linear.x
        linear = replace(twist.linear, x=speed * math.cos(yaw), y=speed * math.sin(yaw))
        turned = pose(-p.position.y, p.position.x, yaw)
        message = replace(
            m[3],
            child_frame_id="map",
            pose=replace(m[3].pose, pose=turned),
            twist=replace(m[3].twist, twist=replace(twist, linear=linear)),
        )
        return (*m[:3], message)

    source = write_bag(tmp_path / "day", messages_of(day, in_map))
    assert run(source, tmp_path / "rec", *DECLARED) == 0
    event, provenance = imported(tmp_path / "rec")
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.02)
    assert provenance.imported is not None
    assert provenance.imported.states is not None
    said = " ".join(provenance.imported.states.notes)
    assert "/vut/odom: speeds are in map, and were turned into the heading" in said


def test_a_gap_in_the_poses_is_accepted_and_said(day: TrackDay, tmp_path: Path) -> None:
    low_ns, high_ns = (1_700_000_000 * 10**9 + round(s * 1e9) for s in (5.0, 5.8))
    kept = [m for m in day.messages() if m[0] != "/vut/odom" or not low_ns <= m[2] < high_ns]
    assert run(write_bag(tmp_path / "day", kept), tmp_path / "rec", *DECLARED) == 0
    with BagReader(tmp_path / "rec") as reader:
        notes = json.loads(reader.attachment("import.json") or b"")["states"]["notes"]
    assert "vut: 1 gaps of more than 0.3 s, the longest 0.82 s" in " ".join(notes)


def test_samples_that_are_repeated_are_left_out_and_said(day: TrackDay, tmp_path: Path) -> None:
    again = [(t, kind, ns + 1_000_000, m) for t, kind, ns, m in day.messages() if t == "/ot1/odom"]
    source = write_bag(tmp_path / "day", [*day.messages(), *again])
    assert run(source, tmp_path / "rec", *DECLARED) == 0
    event, provenance = imported(tmp_path / "rec")
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.02)
    assert provenance.imported is not None
    assert provenance.imported.states is not None
    assert (
        "ot1: 501 samples that repeat the one before were left out"
        in provenance.imported.states.notes
    )


def test_a_camera_whose_place_nobody_says_has_none(day: TrackDay, tmp_path: Path) -> None:
    elsewhere = TYPES.types[TF](
        transforms=[transform("roof", "camera_optical", (0, 0, 0), (-0.5, 0.5, -0.5, 0.5))]
    )
    more: list[Message] = [
        ("/info", INFO, day.zero_ns, camera_info(day.zero_ns, 32.0)),
        ("/tf_static", TF, day.zero_ns, elsewhere),
    ]
    source = write_bag(tmp_path / "day", [*day.messages(), *more])
    assert run(source, tmp_path / "rec", *DECLARED, "--camera-info", "/info") == 0
    _, provenance = imported(tmp_path / "rec")
    assert provenance.imported is not None
    assert provenance.imported.states is not None
    assert provenance.imported.camera.height_m is None
    assert (
        "camera: /tf_static doesn't lead from camera_optical to base_link; its place isn't known "
        "(--mount says it)"
    ) in provenance.imported.states.notes


def test_programs_get_the_summary_as_json(
    bag: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(bag, tmp_path / "rec", *DECLARED, "--rate", 5, "--json") == 0
    shown = json.loads(capsys.readouterr().out)
    assert (shown["frames"], shown["keep_every"], shown["rate_hz"]) == (51, 2, 5.0)
    assert (shown["width_px"], shown["height_px"], shown["duration_s"]) == (64, 48, 10.0)
    assert shown["import"]["states"]["objects"] == {"ot1": "car"}


def test_a_simulators_time_may_run_slower_than_the_recorders(day: TrackDay, tmp_path: Path) -> None:
    """Stamps from 0 on, at half the speed; one topic begins two seconds late."""
    slow = replace(day, zero_ns=0)
    wall_ns = 1_700_000_000 * 10**9
    messages = [
        (topic, kind, wall_ns + 2 * ns, message)
        for topic, kind, ns, message in slow.messages()
        if topic != "/ot1/odom" or ns > 2 * 10**9
    ]
    source = write_bag(tmp_path / "day", messages)
    assert run(source, tmp_path / "rec", *DECLARED) == 0
    event, _ = imported(tmp_path / "rec")
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.02)
