"""The CARLA target of METHOD 2.5: ``ssp.carla/1``, one JSON file, and the map.

No Python of ours is needed to use the file. Its frame is CARLA's: left-handed with y to the south,
m, degrees, yaw clockwise seen from above, pitch up. docs/exports.md describes its parts.
"""

from __future__ import annotations

import math
import re
from pathlib import Path, PurePath
from typing import Any

from ssp_core.carla.sensor import weather_of
from ssp_core.errors import InputError
from ssp_core.files.writing import write_bytes, write_json
from ssp_core.geometry import Pose2
from ssp_core.hashing import sha256_bytes
from ssp_core.motion.state import Size
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Camera
from ssp_core.run_file.participants import (
    Brake,
    FollowPath,
    Hold,
    Manoeuvre,
    Motion,
    ParticipantSpec,
    RelativeDistance,
    TriggerSpec,
)
from ssp_core.run_file.values import Point
from ssp_scenario_manager.compile.targets.carla_check import check_against_map, is_installed
from ssp_scenario_manager.compile.targets.map_file import (
    Heights,
    MapFile,
    map_file,
    provenance,
    trigger_condition,
)
from ssp_scenario_manager.compile.targets.ramps import CLASSES, TARGET_START_S
from ssp_scenario_manager.compile.task import Task
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.scenarios.base import Plan

CARLA_FILE = "carla_config.json"
# Middle of the body's box ahead of the actor's origin, as measured of CARLA 0.9.1x; of others 0.
_BOX_FORWARD_M = {
    "vehicle.tesla.model3": 0.03,
    "vehicle.carlamotors.firetruck": -0.25,
    "vehicle.mitsubishi.fusorosa": -0.45,
}
# Room below a body that appears, so that it doesn't stick in the ground.
_VEHICLE_ABOVE_M = 0.3
_WALKER_ABOVE_M = 0.1
# A file's numbers: a tenth of a micrometre, and less than that on the horizon.
_DIGITS = 7
# Names under which CARLA ships towns whose OpenDRIVE it also ships.
_TOWN = re.compile(r"Town(0[1-7]|10HD|1[1-3]|15)(_Opt)?")
# Fields of carla.OpendriveGenerationParameters.
_GENERATION = {
    "vertex_distance": 1.0,
    "max_road_length": 50.0,
    "wall_height": 0.0,
    "additional_width": 0.6,
    "smooth_junctions": True,
    "enable_mesh_visibility": True,
}
# Fields of carla.WorldSettings; at most max_substeps of max_substep_delta_time make a step.
_WORLD = {
    "synchronous_mode": True,
    "substepping": True,
    "max_substep_delta_time": 0.01,
    "max_substeps": 10,
}


def export_carla(
    task: Task, block: Block, plan: Plan, map_text: str | None, folder: Path
) -> list[Path]:
    """Write ``carla_config.json`` and the map.

    Args:
        task: sealed.
        block: that the task was placed on.
        plan: for the conflict point.
        map_text: the user's map; None where the task's place isn't an OpenDRIVE map.
        folder: to write into; it is there.

    Returns:
        The files.

    Raises:
        InputError: the block can't be put into OpenDRIVE, a place has no height on the map, or
            something isn't where CARLA's map has a place for it.
    """
    chart = map_file(task, block, map_text)
    config = carla_config(task, block, plan, chart)
    if is_installed() and (problems := check_against_map(config, chart.data.decode())):
        more = f" ({len(problems) - 1} more)" if len(problems) > 1 else ""
        raise InputError(
            f"doesn't fit CARLA's reading of the map: {problems[0]}{more}",
            file=chart.name,
            remedy="choose another block or map",
        )
    write_bytes(folder / chart.name, chart.data)
    write_json(folder / CARLA_FILE, config)
    return [folder / CARLA_FILE, folder / chart.name]


def carla_config(task: Task, block: Block, plan: Plan, chart: MapFile) -> dict[str, Any]:
    """Return the configuration of a task, as JSON-like data."""
    run, facts, heights = task.run, provenance(task), chart.heights
    sources = "event", "event_version", "task_version", "compiler"
    return {
        "schema": "ssp.carla/1",
        "carla_version": "0.9.16",
        "provenance": {name: facts[name] for name in sources},
        "seed": task.seed,  # of walkers and the traffic manager
        "map": _map_link(chart),
        "world": {**_WORLD, "fixed_delta_seconds": run.step_s},
        "weather": weather_of(run.look),
        "actors": [_actor(who, heights) for who in (run.vut, *run.targets)],
        "triggers": [_trigger(spec, heights) for spec in run.triggers],
        "conflict": _place(block.line.to_map(plan.conflict.s_m, plan.conflict.l_m), heights),
        "camera": None if run.camera is None else _camera(run.camera, run.vut),
        "speed_limit_mps": task.limits.speed_mps,
        "end_s": min(run.end.at_latest_s, run.limits.duration_s),
    }


def _number(value: float) -> float:
    """Round, without a negative zero."""
    return round(value, _DIGITS) + 0.0


def _location(x_m: float, y_m: float, z_m: float) -> dict[str, float]:
    """Return a place of frame map for CARLA: y changes its sign."""
    return {"x": _number(x_m), "y": _number(-y_m), "z": _number(z_m)}


def transform(pose: Pose2, z_m: float = 0.0) -> dict[str, dict[str, float]]:
    """Return a pose of frame map for CARLA: y and yaw change sign, yaw is in (-180, 180]."""
    yaw = _number(math.remainder(-math.degrees(pose.yaw_rad), 360.0))
    return {
        "location": _location(pose.x_m, pose.y_m, z_m),
        "rotation": {"pitch": 0.0, "yaw": 180.0 if yaw <= -180.0 else yaw, "roll": 0.0},
    }


def _place(point: Point, heights: Heights) -> dict[str, float]:
    return _location(*point, heights.at(point))


def _map_link(chart: MapFile) -> dict[str, Any]:
    """Name one of CARLA's towns, or a world that is generated from the file beside."""
    name = PurePath(chart.name).stem
    town = not chart.own and _TOWN.fullmatch(name) is not None
    return {
        "name": name,
        "load": "load_world" if town else "generate_opendrive_world",
        "file": chart.name,
        "sha256": sha256_bytes(chart.data),
        "generation": None if town else _GENERATION,
    }


def _drive(motion: Motion, start_s: float, heights: Heights) -> dict[str, Any]:
    """Describe a drive along a route from standstill; the reference point is to follow it."""
    return {
        "route": [_place(point, heights) for point in motion.path],
        "start_s": start_s,
        "speed_mps": motion.cruise_mps,
        "acceleration_mps2": motion.acceleration_mps2,
        "deceleration_mps2": motion.deceleration_mps2,
    }


def _actor(who: ParticipantSpec, heights: Heights) -> dict[str, Any]:
    """Return one participant.

    ``reference`` is the task's pose on the ground: below the rear axle, or below a pedestrian.
    ``spawn`` is the same for CARLA: a vehicle's origin lies below its body, ``box_forward`` behind
    the middle, a walker's at half its height, and both want some room above the ground.
    """
    size, start = who.size, who.start.pose
    ground = heights.at((start.x_m, start.y_m))
    walks = who.object_class == "pedestrian"
    above = size.height_m / 2 + _WALKER_ABOVE_M if walks else _VEHICLE_ABOVE_M
    blueprint = CLASSES[who.object_class].blueprint
    origin = Pose2(*start.to_parent(_origin_ahead_m(size, blueprint), 0.0), start.yaw_rad)
    start_s = 0.0 if who.id == VUT_ID else TARGET_START_S
    return {
        "id": who.id,
        "object_class": who.object_class,
        "blueprint": blueprint,
        "box_forward": _BOX_FORWARD_M.get(blueprint, 0.0),
        "role_name": who.id,
        "extent": {
            "front": size.front_m,
            "rear": size.rear_m,
            "width": size.width_m,
            "height": size.height_m,
        },
        "reference": transform(start, ground),
        "spawn": transform(origin, ground + above),
        "drive": None if who.approach is None else _drive(who.approach, start_s, heights),
    }


def _origin_ahead_m(size: Size, blueprint: str) -> float:
    """Return the distance from the reference point forward to CARLA's origin, m.

    It puts the middle of CARLA's box over that of ours.
    """
    return 0.5 * (size.front_m - size.rear_m) - _BOX_FORWARD_M.get(blueprint, 0.0)


def _act(manoeuvre: Manoeuvre, heights: Heights) -> dict[str, Any]:
    if isinstance(manoeuvre, FollowPath):
        drive = _drive(manoeuvre.motion, 0.0, heights)
        return {"kind": "follow_path", "drive": drive}
    if isinstance(manoeuvre, Hold):
        return {"kind": "hold"}
    rate = manoeuvre.deceleration_mps2
    if isinstance(manoeuvre, Brake):
        return {"kind": "brake", "speed_mps": manoeuvre.to_mps, "deceleration_mps2": rate}
    return {
        "kind": "lane_change",
        "right_m": -manoeuvre.lateral_shift_m,
        "duration_s": manoeuvre.duration_s,
        "speed_mps": manoeuvre.cruise_mps,
        "deceleration_mps2": rate,
    }


def _trigger(spec: TriggerSpec, heights: Heights) -> dict[str, Any]:
    """Return a trigger, which fires once; the actor acts ``lead_time_s`` later.

    relative_distance: the bumper gap from the VUT's front to the object along the VUT's route is
    below ``below`` m. time_to_arrival: the VUT's front reaches ``anchor`` in less than ``below`` s
    at its present speed.
    """
    condition = trigger_condition(spec)
    if isinstance(condition, RelativeDistance):
        other, anchor = condition.object_id, None
        below, unit = condition.below_m, "m"
    else:
        other, anchor = None, _place(condition.anchor, heights)
        below, unit = condition.below_s, "s"
    return {
        "id": spec.id,
        "quantity": condition.type,
        "object_id": other,
        "anchor": anchor,
        "below": below,
        "unit": unit,
        "held_for_s": spec.held_for_s,
        "not_before_s": spec.not_before_s,
        "lead_time_s": spec.lead_time_s,
        "actor": spec.object_id,
        "act": _act(spec.manoeuvre, heights),
    }


def _camera(camera: Camera, vut: ParticipantSpec) -> dict[str, Any]:
    """Return the forward camera; its mounting is relative to the VUT's origin in CARLA.

    There y is to the right, pitch is positive upwards, yaw to the right and roll to the right.
    """
    ahead_m = _origin_ahead_m(vut.size, CLASSES[vut.object_class].blueprint)
    return {
        "blueprint": "sensor.camera.rgb",
        "image_size_x": camera.width_px,
        "image_size_y": camera.height_px,
        "fov": camera.hfov_deg,
        "sensor_tick": 1.0 / camera.rate_hz,
        "attach_to": VUT_ID,
        "mounting": {
            "location": {
                "x": _number(camera.forward_m - ahead_m),
                "y": _number(-camera.left_m),
                "z": camera.height_m,
            },
            "rotation": {
                "pitch": _number(-math.degrees(camera.pitch_down_rad)),
                "yaw": _number(-math.degrees(camera.yaw_left_rad)),
                "roll": _number(math.degrees(camera.roll_right_rad)),
            },
        },
    }
