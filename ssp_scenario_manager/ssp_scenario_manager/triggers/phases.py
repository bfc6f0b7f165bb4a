"""Phases of the event while it happens (METHOD 1): approach, trigger, conflict, resolution.

Online, "staying so" and "for good" can only be waited for. An event's stamp is the instant at which
the condition began; it is published once the condition has stayed for the confirmation time. An
audit recomputes the phases from the recorded states.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import Encounter, Observable, encounter, is_conflict, is_observable
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import ConflictThresholds
from ssp_core.vocabulary import Phase

TRIGGER_CONFIRMATION_S = 0.2
RESOLUTION_CONFIRMATION_S = 1.0


@dataclass(frozen=True, slots=True)
class PhaseStart:
    """A phase has begun: when, and what was measured then."""

    phase: Phase
    stamp_ns: int
    evidence: str


@dataclass(frozen=True, slots=True)
class PhaseWatch:
    """Present phase, and since when the condition of the next one has held.

    ``conflict`` is the first conflict after a trigger that is still being confirmed.
    """

    phase: Phase = Phase.APPROACH
    since_ns: int | None = None
    evidence: str = ""
    conflict: PhaseStart | None = None


def _text(meeting: Encounter, target: ObjectState, kind: Observable) -> str:
    if kind == "braking":
        seen = f"deceleration {-target.acceleration_mps2:.2f} m/s^2"
    else:
        seen = f"arrival gap {meeting.arrival_gap_s:.2f} s, lateral speed "
        seen += f"{meeting.towards_mps:.2f} m/s"
    return f"gap {meeting.gap_m:.1f} m, TTC {meeting.ttc_s:.2f} s, {seen}"


def next_phase(
    watch: PhaseWatch,
    vut: ObjectState,
    target: ObjectState,
    path: Polyline,
    thresholds: ConflictThresholds,
    kind: Observable = "lateral",
) -> tuple[PhaseWatch, PhaseStart | None]:
    """Takes the states of one instant into account.

    Args:
        watch: what is known so far.
        vut: state of the VUT.
        target: state of the object target that carries the event, same stamp.
        path: the VUT's path.
        thresholds: when a conflict begins.
        kind: what makes the target's manoeuvre observable.

    Returns:
        The new watch, and the phase that has been confirmed, if any.
    """
    if watch.phase is Phase.RESOLUTION:
        return watch, None
    if watch.phase is Phase.TRIGGER and watch.conflict is not None:
        return PhaseWatch(Phase.CONFLICT), watch.conflict
    meeting = encounter(vut, target, path)
    conflict = is_conflict(meeting, thresholds.ttc_s, thresholds.arrival_gap_s)
    if watch.phase is Phase.APPROACH:
        met, confirm_s, following = (
            is_observable(kind, meeting, target),
            TRIGGER_CONFIRMATION_S,
            Phase.TRIGGER,
        )
    elif watch.phase is Phase.TRIGGER:
        met, confirm_s, following = conflict, 0.0, Phase.CONFLICT
    else:
        met, confirm_s, following = not conflict, RESOLUTION_CONFIRMATION_S, Phase.RESOLUTION
    if not met:
        return PhaseWatch(watch.phase), None
    if watch.since_ns is None:
        watch = replace(watch, since_ns=vut.stamp_ns, evidence=_text(meeting, target, kind))
    elif watch.phase is Phase.APPROACH and conflict and watch.conflict is None:
        start = PhaseStart(Phase.CONFLICT, vut.stamp_ns, _text(meeting, target, kind))
        watch = replace(watch, conflict=start)
    since = watch.since_ns if watch.since_ns is not None else vut.stamp_ns
    if vut.stamp_ns - since < seconds_to_ns(confirm_s):
        return watch, None
    begun = PhaseStart(following, since, watch.evidence)
    return PhaseWatch(following, conflict=watch.conflict), begun
