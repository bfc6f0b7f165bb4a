"""The rules that an object target is judged by: the part of a run that concerns it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import ParticipantSpec


class Rules(Protocol):
    """The part of a run that a Target needs; every ``RunSpec`` has it."""

    @property
    def targets(self) -> Sequence[ParticipantSpec]: ...
    @property
    def limits(self) -> Limits: ...
    @property
    def geofence(self) -> Sequence[tuple[float, float]]: ...
    @property
    def step_s(self) -> float: ...
    @property
    def event_version(self) -> str: ...


@dataclass(frozen=True, slots=True)
class ObjectRules:
    """Rules of one object that is part of no run of ours.

    Args:
        geofence: polygon, m, frame map.
        step_s: how often the object judges its state.
        event_version: K* version of the run that it was prepared for; empty for none.
    """

    spec: ParticipantSpec
    limits: Limits
    geofence: tuple[tuple[float, float], ...]
    step_s: float
    event_version: str = ""

    @property
    def targets(self) -> Sequence[ParticipantSpec]:
        return (self.spec,)
