"""SUMO with objects moved from outside: exact poses, reacting traffic, determinism, refusals."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import libsumo  # type: ignore[import-untyped] # has no types
import pytest

from ssp_core.errors import HostError, InputError
from ssp_core.geometry import Pose2
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import Role
from ssp_core.world.sumo_network import OVERHANG_M, find_netconvert, write_network
from ssp_ot_controller.sil.sumo_world import SumoWorld, to_sumo
from tests.support.runs import small_run
from tests.support.states import object_state

ORIGIN = Pose2(-120.5, -33.25, 0.4)
STEP_S = 0.02


def start(x_m: float, y_m: float, yaw_rad: float = 0.0) -> dict[str, float]:
    east, north = ORIGIN.to_parent(x_m, y_m)
    return {"x_m": east, "y_m": north, "yaw_rad": ORIGIN.yaw_rad + yaw_rad}


def lane(y_m: float, direction: str) -> dict[str, Any]:
    return {"y_m": y_m, "width_m": 3.5, "direction": direction}


def run_spec(**changes: Any) -> RunSpec:
    """A turned, shifted block with two lanes one way and one the other, and traffic on it."""
    spec: dict[str, Any] = {
        "seed": 2**40 + 3,
        "step_s": STEP_S,
        "road": {
            "origin": {"x_m": ORIGIN.x_m, "y_m": ORIGIN.y_m, "yaw_rad": ORIGIN.yaw_rad},
            "length_m": 300.0,
            "lanes": [lane(0.0, "forward"), lane(-3.5, "forward"), lane(3.5, "backward")],
            "sidewalk_left_m": 2.0,
            "sidewalk_right_m": 2.0,
        },
        "geofence": [(-900, -900), (900, -900), (900, 900), (-900, 900)],
        "vut": {"id": "vut", "object_class": "car", "start": start(60.0, 0.0)},
        "driver": {"cruise_mps": 12.0},
        "targets": [
            {"id": "ot1", "object_class": "car", "start": start(80.0, -3.5)},
            {"id": "ped", "object_class": "pedestrian", "start": start(150.0, -6.2, 1.5)},
            {"id": "bike", "object_class": "cyclist", "start": start(100.0, -3.5)},
        ],
        "limits": {"speed_mps": 20.0, "acceleration_mps2": 4.0},
        "traffic": [
            {"id": "behind", "object_class": "car", "lane": 0, "x_m": 20.0, "speed_mps": 12.0},
            {"id": "oncoming", "object_class": "truck", "lane": 2, "x_m": 250.0, "speed_mps": 9.0},
        ],
    }
    return RunSpec.model_validate(small_run(**{**spec, **changes}))


def posed(p: ParticipantSpec, pose: Pose2, speed_mps: float = 0.0) -> ObjectState:
    return object_state(p.id, p.cls, pose.x_m, pose.y_m, pose.yaw_rad, speed_mps, size=p.size)


def everybody(run: RunSpec) -> list[ObjectState]:
    return [posed(p, p.start.pose) for p in (run.vut, *run.targets)]


def in_block(state: ObjectState) -> tuple[float, float]:
    return ORIGIN.to_local(state.x_m, state.y_m)


@pytest.fixture
def world(tmp_path: Path) -> Iterator[SumoWorld]:
    with SumoWorld(run_spec(), tmp_path) as opened:
        yield opened


def test_lanes_lie_where_the_run_file_says(tmp_path: Path) -> None:
    net = write_network(run_spec().road, tmp_path)
    root = ElementTree.parse(net.path).getroot()
    shapes = {
        element.attrib["id"]: [
            ORIGIN.to_local(*map(float, point.split(",")))
            for point in element.attrib["shape"].split()
        ]
        for element in root.iter("lane")
    }
    ends = (-OVERHANG_M, 300.0 + OVERHANG_M)
    expected = {
        "forward_0": (ends, -3.5),
        "forward_1": (ends, 0.0),
        "backward_0": (ends[::-1], 3.5),
        "walk_left_0": (ends, 6.25),
        "walk_right_0": (ends, -6.25),
    }
    assert set(shapes) == set(expected)
    for name, (x, y) in expected.items():
        assert shapes[name][0] == pytest.approx((x[0], y), abs=1e-5)
        assert shapes[name][-1] == pytest.approx((x[1], y), abs=1e-5)
    assert [(p.edge, p.index) for p in net.lanes] == [
        ("forward", 1),
        ("forward", 0),
        ("backward", 0),
    ]


def test_without_netconvert_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    monkeypatch.setattr("shutil.which", lambda _: None)
    with pytest.raises(HostError, match="eclipse-sumo"):
        find_netconvert()


def test_traffic_starts_where_and_as_fast_as_specified(world: SumoWorld) -> None:
    behind, oncoming = world.traffic()
    assert world.now_ns == 0
    assert (behind.object_id, oncoming.object_id) == ("behind", "oncoming")
    assert in_block(behind) == pytest.approx((20.0 - behind.size.front_m, 0.0), abs=1e-4)
    assert in_block(oncoming) == pytest.approx((250.0 + oncoming.size.front_m, 3.5), abs=1e-4)
    assert (behind.speed_mps, oncoming.speed_mps) == (12.0, 9.0)
    assert oncoming.yaw_rad == pytest.approx(ORIGIN.yaw_rad - math.pi, abs=1e-6)
    assert (behind.role, behind.sequence, behind.stamp_ns) == (Role.TRAFFIC, 1, 0)


def test_sumo_has_exactly_the_poses_that_it_was_given(world: SumoWorld) -> None:
    run = run_spec()
    for k in range(1, 40):
        # Off the lanes, turned, and sideways at once: nothing may be matched to a lane.
        poses = [
            posed(p, Pose2(p.start.x_m + 0.2 * k, p.start.y_m - 0.1 * k, 0.05 * k), 10.0)
            for p in (run.vut, *run.targets)
        ]
        states = world.step(poses)
        assert all(s.stamp_ns == world.now_ns == k * 20_000_000 for s in states)
        for s in poses:
            at = to_sumo(s.pose, s.size.front_m)
            domain = libsumo.person if s.object_id == "ped" else libsumo.vehicle
            assert domain.getPosition(s.object_id) == pytest.approx((at.x_m, at.y_m), abs=1e-9)
            assert domain.getAngle(s.object_id) == pytest.approx(at.angle_deg % 360.0, abs=1e-9)
            if s.object_id != "ped":
                assert libsumo.vehicle.getSpeed(s.object_id) == pytest.approx(10.0)


def drive_by(tmp_path: Path, seed: int, cut_in: bool) -> list[list[ObjectState]]:
    """The VUT parks far ahead; the target drives at 5 m/s and changes into the traffic's lane."""
    run = run_spec(seed=seed)
    rows = []
    with SumoWorld(run, tmp_path) as world:
        for k in range(1, 301):
            still = everybody(run)
            side = min(max((k - 20) / 125.0, 0.0), 1.0) if cut_in else 0.0
            x, y = ORIGIN.to_parent(80.0 + 5.0 * STEP_S * k, -3.5 + 3.5 * side)
            target = posed(run.targets[0], Pose2(x, y, ORIGIN.yaw_rad), 5.0)
            far = Pose2(*ORIGIN.to_parent(290.0, 0.0), ORIGIN.yaw_rad)
            rows.append(world.step([posed(run.vut, far), target, *still[2:]]))
    return rows


def test_traffic_reacts_to_a_target_that_cuts_in_and_output_stays_clean(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    free = drive_by(tmp_path / "a", 1, cut_in=False)[-1][0]
    behind = drive_by(tmp_path / "b", 1, cut_in=True)[-1][0]
    assert free.speed_mps == pytest.approx(12.0, abs=0.1)
    assert behind.speed_mps < 10.5
    assert in_block(behind)[0] + behind.size.front_m < 80.0 + 5.0 * 6.0
    assert tuple(capfd.readouterr()) == ("", "")


def test_the_same_seed_gives_the_same_traffic(tmp_path: Path) -> None:
    assert drive_by(tmp_path / "a", 7, True) == drive_by(tmp_path / "b", 7, True)


@pytest.mark.parametrize("field", ["x_m", "y_m", "yaw_rad", "speed_mps"])
@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_pose_that_is_not_finite_never_reaches_sumo(
    world: SumoWorld, field: str, bad: float
) -> None:
    poses = everybody(run_spec())
    world.step(poses)
    before, now_ns = libsumo.vehicle.getPosition("vut"), world.now_ns
    change: dict[str, Any] = {field: bad}
    broken = [replace(poses[0], **change), *poses[1:]]
    with pytest.raises(ValueError, match="'vut' isn't finite"):
        world.step(broken)
    assert libsumo.vehicle.getPosition("vut") == before
    assert world.now_ns == now_ns


def test_every_object_is_needed_every_step(world: SumoWorld) -> None:
    poses = everybody(run_spec())
    for wrong in (poses[:-1], [*poses, poses[0]], [replace(poses[0], object_id="x"), *poses[1:]]):
        with pytest.raises(ValueError, match="one state of each"):
            world.step(wrong)


def test_one_simulation_per_process(world: SumoWorld, tmp_path: Path) -> None:
    with pytest.raises(RuntimeError, match="one SUMO simulation"):
        SumoWorld(run_spec(), tmp_path / "second").__enter__()
    world.step(everybody(run_spec()))


@pytest.mark.parametrize(
    ("traffic", "message"),
    [
        ({"lane": 3}, "3 lane"),
        ({"object_class": "pedestrian"}, "pedestrian"),
        ({"id": "vut"}, "same id"),
        ({"x_m": 251.0, "lane": 1}, "no room"),
    ],
)
def test_traffic_that_cannot_be_is_refused(
    tmp_path: Path, traffic: dict[str, Any], message: str
) -> None:
    spec = {"id": "t", "object_class": "car", "lane": 0, "x_m": 20.0, "speed_mps": 5.0, **traffic}
    other = {"id": "u", "object_class": "car", "lane": 1, "x_m": 250.0, "speed_mps": 5.0}
    run = run_spec(traffic=[other, spec])
    with pytest.raises(InputError, match=message), SumoWorld(run, tmp_path):
        pass
    assert not libsumo.isLoaded()


def test_traffic_with_no_speed_stands(tmp_path: Path) -> None:
    spec = {"id": "p", "object_class": "bus", "lane": 1, "x_m": 200.0, "speed_mps": 0.0}
    run = run_spec(traffic=[spec])
    with SumoWorld(run, tmp_path) as world:
        for _ in range(50):
            [bus] = world.step(everybody(run))
        assert in_block(bus) == pytest.approx((200.0 - bus.size.front_m, -3.5), abs=1e-4)


def test_a_network_is_made_once_for_a_road_and_again_for_another(tmp_path: Path) -> None:
    road = run_spec().road
    made = write_network(road, tmp_path).path
    made.write_bytes(made.read_bytes() + b"<!-- kept -->")
    assert write_network(road, tmp_path).path.read_bytes().endswith(b"<!-- kept -->")
    longer = road.model_copy(update={"length_m": road.length_m + 10.0})
    assert not write_network(longer, tmp_path).path.read_bytes().endswith(b"<!-- kept -->")
    # Without its end a network is none.
    made.unlink()
    assert write_network(longer, tmp_path).path.is_file()
