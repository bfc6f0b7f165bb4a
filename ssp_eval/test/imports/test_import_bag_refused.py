"""ssp import-bag refuses what contradicts itself, and explains wrong use."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from foreign_recordings import (
    INFO,
    Message,
    TrackDay,
    camera_info,
    header,
    jpeg,
    picture,
    write_bag,
)
from track_day_changes import (
    DECLARED,
    OBJECTS,
    for_a_while,
    framed,
    messages_of,
    moved,
    of_all,
    once_back,
    restamped,
    twisted,
)


@pytest.fixture(scope="module")
def bag(day: TrackDay, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The track day as an MCAP bag."""
    return write_bag(tmp_path_factory.mktemp("day") / "bag", day.messages())


WRONG_BAGS: list[tuple[str, Callable[[Message], Message | None], str]] = [
    ("km/h", twisted(3.6), "/ot1/odom: has speeds 3.6 times those of its positions"),
    (
        "degrees",
        moved(lambda x, y, yaw: (x, y, math.pi / 2 - yaw)),
        "degrees off its direction of motion (they look clockwise from +y, as a compass counts)",
    ),
    ("left-handed", moved(lambda x, y, yaw: (x, y, yaw + math.pi)), "turned by half a turn"),
    (
        "a jump",
        moved(lambda x, y, yaw: (x + (30.0 if x > 70.0 else 0.0), y, yaw)),
        "/ot1/odom: jumps by 30.2 m within 0.02 s: one id must be one object",
    ),
    (
        "no speed for a while",
        for_a_while(twisted(0.0)),
        "/ot1/odom: states 0.00 m/s from 5.00 s to 6.18 s after its first sample, while its "
        "positions go at 9.",
    ),
    (
        "a heading turned for a while",
        for_a_while(moved(lambda x, y, yaw: (x, y, yaw + math.pi))),
        "/ot1/odom: has headings that lie 180 degrees off its direction of motion from 5.00 s to ",
    ),
    (
        "a clock that steps",
        of_all(("/vut/odom", "/ot1/odom", "/cam"), lambda t: 800_000_000 if t > 5 * 10**9 else 0),
        "/vut/odom: moves by 0.2 m within 0.82 s, at 4.98 s after its first sample, where it goes "
        "at 10.00 m/s: a step of the clock? [clock_step]",
    ),
    (
        "no number",
        moved(lambda x, y, yaw: (math.nan if x > 70.0 else x, y, yaw)),
        "/ot1/odom: has a x_m that is no number",
    ),
    (
        "two frames",
        framed("odom"),
        "/ot1/odom: its poses are in frame 'odom', the others' in 'map' [frames]; say how its "
        "frame lies in theirs with --transform ot1=X,Y,YAW_DEG",
    ),
    (
        "no stamps",
        lambda m: (
            (*m[:3], replace(m[3], header=header(0, m[3].header.frame_id)))
            if m[0] == "/ot1/odom"
            else m
        ),
        "/ot1/odom: 501 of 501 messages have the stamp 0 [clocks]; take the times of receipt",
    ),
    ("a stamp back", once_back, "/vut/odom: 1 stamps go backwards, the first by 0.480 s"),
    (
        "two clocks",
        restamped(lambda t: 2_000_000_000, "/cam"),
        "/cam: its stamps lie 2.000 s after those of /vut/odom, by when both were received",
    ),
    (
        "a clock that drifts",
        restamped(lambda t: -t // 50, "/ot1/odom"),
        "/ot1/odom: its stamps drift by 0.134 s against those of /vut/odom",
    ),
    (
        "no object",
        lambda m: None if m[0] == "/ot1/odom" else m,
        "/ot1/odom: is no topic of this bag [topics]; of these types it has /vut/odom",
    ),
    (
        "an object that isn't there",
        lambda m: None if m[0] == "/ot1/odom" and m[2] > 1_700_000_000_010_000_000 else m,
        "/ot1/odom: holds 1 samples within the crop",
    ),
]


@pytest.mark.parametrize(
    ("change", "match"), [w[1:] for w in WRONG_BAGS], ids=[w[0] for w in WRONG_BAGS]
)
def test_a_bag_that_contradicts_itself_is_refused(
    day: TrackDay,
    tmp_path: Path,
    refused: Callable[..., str],
    change: Callable[[Message], Message | None],
    match: str,
) -> None:
    source = write_bag(tmp_path / "day", messages_of(day, change))
    message = refused("import-bag", source, *OBJECTS, *DECLARED, "--out", tmp_path / "rec")
    assert f"{source}: " in message
    assert match in message


@pytest.mark.parametrize(
    ("options", "status", "match"),
    [
        (("--camera", "/nowhere"), 1, "bag [topics]; of these types it has /cam"),
        (("--camera", "/vut/odom"), 1, "/vut/odom: has messages of another type"),
        (("--camera-info", "/cam"), 1, "/cam: has messages of another type"),
        (("--start", 11), 1, "/cam: has no frame from 11 s on [crop]; its frames span 10.000 s"),
        (("--rate", 60), 1, "--rate: has 10 frames per second, fewer than 60"),
        (("--site", "nowhere"), 1, "no such site (got 'nowhere')"),
        (
            ("--site", "boulevard", "--block", "side"),
            1,
            "nor a route under the VUT's way (got 'side')",
        ),
        (
            ("--site", "north_track", "--transform", "all=5000,0,0"),
            1,
            "no block lies under the VUT's way",
        ),
        (
            ("--event", "cut_in", "--object", "ot2=/ot1/odom:car"),
            1,
            "has the objects ot1, ot2, vut, the K* cut_in has ot1, vut",
        ),
        (("--event", "cut_in", "--scenario", "a"), 2, "--event gives --scenario"),
        (("--object", "ot1=/x:car"), 2, "--object names ot1 twice"),
        (("--object", "ot2=/x:lorry"), 2, "classes are car, truck"),
        (("--block", "main"), 2, "--block is of no use without --site"),
        (("--transform", "ot9=0,0,0"), 2, "--transform ot9=…: the objects are vut, ot1"),
        (("--transform", "ot1=0,0"), 2, "give X,Y,YAW_DEG as numbers"),
        (("--size", "ot1=4x2"), 2, "give LENGTH,WIDTH,HEIGHT as numbers"),
        (("--reference", "ot1=roof"), 2, "give rear_axle, centre, front, rear or a number"),
        (("--mount", "1,0,-1,0"), 2, "Z in (0, 10] m"),
        (("--datum", "91,0"), 2, "latitude 91 must be from -90 to 90"),
        (("--log-by", "A"), 2, "what isn't declared is unknown"),
        (("--place", "x", "--declared-on", "2999-01-01"), 2, "lies in the future"),
    ],
)
def test_wrong_use_is_explained_and_leaves_nothing(
    bag: Path,
    tmp_path: Path,
    refused: Callable[..., str],
    options: tuple[Any, ...],
    status: int,
    match: str,
) -> None:
    given = ("import-bag", bag, *OBJECTS, *DECLARED, *options, "--out", tmp_path / "rec")
    assert match in refused(*given, status=status)


def test_what_is_no_bag_is_one_message(tmp_path: Path, refused: Callable[..., str]) -> None:
    (tmp_path / "text.mcap").write_text("not a bag")
    (tmp_path / "old.bag").write_text("#ROSBAG V2.0")
    (tmp_path / "empty").mkdir()
    for name, match in (
        ("text.mcap", "text.mcap: is no MCAP file"),
        ("old.bag", "old.bag: is a bag of ROS 1"),
        ("empty", "empty: has no metadata.yaml, so it is no closed bag"),
        ("none", "none: is not there"),
    ):
        assert match in refused("import-bag", tmp_path / name, *OBJECTS, "--domain", "physical")


def test_a_domain_is_declared_with_name_date_and_place(
    bag: Path, tmp_path: Path, refused: Callable[..., str]
) -> None:
    given = ("import-bag", bag, *OBJECTS, "--out", tmp_path / "rec")
    assert "Missing option '--domain'" in refused(*given, status=2)
    more = ("--domain", "physical", "--declared-by", "A. Engineer")
    assert "declared by a person with date and place" in refused(*given, *more, status=2)


def test_frames_of_two_sizes_are_refused(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str]
) -> None:
    def cropped(m: Message) -> Message:
        ns = m[2]
        return (
            (*m[:3], jpeg(ns - 3_000_000, picture(1, (128, 48))))
            if (m[0] == "/cam" and ns > 1_700_000_005 * 10**9)
            else m
        )

    source = write_bag(tmp_path / "day", messages_of(day, cropped))
    message = refused("import-bag", source, *OBJECTS, *DECLARED, "--out", tmp_path / "rec")
    assert "/cam: holds a frame at 5.000 s of the clip that can't be used: 128x48 px" in message


def test_an_orientation_that_is_none_is_named(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str]
) -> None:
    def unset(m: Message) -> Message:
        if m[0] != "/vut/odom":
            return m
        p = m[3].pose.pose
        none = replace(p, orientation=replace(p.orientation, w=0.0, z=0.0))
        return (*m[:3], replace(m[3], pose=replace(m[3].pose, pose=none)))

    source = write_bag(tmp_path / "day", messages_of(day, unset))
    message = refused("import-bag", source, *OBJECTS, *DECLARED, "--out", tmp_path / "rec")
    assert "/vut/odom: message 1: the orientation's norm is 0.000, not 1" in message


def test_a_place_that_is_no_number_is_named_by_its_time(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str]
) -> None:
    def lost(m: Message) -> Message:
        if m[0] != "/vut/odom" or m[2] - day.zero_ns < 1_000_000_000:
            return m
        p = m[3].pose.pose
        none = replace(p, position=replace(p.position, x=math.nan))
        return (*m[:3], replace(m[3], pose=replace(m[3].pose, pose=none)))

    source = write_bag(tmp_path / "day", messages_of(day, lost))
    message = refused("import-bag", source, *OBJECTS, *DECLARED, "--out", tmp_path / "rec")
    assert re.search(r"/vut/odom: has a x_m that is no number, 1\.\d+ s after its first", message)


@pytest.mark.parametrize(
    ("info", "match"),
    [
        (camera_info(0, 32.0, (128, 48)), "/info: is of frames of 128x48 px, the camera's have"),
        (camera_info(0, 0.0), "/info.k: says that the camera isn't calibrated"),
    ],
)
def test_a_camera_info_of_another_camera_is_refused(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str], info: Any, match: str
) -> None:
    more: Message = ("/info", INFO, day.zero_ns, info)
    source = write_bag(tmp_path / "day", [*day.messages(), more])
    given = (*OBJECTS, *DECLARED, "--camera-info", "/info", "--out", tmp_path / "rec")
    assert match in refused("import-bag", source, *given)
