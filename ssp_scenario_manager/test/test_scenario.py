"""Scenarios on sites: every place where it belongs, every mistake named by its field."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from ssp_core.errors import InputError
from ssp_core.files import write_text
from ssp_core.geometry import Pose2, point_in_polygon
from ssp_core.run_spec import FollowPath, LaneChange, RunSpec, TimeToArrival, load_run
from ssp_scenario_manager.core.readiness import cannot_fire
from ssp_scenario_manager.resolve import resolve_run
from ssp_scenario_manager.scenario import LIBRARY, load_scenario, load_site

SCENARIOS = ("cut_in", "vru_crossing")
SITES = ("boulevard", "north_track")


def resolve(scenario: str | Path, site: str | Path) -> RunSpec:
    plan, event_version = load_scenario(str(scenario))
    place, site_version = load_site(str(site))
    return resolve_run(
        plan, event_version, place, site_version, run_id="r", seed=3, mode="lockstep"
    )


def library(kind: str, name: str) -> dict[str, Any]:
    text = (LIBRARY / f"{kind}s" / f"{name}.{kind}.yaml").read_text()
    loaded: dict[str, Any] = yaml.safe_load(text)
    return loaded


Changes = dict[tuple[str | int, ...], Any]


@pytest.fixture
def changed(tmp_path: Path) -> Callable[[str, str, Changes], Path]:
    """A file of the library with values changed (None removes a key), in a folder of the test."""

    def change(kind: str, name: str, changes: Changes) -> Path:
        mapping = library(kind, name)
        for path, value in changes.items():
            inner: Any = mapping
            for part in path[:-1]:
                inner = inner[part]
            if value is None:
                del inner[path[-1]]
            else:
                inner[path[-1]] = value
        target = tmp_path / f"{name}.{kind}.yaml"
        target.write_text(yaml.safe_dump(mapping, sort_keys=False))
        return target

    return change


def local(run: RunSpec, x_m: float, y_m: float) -> tuple[float, float]:
    return run.road.origin.pose.to_local(x_m, y_m)


# -- the library ----------------------------------------------------------------------------------


@pytest.mark.parametrize("scenario", SCENARIOS)
@pytest.mark.parametrize("site", SITES)
def test_every_shipped_scenario_runs_on_every_shipped_site(
    scenario: str, site: str, tmp_path: Path
) -> None:
    run = resolve(scenario, site)
    assert (run.scenario, run.site, run.seed, run.mode) == (scenario, site, 3, "lockstep")
    assert cannot_fire(run) == []
    # What is written is what every node reads.
    write_text(tmp_path / "run.yaml", run.model_dump_json(by_alias=True))
    assert load_run(tmp_path / "run.yaml") == run
    # Everybody starts inside the fence, apart from each other, and in the road's frame.
    for who in (run.vut, *run.targets):
        assert point_in_polygon(who.start.x_m, who.start.y_m, run.geofence)
        for path in [who.approach.path] if who.approach else []:
            assert all(point_in_polygon(x, y, run.geofence) for x, y in path)
    (target,) = run.targets
    apart_m = math.hypot(run.vut.start.x_m - target.start.x_m, run.vut.start.y_m - target.start.y_m)
    assert apart_m > run.vut.size.length_m + target.size.length_m + run.limits.separation_m
    assert len({who.id for who in (run.vut, *run.targets)} | {t.id for t in run.traffic}) == (
        1 + len(run.targets) + len(run.traffic)
    )


def test_the_same_event_has_the_same_version_on_both_sites() -> None:
    for scenario in SCENARIOS:
        here, there = (resolve(scenario, site) for site in SITES)
        assert here.event_version == there.event_version
        assert here.site_version != there.site_version
        assert here.thresholds == there.thresholds
        assert [t.id for t in here.triggers] == [t.id for t in there.triggers]
    assert (here.domain, here.stand_in) == ("simulation", False)
    assert (there.domain, there.stand_in) == ("physical", True)


# -- places ---------------------------------------------------------------------------------------


# The library's figures may be tuned; those that the tests count with are given here.
PLACES: Changes = {
    ("vut", "start_x_m"): 15.0,
    ("vut", "end_x_m"): 390.0,
    ("targets", 0, "start", "x_m"): 45.0,
    ("targets", 0, "approach", "end_x_m"): 380.0,
}


def test_cut_in_on_the_boulevard(changed: Callable[[str, str, Changes], Path]) -> None:
    run = resolve(changed("scenario", "cut_in", PLACES), "boulevard")
    assert run.vut.approach is not None
    assert run.vut.approach.path == [(15.0, 0.0), (390.0, 0.0)]
    (ot1,) = run.targets
    assert (ot1.start.x_m, ot1.start.y_m, ot1.start.yaw_rad) == (45.0, 3.5, 0.0)
    assert ot1.approach is not None
    assert ot1.approach.path == [(45.0, 3.5), (380.0, 3.5)]
    (trigger,) = run.triggers
    assert isinstance(trigger.manoeuvre, LaneChange)
    assert trigger.manoeuvre.lateral_shift_m == -3.5
    # Right: 1.75 m of lane, 3 m of sidewalk, 2 m; left: 10.5 + 1.75 + 3 + 2 m.
    assert run.geofence == [(0.0, -6.75), (400.0, -6.75), (400.0, 17.25), (0.0, 17.25)]
    # Lanes counted from the road's middle: forward lanes lie at 0 and 3.5, backward at 7 and 10.5.
    lanes = {t.id: t.lane for t in run.traffic}
    assert (lanes["oncoming1"], lanes["oncoming2"], lanes["ahead1"]) == (2, 2, 0)


CROSSING: Changes = {
    ("targets", 0, "start"): {"x_m": 110.0, "beyond_right_kerb_m": 0.8},
    ("targets", 0, "trigger", "condition", "anchor_x_m"): 110.0,
    ("targets", 0, "trigger", "manoeuvre", "to"): {"x_m": 110.0, "beyond_left_kerb_m": 1.0},
}


def test_crossing_on_the_boulevard(changed: Callable[[str, str, Changes], Path]) -> None:
    run = resolve(changed("scenario", "vru_crossing", CROSSING), "boulevard")
    (ot1,) = run.targets
    # 0.8 m beyond the right kerb at -1.75 m; the left kerb is at 12.25 m.
    assert (ot1.start.x_m, ot1.start.y_m) == pytest.approx((110.0, -2.55))
    assert ot1.start.yaw_rad == pytest.approx(math.pi / 2)
    (trigger,) = run.triggers
    assert isinstance(trigger.manoeuvre, FollowPath)
    assert trigger.manoeuvre.motion.path[0] == pytest.approx((110.0, -2.55))
    assert trigger.manoeuvre.motion.path[1] == pytest.approx((110.0, 13.25))
    assert isinstance(trigger.condition, TimeToArrival)
    assert trigger.condition.anchor == (110.0, 0.0)
    assert run.road.crossing_x_m == 110.0
    assert resolve("cut_in", "boulevard").road.crossing_x_m is None
    assert {t.lane for t in run.traffic} == {3}


def test_places_on_a_rotated_block_by_hand(changed: Callable[[str, str, Changes], Path]) -> None:
    """north_track: origin (512, -240), 37 degrees, lanes 3.75 m wide."""
    run = resolve(changed("scenario", "cut_in", PLACES), "north_track")
    c, s = math.cos(math.radians(37.0)), math.sin(math.radians(37.0))
    (ot1,) = run.targets
    assert (ot1.start.x_m, ot1.start.y_m) == pytest.approx(
        (512.0 + 45.0 * c - 3.75 * s, -240.0 + 45.0 * s + 3.75 * c)
    )
    assert ot1.start.yaw_rad == pytest.approx(math.radians(37.0))
    assert (run.vut.start.x_m, run.vut.start.y_m) == pytest.approx((523.979532, -230.972775))
    assert isinstance(run.triggers[0].manoeuvre, LaneChange)
    assert run.triggers[0].manoeuvre.lateral_shift_m == -3.75
    # Right: 1.875 + 2 + 4 m; left: 11.25 + 1.875 + 2 + 4 m.
    corners = [local(run, *corner) for corner in run.geofence]
    for corner, expected in zip(
        corners, [(0, -7.875), (420, -7.875), (420, 19.125), (0, 19.125)], strict=True
    ):
        assert corner == pytest.approx(expected, abs=1e-9)
    crossing = resolve(changed("scenario", "vru_crossing", CROSSING), "north_track")
    assert crossing.targets[0].start.yaw_rad == pytest.approx(math.radians(127.0))
    assert local(crossing, *crossing.triggers[0].condition.anchor) == pytest.approx(  # type: ignore[union-attr] # a time_to_arrival
        (110.0, 0.0)
    )


@pytest.mark.parametrize("scenario", SCENARIOS)
def test_turning_a_site_changes_nothing_in_the_block(
    changed: Callable[[str, str, Changes], Path], scenario: str
) -> None:
    """METHOD 2.4: the transform is rigid."""
    straight = resolve(scenario, "boulevard")
    pose = Pose2(-31.5, 77.25, math.radians(-141.0))
    site = changed(
        "site",
        "boulevard",
        {
            ("block", "origin_x_m"): pose.x_m,
            ("block", "origin_y_m"): pose.y_m,
            ("block", "heading_deg"): -141.0,
        },
    )
    turned = resolve(scenario, site)
    for before, after in zip(
        (straight.vut, *straight.targets), (turned.vut, *turned.targets), strict=True
    ):
        assert local(turned, after.start.x_m, after.start.y_m) == pytest.approx(
            (before.start.x_m, before.start.y_m), abs=1e-6
        )
        assert math.cos(after.start.yaw_rad - pose.yaw_rad - before.start.yaw_rad) == (
            pytest.approx(1.0)
        )
    assert turned.road.lanes == straight.road.lanes
    assert turned.traffic == straight.traffic


# -- versions -------------------------------------------------------------------------------------


def test_a_version_is_of_the_content(tmp_path: Path) -> None:
    _, shipped = load_scenario("cut_in")
    mapping = library("scenario", "cut_in")
    path = tmp_path / "copy.yaml"
    path.write_text("# another comment\n" + yaml.safe_dump(mapping, sort_keys=True, indent=7))
    assert load_scenario(str(path))[1] == shipped
    mapping["targets"][0]["trigger"]["condition"]["below_m"] = 12.5
    path.write_text(yaml.safe_dump(mapping))
    assert load_scenario(str(path))[1] != shipped
    assert shipped.startswith("sha256:")


# -- mistakes -------------------------------------------------------------------------------------


def test_unknown_names_are_answered_with_the_known_ones(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no such scenario.*'overtake'.*cut_in, vru_crossing"):
        load_scenario("overtake")
    with pytest.raises(InputError, match=r"no such site.*'moon'.*boulevard, north_track"):
        load_site("moon")
    with pytest.raises(InputError, match=r"none\.yaml: can't be read"):
        load_scenario(str(tmp_path / "none.yaml"))


FILE_MISTAKES: dict[str, tuple[str, Changes, str]] = {
    "unknown key": ("cut_in", {("vut", "colour"): "red"}, "vut.colour"),
    "missing key": ("cut_in", {("vut", "end_x_m"): None}, "vut.end_x_m"),
    "another schema": ("cut_in", {("schema",): "ssp.scenario/2"}, "schema"),
    "unknown interaction": ("cut_in", {("interaction",): "overtaking"}, "interaction"),
    "not a number": ("cut_in", {("vut", "start_x_m"): "here"}, "vut.start_x_m"),
    "no finite number": ("cut_in", {("vut", "start_x_m"): math.nan}, "vut.start_x_m"),
    "infinite": ("cut_in", {("vut", "end_x_m"): math.inf}, "vut.end_x_m"),
    "negative speed": (
        "cut_in",
        {("targets", 0, "approach", "cruise_mps"): -1.0},
        "targets[0].approach.cruise_mps",
    ),
    "unknown condition": (
        "cut_in",
        {("targets", 0, "trigger", "condition", "type"): "full_moon"},
        "targets[0].trigger.condition",
    ),
    "condition of another type": (
        "cut_in",
        {("targets", 0, "trigger", "condition", "below_s"): 2.0},
        "targets[0].trigger.condition.below_s",
    ),
    "manoeuvre without a duration": (
        "cut_in",
        {("targets", 0, "trigger", "manoeuvre", "duration_s"): None},
        "targets[0].trigger.manoeuvre.duration_s",
    ),
    "id with a slash": ("cut_in", {("targets", 0, "id"): "a/b"}, "targets[0].id"),
    "no targets": ("cut_in", {("targets",): []}, "targets"),
}


@pytest.mark.parametrize("name", FILE_MISTAKES)
def test_a_mistake_in_a_file(changed: Callable[[str, str, Changes], Path], name: str) -> None:
    scenario, changes, field = FILE_MISTAKES[name]
    path = changed("scenario", scenario, changes)
    with pytest.raises(InputError) as caught:
        load_scenario(str(path))
    assert caught.value.file == str(path)
    assert caught.value.field == field


T0 = ("targets", 0)
MISMATCHES: dict[str, tuple[str, Changes, Changes, str, Any]] = {
    # scenario, changes to it, changes to the site, field, value
    "no place given": (
        "cut_in", {(*T0, "start"): {"x_m": 45.0}}, {}, "targets[0].start", None,
    ),
    "two places given": (
        "cut_in", {(*T0, "start", "beyond_right_kerb_m"): 1.0}, {}, "targets[0].start", None,
    ),
    "a lane that the site lacks": (
        "cut_in", {(*T0, "start", "lane"): 2}, {}, "targets[0].start", 2,
    ),
    "a lane to the right of the first": (
        "cut_in", {(*T0, "trigger", "manoeuvre", "lanes"): -2}, {},
        "targets[0].trigger.manoeuvre.lanes", -1,
    ),
    "lane change from the sidewalk": (
        "cut_in", {(*T0, "start"): {"x_m": 45.0, "beyond_right_kerb_m": 1.0}}, {},
        "targets[0].trigger.manoeuvre.kind", "lane_change",
    ),
    "vut too fast": (
        "cut_in", {("vut", "driver", "cruise_mps"): 16.5}, {}, "vut.driver.cruise_mps", 16.5,
    ),
    "target too fast": (
        "cut_in", {(*T0, "approach", "cruise_mps"): 17.0}, {},
        "targets[0].approach.cruise_mps", 17.0,
    ),
    "manoeuvre too fast": (
        "cut_in", {(*T0, "trigger", "manoeuvre", "cruise_mps"): 17.0}, {},
        "targets[0].trigger.manoeuvre.cruise_mps", 17.0,
    ),
    "walker too fast": (
        "vru_crossing", {(*T0, "trigger", "manoeuvre", "speed_mps"): 16.1}, {},
        "targets[0].trigger.manoeuvre.speed_mps", 16.1,
    ),
    "site too slow": (
        "vru_crossing", {}, {("limits", "speed_mps"): 9.0}, "vut.driver.cruise_mps", 10.0,
    ),
    "target accelerates too hard": (
        "cut_in", {(*T0, "approach", "acceleration_mps2"): 5.1}, {},
        "targets[0].approach.acceleration_mps2", 5.1,
    ),
    "manoeuvre brakes too hard": (
        "cut_in", {(*T0, "trigger", "manoeuvre", "deceleration_mps2"): 5.1}, {},
        "targets[0].trigger.manoeuvre.deceleration_mps2", 5.1,
    ),
    "vut starts before the block": (
        "cut_in", {("vut", "start_x_m"): 0.8}, {}, "vut.start_x_m", 0.8,
    ),
    "vut leaves the block": (
        "cut_in", {("vut", "end_x_m"): 396.5}, {}, "vut.end_x_m", 396.5,
    ),
    "vut backwards": (
        "cut_in", {("vut", "end_x_m"): 15.0}, {}, "vut.end_x_m", 15.0,
    ),
    "target starts outside": (
        "cut_in", {(*T0, "start", "x_m"): -3.0}, {}, "targets[0].start.x_m", -3.0,
    ),
    "target leaves the block": (
        "cut_in", {(*T0, "approach", "end_x_m"): 400.0}, {}, "targets[0].approach.end_x_m", 400.0,
    ),
    "target stays where it is": (
        "cut_in", {(*T0, "approach", "end_x_m"): 45.0}, {}, "targets[0].approach.end_x_m", 45.0,
    ),
    "site with one lane too few": (
        "cut_in", {}, {("block", "vut_lane"): 4}, "block.vut_lane", 4,
    ),
    "target backwards": (
        "cut_in", {(*T0, "approach", "end_x_m"): 40.0}, {}, "targets[0].approach.end_x_m", 40.0,
    ),
    "walker leaves the block": (
        "vru_crossing", {(*T0, "trigger", "manoeuvre", "to", "x_m"): 500.0}, {},
        "targets[0].trigger.manoeuvre.to.x_m", 500.0,
    ),
    "walker goes nowhere": (
        "vru_crossing",
        {(*T0, "trigger", "manoeuvre", "to"): {"x_m": 110.0, "beyond_right_kerb_m": 0.8}}, {},
        "targets[0].trigger.manoeuvre.to", None,
    ),
    "traffic in a lane that the site lacks": (
        "cut_in", {("traffic", 1, "lane"): 2}, {}, "traffic[1].lane", 2,
    ),
    "target named as the vut": (
        "cut_in", {(*T0, "id"): "vut"}, {}, "targets[0].id", "vut",
    ),
    "traffic named as a target": (
        "cut_in", {("traffic", 0, "id"): "ot1"}, {}, "traffic[0].id", "ot1",
    ),
    "gap to a stranger": (
        "cut_in", {(*T0, "trigger", "condition", "object_id"): "ot2"}, {},
        "targets[0].trigger.condition.object_id", "ot2",
    ),
    "site without that lane": (
        "cut_in", {}, {("block", "vut_lane"): 7}, "block.vut_lane", 7,
    ),
    "site with the vut in an oncoming lane": (
        "cut_in", {}, {("block", "vut_lane"): 3}, "block.vut_lane", 3,
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MISMATCHES)
def test_a_scenario_that_does_not_fit(
    changed: Callable[[str, str, Changes], Path], name: str
) -> None:
    scenario, plan_changes, site_changes, field, value = MISMATCHES[name]
    figures = PLACES if scenario == "cut_in" else CROSSING
    plan = changed("scenario", scenario, {**figures, **plan_changes})
    site = changed("site", "boulevard", site_changes)
    with pytest.raises(InputError) as caught:
        resolve(plan, site)
    assert (caught.value.field, caught.value.value) == (field, value)


def test_a_remedy_says_what_would_be_right(
    changed: Callable[[str, str, Changes], Path],
) -> None:
    for scenario_changes, site_changes, remedy in (
        (
            {("vut", "end_x_m"): 400.0},
            {},
            "from 0.9 to 396.4 m fits on the block of site boulevard",
        ),
        ({("vut", "driver", "cruise_mps"): 20.0}, {}, "at most 16 m/s on site boulevard"),
        ({(*T0, "approach", "end_x_m"): 45.0}, {}, "more than 45 m"),
        ({}, {("block", "vut_lane"): 4}, "the block has lanes 0 to 3"),
    ):
        plan = changed("scenario", "cut_in", {**PLACES, **scenario_changes})
        with pytest.raises(InputError, match=remedy):
            resolve(plan, changed("site", "boulevard", site_changes))


def test_exactly_at_the_limits_fits(changed: Callable[[str, str, Changes], Path]) -> None:
    plan = changed(
        "scenario",
        "cut_in",
        {
            ("vut", "driver", "cruise_mps"): 16.0,
            ("vut", "start_x_m"): 0.9,
            ("vut", "end_x_m"): 396.4,
            (*T0, "approach", "acceleration_mps2"): 5.0,
        },
    )
    run = resolve(plan, "boulevard")
    assert run.vut.start.x_m - run.vut.size.rear_m == pytest.approx(0.0)
