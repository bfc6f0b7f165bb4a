"""The closed vocabularies of METHOD 5.1, and the words around them."""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from types import MappingProxyType
from typing import Literal, get_args

ObjectWord = Literal["car", "truck", "bus", "motorcycle", "cyclist", "pedestrian"]
PositionWord = Literal[
    "front", "front_left", "front_right", "left", "right", "rear", "rear_left", "rear_right"
]
MotionWord = Literal[
    "stationary",
    "same_direction",
    "oncoming",
    "cutting_in_from_left",
    "cutting_in_from_right",
    "cutting_out",
    "crossing_from_left",
    "crossing_from_right",
    "receding",
]
ConflictWord = Literal["no_conflict", "potential", "active", "resolved"]
LonWord = Literal["stop", "decelerate", "maintain", "accelerate"]
LatWord = Literal["left", "straight", "right"]
DomainWord = Literal["synthetic", "simulation", "physical"]
PhaseWord = Literal["approach", "trigger", "conflict", "resolution"]

OBJECTS: tuple[ObjectWord, ...] = get_args(ObjectWord)
POSITIONS: tuple[PositionWord, ...] = get_args(PositionWord)
MOTIONS: tuple[MotionWord, ...] = get_args(MotionWord)
CONFLICTS: tuple[ConflictWord, ...] = get_args(ConflictWord)
LON_ACTIONS: tuple[LonWord, ...] = get_args(LonWord)
LAT_ACTIONS: tuple[LatWord, ...] = get_args(LatWord)
DOMAINS: tuple[DomainWord, ...] = get_args(DomainWord)
PHASES: tuple[PhaseWord, ...] = get_args(PhaseWord)

# How papers shorten the names of domains.
_SHORT_DOMAINS: Mapping[str, DomainWord] = MappingProxyType(
    {"syn": "synthetic", "sim": "simulation", "phy": "physical"}
)
DOMAINS_READ = f"{', '.join(DOMAINS)} (or Syn, Sim, Phy)"


def read_domain(text: str) -> DomainWord | None:
    """Return the domain that a person named, by its word or by Syn, Sim or Phy; None for another.

    Case doesn't matter.
    """
    plain = text.casefold()
    return next((word for word in DOMAINS if word == plain), _SHORT_DOMAINS.get(plain))


class ObjectClass(IntEnum):
    """Object classes by the numbers of ObjectState.msg."""

    UNKNOWN = 0
    CAR = 1
    TRUCK = 2
    BUS = 3
    MOTORCYCLE = 4
    CYCLIST = 5
    PEDESTRIAN = 6

    @property
    def word(self) -> str:
        """The word of METHOD 5.1, ``unknown`` for UNKNOWN."""
        return self.name.lower()

    @classmethod
    def from_word(cls, word: str) -> ObjectClass:
        """Return the class of a word; raise KeyError for one outside the vocabulary."""
        return cls[word.upper()]


class Role(IntEnum):
    """Roles by the numbers of ObjectState.msg."""

    UNKNOWN = 0
    VUT = 1
    OT = 2
    TRAFFIC = 3


class Phase(IntEnum):
    """Phases by the numbers of PhaseEvent.msg."""

    UNKNOWN = 0
    APPROACH = 1
    TRIGGER = 2
    CONFLICT = 3
    RESOLUTION = 4

    @property
    def is_provisional(self) -> bool:
        """Announced live, the rest of the recording may take it back.

        A resolution is one for good (METHOD 1, 4.1), which a session can only wait for.
        """
        return self is Phase.RESOLUTION


class ControlState(IntEnum):
    """Object states with the names and numbers of ISO 22133."""

    OFF = 0
    INIT = 1
    ARMED = 2
    DISARMED = 3
    RUNNING = 4
    POSTRUN = 5
    REMOTE_CONTROLLED = 6
    ABORTING = 7
    PRE_ARMING = 8
    PRE_RUNNING = 9


class SessionPhase(IntEnum):
    """Session states by the numbers of SessionState.msg."""

    UNKNOWN = 0
    IDLE = 1
    LOADED = 2
    CONNECTED = 3
    ARMED = 4
    RUNNING = 5
    STOPPING = 6
    FINISHED = 7
    ABORTING = 8
    ABORTED = 9


class Verdict(IntEnum):
    """Verdicts of a run by the numbers of SessionState.msg."""

    NONE = 0
    VALID = 1
    INVALID_HARNESS = 2
    FAILED_SAFETY = 3
    ABORTED = 4
    OFF_SPEC = 5
