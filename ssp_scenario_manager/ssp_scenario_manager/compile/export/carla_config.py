"""``ssp.carla/1``: what a CARLA client needs to stage a task, as plain data.

CARLA's frame is left-handed: x as ours, y to the south, yaw clockwise in degrees. Everything in
this file is in it, in metres, seconds and degrees.
"""

from __future__ import annotations

from typing import Annotated, Literal

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
