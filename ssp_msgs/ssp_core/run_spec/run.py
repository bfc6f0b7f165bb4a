"""The run file itself, and how it is read."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import (
    ConfigDict,
    Field,
    model_validator,
)

from ssp_core.files import load_model
from ssp_core.run_spec.faults import LIVE_FAULTS, Fault, LinkDisturbance
from ssp_core.run_spec.limits import ConflictThresholds, Limits, WantedPassing
from ssp_core.run_spec.participants import Driver, ParticipantSpec, TrafficSpec
from ssp_core.run_spec.picture import Camera, Look
from ssp_core.run_spec.road import Road
from ssp_core.run_spec.triggers import TriggerSpec
from ssp_core.run_spec.values import NonNegative, ObjectId, Point, Positive, Strict
from ssp_core.vocab import DomainWord

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
    observable: Literal["lateral", "braking"] = Field(
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
    step_s: Annotated[float, Field(ge=0.005, le=0.1)] = 0.02
    road: Road
    geofence: Annotated[list[Point], Field(min_length=3)]
    vut: ParticipantSpec
    driver: Driver
    targets: Annotated[list[ParticipantSpec], Field(min_length=1)]
    triggers: Annotated[list[TriggerSpec], Field(min_length=1)]
    thresholds: ConflictThresholds = ConflictThresholds()
    passing: WantedPassing | None = Field(
        None, description="what K* says of it; null: made by hand, nobody judges the passing"
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
