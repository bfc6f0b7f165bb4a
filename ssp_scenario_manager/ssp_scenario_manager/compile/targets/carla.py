"""The CARLA target of METHOD 2.5: one JSON file and the map; no Python of ours is needed to use
it.
"""

from __future__ import annotations

import math
import re
from pathlib import Path, PurePath

from ssp_core.errors import InputError
from ssp_core.files import write_bytes, write_json
from ssp_core.geometry import Pose2
from ssp_core.hashing import sha256_bytes
from ssp_core.motion.state import Size
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Camera, Look
from ssp_core.run_file.participants import (
    Brake,
    FollowPath,
    LaneChange,
    Motion,
    ParticipantSpec,
    RelativeDistance,
    TimeToArrival,
    TriggerSpec,
)
from ssp_core.run_file.values import Point
from ssp_scenario_manager.compile.targets.carla_config import (
    SCHEMA,
    Actor,
    CarlaConfig,
    ChangeLane,
    Drive,
    Extent,
    ForwardCamera,
    Location,
    MapLink,
    MeshGeneration,
    Provenance,
    Rotation,
    SlowDown,
    Transform,
    Trigger,
    Walk,
    Weather,
    WorldSettings,
    check_against_map,
    is_installed,
)
from ssp_scenario_manager.compile.targets.map_file import Heights, MapFile, map_file, provenance
from ssp_scenario_manager.compile.targets.ramps import CLASSES, TARGET_START_S
from ssp_scenario_manager.compile.task import Task
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.scenarios.base import Plan

# Room below a body that appears, so that it doesn't stick in the ground.
_VEHICLE_ABOVE_M = 0.3
_WALKER_ABOVE_M = 0.1
# A file's numbers: a tenth of a micrometre, and less than that on the horizon.
_DIGITS = 7


def _number(value: float) -> float:
    """Rounded, without a negative zero."""
    return round(value, _DIGITS) + 0.0


def location(point: Point, z_m: float = 0.0) -> Location:
    """A place of frame map: y changes its sign."""
    return Location(x=_number(point[0]), y=_number(-point[1]), z=_number(z_m))


def transform(pose: Pose2, z_m: float = 0.0) -> Transform:
    """A pose of frame map: y and yaw change their signs, yaw is in (-180, 180]."""
    yaw = _number(math.remainder(-math.degrees(pose.yaw_rad), 360.0))
    return Transform(
        location=location((pose.x_m, pose.y_m), z_m),
        rotation=Rotation(pitch=0.0, yaw=180.0 if yaw <= -180.0 else yaw, roll=0.0),
    )


def body_middle_m(size: Size) -> float:
    """From the reference point forward to the middle of the body: CARLA's origin."""
    return 0.5 * (size.front_m - size.rear_m)


def spawn(who: ParticipantSpec, ground_m: float) -> Transform:
    """Where CARLA is to put a participant: middle of the body, somewhat above the ground."""
    start = who.start.pose
    middle = start.to_parent(body_middle_m(who.size), 0.0)
    walks = who.object_class == "pedestrian"
    above = who.size.height_m / 2 + _WALKER_ABOVE_M if walks else _VEHICLE_ABOVE_M
    return transform(Pose2(*middle, start.yaw_rad), ground_m + above)


def camera_mounting(camera: Camera, size: Size) -> Transform:
    """The forward camera relative to the VUT's origin in CARLA.

    There y is to the right, pitch is positive upwards, yaw to the right and roll to the right.
    """
    return Transform(
        location=Location(
            x=_number(camera.forward_m - body_middle_m(size)),
            y=_number(-camera.left_m),
            z=camera.height_m,
        ),
        rotation=Rotation(
            pitch=_number(-math.degrees(camera.pitch_down_rad)),
            yaw=_number(-math.degrees(camera.yaw_left_rad)),
            roll=_number(math.degrees(camera.roll_right_rad)),
        ),
    )


CARLA_FILE = "carla_config.json"
# Names under which CARLA ships towns whose OpenDRIVE it also ships.
_TOWN = re.compile(r"Town(0[1-7]|10HD|1[1-3]|15)(_Opt)?")
# Fog as CARLA's percent: how much of the light is lost over this distance.
_FOG_OVER_M = 100.0


def export_carla(
    task: Task, block: Block, plan: Plan, map_text: str | None, folder: Path
) -> list[Path]:
    """Writes ``carla_config.json`` and the map.

    Args:
        task: sealed.
        block: that the task was placed on.
        plan: for the conflict point.
        map_text: the user's map; None where the task's place isn't an OpenDRIVE map.
        folder: to write into; it is there.

    Returns:
        The files.

    Raises:
        InputError: something can't be told, or isn't where the map has a place for it.
    """
    chart = map_file(task, block, map_text)
    config = carla_config(task, block, plan, chart)
    if is_installed():
        problems = check_against_map(config, chart.data.decode())
        if problems:
            more = f" ({len(problems) - 1} more)" if len(problems) > 1 else ""
            raise InputError(
                f"doesn't fit CARLA's reading of the map: {problems[0]}{more}",
                file=chart.name,
                remedy="choose another block or map",
            )
    write_bytes(folder / chart.name, chart.data)
    write_json(folder / CARLA_FILE, config.model_dump(mode="json", by_alias=True))
    return [folder / CARLA_FILE, folder / chart.name]


def carla_config(task: Task, block: Block, plan: Plan, chart: MapFile) -> CarlaConfig:
    """The configuration of a task.

    Raises:
        InputError: a trigger asks something that the file can't tell.
    """
    run = task.run
    facts = provenance(task)
    return CarlaConfig(
        provenance=Provenance(
            event=facts["event"],
            event_version=facts["event_version"],
            task_version=facts["task_version"],
            compiler=facts["compiler"],
        ),
        seed=task.seed,
        map=_map_link(chart),
        world=WorldSettings(fixed_delta_seconds=run.step_s),
        weather=_weather(run.look),
        actors=[_actor(who, chart.heights) for who in (run.vut, *run.targets)],
        triggers=[
            _trigger(spec, f"run.triggers[{i}]", chart.heights)
            for i, spec in enumerate(run.triggers)
        ],
        conflict=_place(block.line.to_map(plan.conflict.s_m, plan.conflict.l_m), chart.heights),
        camera=None if run.camera is None else _camera(run.camera, run.vut.size),
        speed_limit_mps=task.limits.speed_mps,
        end_s=min(run.end.at_latest_s, run.limits.duration_s),
    )


def _map_link(chart: MapFile) -> MapLink:
    name = PurePath(chart.name).stem
    town = not chart.own and _TOWN.fullmatch(name) is not None
    return MapLink(
        name=name,
        load="load_world" if town else "generate_opendrive_world",
        file=chart.name,
        sha256=sha256_bytes(chart.data),
        generation=None if town else MeshGeneration(),
    )


def _weather(look: Look) -> Weather:
    """Sun and fog of a run under a clear sky; the sun's azimuth turns as CARLA's yaw does."""
    return Weather(
        cloudiness=10.0,
        precipitation=0.0,
        precipitation_deposits=0.0,
        wind_intensity=5.0,
        sun_azimuth_angle=round(-look.sun_azimuth_deg % 360.0, 6),
        sun_altitude_angle=look.sun_elevation_deg,
        fog_density=round(100.0 * -math.expm1(-look.fog_per_m * _FOG_OVER_M), 6),
        fog_distance=0.0,
        wetness=0.0,
    )


def _place(point: Point, heights: Heights) -> Location:
    return location(point, heights.at(point))


def _drive(motion: Motion, start_s: float, heights: Heights) -> Drive:
    return Drive(
        route=[_place(point, heights) for point in motion.path],
        start_s=start_s,
        speed_mps=motion.cruise_mps,
        acceleration_mps2=motion.acceleration_mps2,
        deceleration_mps2=motion.deceleration_mps2,
    )


def _actor(who: ParticipantSpec, heights: Heights) -> Actor:
    start_s = 0.0 if who.id == VUT_ID else TARGET_START_S
    size = who.size
    ground = heights.at((who.start.x_m, who.start.y_m))
    return Actor(
        id=who.id,
        object_class=who.object_class,
        blueprint=CLASSES[who.object_class].blueprint,
        role_name=who.id,
        extent=Extent(
            front=size.front_m, rear=size.rear_m, width=size.width_m, height=size.height_m
        ),
        reference=transform(who.start.pose, ground),
        spawn=spawn(who, ground),
        drive=None if who.approach is None else _drive(who.approach, start_s, heights),
    )


def _act(
    manoeuvre: LaneChange | FollowPath | Brake, heights: Heights
) -> ChangeLane | SlowDown | Walk:
    if isinstance(manoeuvre, LaneChange):
        return ChangeLane(
            kind="lane_change",
            right_m=-manoeuvre.lateral_shift_m,
            duration_s=manoeuvre.duration_s,
            speed_mps=manoeuvre.cruise_mps,
            deceleration_mps2=manoeuvre.deceleration_mps2,
        )
    if isinstance(manoeuvre, Brake):
        return SlowDown(
            kind="brake",
            speed_mps=manoeuvre.to_mps,
            deceleration_mps2=manoeuvre.deceleration_mps2,
        )
    return Walk(kind="follow_path", drive=_drive(manoeuvre.motion, 0.0, heights))


def _trigger(spec: TriggerSpec, field: str, heights: Heights) -> Trigger:
    condition = spec.condition
    if not isinstance(condition, RelativeDistance | TimeToArrival):
        raise InputError(
            f"{SCHEMA} tells of a relative distance or a time to arrival only",
            field=f"{field}.condition.type",
            value=condition.type,
            remedy="relative_distance or time_to_arrival",
        )
    if spec.edge != "none":
        raise InputError(
            f"{SCHEMA} has no edges", field=f"{field}.edge", value=spec.edge, remedy="none"
        )
    distance = isinstance(condition, RelativeDistance)
    return Trigger(
        id=spec.id,
        quantity=condition.type,
        object_id=condition.object_id if isinstance(condition, RelativeDistance) else None,
        anchor=(
            None if isinstance(condition, RelativeDistance) else _place(condition.anchor, heights)
        ),
        below=condition.below_m if isinstance(condition, RelativeDistance) else condition.below_s,
        unit="m" if distance else "s",
        held_for_s=spec.held_for_s,
        not_before_s=spec.not_before_s,
        lead_time_s=spec.lead_time_s,
        actor=spec.object_id,
        act=_act(spec.manoeuvre, heights),
    )


def _camera(camera: Camera, size: Size) -> ForwardCamera:
    return ForwardCamera(
        image_size_x=camera.width_px,
        image_size_y=camera.height_px,
        fov=camera.hfov_deg,
        sensor_tick=1.0 / camera.rate_hz,
        attach_to=VUT_ID,
        mounting=camera_mounting(camera, size),
    )
