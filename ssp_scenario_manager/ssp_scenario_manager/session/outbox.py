"""The facts that a session sends; the node turns them into messages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from ssp_core.motion.event import PhaseBegan
from ssp_core.motion.reference import Reference
from ssp_core.vocabulary import SessionPhase, Verdict
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.triggers.conditions import Sample


@dataclass(frozen=True, slots=True)
class StateChanged:
    """A transition of the session; one to the same state has no effect and tells something."""

    stamp_ns: int
    state: SessionPhase
    previous: SessionPhase
    event: str
    reason: str
    verdict: Verdict
    reasons: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class TriggerDecision:
    """Decision record of a trigger (TriggerEvent.msg, without the node's own latency)."""

    stamp_ns: int
    trigger_id: str
    condition: str
    threshold: float
    samples: tuple[Sample, ...]
    crossing_ns: int
    dispatched_ns: int
    object_ids: tuple[str, ...]
    reference_ids: tuple[str, ...]


class ObjectCommand(Enum):
    """The command for every object of the run, as ObjectCommand.srv has it."""

    ARM = 2
    DISARM = 3
    ALL_CLEAR = 7


@dataclass(frozen=True, slots=True)
class Note:
    """Something that people should know, and that changes nothing."""

    stamp_ns: int
    text: str


# A reference goes to its object; a violation is announced, and the session aborts.
Outgoing = (
    StateChanged | Reference | TriggerDecision | PhaseBegan | Violation | ObjectCommand | Note
)
