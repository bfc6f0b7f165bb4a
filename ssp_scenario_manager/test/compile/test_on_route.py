"""Starts lie on their paths, and paths on the run's road; who sweeps over others is refused."""

from __future__ import annotations

import math
from typing import Any

import pytest

from ssp_core.errors import InputError
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.road import CurvePiece
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.run.sweep import Sweep, Variation, with_values
from ssp_scenario_manager.session.session import Session
from ssp_scenario_manager.triggers.on_route import off_route

ON_A_BEND = [CurvePiece(length_m=400.0, start_curvature_1pm=0.01, end_curvature_1pm=0.01)]


def changed(run: RunSpec, field: str, value: Any) -> RunSpec:
    return with_values(run, {field: value}, run.seed)


def test_a_sound_run_is_on_its_route(run: RunSpec) -> None:
    assert off_route(run) == []


@pytest.mark.parametrize(
    ("field", "shift"),
    [
        ("vut.start.y_m", 0.15),
        ("vut.start.y_m", -1.49),
        ("vut.start.x_m", 1.4),
        ("vut.start.yaw_rad", 0.34),
        ("vut.start.yaw_rad", 2.0 * math.pi),
        ("targets.0.start.y_m", 1.4),
        ("road.origin.y_m", 1.5),
        ("road.origin.x_m", 0.9),
    ],
)
def test_a_small_change_is_still_on_it(run: RunSpec, field: str, shift: float) -> None:
    base: Any = run
    for part in field.split("."):
        base = base[int(part)] if part.isdecimal() else getattr(base, part)
    assert off_route(changed(run, field, base + shift)) == []


OFF = [
    (
        "vut.start.y_m",
        10.5,
        r"vut\.start: lies 10\.5 m from its path's .*at most 1\.5 m",
    ),
    ("vut.start.x_m", 15.0, r"vut\.start: lies \d+\.\d m from"),
    ("vut.start.yaw_rad", 2.5, r"vut\.start\.yaw_rad: 2\.5\d* rad differs by 2\.50 rad"),
    ("vut.start.yaw_rad", -0.4, r"vut\.start\.yaw_rad: -0\.(4|39\d+) rad differs by 0\.40 rad"),
    ("targets.0.start.x_m", -20.0, r"targets\[0\]\.start: lies"),
    ("targets.0.start.yaw_rad", math.pi, r"targets\[0\]\.start\.yaw_rad"),
    ("road.origin.yaw_rad", 1.57, r"vut\.approach\.path: .* lies off the run's road"),
    ("road.origin.x_m", 500.0, r"vut\.approach\.path: .* lies off the run's road"),
    (
        "road.origin.y_m",
        7.0,
        r"vut\.approach\.path: .* and the VUT's lanes",
    ),
]


@pytest.mark.parametrize(("field", "value", "says"), OFF)
def test_what_is_off_it_is_not_swept(run: RunSpec, field: str, value: float, says: str) -> None:
    with pytest.raises(InputError, match=says):
        Sweep(run, (Variation(field, (value,)),), 1).check()
    # What is drawn is judged as it will be run.
    drawn = Variation(field, (value, value + 0.001), is_drawn=True)
    with pytest.raises(InputError, match=says):
        Sweep(run, (drawn,), 1).check()


def test_nor_loaded(run: RunSpec) -> None:
    answer = Session().load(changed(run, "vut.start.y_m", 10.5), 0)
    assert not answer.accepted
    assert "vut.start: lies 10.5 m" in answer.error_msg


def test_on_a_bend_the_offset_from_the_line_counts(run: RunSpec) -> None:
    road = run.road.model_copy(update={"pieces": ON_A_BEND, "length_m": 400.0})
    line = ReferenceLine.of_road(road)
    lane = road.lanes[0]

    def on(offset_m: float) -> RunSpec:
        path = line.path(15.0, 300.0, offset_m)
        pose = line.pose(15.0)
        approach = run.vut.approach
        assert approach is not None
        start = run.vut.start.model_copy(
            update={"x_m": path[0][0], "y_m": path[0][1], "yaw_rad": pose.yaw_rad}
        )
        vut = run.vut.model_copy(
            update={"start": start, "approach": approach.model_copy(update={"path": path})}
        )
        return run.model_copy(update={"road": road, "vut": vut, "targets": [], "triggers": []})

    assert off_route(on(lane.y_m)) == []
    assert any("vut.approach.path" in problem for problem in off_route(on(lane.y_m - 3.5)))


def on_path(mapping: dict[str, Any], who: dict[str, Any], *path: tuple[float, float]) -> list[str]:
    """Problems of a run in which a participant starts on a path, along it, and follows it."""
    (x_m, y_m), (next_x_m, next_y_m) = path[:2]
    yaw_rad = math.atan2(next_y_m - y_m, next_x_m - x_m)
    who["start"] = {"x_m": x_m, "y_m": y_m, "yaw_rad": yaw_rad}
    who["approach"] = {"path": list(path), "cruise_mps": 5.0}
    return off_route(RunSpec.model_validate(mapping))


@pytest.mark.parametrize(
    ("end", "sound"),
    [
        # Lanes from -1.75 m to 5.25 m, sidewalks of 1 m and 2 m, and 30 m beside them.
        ((100.0, 36.25), True),
        ((100.0, 36.26), False),
        ((100.0, -33.75), True),
        ((100.0, -33.76), False),
        # The road is 300 m long, and SUMO's goes on for 100 m at each end.
        ((-100.0, 0.0), True),
        ((-100.1, 0.0), False),
        ((400.0, 0.0), True),
        ((400.1, 0.0), False),
    ],
)
def test_a_target_may_leave_the_road_so_far(
    run_mapping: dict[str, Any], end: tuple[float, float], sound: bool
) -> None:
    run_mapping["road"] |= {"sidewalk_left_m": 1.0, "sidewalk_right_m": 2.0}
    (target,) = run_mapping["targets"]
    says = (
        f"targets[0].approach.path: x {end[0]:.1f} m, y {end[1]:.1f} m lies off the run's road "
        "and its surroundings (road.origin, road.lanes)"
    )
    assert on_path(run_mapping, target, (40.0, 3.5), end) == ([] if sound else [says])


@pytest.mark.parametrize(
    ("end", "sound"),
    [
        ((301.0, 0.0), True),
        ((301.1, 0.0), False),
        # Half a lane of 4 m and 0.5 m beside the lanes.
        ((250.0, 2.5), True),
        ((250.0, 2.51), False),
        ((250.0, -2.5), True),
        ((250.0, -2.51), False),
    ],
)
def test_the_vut_keeps_to_its_lanes(
    run_mapping: dict[str, Any], end: tuple[float, float], sound: bool
) -> None:
    run_mapping["road"]["lanes"] = [{"y_m": 0.0, "width_m": 4.0, "direction": "forward"}]
    problems = on_path(run_mapping, run_mapping["vut"], (0.0, 0.0), end)
    named = [problem.split(":")[0] for problem in problems]
    assert named == ([] if sound else ["vut.approach.path"])


def test_the_first_point_off_the_road_is_named(run_mapping: dict[str, Any]) -> None:
    (target,) = run_mapping["targets"]
    (problem,) = on_path(run_mapping, target, (40.0, 3.5), (60.0, 50.0), (80.0, 3.5), (99.0, 60.0))
    assert "x 60.0 m, y 50.0 m" in problem


def test_at_the_limits_of_arming_a_start_is_sound(run_mapping: dict[str, Any]) -> None:
    run_mapping["limits"] |= {"start_region_m": 1.5, "start_yaw_rad": 0.25}
    turned = run_mapping["targets"][0]
    turned["start"] = {"x_m": 40.0, "y_m": 5.0, "yaw_rad": -0.25}
    assert off_route(RunSpec.model_validate(run_mapping)) == []


def test_a_start_is_held_against_its_path_in_every_direction(run_mapping: dict[str, Any]) -> None:
    (target,) = run_mapping["targets"]
    assert on_path(run_mapping, target, (40.0, 3.5), (40.0, 30.0)) == []
    target["start"]["yaw_rad"] = -math.pi / 2.0
    (problem,) = off_route(RunSpec.model_validate(run_mapping))
    assert "targets[0].start.yaw_rad: -1.5708 rad differs by 3.14 rad" in problem


def follow(mapping: dict[str, Any], *path: tuple[float, float]) -> list[str]:
    """Problems of a run whose trigger lets its object follow a path."""
    motion = {"path": list(path), "cruise_mps": 5.0}
    mapping["triggers"][0]["manoeuvre"] = {"kind": "follow_path", "motion": motion}
    return off_route(RunSpec.model_validate(mapping))


def test_the_path_of_a_manoeuvre_is_judged_too(run_mapping: dict[str, Any]) -> None:
    # It begins where its object is then, which isn't the start.
    assert follow(run_mapping, (90.0, 3.5), (120.0, 0.0)) == []
    (problem,) = follow(run_mapping, (90.0, 3.5), (120.0, 50.0))
    assert problem.startswith("triggers[0].manoeuvre.motion.path: x 120.0 m, y 50.0 m lies off")
    # Without an approach its object waits where the path begins.
    del run_mapping["targets"][0]["approach"]
    (problem,) = follow(run_mapping, (90.0, 3.5), (120.0, 0.0))
    assert problem.startswith("targets[0].start: lies 50.0 m from its path's first point")
    assert follow(run_mapping, (40.0, 3.5), (40.0, 5.0)) != []
    run_mapping["targets"][0]["start"]["yaw_rad"] = math.pi / 2.0
    assert follow(run_mapping, (40.0, 3.5), (40.0, 5.0)) == []
    # The triggers of an object that isn't there are refused elsewhere.
    run_mapping["triggers"][0]["object_id"] = "ot9"
    assert follow(run_mapping, (90.0, 3.5), (120.0, 50.0)) == []


def arm(mapping: dict[str, Any], *path: tuple[float, float]) -> list[str]:
    """Problems of a run beside whose road an arm of 100 m leads north from (150, 40)."""
    mapping["road"]["junction"] = [
        {
            "origin": {"x_m": 150.0 + shift_m, "y_m": 40.0, "yaw_rad": math.pi / 2.0},
            "length_m": 100.0,
            "lanes": [
                {"y_m": -2.0, "width_m": 4.0, "direction": "forward"},
                {"y_m": 1.5, "width_m": 3.0, "direction": "backward"},
            ],
            "junction_at": "start",
        }
        # The second arm leads somewhere else: a point lies on one of them.
        for shift_m in (0.0, 60.0)
    ]
    return on_path(mapping, mapping["targets"][0], *path)


@pytest.mark.parametrize(
    ("end", "sound"),
    [
        ((150.0, 39.001), True),
        ((150.0, 38.999), False),
        ((150.0, 141.0), True),
        ((150.0, 141.001), False),
        ((147.001, 100.0), True),
        ((146.999, 100.0), False),
        ((153.999, 100.0), True),
        ((154.001, 100.0), False),
        ((210.0, 60.0), True),
        ((180.0, 60.0), False),
        ((150.0, -60.0), False),
    ],
)
def test_a_target_may_use_the_roads_of_a_junction(
    run_mapping: dict[str, Any], end: tuple[float, float], sound: bool
) -> None:
    assert (arm(run_mapping, (150.0, 3.5), end) == []) is sound


def test_points_on_several_arms_and_the_road_make_a_sound_path(run_mapping: dict[str, Any]) -> None:
    assert arm(run_mapping, (151.0, 110.0), (151.0, 40.0), (180.0, 0.0), (209.0, 110.0)) == []


def test_the_vut_may_not_use_the_arms_of_a_junction(run_mapping: dict[str, Any]) -> None:
    arm(run_mapping, (150.0, 3.5), (150.0, 60.0))
    (problem,) = on_path(run_mapping, run_mapping["vut"], (150.0, 0.0), (150.0, 60.0))
    assert problem.endswith("and the VUT's lanes (road.origin, road.lanes)")
