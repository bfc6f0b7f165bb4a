"""Limits of a session as the manager judges them: what was passed, and what it makes of a run.

Limits are inclusive: a value equal to its limit is still allowed (METHOD 6.11). The predicates that
objects judge by too stand in ssp_core.safety.limits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from ssp_core import names
from ssp_core.clock import ns_to_seconds
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.safety import limits as judge
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.safety.fence import box_excess_m
from ssp_core.safety.limits import LimitViolation
from ssp_core.safety.liveness import SILENCES
from ssp_core.vocabulary import Verdict
from ssp_core.world.plant import LimitFact

# A manager whose own timer comes so late blames nobody for that time.
LATE_S = 0.5
# Events of other nodes are under way for less.
REPORT_AGE_S = 2.0
_C = SafetyCode
# What a run becomes whose first reason is this; whatever isn't here failed on safety.
_VERDICTS = {
    **dict.fromkeys(
        (
            _C.OPERATOR,
            _C.OBJECT_SILENT,
            _C.VUT_SILENT,
            _C.HEARTBEAT_LOST,
            _C.ACK_MISSING,
            _C.REFERENCE_REFUSED,
            _C.STATE_STALE,
            _C.REPLY_MISSING,
            _C.CLOCK_OFFSET,
            _C.LINK_DELAY,
            _C.CONNECTION_LOST,
        ),
        Verdict.ABORTED,
    ),
    **dict.fromkeys(
        (_C.RECORDER, _C.WORLD_SILENT, _C.PARTICIPANT_LOST, _C.OVERRUN, _C.FOREIGN_MANAGER),
        Verdict.INVALID_HARNESS,
    ),
    _C.EVENT_MISSING: Verdict.OFF_SPEC,
}
# An object may stop for reasons of its own; our lateness is blamed only if it exceeded the limit.
_OF_OBJECTS = {_C.OBJECT_ABORTED, _C.HEARTBEAT_LOST}
# What also seems passed to a manager that stood still itself.
_OF_TIME = _OF_OBJECTS | {
    _C.WORLD_SILENT,
    _C.VUT_SILENT,
    _C.OBJECT_SILENT,
    _C.REPLY_MISSING,
    _C.ACK_MISSING,
    _C.CLOCK_OFFSET,
    _C.LINK_DELAY,
    _C.PARTICIPANT_LOST,
}


def verdict_for(code: SafetyCode) -> Verdict:
    """Return the verdict of a run whose first reason has this code."""
    return _VERDICTS.get(code, Verdict.FAILED_SAFETY)


@dataclass(frozen=True, slots=True)
class Violation:
    """A limit that was passed: what, whose, how far, and when.

    ``by_us``: our own side brought it about, whatever the code says by itself. ``words`` say what
    happened, where the numbers alone don't.
    """

    code: SafetyCode
    object_id: str
    measured: float
    limit: float
    stamp_ns: int
    detail: str = ""
    by_us: bool = False
    words: str = ""

    @property
    def verdict(self) -> Verdict:
        """Return the verdict of a run whose first reason this is."""
        return Verdict.INVALID_HARNESS if self.by_us else verdict_for(self.code)

    @property
    def text(self) -> str:
        """The reason as it stands in verdicts and reports."""
        meaning = MEANINGS[self.code]
        who = f" {self.object_id}:" if self.object_id else ""
        unit = f" {meaning.unit}" if meaning.unit else ""
        measured = f"{self.measured:.3g}{unit}"
        if self.code in SILENCES and self.measured == math.inf:
            measured = "never heard"
        figures = self.words or f"{measured}, limit {self.limit:.3g}{unit}"
        detail = f" ({self.detail})" if self.detail else ""
        return f"{meaning.limit_name}:{who} {figures}{detail}"

    def announcement(self, node: str) -> LimitFact:
        """Return what a node announces of it."""
        return LimitFact(
            self.code, node, self.object_id, self.measured, self.limit, self.stamp_ns, self.words
        )


def of_object(
    passed: LimitViolation | None, object_id: str, stamp_ns: int, detail: str = ""
) -> Violation | None:
    """Return a shared predicate's answer as this session's violation."""
    if passed is None:
        return None
    return Violation(
        passed.code, object_id, passed.measured, passed.limit, stamp_ns, detail, words=passed.words
    )


def silent(
    code: SafetyCode, who: str, age_s: float, limit_s: float, stamp_ns: int
) -> Violation | None:
    """Find a silence longer than allowed; an age that is no number is too long."""
    return None if age_s <= limit_s else Violation(code, who, age_s, limit_s, stamp_ns)


def too_many(code: SafetyCode, count: int, stamp_ns: int, detail: str) -> Violation | None:
    """Find a count above 0 of what may not be there at all."""
    return None if count <= 0 else Violation(code, "", float(count), 0.0, stamp_ns, detail)


def stamp_ahead(
    state: ObjectState, now_ns: int, allowance_s: float, limits: Limits
) -> Violation | None:
    """Find a stamp in the future: the clock that made it is ahead of the session's.

    Args:
        state: of any participant.
        now_ns: session time.
        allowance_s: how far session time itself may lag behind, > 0 where it is only taken from
            messages.
        limits: the run's.
    """
    if state.stamp_ns <= now_ns:
        return None
    passed = judge.stamp_ahead(ns_to_seconds(now_ns - state.stamp_ns), limits, allowance_s)
    return of_object(passed, state.object_id, now_ns, "its states are stamped ahead of time")


# -- of the states of one instant ------------------------------------------------------------------


def kept_apart(everyone: Sequence[ObjectState], spec: RunSpec) -> Sequence[ObjectState]:
    """Return those whose separation is a limit: in a driven run not the VUT (METHOD 8.2)."""
    if spec.driven is None:
        return everyone
    return [state for state in everyone if state.object_id != spec.vut.id]


def too_near(everyone: Sequence[ObjectState], limits: Limits) -> list[Violation]:
    """List pairs whose boxes are closer than the separation limit, or touch.

    Args:
        everyone: finite states at one stamp.
        limits: the run's.
    """
    findings = []
    for i, k in judge.near_pairs(everyone, limits.separation_m):
        a, b = everyone[i], everyone[k]
        both = f"{a.object_id} and {b.object_id}"
        findings.append(of_object(judge.separation(a, b, limits), b.object_id, a.stamp_ns, both))
    return [violation for violation in findings if violation is not None]


def _never(_: ObjectState) -> bool:
    return False


def violations(
    everyone: Sequence[ObjectState],
    spec: RunSpec,
    is_well_inside: Callable[[ObjectState], bool] = _never,
) -> list[Violation]:
    """List all limits that the states of one instant pass, the gravest first.

    Args:
        everyone: states at one stamp, that of the VUT first where there is one.
        spec: gives limits and fence.
        is_well_inside: tells whether a finite state is known to be inside the fence.
    """
    limits = spec.limits
    sound = [state for state in everyone if state.is_finite]
    findings: list[Violation | None] = []
    if len(sound) < len(everyone):
        findings += [
            of_object(judge.state_not_finite(s), s.object_id, s.stamp_ns) for s in everyone
        ]
    findings += too_near(kept_apart(sound, spec), limits)
    for state in sound:
        excess_m = 0.0 if is_well_inside(state) else box_excess_m(state.box, spec.geofence)
        passed = [
            judge.over_speed(state, limits),
            judge.outside_geofence(excess_m),
            *judge.statement_violations(state, limits),
        ]
        findings += [
            of_object(one, state.object_id, state.stamp_ns) for one in passed if one is not None
        ]
    real = [violation for violation in findings if violation is not None]
    return sorted(real, key=lambda v: v.code != SafetyCode.COLLISION)


# -- of reports ------------------------------------------------------------------------------------


def own_lateness(violation: Violation, late_s: float, heartbeat_s: float) -> Violation:
    """Name the manager's own lateness as the reason of what was found while it stood still.

    A participant that wasn't looked at for a while seems silent, slow or off in time, and an object
    that didn't hear the manager stops by itself.

    Args:
        violation: found by the manager, or seen by another node.
        late_s: how late the manager was of late, on the steady clock; 0 for not.
        heartbeat_s: for how long objects go without hearing the manager.
    """
    # A recorder that lost messages is one without a name; a silent one has its node's.
    silent_recorder = violation.code is SafetyCode.RECORDER and bool(violation.object_id)
    limit_s = max(LATE_S, heartbeat_s) if violation.code in _OF_OBJECTS else LATE_S
    if not (violation.code in _OF_TIME or silent_recorder):
        return violation
    if (
        violation.code not in _OF_OBJECTS
        and abs(violation.measured) - late_s <= violation.limit < late_s
    ):
        # A limit shorter than the manager's own pause, which without it would have been kept.
        limit_s = min(limit_s, violation.limit)
    if late_s <= limit_s:
        return violation
    who = f" of {violation.object_id}" if violation.object_id else ""
    instead = f"instead of {MEANINGS[violation.code].limit_name}{who}"
    return Violation(
        SafetyCode.OVERRUN, names.SCENARIO_MANAGER, late_s, limit_s, violation.stamp_ns, instead
    )


def in_session_time(reported: Violation, now_ns: int) -> Violation:
    """Convert another node's report.

    With a stamp of another clock or run it counts as passed now.
    """
    off_s = ns_to_seconds(reported.stamp_ns - now_ns)
    if abs(off_s) <= REPORT_AGE_S:
        return reported
    detail = f"{reported.detail}, stamped {off_s:+.3g} s from the session's time"
    return replace(reported, stamp_ns=now_ns, detail=detail)
