"""When a cell's fault strikes, from the times of an undisturbed run; session times, s."""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.errors import InputError
from ssp_core.run_file.model import Fault, RunSpec
from ssp_core.vocabulary import Phase, SessionPhase
from ssp_scenario_manager.faults.evidence import Evidence
from ssp_scenario_manager.faults.model import OT, Row, Stage

BEFORE_TRIGGER_S = 1.0
INTO_CONFLICT_S = 0.3
_MOVES_MPS = 0.1


@dataclass(frozen=True, slots=True)
class Nominal:
    """The undisturbed run.

    Args:
        trigger_s: dispatch of the manoeuvre.
        conflict_s: start of the conflict.
        end_s: the session begins to stop.
        moves: whether the initiator moves at each stage's instant; armed: with the start.
    """

    trigger_s: float
    conflict_s: float
    end_s: float
    moves: dict[Stage, bool]


def nominal_of(evidence: Evidence) -> Nominal:
    """Times of a run without faults.

    Raises:
        InputError: it wasn't valid, so that its times mean nothing.
    """
    conflict = evidence.phase_at(Phase.CONFLICT)
    end = evidence.reached(SessionPhase.STOPPING)
    if evidence.verdict != "valid" or not evidence.triggers or conflict is None or end is None:
        why = evidence.reasons[0] if evidence.reasons else "a phase is missing"
        raise InputError(
            f"is {evidence.verdict} without any fault: {why}",
            field="nominal run",
            remedy="`ssp run` the scenario until it is valid",
        )
    trigger = evidence.triggers[0]
    times = Nominal(trigger, conflict, end, {})
    track = evidence.truth[evidence.spec.initiator_id]
    step_s = evidence.spec.step_s
    target = next(t for t in evidence.spec.targets if t.id == evidence.spec.initiator_id)
    moves = {Stage.ARMED: target.approach is not None}
    for stage in (Stage.BEFORE, Stage.AFTER, Stage.CONFLICT):
        moves[stage] = track.speed_at(at_s(stage, times, step_s) or 0.0) > _MOVES_MPS
    return Nominal(trigger, conflict, end, moves)


def at_s(stage: Stage, nominal: Nominal, step_s: float) -> float | None:
    """Session time at which a fault of a stage strikes, on a step; None: armed."""
    if stage is Stage.ARMED:
        return None
    if stage is Stage.BEFORE:
        at = nominal.trigger_s - BEFORE_TRIGGER_S
    elif stage is Stage.AFTER:
        halfway = 0.5 * (nominal.trigger_s + nominal.conflict_s)
        at = max(halfway, nominal.trigger_s + step_s)
    else:
        at = min(nominal.conflict_s + INTO_CONFLICT_S, nominal.end_s - step_s)
    return round(max(at, step_s) / step_s) * step_s


def fault_of(row: Row, stage: Stage, nominal: Nominal, run: RunSpec) -> Fault:
    """The fault of one cell."""
    when = at_s(stage, nominal, run.step_s)
    return Fault(
        kind=row.kind,
        target=run.initiator_id if row.target == OT else row.target,
        at_s=None if when is None else round(when, 6),
        duration_s=row.duration_s,
        value=row.value,
    )
