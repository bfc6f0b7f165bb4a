"""The run file ``ssp.run/1``: one resolved run, which every node of a session reads.

Limits, camera and faults of the run stand here; its road and its participants have own files.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    ConfigDict,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from ssp_core.files.reading import load_model
from ssp_core.run_file.driven import COMMANDED, Driven
from ssp_core.run_file.participants import (
    Driver,
    ParticipantSpec,
    TrafficSpec,
    TriggerSpec,
    path_length_m,
)
from ssp_core.run_file.participation import participants
from ssp_core.run_file.road import Road
from ssp_core.run_file.values import (
    Finite,
    NonNegative,
    ObjectId,
    Outline,
    Pitch,
    Positive,
    Roll,
    SiteDatum,
    Strict,
    Yaw,
    without_defaults,
)
from ssp_core.vocabulary import DomainWord

_TOLERANCE_S = 1e-9


STOP_REACTION_S = 1.0
START_YAW_RAD = 0.35


# What a limit may be: beyond, it is a slip of the hand or switches the limit off.
LimitS = Annotated[Finite, Field(ge=0.001, le=60)]
LimitM = Annotated[Finite, Field(ge=0.01, le=100)]
LimitRad = Annotated[Finite, Field(ge=0.01, le=math.pi)]


class Limits(Strict):
    """Limits of the site, each within a plausible range; passing one is a safety event."""

    speed_mps: Annotated[Finite, Field(ge=0.1, le=100)] = Field(description="of everybody, fastest")
    acceleration_mps2: Annotated[Finite, Field(ge=0.1, le=100)] = Field(
        description="while a reference is driven, hardest"
    )
    stop_deceleration_mps2: Annotated[Finite, Field(ge=0.1, le=20)] = Field(
        4.0, description="of a safe stop"
    )
    separation_m: Annotated[Finite, Field(ge=0, le=100)] = Field(
        0.5, description="between any two bodies, least"
    )
    state_age_s: LimitS = Field(0.3, description="of a state when it is used")
    heartbeat_s: LimitS = Field(
        0.5, description="silence of the manager, after which an object stops by itself"
    )
    ack_s: LimitS = Field(0.5, description="until a reference is answered")
    error_longitudinal_m: Annotated[Finite, Field(ge=0.01, le=1000)] = Field(
        2.0, description="ahead of or behind the reference"
    )
    error_lateral_m: LimitM = Field(0.8, description="beside the reference")
    error_yaw_rad: LimitRad = Field(0.35, description="turned from the reference")
    duration_s: Annotated[Finite, Field(ge=0.1, le=86400)] = Field(60.0, description="of a run")
    position_std_m: LimitM = Field(0.5, description="localisation's own stated uncertainty")
    jump_m: LimitM = Field(1.0, description="between a position and where the last one led")
    frozen_s: LimitS = Field(0.3, description="a moving object whose position stands")
    clock_offset_s: LimitS = Field(0.05, description="of an object's clock")
    link_delay_s: LimitS = Field(0.5, description="there and back")
    start_region_m: LimitM = Field(1.5, description="from an object's start when it is armed")
    start_yaw_rad: LimitRad = Field(
        START_YAW_RAD, description="from an object's heading at its start when it is armed"
    )
    trigger_age_s: LimitS | None = Field(
        None,
        description="no trigger is judged on an older state of the VUT; null: two steps of the run",
    )
    stop_reaction_s: LimitS = Field(
        STOP_REACTION_S, description="from an abort until an object that drives becomes slower"
    )

    omnidirectional: list[ObjectId] = Field(
        [], description="objects that may move in any direction, whatever their heading"
    )
    heading_by_course: list[ObjectId] = Field(
        [], description="objects whose heading is the course over ground, unknown while they stand"
    )

    @model_serializer(mode="wrap")
    def _as_before_these(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_defaults(
            dump(self),
            start_yaw_rad=START_YAW_RAD,
            stop_reaction_s=STOP_REACTION_S,
            omnidirectional=[],
            heading_by_course=[],
        )


class ConflictThresholds(Strict):
    """METHOD 1: conflict starts when TTC or the predicted arrival gap is under these.

    An event whose K* gives no threshold for one of them is judged by the other alone.
    """

    ttc_s: Positive | None = 2.5
    arrival_gap_s: Positive | None = 1.5


class WantedPassing(Strict):
    """K*'s requirement on how VUT and initiator pass the conflict zone (METHOD 1, 4.4)."""

    first: Literal["initiator", "vut"] = Field(description="who arrives first")
    least_gap_s: Finite | None = Field(
        None, description="of second arrival minus first departure; null: any"
    )
    most_gap_s: Finite | None = Field(None, description="as least_gap_s")

    @model_validator(mode="after")
    def _is_a_range(self) -> WantedPassing:
        if self.bounds_s[0] > self.bounds_s[1]:
            raise ValueError("least_gap_s is above most_gap_s")
        return self

    @property
    def initiator_first(self) -> bool:
        return self.first == "initiator"

    @property
    def bounds_s(self) -> tuple[float, float]:
        """Least and largest time gap, infinite where it may be any."""
        return (
            -math.inf if self.least_gap_s is None else self.least_gap_s,
            math.inf if self.most_gap_s is None else self.most_gap_s,
        )

    def misses(
        self,
        initiator: str,
        initiator_first: bool | None,
        gap_s: float | None,
        *,
        vut_arrived: bool,
    ) -> list[str]:
        """List how a passing departs from K*, each with quantity, value and range.

        A gap is asked for only where K* bounds it; one that never came is a miss then too.

        Args:
            initiator: id of the object.
            initiator_first: it arrived before the VUT; None: it never arrived.
            gap_s: time gap at the conflict point; None: one of them never arrived or never left.
            vut_arrived: it reached the conflict zone.
        """
        names = (initiator, "the VUT")
        first, second = names if self.initiator_first else names[::-1]
        requirement = f"K* wants {first} before {second}"
        if initiator_first is None:
            return [f"passing order: {initiator} never came into the VUT's corridor, {requirement}"]
        if initiator_first is not self.initiator_first:
            return [f"passing order: {second} before {first}, {requirement}"]
        least, most = self.bounds_s
        if math.isinf(least) and math.isinf(most):
            return []
        requirement = f"K* wants {least:g} to {most:g} s"
        if gap_s is None:
            if vut_arrived:
                why, where = f"{first} never left the conflict zone", "beyond"
            else:
                why, where = "the VUT never reached the conflict zone", "up to"
            why += f" (more road {where} it, or a longer run, would do)"
            return [f"time gap at the conflict point: none, {why}; {requirement}"]
        if not least - _TOLERANCE_S <= gap_s <= most + _TOLERANCE_S:
            return [f"time gap at the conflict point: {gap_s:.3f} s, {requirement}"]
        return []


class Camera(Strict):
    """Forward camera: pinhole without distortion, mounted on the VUT."""

    width_px: Annotated[int, Field(ge=64, le=4096)] = 960
    height_px: Annotated[int, Field(ge=64, le=4096)] = 540
    hfov_deg: Annotated[float, Field(gt=10, lt=150)] = 75.0
    rate_hz: Annotated[float, Field(gt=0, le=60)] = 10.0
    forward_m: Finite = Field(1.8, description="ahead of the VUT's reference point")
    left_m: Finite = Field(0.0, description="to the left of the VUT's middle")
    height_m: Positive = 1.45
    pitch_down_rad: Pitch = 0.03
    yaw_left_rad: Yaw = 0.0
    roll_right_rad: Roll = 0.0
    exposure_time_s: NonNegative = Field(0.0, description="motion blur; 0: none")
    renderer: Literal["raster", "carla"] = Field(
        "raster",
        description="raster: numba, the same pixels everywhere; carla: a server, which `ssp run "
        "--camera` names",
    )
    jpeg_quality: Annotated[int, Field(ge=10, le=100)] = 90

    @property
    def focal_px(self) -> float:
        return self.width_px / 2 / math.tan(math.radians(self.hfov_deg) / 2)


class Look(Strict):
    """The appearance of the surroundings. Nothing here changes what happens."""

    palette: Literal["suburb", "proving_ground", "dusk_city"] = "suburb"
    fog_per_m: NonNegative = 0.002
    rain: Annotated[float, Field(ge=0, le=1)] = Field(0.0, description="0 none, 1 a downpour")
    light: Literal["day", "dusk"] = "day"
    sun_azimuth_deg: Finite = 50.0
    sun_elevation_deg: Annotated[float, Field(gt=5, le=90)] = 40.0
    exposure: Positive = 1.0
    noise_sigma: NonNegative = 1.5


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


# Up to so many object targets have a state topic each.
SINGLE_STATE_TOPICS = 4
RUN_SCHEMA: Literal["ssp.run/1"] = "ssp.run/1"


class EndCondition(Strict):
    """The run is complete after the event was resolved, or has nothing left to wait for."""

    after_resolution_s: NonNegative = 1.5
    at_latest_s: Positive = 40.0


class RunSpec(Strict):
    """One resolved run, everything in frame map and SI units."""

    schema_: Literal["ssp.run/1"] = Field(RUN_SCHEMA, alias="schema")
    run_id: str
    scenario: str
    interaction: ObjectId
    observable: Literal["lateral", "braking", "closing"] = Field(
        "lateral", description="what makes the OT's manoeuvre observable: the trigger's start"
    )
    initiator: ObjectId | None = Field(
        None, description="the OT whose manoeuvre is the event; null: the first trigger's"
    )
    domain: DomainWord
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
    plant: Literal["bodies", "carla"] = Field(
        "bodies",
        description="what moves VUT and targets. bodies: ours; carla: the vehicle physics of a "
        "server, which `ssp run --plant` names, in lockstep only",
    )
    step_s: Annotated[float, Field(ge=0.005, le=0.1)] = 0.02
    road: Road
    geofence: Outline
    vut: ParticipantSpec
    driver: Driver
    targets: Annotated[list[ParticipantSpec], Field(min_length=1)]
    triggers: Annotated[list[TriggerSpec], Field(min_length=1)]
    thresholds: ConflictThresholds = ConflictThresholds()
    passing: WantedPassing | None = Field(
        None, description="what K* says of it; null: made by hand, and not judged"
    )
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
    datum: SiteDatum | None = Field(None, description="of frame map; null: unknown")
    session_token: Annotated[str, Field(pattern=r"^((live|sim)-[0-9a-z]{1,40})?$")] = Field(
        "", description="of the session that `ssp run` led with this file; empty: of none"
    )
    driven: Driven | None = Field(
        None, description="who drives the VUT of a driven session; null: the driver above"
    )
    declaring: tuple[
        Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]*(/[a-z][a-z0-9_]*)?$")], ...
    ] = Field((), description="participants of a live session that must declare their kind")

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @model_serializer(mode="wrap")
    def _without_what_nobody_gave(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_defaults(
            dump(self), plant="bodies", datum=None, session_token="", driven=None, declaring=()
        )

    @model_validator(mode="after")
    def _everybody_declares(self) -> RunSpec:
        participant_names = participants(
            [t.id for t in self.targets], has_camera=self.camera is not None
        )
        missing = [who for who in participant_names if who not in self.declaring]
        if self.declaring and missing:
            raise ValueError(f"declaring lacks {', '.join(missing)}, which must declare their kind")
        return self

    @model_validator(mode="after")
    def _carla_moves_simulated_bodies(self) -> RunSpec:
        if self.plant == "carla" and self.mode != "lockstep":
            raise ValueError(
                f"plant carla moves simulated bodies in lockstep only, and the mode is {self.mode}"
            )
        return self

    @model_validator(mode="after")
    def _nothing_depends_on_a_driven_vut(self) -> RunSpec:
        if self.driven is None:
            return self
        if self.mode != "lockstep" or self.plant != "bodies":
            raise ValueError("a driver leads the VUT in lockstep with our own bodies only")
        if self.traffic or any(t.adaptation is not None for t in self.triggers):
            raise ValueError("a driven run has no traffic and no adaptation (METHOD 8.2)")
        if self.driver.external or self.vut.approach is None:
            raise ValueError("a driven run needs a path for the VUT and its built-in driver")
        return self

    @model_validator(mode="after")
    def _the_vut_comes_to_where_it_gives_way(self) -> RunSpec:
        length_m = path_length_m(self.vut.approach.path) if self.vut.approach is not None else 0.0
        for place in self.driver.gives_way:
            if place.zone_m[1] > length_m:
                raise ValueError(
                    f"driver.gives_way: zone_m ends at {place.zone_m[1]:g} m and the VUT's path at "
                    f"{length_m:.1f} m"
                )
        return self

    @model_validator(mode="after")
    def _real_objects_are_left_alone(self) -> RunSpec:
        problem = self.live_problem
        if problem is not None:
            raise ValueError(problem)
        return self

    @property
    def has_driver_node(self) -> bool:
        """Tell whether another node drives the VUT of a session of several processes.

        The world itself leads a VUT that is commanded without plans.
        """
        is_asked = self.driven is not None and self.driven.driver not in COMMANDED
        return self.driver.external or is_asked

    @property
    def live_problem(self) -> str | None:
        """Name a disturbance, a fault or traffic that a live run must not have.

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
    def trigger_age_s(self) -> float:
        """Age of a VUT's state beyond which no trigger is judged; two steps where not given."""
        limit_s = self.limits.trigger_age_s
        return 2.0 * self.step_s if limit_s is None else limit_s

    @property
    def object_ids(self) -> list[str]:
        """Ids of the VUT and of the object targets."""
        return [self.vut.id, *(target.id for target in self.targets)]

    @property
    def initiator_id(self) -> str:
        """Id of the OT whose manoeuvre is the event."""
        return self.initiator or self.triggers[0].object_id

    @property
    def states_in_one(self) -> bool:
        """True: object targets send their states as one ObjectStates message per process."""
        return len(self.targets) > SINGLE_STATE_TOPICS

    def disturbance_of(self, object_id: str) -> LinkDisturbance:
        """Return the disturbance of one object's links, sensors and actuators."""
        return self.disturbances.get(object_id, self.disturbance)


def load_run(path: str | Path) -> RunSpec:
    """Read a run file.

    Raises:
        InputError: it can't be read or is not a valid run file.
    """
    return load_model(RunSpec, path)
