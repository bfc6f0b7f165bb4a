"""The run file ``ssp.run/1``: one resolved run, which every node of a session reads.

It is written by ``ssp run`` from a scenario and a site, is recorded as an attachment of the bag,
and holds everything in frame map and SI units. People read it; they write scenarios and sites.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from ssp_core.files import load_model
from ssp_core.geometry import Pose2
from ssp_core.state import DEFAULT_SIZES, Size
from ssp_core.vocab import ObjectClass

RUN_SCHEMA: Literal["ssp.run/1"] = "ssp.run/1"


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be a finite number")
    return value


Finite = Annotated[float, AfterValidator(_finite)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_finite)]
NonNegative = Annotated[float, Field(ge=0), AfterValidator(_finite)]
Point = tuple[Finite, Finite]
Path2 = Annotated[list[Point], Field(min_length=2)]
ObjectWord = Literal["car", "truck", "bus", "motorcycle", "cyclist", "pedestrian"]
ObjectId = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


class Strict(BaseModel):
    """Base of all file models: unknown keys are errors, values can't be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Start(Strict):
    """Initial pose of the reference point, frame map."""

    x_m: Finite
    y_m: Finite
    yaw_rad: Finite

    @property
    def pose(self) -> Pose2:
        return Pose2(self.x_m, self.y_m, self.yaw_rad)


class Lane(Strict):
    """One lane of the block, in the block's frame (x along the road, y to the left)."""

    y_m: Finite = Field(description="lateral position of the centre line")
    width_m: Positive
    direction: Literal["forward", "backward"]


class Road(Strict):
    """The block that the run takes place on: straight, with a rigid transform to map."""

    origin: Start
    length_m: Positive
    lanes: Annotated[list[Lane], Field(min_length=1)]
    sidewalk_left_m: NonNegative = 0.0
    sidewalk_right_m: NonNegative = 0.0
    crossing_x_m: Finite | None = Field(None, description="zebra crossing's centre, block frame")
    speed_limit_mps: Positive = 13.9

    @property
    def left_edge_m(self) -> float:
        """Lateral position of the carriageway's left edge, block frame."""
        return max(lane.y_m + lane.width_m / 2 for lane in self.lanes)

    @property
    def right_edge_m(self) -> float:
        """Lateral position of the carriageway's right edge, block frame."""
        return min(lane.y_m - lane.width_m / 2 for lane in self.lanes)


class Camera(Strict):
    """Forward camera: pinhole without distortion, mounted on the VUT."""

    width_px: Annotated[int, Field(ge=64, le=4096)] = 960
    height_px: Annotated[int, Field(ge=64, le=4096)] = 540
    hfov_deg: Annotated[float, Field(gt=10, lt=150)] = 75.0
    rate_hz: Annotated[float, Field(gt=0, le=60)] = 10.0
    forward_m: Finite = Field(1.8, description="ahead of the VUT's reference point")
    height_m: Positive = 1.45
    pitch_down_rad: Finite = 0.03
    jpeg_quality: Annotated[int, Field(ge=10, le=100)] = 90

    @property
    def focal_px(self) -> float:
        return self.width_px / 2 / math.tan(math.radians(self.hfov_deg) / 2)


class Look(Strict):
    """What the surroundings look like. Nothing here changes what happens."""

    palette: Literal["suburb", "proving_ground", "dusk_city"] = "suburb"
    fog_per_m: NonNegative = 0.002
    sun_azimuth_deg: Finite = 50.0
    sun_elevation_deg: Annotated[float, Field(gt=5, le=90)] = 40.0
    exposure: Positive = 1.0
    noise_sigma: NonNegative = 1.5


class Driver(Strict):
    """The VUT's built-in driver: speed profile, and what it does when something is in its way."""

    cruise_mps: Positive
    acceleration_mps2: Positive = 2.0
    comfortable_deceleration_mps2: Positive = 2.5
    headway_s: Positive = 1.4
    standstill_gap_m: Positive = 3.0
    reacts: bool = True


class Motion(Strict):
    """Along a path: from standstill to cruise_mps, held, and to a standstill at its end."""

    path: Path2
    cruise_mps: Positive
    acceleration_mps2: Positive = 2.0
    deceleration_mps2: Positive = 2.0


class LaneChange(Strict):
    """From the tracked path sideways while driving on, then parallel to it."""

    kind: Literal["lane_change"]
    lateral_shift_m: Finite = Field(description="+ is left")
    duration_s: Positive
    cruise_mps: Positive
    deceleration_mps2: Positive = 2.0


class FollowPath(Strict):
    """Along a path of its own that starts where the object stands."""

    kind: Literal["follow_path"]
    motion: Motion


Manoeuvre = Annotated[LaneChange | FollowPath, Field(discriminator="kind")]


class ParticipantSpec(Strict):
    """VUT or OT: what it is, where it starts, and what it is to do before the trigger."""

    id: ObjectId
    object_class: ObjectWord
    start: Start
    approach: Motion | None = None

    @property
    def cls(self) -> ObjectClass:
        return ObjectClass.from_word(self.object_class)

    @property
    def size(self) -> Size:
        return DEFAULT_SIZES[self.cls]


class RelativeDistance(Strict):
    """Bumper gap along the VUT's path from the VUT to an object ahead of it."""

    type: Literal["relative_distance"]
    object_id: ObjectId
    below_m: Positive


class TimeToArrival(Strict):
    """Time until the VUT's front reaches an anchor, at its present speed."""

    type: Literal["time_to_arrival"]
    anchor: Point
    below_s: Positive


Condition = Annotated[RelativeDistance | TimeToArrival, Field(discriminator="type")]


class TriggerSpec(Strict):
    """Fires once, at the instant from which the condition has held for held_for_s."""

    id: str
    condition: Condition
    held_for_s: NonNegative = 0.0
    not_before_s: NonNegative = Field(0.0, description="session time")
    object_id: ObjectId = Field(description="the OT that gets the manoeuvre")
    manoeuvre: Manoeuvre
    lead_time_s: NonNegative = Field(0.1, description="execute_at minus dispatch")


class Limits(Strict):
    """Limits of the site; passing one is a safety event."""

    speed_mps: Positive
    acceleration_mps2: Positive
    stop_deceleration_mps2: Positive = 4.0
    separation_m: NonNegative = 0.5
    state_age_s: Positive = 0.3
    heartbeat_s: Positive = 0.5
    ack_s: Positive = 0.5
    error_longitudinal_m: Positive = 2.0
    error_lateral_m: Positive = 0.8
    error_yaw_rad: Positive = 0.35
    duration_s: Positive = 60.0


class ConflictThresholds(Strict):
    """METHOD 1: conflict starts when TTC or the predicted arrival gap is under these."""

    ttc_s: Positive = 2.5
    arrival_gap_s: Positive = 1.5


class LinkDisturbance(Strict):
    """Seeded disturbance of one run's links and sensors; zero is off."""

    state_delay_s: NonNegative = 0.0
    state_loss: Annotated[float, Field(ge=0, lt=1)] = 0.0
    position_noise_m: NonNegative = 0.0
    speed_noise_mps: NonNegative = 0.0
    actuator_lag_scale: Positive = 1.0


class TrafficSpec(Strict):
    """A vehicle that SUMO drives."""

    id: ObjectId
    object_class: ObjectWord
    lane: Annotated[int, Field(ge=0)] = Field(description="index into road.lanes")
    x_m: Finite = Field(description="front bumper at the start, block frame")
    speed_mps: NonNegative


class EndCondition(Strict):
    """The run is complete after the event was resolved, or has nothing left to wait for."""

    after_resolution_s: NonNegative = 1.5
    at_latest_s: Positive = 40.0


class RunSpec(Strict):
    """One resolved run; see the module's docstring."""

    schema_: Literal["ssp.run/1"] = Field(RUN_SCHEMA, alias="schema")
    run_id: str
    scenario: str
    interaction: Literal["cut_in", "vru_crossing"]
    domain: Literal["synthetic", "simulation", "physical"]
    stand_in: bool = Field(description="true: a software stand-in for a physical session")
    event_version: str
    site: str
    site_version: str
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    mode: Literal["lockstep", "realtime"]
    step_s: Annotated[float, Field(ge=0.005, le=0.1)] = 0.02
    road: Road
    geofence: Annotated[list[Point], Field(min_length=3)]
    vut: ParticipantSpec
    driver: Driver
    targets: Annotated[list[ParticipantSpec], Field(min_length=1)]
    triggers: Annotated[list[TriggerSpec], Field(min_length=1)]
    thresholds: ConflictThresholds = ConflictThresholds()
    limits: Limits
    disturbance: LinkDisturbance = LinkDisturbance()
    traffic: list[TrafficSpec] = []
    camera: Camera | None = Field(Camera(), description="null: nothing is rendered")
    look: Look = Look()
    end: EndCondition = EndCondition()

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


def load_run(path: str | Path) -> RunSpec:
    """Reads a run file.

    Raises:
        InputError: it can't be read or is not a valid run file.
    """
    return load_model(RunSpec, path)
