"""Axes of others: what is named after downward axes must be stated, and is then brought to ours."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from foreign_recordings import (
    ODOMETRY,
    TYPES,
    Message,
    TrackDay,
    imported,
    odometry,
    pose,
    read,
    starts,
    truth,
    vector,
    write_bag,
)

from ssp_core.cli import main
from ssp_eval.importers.axes import Axes

OBJECTS = ("--vut", "/vut/odom", "--object", "ot1=/ot1/odom:car", "--camera", "/cam")
TURN_RAD = 0.6


def run(bag: Path, out: Path, *options: object) -> int:
    given = (*options, "--domain", "physical", "--out", out)
    return main(["import-bag", str(bag), *OBJECTS, *map(str, given)])


def rewritten(day: TrackDay, change: Callable[[Any, Any], Any]) -> list[Message]:
    """The day's messages, the odometry made of states and messages by a function."""
    made: list[Message] = [m for m in day.messages() if m[1] != ODOMETRY]
    for name, states in day.states.items():
        for one in states:
            ns = day.zero_ns + one.stamp_ns
            made.append((f"/{name}/odom", ODOMETRY, ns + 3_000_000, change(one, odometry(ns, one))))
    return made


def with_twist(message: Any, x: float, y: float, rate: float) -> Any:
    twist = TYPES.types["geometry_msgs/msg/Twist"](
        linear=vector(x, y), angular=vector(0.0, 0.0, rate)
    )
    return replace(message, twist=replace(message.twist, twist=twist))


def downward(world: str, frame: str, child: str) -> Callable[[Any, Any], Any]:
    """The same motion along other axes; to the right is positive across."""

    def change(one: Any, message: Any) -> Any:
        place = (one.y_m, one.x_m, math.pi / 2.0 - one.yaw_rad)
        if world == "frd":
            place = (one.x_m, -one.y_m, -one.yaw_rad)
        head = replace(message.header, frame_id=frame)
        message = replace(message, header=head, child_frame_id=child)
        message = replace(message, pose=replace(message.pose, pose=pose(*place)))
        return with_twist(message, one.speed_mps, 0.0, -one.yaw_rate_radps)

    return change


def turned(day: TrackDay) -> TrackDay:
    """The day's event in a map that is turned, so that no road leads along an axis."""
    c, s = math.cos(TURN_RAD), math.sin(TURN_RAD)
    return replace(
        day,
        states={
            name: [
                replace(
                    one,
                    x_m=c * one.x_m - s * one.y_m,
                    y_m=s * one.x_m + c * one.y_m,
                    yaw_rad=one.yaw_rad + TURN_RAD,
                )
                for one in states
            ]
            for name, states in day.states.items()
        },
    )


def assert_same(out: Path, day: TrackDay) -> None:
    """The recording has the day's states, and its event."""
    states, _ = read(out)
    for name, ones in day.states.items():
        found = {round(t * 1e9): row[name] for t, row in states.series if name in row}
        for one in ones[::50]:
            same = found[one.stamp_ns]
            assert (same.x_m, same.y_m) == pytest.approx((one.x_m, one.y_m), abs=1e-6)
            assert math.remainder(same.yaw_rad - one.yaw_rad, math.tau) == pytest.approx(
                0, abs=1e-6
            )
            assert same.speed_mps == pytest.approx(one.speed_mps, abs=1e-6)
            assert same.yaw_rate_radps == pytest.approx(one.yaw_rate_radps, abs=1e-6)
    event, _ = imported(out)
    assert starts(event) == pytest.approx(starts(truth(day)), abs=0.02)


@pytest.mark.parametrize(
    ("world", "frame", "child"),
    [
        ("ned", "local_ned", "base_link_frd"),
        ("ned", "map_NED", "base_link"),
        ("frd", "odom", "vut/FRD"),
        ("frd", "odomFrd", ""),
    ],
)
def test_downward_axes_are_refused_until_they_are_stated(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str], world: str, frame: str, child: str
) -> None:
    there = turned(day)
    source = write_bag(tmp_path / "day", rewritten(there, downward(world, frame, child)))
    said = refused(
        "import-bag", source, *OBJECTS, "--domain", "physical", "--out", tmp_path / "rec"
    )
    for name in ("vut", "ot1"):
        assert f"/{name}/odom: its frame is named " in said
        assert f"--axes {name}=ned" in said
    assert frame in said
    assert run(source, tmp_path / "rec", "--axes", f"all={world}") == 0
    assert_same(tmp_path / "rec", there)


def test_names_that_only_look_so_are_taken_as_they_are(day: TrackDay, tmp_path: Path) -> None:
    def change(_: Any, message: Any) -> Any:
        head = replace(message.header, frame_id="planned_map")
        return replace(message, header=head, child_frame_id="wednesday/base_link")

    assert run(write_bag(tmp_path / "day", rewritten(day, change)), tmp_path / "rec") == 0


def test_axes_that_are_stated_as_usual_ones_are_taken_as_they_are(
    day: TrackDay, tmp_path: Path
) -> None:
    def change(_: Any, message: Any) -> Any:
        return replace(message, child_frame_id="base_link_frd")

    source = write_bag(tmp_path / "day", rewritten(day, change))
    assert run(source, tmp_path / "rec", "--axes", "vut=enu", "--axes", "all=enu/frd") == 0
    states, _ = read(tmp_path / "rec")
    rates = [row["ot1"].yaw_rate_radps for _, row in states.series if "ot1" in row]
    # The object's child frame is stated to lead downwards.
    assert rates == [-one.yaw_rate_radps for one in day.states["ot1"][: len(rates)]]


def test_a_twist_in_the_maps_axes_is_refused_until_it_is_stated(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str]
) -> None:
    def change(one: Any, message: Any) -> Any:
        east, north = math.cos(one.yaw_rad), math.sin(one.yaw_rad)
        speed = one.speed_mps
        return with_twist(message, speed * east, speed * north, one.yaw_rate_radps)

    there = turned(day)
    source = write_bag(tmp_path / "day", rewritten(there, change))
    said = refused(
        "import-bag", source, *OBJECTS, "--domain", "physical", "--out", tmp_path / "rec"
    )
    assert "/vut/odom: has a twist along the axes of its poses' frame" in said
    assert "[speed]" not in said
    assert run(source, tmp_path / "rec", "--twist", "all=parent") == 0
    assert_same(tmp_path / "rec", there)


@pytest.mark.parametrize(
    ("option", "match"),
    [
        (("--axes", "vut=esd"), "--axes vut=esd: give enu, ned, frd, or one with /flu or /frd"),
        (("--axes", "vut=ned/"), "--axes vut=ned/: give"),
        (("--axes", "ot7=ned"), "--axes ot7=…: the ids are vut, ot1"),
        (("--twist", "vut=map"), "--twist vut=map: give child or parent"),
    ],
)
def test_wrong_use_is_explained(
    day: TrackDay, tmp_path: Path, refused: Callable[..., str], option: tuple[str, ...], match: str
) -> None:
    said = refused("import-bag", tmp_path, *OBJECTS, *option, "--domain", "physical", status=2)
    assert match in said


def test_axes_have_texts() -> None:
    assert Axes.of_text("ned") == Axes("ned", "frd")
    assert Axes.of_text("enu") == Axes()
    assert Axes.of_text("ned/flu").text == "ned/flu"
