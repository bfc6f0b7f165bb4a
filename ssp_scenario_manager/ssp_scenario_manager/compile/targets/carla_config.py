"""``ssp.carla/1``, what a CARLA client needs to stage a task, and its check against CARLA's own
reading of the map.
"""

from __future__ import annotations

import importlib
import importlib.util
import itertools
import math
from collections.abc import Iterator, Sequence
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from ssp_core.run_file.values import Finite, NonNegative, ObjectId, Positive, Strict
from ssp_core.vocabulary import ObjectWord

SCHEMA: Literal["ssp.carla/1"] = "ssp.carla/1"
CARLA_VERSION: Literal["0.9.16"] = "0.9.16"


class Location(Strict):
    """A place: m."""

    x: Finite
    y: Finite
    z: Finite


class Rotation(Strict):
    """Degrees; yaw clockwise seen from above, pitch up."""

    pitch: Finite
    yaw: Finite
    roll: Finite


class Transform(Strict):
    location: Location
    rotation: Rotation


class Provenance(Strict):
    """What the file was made from (METHOD 2.5)."""

    event: str
    event_version: str
    task_version: str
    compiler: str


class MeshGeneration(Strict):
    """Fields of ``carla.OpendriveGenerationParameters``."""

    vertex_distance: Positive = 1.0
    max_road_length: Positive = 50.0
    wall_height: NonNegative = 0.0
    additional_width: NonNegative = 0.6
    smooth_junctions: bool = True
    enable_mesh_visibility: bool = True


class MapLink(Strict):
    """The world to load: one of CARLA's towns, or one generated from the file beside."""

    name: str
    load: Literal["load_world", "generate_opendrive_world"]
    file: str = Field(description="OpenDRIVE, beside this file")
    sha256: str = Field(description="of that file")
    generation: MeshGeneration | None = Field(description="null with load_world")


class WorldSettings(Strict):
    """Fields of ``carla.WorldSettings``."""

    synchronous_mode: Literal[True] = True
    fixed_delta_seconds: Positive
    substepping: bool = True
    max_substep_delta_time: Positive = 0.01
    max_substeps: Annotated[int, Field(ge=1, le=16)] = 10


class Weather(Strict):
    """Fields of ``carla.WeatherParameters``."""

    cloudiness: NonNegative
    precipitation: NonNegative
    precipitation_deposits: NonNegative
    wind_intensity: NonNegative
    sun_azimuth_angle: Finite
    sun_altitude_angle: Finite
    fog_density: NonNegative
    fog_distance: NonNegative
    wetness: NonNegative


class Drive(Strict):
    """Along a route from standstill, s after the start; the reference point is to follow it."""

    route: Annotated[list[Location], Field(min_length=2)]
    start_s: NonNegative
    speed_mps: Positive
    acceleration_mps2: Positive
    deceleration_mps2: Positive


class Extent(Strict):
    """Of the body in the task, m; CARLA's blueprint has its own."""

    front: Positive = Field(description="from the reference point")
    rear: Positive = Field(description="from the reference point")
    width: Positive
    height: Positive


class Actor(Strict):
    """One participant.

    ``reference`` is the task's pose on the ground: below the rear axle, or below a pedestrian.
    ``spawn`` is the same for CARLA, which puts a vehicle's origin below the middle of its body and
    a walker's at half its height, and wants some room above the ground.
    """

    id: ObjectId
    object_class: ObjectWord
    blueprint: str
    role_name: str
    extent: Extent
    reference: Transform
    spawn: Transform
    drive: Drive | None = Field(None, description="before its trigger; null: it stands")


class ChangeLane(Strict):
    """Sideways while driving on."""

    kind: Literal["lane_change"]
    right_m: Finite = Field(description="+ to the right")
    duration_s: Positive
    speed_mps: Positive
    deceleration_mps2: Positive


class SlowDown(Strict):
    """In its lane, to a lower speed."""

    kind: Literal["brake"]
    speed_mps: NonNegative
    deceleration_mps2: Positive


class Walk(Strict):
    """Along a path of its own to a standstill at its end."""

    kind: Literal["follow_path"]
    drive: Drive


class Trigger(Strict):
    """Fires once.

    relative_distance: the bumper gap from the VUT's front to the object along the VUT's route is
    below ``below`` m. time_to_arrival: the VUT's front reaches ``anchor`` in less than ``below`` s
    at its present speed. The actor acts ``lead_time_s`` later.
    """

    id: str
    quantity: Literal["relative_distance", "time_to_arrival"]
    object_id: ObjectId | None
    anchor: Location | None
    below: Positive
    unit: Literal["m", "s"]
    held_for_s: NonNegative
    not_before_s: NonNegative
    lead_time_s: NonNegative
    actor: ObjectId
    act: Annotated[ChangeLane | SlowDown | Walk, Field(discriminator="kind")]


class ForwardCamera(Strict):
    """A ``sensor.camera.rgb`` on the VUT; ``mounting`` is relative to the VUT's origin in CARLA."""

    blueprint: Literal["sensor.camera.rgb"] = "sensor.camera.rgb"
    image_size_x: Annotated[int, Field(ge=1)]
    image_size_y: Annotated[int, Field(ge=1)]
    fov: Positive = Field(description="horizontal, deg")
    sensor_tick: Positive = Field(description="s between frames")
    attach_to: ObjectId
    mounting: Transform


class CarlaConfig(Strict):
    """The whole file."""

    schema_: Literal["ssp.carla/1"] = Field(SCHEMA, alias="schema")
    carla_version: Literal["0.9.16"] = CARLA_VERSION
    provenance: Provenance
    seed: Annotated[int, Field(ge=0)] = Field(description="of walkers and the traffic manager")
    map: MapLink
    world: WorldSettings
    weather: Weather
    actors: Annotated[list[Actor], Field(min_length=2)]
    triggers: Annotated[list[Trigger], Field(min_length=1)]
    conflict: Location = Field(description="the conflict point (METHOD 1)")
    camera: ForwardCamera | None
    speed_limit_mps: Positive = Field(description="Ω_safe: no participant may be faster")
    end_s: Positive = Field(description="the run ends at the latest")

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


# A route and a start are on a lane's centre line within this, and along it within that.
LATERAL_M = 0.5
YAW_DEG = 5.0
HEIGHT_M = 0.5
# A route is looked at this often, and may leave the lane's own length by this share and distance.
_STEP_M = 5.0
_REACH_M = 1.0


def is_installed() -> bool:
    """The package ``carla`` is there."""
    return importlib.util.find_spec("carla") is not None


def check_against_map(config: CarlaConfig, xodr: str) -> list[str]:
    """What of a configuration isn't where CARLA's map has a place for it; empty: all is.

    A participant that drives starts on the centre of a driving lane, along it, and its route is
    connected. One that stands or walks has ground below it, and a pedestrian waits on no driving
    lane. Heights agree.

    Raises:
        ModuleNotFoundError: ``carla`` isn't installed.
    """
    carla = importlib.import_module("carla")
    chart = carla.Map(config.map.name, xodr)
    problems: list[str] = []
    for actor in config.actors:
        if actor.drive is None:
            problems += _stands(carla, chart, actor)
        else:
            problems += _starts(carla, chart, actor)
            problems += _is_connected(carla, chart, actor.id, actor.drive)
    for trigger in config.triggers:
        if isinstance(trigger.act, Walk):
            for end in (trigger.act.drive.route[0], trigger.act.drive.route[-1]):
                if _ground(carla, chart, end) is None:
                    problems.append(f"{trigger.actor} walks from or to {_text(end)}, off the map")
    return problems


def _text(place: Location) -> str:
    return f"({place.x:.1f}, {place.y:.1f})"


def _under(carla: Any, chart: Any, place: Location, lane_type: Any) -> Any:
    """The waypoint of the lane that a place lies in, or None."""
    return chart.get_waypoint(
        carla.Location(x=place.x, y=place.y, z=place.z),
        project_to_road=False,
        lane_type=lane_type,
    )


def _ground(carla: Any, chart: Any, place: Location) -> Any:
    """The waypoint of the strip of any kind that a place lies in, or None.

    CARLA makes ground of strips of type ``none`` too, but finds them only as neighbours.
    """
    found = _under(carla, chart, place, carla.LaneType.Any)
    if found is not None:
        return found
    nearest = chart.get_waypoint(
        carla.Location(x=place.x, y=place.y, z=place.z),
        project_to_road=True,
        lane_type=carla.LaneType.Any,
    )
    for beside in (nearest.get_left_lane(), nearest.get_right_lane()):
        if beside is not None and _off_m(beside, place) <= beside.lane_width / 2:
            return beside
    return None


def _off_m(waypoint: Any, place: Location) -> float:
    found = waypoint.transform.location
    return math.hypot(found.x - place.x, found.y - place.y)


def _stands(carla: Any, chart: Any, actor: Actor) -> list[str]:
    place = actor.reference.location
    waypoint = _ground(carla, chart, place)
    if waypoint is None:
        return [f"{actor.id} stands at {_text(place)}, where the map has no lane of any kind"]
    if actor.object_class == "pedestrian" and waypoint.lane_type == carla.LaneType.Driving:
        return [f"{actor.id} waits at {_text(place)}, on driving lane {waypoint.lane_id}"]
    return _height(waypoint, actor)


def _height(waypoint: Any, actor: Actor) -> list[str]:
    ground, place = waypoint.transform.location.z, actor.reference.location
    if abs(ground - place.z) <= HEIGHT_M:
        return []
    return [f"{actor.id} stands at a height of {place.z:g} m, where the ground is {ground:.2f} m"]


def _starts(carla: Any, chart: Any, actor: Actor) -> list[str]:
    place = actor.reference.location
    waypoint = _under(carla, chart, place, carla.LaneType.Driving)
    if waypoint is None:
        return [f"{actor.id} starts at {_text(place)}, which is on no driving lane"]
    problems = _height(waypoint, actor)
    off = _off_m(waypoint, place)
    if off > LATERAL_M:
        problems.append(f"{actor.id} starts {off:.2f} m beside its lane's centre")
    turn = math.remainder(waypoint.transform.rotation.yaw - actor.reference.rotation.yaw, 360.0)
    if abs(turn) > YAW_DEG:
        problems.append(f"{actor.id} starts {abs(turn):.1f} deg off its lane's direction")
    return problems


def _every(route: Sequence[Location]) -> Iterator[Location]:
    """A route's points, and more between those that are far from each other."""
    yield route[0]
    for a, b in itertools.pairwise(route):
        parts = max(1, math.ceil(math.hypot(b.x - a.x, b.y - a.y) / _STEP_M))
        for i in range(1, parts + 1):
            share = i / parts
            yield Location(
                x=a.x + share * (b.x - a.x),
                y=a.y + share * (b.y - a.y),
                z=a.z + share * (b.z - a.z),
            )


def _is_connected(carla: Any, chart: Any, name: str, drive: Drive) -> list[str]:
    """Each point of the route is on a driving lane, and is reached from the one before."""
    before: Any = None
    last: Location | None = None
    for place in _every(drive.route):
        here = _under(carla, chart, place, carla.LaneType.Driving)
        if here is None:
            return [f"the route of {name} leaves the driving lanes at {_text(place)}"]
        if _off_m(here, place) > LATERAL_M:
            return [f"the route of {name} leaves its lane's centre at {_text(place)}"]
        if before is not None and last is not None:
            ahead = math.hypot(place.x - last.x, place.y - last.y)
            reached = min(
                (_off_m(w, place) for w in before.next(max(ahead, 0.01))), default=math.inf
            )
            if reached > _REACH_M:
                return [f"the route of {name} isn't connected at {_text(place)}"]
        before, last = here, place
    return []
