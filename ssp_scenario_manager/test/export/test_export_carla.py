"""The CARLA configuration: its frame, what it tells of a task, and the check against the map."""

from __future__ import annotations

import json
import math
import re
import types
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_core.geometry import Pose2
from ssp_core.hashing import sha256_file
from ssp_scenario_manager.compile.targets import carla
from ssp_scenario_manager.compile.targets.carla import carla_config, export_carla, transform
from ssp_scenario_manager.compile.targets.carla_check import check_against_map
from ssp_scenario_manager.compile.targets.map_file import map_file
from ssp_scenario_manager.compile.task import PlaceLink
from ssp_scenario_manager.scenarios.events.kinds import KINDS

# Where roads cross: test_maps_crossing_car.py.
EVENTS = tuple(sorted(name for name, kind in KINDS.items() if not kind.at_junction))


@pytest.fixture(autouse=True)
def without_carla(monkeypatch: pytest.MonkeyPatch) -> None:
    """Skip CARLA's check of the exports, even if the extra is installed."""
    monkeypatch.setattr(carla, "is_installed", lambda: False)


def as_namespace(value: Any) -> Any:
    """JSON-like data whose fields are attributes."""
    return json.loads(json.dumps(value), object_hook=lambda fields: types.SimpleNamespace(**fields))


def exported(case: Any, folder: Path, map_text: str | None = None) -> Any:
    files = export_carla(case.task, case.block, case.plan, map_text, folder)
    return as_namespace(json.loads(files[0].read_text()))


poses = st.builds(Pose2, st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(-math.pi, math.pi))


def _back(told: Any) -> tuple[float, float, float]:
    """CARLA's transform as a right-handed pose, by the definition of its frame."""
    return told.location.x, -told.location.y, math.radians(-told.rotation.yaw)


@given(poses, st.floats(-50.0, 50.0), st.floats(-50.0, 50.0))
def test_the_frame_is_mirrored_and_nothing_else(pose: Pose2, ahead: float, left: float) -> None:
    told = as_namespace(transform(pose))
    x, y, yaw = _back(told)
    assert math.dist((x, y), (pose.x_m, pose.y_m)) < 1e-6
    assert math.remainder(yaw - pose.yaw_rad, 2 * math.pi) == pytest.approx(0.0, abs=1e-8)
    assert -180.0 < told.rotation.yaw <= 180.0
    # A point ahead and to the left is ahead and at negative right in CARLA.
    there = pose.to_parent(ahead, left)
    turn = math.radians(told.rotation.yaw)
    right = -left
    cx = told.location.x + math.cos(turn) * ahead - math.sin(turn) * right
    cy = told.location.y + math.sin(turn) * ahead + math.cos(turn) * right
    assert math.dist((cx, -cy), there) < 1e-5


def test_bodies_appear_around_their_middle_above_the_ground(case_of: Any, tmp_path: Path) -> None:
    config = exported(case_of("occluded_crossing"), tmp_path)
    vut, walker, truck = config.actors
    assert (vut.reference.location.x, vut.reference.location.y) == (15.0, 0.0)
    # A car reaches from 0.9 m behind to 3.6 m ahead of its rear axle.
    # CARLA's box of that car lies 0.03 m ahead of its origin.
    assert vut.spawn.location.x == pytest.approx(15.0 + 1.35 - 0.03)
    assert 0.0 < vut.spawn.location.z < 0.5
    # The pedestrian faces left, which is CARLA's -90 degrees, and stands to the right: y > 0.
    assert walker.spawn.rotation.yaw == pytest.approx(-90.0)
    assert walker.spawn.location.y == pytest.approx(1.75 + 0.8)
    assert walker.spawn.location.z == pytest.approx(1.75 / 2 + 0.1)
    assert walker.blueprint.startswith("walker.")
    # And that of the fire engine 0.25 m behind.
    assert truck.spawn.location.x == pytest.approx(100.0 + 2.5 + 0.25)
    assert (vut.box_forward, walker.box_forward, truck.box_forward) == (0.03, 0.0, -0.25)
    assert truck.drive is None
    assert walker.drive is None


def test_a_lane_change_to_the_right_is_to_the_right(case_of: Any, tmp_path: Path) -> None:
    config = exported(case_of("cut_in"), tmp_path)
    (trigger,) = config.triggers
    assert vars(trigger.act) == {
        "kind": "lane_change",
        "right_m": 3.5,
        "duration_s": 2.4,
        "speed_mps": 5.5,
        "deceleration_mps2": 2.0,
    }
    assert (trigger.quantity, trigger.object_id, trigger.below, trigger.unit) == (
        "relative_distance",
        "ot1",
        18.0,
        "m",
    )
    assert (trigger.lead_time_s, trigger.not_before_s, trigger.anchor) == (0.1, 4.0, None)
    target = config.actors[1]
    assert target.drive is not None
    assert [(p.x, p.y) for p in target.drive.route] == [(52.0, -3.5), (380.0, -3.5)]
    assert target.drive.start_s == pytest.approx(0.7)


def test_an_arrival_has_its_anchor_and_a_walk_its_route(case_of: Any, tmp_path: Path) -> None:
    config = exported(case_of("vru_crossing"), tmp_path)
    (trigger,) = config.triggers
    assert trigger.anchor is not None
    assert (trigger.anchor.x, trigger.anchor.y, trigger.unit) == (110.0, 0.0, "s")
    assert trigger.object_id is None
    assert trigger.act.kind == "follow_path"
    ends = [(p.x, p.y) for p in trigger.act.drive.route]
    assert ends == [(110.0, 2.55), (110.0, -13.25)]


def test_a_braking_goes_to_its_speed(case_of: Any, tmp_path: Path) -> None:
    (trigger,) = exported(case_of("lead_braking"), tmp_path).triggers
    assert vars(trigger.act) == {
        "kind": "brake",
        "speed_mps": 2.0,
        "deceleration_mps2": 4.0,
    }


def test_camera_world_and_sources_are_those_of_the_task(case_of: Any, tmp_path: Path) -> None:
    case = case_of("cut_in")
    config = exported(case, tmp_path)
    assert config.camera is not None
    camera = case.task.run.camera
    assert (config.camera.image_size_x, config.camera.image_size_y) == (960, 540)
    assert (config.camera.fov, config.camera.sensor_tick) == (75.0, 0.1)
    mounting = config.camera.mounting
    # 1.8 m ahead of the rear axle is 0.45 m ahead of the body's middle, which lies 0.03 m ahead
    # of CARLA's origin; down is negative.
    assert mounting.location.x == pytest.approx(camera.forward_m - 1.35 + 0.03)
    assert mounting.location.z == camera.height_m
    assert mounting.rotation.pitch == pytest.approx(-math.degrees(camera.pitch_down_rad))
    assert config.world.synchronous_mode is True
    assert config.world.fixed_delta_seconds == case.task.run.step_s
    # CARLA's own rule for substepping.
    assert (
        config.world.fixed_delta_seconds
        <= config.world.max_substep_delta_time * config.world.max_substeps
    )
    assert config.seed == 7
    assert config.provenance.event_version == case.task.event.version
    assert config.provenance.task_version == case.task.version
    assert config.provenance.compiler == "ssp 0.1.0"
    assert config.map.sha256 == sha256_file(tmp_path / config.map.file)
    assert config.map.load == "generate_opendrive_world"
    assert config.map.generation is not None


def test_no_camera_is_null(case_of: Any) -> None:
    case = case_of("cut_in")
    task = case.task.model_copy(update={"run": case.task.run.model_copy(update={"camera": None})})
    chart = map_file(task, case.block, None)
    assert carla_config(task, case.block, case.plan, chart)["camera"] is None


@pytest.mark.parametrize(
    ("name", "load"),
    [
        ("Town01.xodr", "load_world"),
        ("maps/Town10HD_Opt.xodr", "load_world"),
        ("Town99.xodr", "generate_opendrive_world"),
        ("motorway.xodr", "generate_opendrive_world"),
    ],
)
def test_carlas_own_towns_are_loaded_and_others_generated(
    name: str, load: str, case_of: Any, tmp_path: Path
) -> None:
    place = PlaceLink(kind="opendrive", name=name, sha256="sha256:map")
    case = case_of("cut_in", None, "carla", place)
    config = exported(case, tmp_path, "<OpenDRIVE/>")
    assert (config.map.load, config.map.name) == (load, Path(name).stem)
    assert (config.map.generation is None) == (load == "load_world")


def test_the_sun_turns_as_yaw_does(case_of: Any) -> None:
    case = case_of("cut_in")
    for azimuth, told in ((0.0, 0.0), (90.0, 270.0), (-30.0, 30.0)):
        look = case.task.run.look.model_copy(update={"sun_azimuth_deg": azimuth})
        run = case.task.run.model_copy(update={"look": look})
        task = case.task.model_copy(update={"run": run})
        config = carla_config(task, case.block, case.plan, map_file(task, case.block, None))
        assert config["weather"]["sun_azimuth_angle"] == pytest.approx(told)


@pytest.mark.parametrize("name", EVENTS)
def test_the_same_task_gives_the_same_bytes(name: str, case_of: Any, tmp_path: Path) -> None:
    texts = []
    for _ in range(2):
        case = case_of(name)
        files = export_carla(case.task, case.block, case.plan, None, tmp_path)
        texts.append([f.read_bytes() for f in files])
    assert texts[0] == texts[1]
    assert json.loads(texts[0][0])["schema"] == "ssp.carla/1"


def config_of(case: Any) -> tuple[dict[str, Any], str]:
    """The configuration, as a file's reader has it, and its map."""
    chart = map_file(case.task, case.block, None)
    config = carla_config(case.task, case.block, case.plan, chart)
    return json.loads(json.dumps(config)), chart.data.decode()


@pytest.mark.carla
@pytest.mark.parametrize("name", EVENTS)
def test_a_good_configuration_fits_the_map(name: str, case_of: Any, tmp_path: Path) -> None:
    config, text = config_of(case_of(name))
    assert check_against_map(config, text) == []


@pytest.mark.carla
def test_a_verge_is_ground_to_wait_on(case_of: Any, block_of: Any) -> None:
    raw, text = config_of(case_of("vru_crossing", block_of(right_boundary="verge")))
    raw["actors"][1]["reference"]["location"]["y"] = 9.0
    assert check_against_map(raw, text) == []


@pytest.mark.carla
def test_a_bent_road_fits_carlas_reading(case_of: Any, curved_block: Any) -> None:
    for name in EVENTS:
        config, text = config_of(case_of(name, curved_block))
        assert check_against_map(config, text) == []


Spoil = Callable[[dict[str, Any]], None]


def _set(path: str, value: Any) -> Spoil:
    def spoil(raw: dict[str, Any]) -> None:
        *parents, last = path.split(".")
        node: Any = raw
        for part in parents:
            node = node[int(part)] if part.isdigit() else node[part]
        node[int(last) if last.isdigit() else last] = value

    return spoil


def _route(index: int, points: list[tuple[float, float]]) -> Spoil:
    return _set(f"actors.{index}.drive.route", [{"x": x, "y": y, "z": 0.0} for x, y in points])


@pytest.mark.carla
@pytest.mark.parametrize(
    ("name", "spoil", "words"),
    [
        ("cut_in", _set("actors.0.reference.location.y", 3.5), "vut starts at .* no driving lane"),
        ("cut_in", _set("actors.0.reference.location.y", 0.8), "vut starts 0.80 m beside"),
        ("cut_in", _set("actors.0.reference.rotation.yaw", 180.0), "180.0 deg off"),
        ("cut_in", _set("actors.0.reference.rotation.yaw", 6.0), "6.0 deg off"),
        ("cut_in", _set("actors.0.reference.location.z", 2.0), "height of 2 m"),
        ("cut_in", _route(0, [(15.0, 0.0), (450.0, 0.0)]), "leaves the driving lanes"),
        ("cut_in", _route(0, [(15.0, 0.0), (385.0, 1.0)]), "leaves its lane's centre"),
        ("cut_in", _route(1, [(380.0, -3.5), (52.0, -3.5)]), "ot1 isn't connected"),
        ("vru_crossing", _set("actors.1.reference.location.y", 0.0), "on driving lane -2"),
        ("vru_crossing", _set("actors.1.reference.location.y", 9.0), "no lane of any kind"),
        (
            "vru_crossing",
            _set("triggers.0.act.drive.route.1", {"x": 110.0, "y": -20.0, "z": 0.0}),
            "off the map",
        ),
        ("occluded_crossing", _set("actors.2.reference.location.y", 30.0), "no lane of any kind"),
    ],
)
def test_what_doesnt_fit_the_map_is_named(
    name: str, spoil: Spoil, words: str, case_of: Any
) -> None:
    raw, text = config_of(case_of(name))
    spoil(raw)
    problems = check_against_map(raw, text)
    assert len(problems) == 1
    assert re.search(words, problems[0]), problems


def test_a_misfit_is_refused_before_anything_is_written(
    case_of: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(carla, "is_installed", lambda: True)
    monkeypatch.setattr(carla, "check_against_map", lambda *_: ["ot1 floats", "so does vut"])
    case = case_of("cut_in")
    with pytest.raises(InputError, match=r"ot1 floats \(1 more\)"):
        export_carla(case.task, case.block, case.plan, None, tmp_path)
    assert list(tmp_path.iterdir()) == []
