"""The run file ``ssp.run/1``: one resolved run, which every node of a session reads.

It is written by ``ssp run`` from a scenario and a site, is recorded as an attachment of the bag,
and holds everything in frame map and SI units. People read it; they write scenarios and sites.
"""

from ssp_core.run_spec.conditions import (
    AllOf,
    AnyOf,
    Condition,
    ElapsedTime,
    InRegion,
    Leaf,
    PhaseReached,
    RelativeDistance,
    SpeedIs,
    TimeHeadway,
    TimeToArrival,
    TimeToCollision,
)
from ssp_core.run_spec.faults import Fault, FaultKind, LinkDisturbance
from ssp_core.run_spec.limits import ConflictThresholds, Limits, WantedPassing
from ssp_core.run_spec.participants import (
    Brake,
    Driver,
    FollowPath,
    LaneChange,
    Manoeuvre,
    Motion,
    ParticipantSpec,
    SpeedChange,
    TrafficSpec,
)
from ssp_core.run_spec.picture import Camera, Look
from ssp_core.run_spec.road import CurvePiece, Lane, Road
from ssp_core.run_spec.run import EndCondition, RunSpec, load_run
from ssp_core.run_spec.scenery import (
    MOST_SCENERY,
    Building,
    Pole,
    Scenery,
    SceneryItem,
    Sign,
    Tree,
    without_empty_scenery,
)
from ssp_core.run_spec.triggers import Adaptation, TriggerSpec
from ssp_core.run_spec.values import (
    Finite,
    NonNegative,
    ObjectId,
    Path2,
    Point,
    Positive,
    Start,
    Strict,
)

__all__ = [
    "MOST_SCENERY",
    "Adaptation",
    "AllOf",
    "AnyOf",
    "Brake",
    "Building",
    "Camera",
    "Condition",
    "ConflictThresholds",
    "CurvePiece",
    "Driver",
    "ElapsedTime",
    "EndCondition",
    "Fault",
    "FaultKind",
    "Finite",
    "FollowPath",
    "InRegion",
    "Lane",
    "LaneChange",
    "Leaf",
    "Limits",
    "LinkDisturbance",
    "Look",
    "Manoeuvre",
    "Motion",
    "NonNegative",
    "ObjectId",
    "ParticipantSpec",
    "Path2",
    "PhaseReached",
    "Point",
    "Pole",
    "Positive",
    "RelativeDistance",
    "Road",
    "RunSpec",
    "Scenery",
    "SceneryItem",
    "Sign",
    "SpeedChange",
    "SpeedIs",
    "Start",
    "Strict",
    "TimeHeadway",
    "TimeToArrival",
    "TimeToCollision",
    "TrafficSpec",
    "Tree",
    "TriggerSpec",
    "WantedPassing",
    "load_run",
    "without_empty_scenery",
]
