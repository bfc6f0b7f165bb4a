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
    drawn = Variation(field, (value, value + 0.001), drawn=True)
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
