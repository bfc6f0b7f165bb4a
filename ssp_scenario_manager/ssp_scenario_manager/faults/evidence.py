"""What a run left behind, as far as a judgement of a fault needs it."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState, Phase, SessionPhase
from ssp_scenario_manager.faults.motion import Track


@dataclass(frozen=True, slots=True)
class SafetyNote:
    """A safety event: when, which limit, who saw it, whose."""

    t_s: float
    limit_name: str
    source: str
    object_id: str


@dataclass(frozen=True, slots=True)
class FaultNote:
    """An injected fault that began or ended; wall time where the runner injected it."""

    t_s: float
    index: int
    active: bool
    wall_s: float | None = None


@dataclass(frozen=True, slots=True)
class Heard:
    """What the runner heard, with the wall's clock: a session state or a safety event."""

    kind: str
    name: str
    detail: str
    t_s: float
    wall_s: float


@dataclass(frozen=True, slots=True)
class Evidence:
    """One run, as far as a judgement of a fault needs it. Session times in s.

    Args:
        verdict: word of result.json.
        reasons: of it.
        truth: true states of VUT and OTs while the world ran, by id.
        own_states: (time, object, control state) whenever a target's published state changed it.
        session: (time, state) of each transition.
        phases: start of each phase of the event.
        triggers: when each trigger fired.
        safety: events in their order.
        faults: injected ones, in their order.
        last_heartbeat_s: of the manager; None without one.
        last_state_s: of each target, as published.
        lost: messages that the recorder says are lost.
        heard: by the runner.
        problems: what is wrong with what the run left.
        wall_s: how long the run took on the wall's clock.
        has_wall: False: the run took no time on the wall's clock that would mean anything.
    """

    spec: RunSpec
    verdict: str
    reasons: tuple[str, ...]
    truth: dict[str, Track]
    own_states: tuple[tuple[float, str, ControlState], ...] = ()
    session: tuple[tuple[float, SessionPhase], ...] = ()
    phases: tuple[tuple[float, Phase], ...] = ()
    triggers: tuple[float, ...] = ()
    safety: tuple[SafetyNote, ...] = ()
    faults: tuple[FaultNote, ...] = ()
    last_heartbeat_s: float | None = None
    last_state_s: dict[str, float] | None = None
    lost: int = 0
    heard: tuple[Heard, ...] = ()
    problems: tuple[str, ...] = ()
    wall_s: float = 0.0
    has_wall: bool = True

    def reached(self, state: SessionPhase) -> float | None:
        """When the session came to a state first; None when it didn't."""
        return next((t for t, s in self.session if s is state), None)

    def phase_at(self, phase: Phase) -> float | None:
        """When a phase of the event began; None when it didn't."""
        return next((t for t, p in self.phases if p is phase), None)
