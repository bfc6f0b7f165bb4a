"""SUMO on a road that bends: lanes along the line, traffic in them, a VUT that keeps its own."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.road import CurvePiece
from ssp_core.world.reference_line import ReferenceLine
from ssp_core.world.sumo_network import OVERHANG_M, write_network
from ssp_ot_controller.sil.sumo_world import SumoWorld
from ssp_ot_controller.sil.world import World
from tests.support.runs import small_run

ORIGIN = Pose2(40.0, -25.0, -0.7)
K = 1.0 / 60.0
PIECES = [
    CurvePiece(length_m=80.0),
    CurvePiece(length_m=30.0, end_curvature_1pm=K),
    CurvePiece(length_m=60.0, start_curvature_1pm=K, end_curvature_1pm=K),
    CurvePiece(length_m=30.0, start_curvature_1pm=K),
    CurvePiece(length_m=60.0),
]
LENGTH_M = 260.0
LINE = ReferenceLine(ORIGIN, PIECES)
LANES = (-3.5, 0.0, 3.5)


def start(s_m: float, l_m: float) -> dict[str, float]:
    x, y = LINE.to_map(s_m, l_m)
    return {"x_m": x, "y_m": y, "yaw_rad": LINE.pose(s_m).yaw_rad}


def run_spec() -> RunSpec:
    spec: dict[str, Any] = {
        "road": {
            "origin": {"x_m": ORIGIN.x_m, "y_m": ORIGIN.y_m, "yaw_rad": ORIGIN.yaw_rad},
            "length_m": LENGTH_M,
            "pieces": [piece.model_dump() for piece in PIECES],
            "lanes": [
                {"y_m": y, "width_m": 3.5, "direction": "backward" if y > 0 else "forward"}
                for y in LANES
            ],
            "sidewalk_right_m": 2.0,
        },
        "geofence": [(-900, -900), (900, -900), (900, 900), (-900, 900)],
        "vut": {
            "id": "vut",
            "object_class": "car",
            "start": start(60.0, 0.0),
            "approach": {"path": LINE.path(60.0, 250.0, 0.0), "cruise_mps": 10.0},
        },
        "driver": {"cruise_mps": 10.0, "reacts": False},
        "targets": [{"id": "ot1", "object_class": "car", "start": start(10.0, -3.5)}],
        "limits": {"speed_mps": 20.0, "acceleration_mps2": 4.0},
        "traffic": [
            {"id": "ahead", "object_class": "car", "lane": 0, "x_m": 90.0, "speed_mps": 8.0},
            {"id": "oncoming", "object_class": "truck", "lane": 2, "x_m": 230.0, "speed_mps": 9.0},
        ],
    }
    return RunSpec.model_validate(small_run(**spec))


def test_lanes_lie_along_the_line_and_beyond_it(tmp_path: Path) -> None:
    net = write_network(run_spec().road, tmp_path)
    lanes = {e.attrib["id"]: e.attrib for e in ElementTree.parse(net.path).getroot().iter("lane")}
    wanted = {"forward_0_0": -3.5, "forward_1_0": 0.0, "backward_0_0": 3.5, "walk_right_0": -6.25}
    assert lanes.keys() == wanted.keys()
    for name, offset in wanted.items():
        points = [tuple(map(float, p.split(","))) for p in lanes[name]["shape"].split()]
        local = [LINE.to_local(x, y) for x, y in points]
        assert [l_m for _, l_m in local] == pytest.approx([offset] * len(local), abs=1e-3)
        ends = (-OVERHANG_M, LENGTH_M + OVERHANG_M)
        first, last = local[0][0], local[-1][0]
        assert (first, last) == pytest.approx(ends[:: -1 if "back" in name else 1], abs=1e-3)
        middles = [
            LINE.to_local((a[0] + b[0]) / 2, (a[1] + b[1]) / 2)[1] for a, b in pairwise(points)
        ]
        assert middles == pytest.approx([offset] * len(middles), abs=0.012)
        along = sum(math.dist(a, b) for a, b in pairwise(points))
        assert float(lanes[name]["length"]) == pytest.approx(along, abs=1e-3)


def test_traffic_starts_and_stays_in_its_lane(tmp_path: Path) -> None:
    run = run_spec()
    with SumoWorld(run, tmp_path) as sumo:
        world = World(run, sumo)
        begun = {s.object_id: s for s in sumo.traffic()}
        for name, front, offset, turned in (("ahead", 90.0, -3.5, 0), ("oncoming", 230.0, 3.5, 1)):
            state = begun[name]
            s_m, l_m = LINE.to_local(*state.pose.to_parent(state.size.front_m, 0.0))
            # SUMO inserts a vehicle at the end of a step, with which it has moved on by one.
            assert s_m == pytest.approx(front, abs=0.25)
            assert l_m == pytest.approx(offset, abs=0.02)
            yaw = LINE.pose(s_m).yaw_rad + turned * math.pi
            assert wrap_angle(state.yaw_rad - yaw) == pytest.approx(0.0, abs=0.1)
        offsets: dict[str, list[float]] = {"ahead": [], "oncoming": [], "vut": []}
        speeds = []
        before = begun["ahead"]
        for _ in range(600):
            for state in world.advance({}, drive_vut=True):
                if state.object_id in offsets:
                    offsets[state.object_id].append(LINE.to_local(state.x_m, state.y_m)[1])
                if state.object_id == "ahead":
                    step = math.dist((state.x_m, state.y_m), (before.x_m, before.y_m))
                    speeds.append(step / run.step_s / state.speed_mps)
                    before = state
    # A rear axle cuts a bend: 3 m of wheelbase at a radius of 60 m give less than 0.2 m.
    assert max(abs(v + 3.5) for v in offsets["ahead"]) < 0.2
    assert max(abs(v - 3.5) for v in offsets["oncoming"]) < 0.5
    # It covers the ground at the speed that it reports, on the inner lane and on the outer.
    assert sorted(speeds)[len(speeds) // 2] == pytest.approx(1.0, abs=0.01)
    assert max(abs(v) for v in offsets["vut"]) < 0.25
