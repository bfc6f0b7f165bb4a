"""Limits of a session as the manager judges them: one named predicate each, with what it measured.

A predicate returns None while its limit is kept. Limits are inclusive: a value equal to its limit
is still allowed (METHOD 6.11). What objects judge by too stands in ssp_core.safety.limits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from ssp_core import names
from ssp_core.clock import ns_to_seconds
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.safety import limits as judge
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.safety.limits import LimitViolation
from ssp_core.vocabulary import ControlState, Verdict

# A manager whose own timer comes so late blames nobody for that time.
LATE_S = 0.5
_OF_TIME = {
    SafetyCode.HEARTBEAT_LOST,
    SafetyCode.WORLD_SILENT,
    SafetyCode.VUT_SILENT,
    SafetyCode.OBJECT_SILENT,
    SafetyCode.OBJECT_ABORTED,
    SafetyCode.REPLY_MISSING,
    SafetyCode.ACK_MISSING,
    SafetyCode.CLOCK_OFFSET,
    SafetyCode.LINK_DELAY,
    SafetyCode.PARTICIPANT_LOST,
}
_OF_OBJECTS = {SafetyCode.OBJECT_ABORTED, SafetyCode.HEARTBEAT_LOST}
# Events of other nodes are under way for less.
REPORT_AGE_S = 2.0


@dataclass(frozen=True, slots=True)
class Violation:
    """A limit that was passed: what, whose, how far, and when.

    ``by_us``: our own side brought it about, whatever the code says by itself.
    """

    code: SafetyCode
    object_id: str
    measured: float
    limit: float
    stamp_ns: int
    detail: str = ""
    by_us: bool = False

    @property
    def verdict(self) -> Verdict:
        """Of a run whose first reason this is."""
        return Verdict.INVALID_HARNESS if self.by_us else verdict_for(self.code)

    @property
    def text(self) -> str:
        """The reason as it stands in verdicts and reports."""
        meaning = MEANINGS[self.code]
        who = f" {self.object_id}:" if self.object_id else ""
        unit = f" {meaning.unit}" if meaning.unit else ""
        figures = f"{self.measured:.3g}{unit}, limit {self.limit:.3g}{unit}"
        detail = f" ({self.detail})" if self.detail else ""
        return f"{meaning.limit_name}:{who} {figures}{detail}"


def of_object(
    passed: LimitViolation | None, object_id: str, stamp_ns: int, detail: str = ""
) -> Violation | None:
    """A shared predicate's answer as this session's violation."""
    if passed is None:
        return None
    return Violation(passed.code, object_id, passed.measured, passed.limit, stamp_ns, detail)


# -- of two objects -------------------------------------------------------------------------------


def too_near(a: ObjectState, b: ObjectState, limits: Limits) -> Violation | None:
    """The boxes of two objects are closer than the separation limit, or touch."""
    passed = judge.separation(a, b, limits)
    return of_object(passed, b.object_id, a.stamp_ns, f"{a.object_id} and {b.object_id}")


# -- of times -------------------------------------------------------------------------------------


def silent(
    code: SafetyCode, who: str, age_s: float, limit_s: float, stamp_ns: int
) -> Violation | None:
    """Nothing was heard for longer than allowed; an age that is no number is too long."""
    if age_s <= limit_s:
        return None
    return Violation(code, who, age_s, limit_s, stamp_ns)


def vut_silent(age_s: float, limits: Limits, stamp_ns: int) -> Violation | None:
    """The newest state of the VUT is too old, s on the session's clock."""
    return silent(SafetyCode.VUT_SILENT, "vut", age_s, limits.state_age_s, stamp_ns)


def object_silent(object_id: str, age_s: float, limits: Limits, stamp_ns: int) -> Violation | None:
    """The newest state of an object target is too old, s on the session's clock."""
    return silent(SafetyCode.OBJECT_SILENT, object_id, age_s, limits.state_age_s, stamp_ns)


def reply_missing(object_id: str, age_s: float, limits: Limits, stamp_ns: int) -> Violation | None:
    """An object target doesn't answer heartbeats any more, s on the steady clock."""
    return silent(SafetyCode.REPLY_MISSING, object_id, age_s, limits.heartbeat_s, stamp_ns)


def ack_missing(
    object_id: str, dispatched_ns: int, now_ns: int, limits: Limits
) -> Violation | None:
    """A reference was sent and not answered in time."""
    age_s = ns_to_seconds(now_ns - dispatched_ns)
    return silent(SafetyCode.ACK_MISSING, object_id, age_s, limits.ack_s, now_ns)


def duration(started_ns: int, now_ns: int, limits: Limits) -> Violation | None:
    """The run goes on for too long."""
    passed = judge.duration(ns_to_seconds(now_ns - started_ns), limits)
    return of_object(passed, "", now_ns)


def stamp_ahead(
    state: ObjectState, now_ns: int, allowance_s: float, limits: Limits
) -> Violation | None:
    """A state's stamp lies in the future: the clock that made it is ahead of the session's.

    Args:
        state: the newest state of an object.
        now_ns: session time.
        allowance_s: how far session time itself may lag behind, > 0 where it is only taken from
            messages.
        limits: of the site.
    """
    passed = judge.stamp_ahead(ns_to_seconds(now_ns - state.stamp_ns), limits, allowance_s)
    return of_object(passed, state.object_id, now_ns, "its states are stamped ahead of time")


# -- of reports -----------------------------------------------------------------------------------


def own_abort(state: ObjectState) -> Violation | None:
    """An object went to ABORTING on its own."""
    if state.control_state is not ControlState.ABORTING:
        return None
    return Violation(
        SafetyCode.OBJECT_ABORTED, state.object_id, 1.0, 0.0, state.stamp_ns, "local stop"
    )


def not_running(state: ObjectState) -> Violation:
    """An object that isn't RUNNING although the session is."""
    detail = f"it is {state.control_state.name} while the session runs"
    return Violation(SafetyCode.OBJECT_ABORTED, state.object_id, 1.0, 0.0, state.stamp_ns, detail)


def tracking_error(state: ObjectState, limits: Limits) -> Violation | None:
    """The object's own report of its distance from the reference that it drives."""
    if not state.reference_id:
        return None
    passed = (
        judge.error_longitudinal(state.error_longitudinal_m, limits)
        or judge.error_lateral(state.error_lateral_m, limits)
        or judge.error_yaw(state.error_yaw_rad, limits)
    )
    return of_object(passed, state.object_id, state.stamp_ns)


def own_lateness(found: Violation, late_s: float, heartbeat_s: float) -> Violation:
    """What was found while the manager itself stood still: then its own lateness is the reason.

    Who wasn't looked at for seconds seems silent, slow or off in time, and an object that didn't
    hear the manager stops by itself.

    Args:
        found: by the manager, or seen by another node.
        late_s: how late the manager was of late, on the steady clock; 0 for not.
        heartbeat_s: for how long objects go without hearing the manager.
    """
    # A recorder that lost messages is one without a name; a silent one has its node's.
    silent_recorder = found.code is SafetyCode.RECORDER and bool(found.object_id)
    # Objects stop by themselves for many reasons; a manager that was heard in time is none.
    limit_s = max(LATE_S, heartbeat_s) if found.code in _OF_OBJECTS else LATE_S
    if late_s <= limit_s or not (found.code in _OF_TIME or silent_recorder):
        return found
    instead = f"instead of {MEANINGS[found.code].limit_name}"
    who = f" of {found.object_id}" if found.object_id else ""
    return Violation(
        SafetyCode.OVERRUN, names.SCENARIO_MANAGER, late_s, limit_s, found.stamp_ns, instead + who
    )


def in_session_time(reported: Violation, now_ns: int) -> Violation:
    """What another node reports; with a stamp of another clock or run it counts as passed now.

    Args:
        reported: with the stamp that it came with.
        now_ns: session time.
    """
    off_s = ns_to_seconds(reported.stamp_ns - now_ns)
    if abs(off_s) <= REPORT_AGE_S:
        return reported
    detail = f"{reported.detail}, stamped {off_s:+.3g} s from the session's time"
    return replace(reported, stamp_ns=now_ns, detail=detail)


def recorder_lost(lost: int, stamp_ns: int) -> Violation | None:
    """The recorder has lost messages: the run can't be explained from its bag."""
    if lost <= 0:
        return None
    detail = "messages lost by the recorder"
    return Violation(SafetyCode.RECORDER, "", float(lost), 0.0, stamp_ns, detail)


def foreign_manager(others: int, stamp_ns: int, detail: str) -> Violation | None:
    """Others publish what one node alone may, as a second manager its heartbeats; who, in words."""
    if others <= 0:
        return None
    return Violation(SafetyCode.FOREIGN_MANAGER, "", float(others), 0.0, stamp_ns, detail)


# -- verdicts -------------------------------------------------------------------------------------

# What an abort for this reason makes of the run; codes that aren't here fail on safety.
_ABORTED = {
    SafetyCode.OPERATOR,
    SafetyCode.OBJECT_SILENT,
    SafetyCode.VUT_SILENT,
    SafetyCode.HEARTBEAT_LOST,
    SafetyCode.ACK_MISSING,
    SafetyCode.REFERENCE_REFUSED,
    SafetyCode.STATE_STALE,
    SafetyCode.REPLY_MISSING,
    SafetyCode.CLOCK_OFFSET,
    SafetyCode.LINK_DELAY,
}
_HARNESS = {
    SafetyCode.RECORDER,
    SafetyCode.WORLD_SILENT,
    SafetyCode.PARTICIPANT_LOST,
    SafetyCode.OVERRUN,
    SafetyCode.FOREIGN_MANAGER,
}


def verdict_for(code: SafetyCode) -> Verdict:
    """The verdict of a run whose first reason has this code."""
    if code in _HARNESS:
        return Verdict.INVALID_HARNESS
    if code in _ABORTED:
        return Verdict.ABORTED
    if code is SafetyCode.EVENT_MISSING:
        return Verdict.OFF_SPEC
    return Verdict.FAILED_SAFETY
