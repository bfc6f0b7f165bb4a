"""The run file ``ssp.run/1``: one resolved run, which every node of a session reads.

It is written by ``ssp run`` from a scenario and a site, is recorded as an attachment of the bag,
and holds everything in frame map and SI units. People read it; they write scenarios and sites.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from ssp_core.files import load_model
from ssp_core.geometry import Pose2
from ssp_core.state import DEFAULT_SIZES, Size
from ssp_core.vocab import ObjectClass

# Up to so many object targets have a state topic each.
SINGLE_STATE_TOPICS = 4
# On one road; more would be felt in every frame.
MOST_SCENERY = 1000
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
SceneryExtent = Annotated[float, Field(ge=0.5, le=300)]
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


class CurvePiece(Strict):
    """A piece of a reference line whose curvature changes linearly with arc length.

    Both curvatures 0: straight; equal: an arc; else a clothoid. + turns left.
    """

    length_m: Positive
    start_curvature_1pm: Finite = 0.0
    end_curvature_1pm: Finite = 0.0


def without_empty_scenery(dumped: dict[str, Any]) -> dict[str, Any]:
    """A dumped block; one without scenery reads, and hashes, as if there were no such field."""
    if not dumped.get("scenery", True):
        del dumped["scenery"]
    return dumped


class Building(Strict):
    """A building: a rectangle of walls on the ground.

    Its length lies along the road turned to the left by ``yaw_rad``.
    """

    type: Literal["building"]
    s_m: Finite = Field(description="of its middle")
    l_m: Finite = Field(description="of its middle, + left")
    yaw_rad: Finite = 0.0
    length_m: SceneryExtent
    width_m: SceneryExtent
    height_m: SceneryExtent


class Sign(Strict):
    """A traffic sign on a post."""

    type: Literal["sign"]
    s_m: Finite
    l_m: Finite = Field(description="+ left")
    kind: Literal["speed_limit", "crossing", "stop", "yield", "other"] = Field(
        description="other: a plain plate"
    )
    value: Annotated[int, Field(ge=1, le=999)] | None = Field(
        None, description="number printed on it: a speed limit's, in the place's own unit"
    )
    direction: Literal["forward", "backward"] = Field(
        "forward", description="of the traffic that it faces"
    )

    @model_validator(mode="after")
    def _has_its_number(self) -> Sign:
        if (self.value is not None) != (self.kind == "speed_limit"):
            raise ValueError("a sign has a value if it is a speed_limit, and no other has one")
        return self


class Tree(Strict):
    """A broad-leaved tree."""

    type: Literal["tree"]
    s_m: Finite
    l_m: Finite = Field(description="+ left")
    height_m: Annotated[float, Field(ge=1, le=60)] = 7.0


class Pole(Strict):
    """A bare post; with a lamp, a street lamp whose arm reaches towards the road."""

    type: Literal["pole"]
    s_m: Finite
    l_m: Finite = Field(description="+ left")
    height_m: Annotated[float, Field(ge=0.5, le=60)] = 7.5
    lamp: bool = False


SceneryItem = Annotated[Building | Sign | Tree | Pole, Field(discriminator="type")]
Scenery = Annotated[list[SceneryItem], Field(max_length=MOST_SCENERY)]


class Road(Strict):
    """The block that the run takes place on, with its transform to map (METHOD 2.4).

    The block's frame is (s, l): arc length along the reference line, which starts at the origin in
    its direction, and distance to its left. Without pieces the line is straight, and the transform
    is the rigid motion p = R p_local + t.
    """

    origin: Start
    length_m: Positive
    pieces: list[CurvePiece] = Field([], description="empty: straight; else they sum to length_m")
    lanes: Annotated[list[Lane], Field(min_length=1)]
    sidewalk_left_m: NonNegative = 0.0
    sidewalk_right_m: NonNegative = 0.0
    crossing_x_m: Finite | None = Field(None, description="zebra crossing's centre, block frame")
    speed_limit_mps: Positive = 13.9
    scenery: Scenery = Field([], description="what the map has beside the road, block frame")

    @model_serializer(mode="wrap")
    def _without_empty_scenery(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_empty_scenery(dump(self))

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
    left_m: Finite = Field(0.0, description="to the left of the VUT's middle")
    height_m: Positive = 1.45
    pitch_down_rad: Finite = 0.03
    yaw_left_rad: Finite = 0.0
    roll_right_rad: Finite = 0.0
    exposure_time_s: NonNegative = Field(0.0, description="motion blur; 0: none")
    renderer: Literal["raster", "gl"] = Field(
        "raster", description="raster: numba, the same pixels everywhere; gl: OpenGL through EGL"
    )
    jpeg_quality: Annotated[int, Field(ge=10, le=100)] = 90

    @property
    def focal_px(self) -> float:
        return self.width_px / 2 / math.tan(math.radians(self.hfov_deg) / 2)


class Look(Strict):
    """What the surroundings look like. Nothing here changes what happens."""

    palette: Literal["suburb", "proving_ground", "dusk_city"] = "suburb"
    fog_per_m: NonNegative = 0.002
    rain: Annotated[float, Field(ge=0, le=1)] = Field(0.0, description="0 none, 1 a downpour")
    light: Literal["day", "dusk"] = "day"
    sun_azimuth_deg: Finite = 50.0
    sun_elevation_deg: Annotated[float, Field(gt=5, le=90)] = 40.0
    exposure: Positive = 1.0
    noise_sigma: NonNegative = 1.5


class SpeedChange(Strict):
    """From this session time on the driver wants another speed."""

    at_s: NonNegative
    cruise_mps: NonNegative


class Driver(Strict):
    """The VUT's built-in driver: speed profile, and what it does when something is in its way."""

    cruise_mps: Positive
    acceleration_mps2: Positive = 2.0
    comfortable_deceleration_mps2: Positive = 2.5
    headway_s: Positive = 1.4
    standstill_gap_m: Positive = 3.0
    reacts: bool = True
    external: bool = Field(
        False, description="true: the VUT is driven by commands on vut/command, which may go silent"
    )
    aeb_deceleration_mps2: Positive | None = Field(
        None, description="emergency braking when nothing else avoids a collision; null: none"
    )
    later: list[SpeedChange] = Field([], description="changes of cruise speed while it drives")


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


class Brake(Strict):
    """Along the tracked path, to a lower speed at once."""

    kind: Literal["brake"]
    to_mps: NonNegative = Field(description="speed to end at; 0 is a standstill")
    deceleration_mps2: Positive


Manoeuvre = Annotated[LaneChange | FollowPath | Brake, Field(discriminator="kind")]


class ParticipantSpec(Strict):
    """VUT or OT: what it is, where it starts, and what it is to do before the trigger."""

    id: ObjectId
    object_class: ObjectWord
    start: Start
    approach: Motion | None = None
    tracker: Literal["lqr", "mpc"] = Field(
        "lqr", description="how an OT follows its references; mpc needs the package osqp"
    )

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


class TimeHeadway(Strict):
    """Bumper gap to an object ahead of the VUT over the VUT's speed."""

    type: Literal["time_headway"]
    object_id: ObjectId
    below_s: Positive


class TimeToCollision(Strict):
    """Bumper gap to an object over the closing speed along the VUT's path (METHOD 1)."""

    type: Literal["time_to_collision"]
    object_id: ObjectId
    below_s: Positive


class SpeedIs(Strict):
    """Speed of the VUT or an object."""

    type: Literal["speed"]
    object_id: ObjectId
    relation: Literal["above", "below"]
    value_mps: NonNegative


class InRegion(Strict):
    """The reference point of the VUT or an object lies in a polygon, frame map."""

    type: Literal["in_region"]
    object_id: ObjectId
    polygon: Annotated[list[Point], Field(min_length=3)]


class PhaseReached(Strict):
    """A phase of the event has begun."""

    type: Literal["phase_reached"]
    phase: Literal["trigger", "conflict", "resolution"]


class ElapsedTime(Strict):
    """Session time since the start of the run."""

    type: Literal["elapsed_time"]
    after_s: NonNegative


class AllOf(Strict):
    """Every one of these conditions holds."""

    type: Literal["all"]
    of: Annotated[list[Condition], Field(min_length=1)]


class AnyOf(Strict):
    """At least one of these conditions holds."""

    type: Literal["any"]
    of: Annotated[list[Condition], Field(min_length=1)]


Condition = Annotated[
    RelativeDistance
    | TimeToArrival
    | TimeHeadway
    | TimeToCollision
    | SpeedIs
    | InRegion
    | PhaseReached
    | ElapsedTime
    | AllOf
    | AnyOf,
    Field(discriminator="type"),
]
AllOf.model_rebuild()
AnyOf.model_rebuild()


class Adaptation(Strict):
    """After the trigger: keeps the time gap at the conflict point in spite of the VUT's speed.

    The manager sends the OT references for the same path with another speed profile, so that it
    meets the VUT as specified. It ends when the one that decides the gap is about to arrive, and
    when the VUT responds to the OT.
    """

    anchor: Point | None = Field(
        None,
        description="conflict point on the VUT's path, frame map; null: where the OT comes into "
        "the VUT's corridor",
    )
    first: Literal["initiator", "vut"] = Field(description="who arrives first")
    gap_s: Finite = Field(description="second arrival minus first departure (METHOD 1)")
    rate_hz: Annotated[float, Field(gt=0, le=20)] = 10.0
    lead_time_s: NonNegative = Field(0.1, description="execute_at minus dispatch")
    speed_share: tuple[Positive, Positive] = Field(
        (0.6, 1.4), description="slowest and fastest, as shares of the manoeuvre's own speed"
    )
    acceleration_mps2: Positive | None = Field(
        None, description="hardest acceleration; null: what the site allows"
    )
    deceleration_mps2: Positive | None = Field(
        None, description="hardest braking; null: what the site allows"
    )
    dead_band_s: NonNegative = Field(0.03, description="errors of the gap that are let be")
    freeze_s: NonNegative = Field(
        0.4, description="no more changes once what decides the gap is nearer than this"
    )
    response_mps2: Positive | None = Field(
        1.5,
        description="a VUT that brakes harder once the manoeuvre has begun responds to it; null: "
        "it never does",
    )


class TriggerSpec(Strict):
    """Fires once, at the instant from which the condition has held for held_for_s.

    ``edge`` as in OpenSCENARIO: none fires also when the condition holds from the first; rising
    needs it to become true, falling to become false.
    """

    id: str
    condition: Condition
    edge: Literal["none", "rising", "falling"] = "none"
    held_for_s: NonNegative = 0.0
    not_before_s: NonNegative = Field(0.0, description="session time")
    object_id: ObjectId = Field(description="the OT that gets the manoeuvre")
    manoeuvre: Manoeuvre
    lead_time_s: NonNegative = Field(0.1, description="execute_at minus dispatch")
    adaptation: Adaptation | None = None


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
    position_std_m: Positive = Field(0.5, description="localisation's own stated uncertainty")
    jump_m: Positive = Field(1.0, description="between a position and where the last one led")
    frozen_s: Positive = Field(0.3, description="a moving object whose position stands")
    clock_offset_s: Positive = 0.05
    link_delay_s: Positive = Field(0.5, description="there and back")
    start_region_m: Positive = Field(1.5, description="from an object's start when it is armed")
    trigger_age_s: Positive | None = Field(
        None, description="no trigger is judged on an older state of the VUT; null: two periods"
    )


class ConflictThresholds(Strict):
    """METHOD 1: conflict starts when TTC or the predicted arrival gap is under these.

    An event whose K* gives no threshold for one of them is judged by the other alone.
    """

    ttc_s: Positive | None = 2.5
    arrival_gap_s: Positive | None = 1.5


class LinkDisturbance(Strict):
    """Seeded disturbance of one object's links, sensors and actuators; zero is off.

    Up is from the object to the manager, down from the manager to the object; one way each.
    """

    state_delay_s: NonNegative = Field(0.0, description="up")
    state_jitter_s: NonNegative = Field(0.0, description="up, one sigma added to the delay")
    state_loss: Annotated[float, Field(ge=0, lt=1)] = Field(0.0, description="up")
    reorder: Annotated[float, Field(ge=0, lt=1)] = Field(
        0.0, description="up: share of states that are overtaken by the next one"
    )
    command_delay_s: NonNegative = Field(0.0, description="down")
    command_loss: Annotated[float, Field(ge=0, lt=1)] = Field(0.0, description="down")
    clock_offset_s: Finite = Field(0.0, description="the object's clock minus the manager's")
    position_noise_m: NonNegative = 0.0
    speed_noise_mps: NonNegative = 0.0
    dropout_per_s: NonNegative = Field(0.0, description="how often localisation fails")
    dropout_s: NonNegative = Field(0.2, description="for how long")
    actuator_lag_scale: Positive = 1.0


FaultKind = Literal[
    "kill",
    "pause",
    "disk_full",
    "operator_abort",
    "link_cut",
    "link_delay",
    "link_loss",
    "link_reorder",
    "clock_step",
    "position_jump",
    "state_nan",
    "state_frozen",
    "actuator_stuck",
    "vut_stop",
    "reference_stale",
    "reference_out_of_fence",
    "trigger_never",
]


class Fault(Strict):
    """A fault that is injected on purpose.

    ``kill``, ``pause`` and ``disk_full`` strike a node, by its name; the others an object by its
    id, the VUT included; ``operator_abort`` and ``trigger_never`` strike the session.
    """

    kind: FaultKind
    target: str = Field("", description="node or object; empty for the session")
    at_s: NonNegative | None = Field(None, description="session time; null: armed, before start")
    duration_s: Positive | None = Field(None, description="null: for good")
    value: Finite | None = Field(None, description="s, share, m or m/s^2, by kind")


# Faults of processes and of the operator: they touch no object's sensors, links or actuators.
LIVE_FAULTS: frozenset[FaultKind] = frozenset(
    {"kill", "pause", "disk_full", "operator_abort", "trigger_never"}
)


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
    interaction: ObjectId
    observable: Literal["lateral", "braking"] = Field(
        "lateral", description="what makes the OT's manoeuvre observable: the trigger's start"
    )
    initiator: ObjectId | None = Field(
        None, description="the OT whose manoeuvre is the event; null: the first trigger's"
    )
    domain: Literal["synthetic", "simulation", "physical"]
    stand_in: bool = Field(description="true: a software stand-in for a physical session")
    event_version: str
    task_version: str | None = Field(None, description="compiled task that this run was made from")
    compiler: str | None = Field(None, description="that compiled it; null: made by hand")
    site: str
    site_version: str
    seed: Annotated[int, Field(ge=0, lt=2**63)]
    mode: Literal["lockstep", "realtime", "live"] = Field(
        description="live: no simulated world; session time is the system clock's"
    )
    step_s: Annotated[float, Field(ge=0.005, le=0.1)] = 0.02
    road: Road
    geofence: Annotated[list[Point], Field(min_length=3)]
    vut: ParticipantSpec
    driver: Driver
    targets: Annotated[list[ParticipantSpec], Field(min_length=1)]
    triggers: Annotated[list[TriggerSpec], Field(min_length=1)]
    thresholds: ConflictThresholds = ConflictThresholds()
    limits: Limits
    disturbance: LinkDisturbance = Field(LinkDisturbance(), description="of everybody's")
    disturbances: dict[ObjectId, LinkDisturbance] = Field(
        {}, description="instead of it, for single objects; the VUT's id is vut"
    )
    faults: list[Fault] = Field([], description="injected on purpose")
    traffic: list[TrafficSpec] = []
    camera: Camera | None = Field(Camera(), description="null: nothing is rendered")
    look: Look = Look()
    end: EndCondition = EndCondition()

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @model_validator(mode="after")
    def _real_objects_are_left_alone(self) -> RunSpec:
        problem = self.live_problem
        if problem is not None:
            raise ValueError(problem)
        return self

    @property
    def live_problem(self) -> str | None:
        """What a live run must not hold: disturbances and faults would move real objects wrongly.

        None where there is nothing of it, and in a simulated run.
        """
        if self.mode != "live":
            return None
        disturbed = [self.disturbance, *self.disturbances.values()]
        if any(one != LinkDisturbance() for one in disturbed):
            return "a live run has no disturbance: real links and sensors have their own"
        for fault in self.faults:
            if fault.kind not in LIVE_FAULTS:
                return f"fault {fault.kind} is for simulated objects, and this run is live"
        if self.traffic:
            return "a live run has no simulated traffic"
        return None

    @property
    def initiator_id(self) -> str:
        """Id of the OT whose manoeuvre is the event."""
        return self.initiator or self.triggers[0].object_id

    @property
    def states_in_one(self) -> bool:
        """True: object targets send their states as one ObjectStates message per process."""
        return len(self.targets) > SINGLE_STATE_TOPICS

    def disturbance_of(self, object_id: str) -> LinkDisturbance:
        """The disturbance of one object's links, sensors and actuators."""
        return self.disturbances.get(object_id, self.disturbance)


def load_run(path: str | Path) -> RunSpec:
    """Reads a run file.

    Raises:
        InputError: it can't be read or is not a valid run file.
    """
    return load_model(RunSpec, path)
