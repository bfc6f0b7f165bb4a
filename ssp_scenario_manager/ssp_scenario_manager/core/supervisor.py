"""Limits of a running session: one named predicate each, with the value it measured.

A predicate returns None while its limit is kept. Limits are inclusive: a value equal to its limit
is still allowed, as METHOD 6.11 has it for thresholds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import box_distance, point_in_polygon
from ssp_core.run_spec import Limits
from ssp_core.safety_codes import MEANINGS, SafetyCode
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState, Verdict


@dataclass(frozen=True, slots=True)
class Violation:
    """A limit that was passed: what, whose, how far, and when."""

    code: SafetyCode
    object_id: str
    measured: float
    limit: float
    stamp_ns: int
    detail: str = ""

    @property
    def text(self) -> str:
        """The reason as it stands in verdicts and reports."""
        meaning = MEANINGS[self.code]
        who = f" {self.object_id}:" if self.object_id else ""
        unit = f" {meaning.unit}" if meaning.unit else ""
        figures = f"{self.measured:.3g}{unit}, limit {self.limit:.3g}{unit}"
        detail = f" ({self.detail})" if self.detail else ""
        return f"{meaning.limit_name}:{who} {figures}{detail}"


def _reach_m(state: ObjectState) -> float:
    """No point of the object is farther than this from its reference point."""
    return max(state.size.front_m, state.size.rear_m) + 0.5 * state.size.width_m


def separation(a: ObjectState, b: ObjectState, limits: Limits) -> Violation | None:
    """Distance between the two boxes; touching is a collision."""
    between = math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)
    if between - _reach_m(a) - _reach_m(b) > limits.separation_m:
        return None
    distance = box_distance(a.box, b.box)
    names = f"{a.object_id} and {b.object_id}"
    if distance == 0.0:
        return Violation(SafetyCode.COLLISION, b.object_id, 0.0, 0.0, a.stamp_ns, names)
    if distance < limits.separation_m:
        return Violation(
            SafetyCode.SEPARATION, b.object_id, distance, limits.separation_m, a.stamp_ns, names
        )
    return None


def silent(
    code: SafetyCode, object_id: str, age_s: float, limit_s: float, stamp_ns: int
) -> Violation | None:
    """Nothing was heard for longer than allowed."""
    if age_s > limit_s:
        return Violation(code, object_id, age_s, limit_s, stamp_ns)
    return None


def ack_missing(
    object_id: str, dispatched_ns: int, now_ns: int, limits: Limits
) -> Violation | None:
    """A reference was sent and not answered in time."""
    return silent(
        SafetyCode.ACK_MISSING,
        object_id,
        ns_to_seconds(now_ns - dispatched_ns),
        limits.ack_s,
        now_ns,
    )


def duration(started_ns: int, now_ns: int, limits: Limits) -> Violation | None:
    """The run goes on for too long."""
    return silent(
        SafetyCode.DURATION, "", ns_to_seconds(now_ns - started_ns), limits.duration_s, now_ns
    )


def own_abort(state: ObjectState) -> Violation | None:
    """An object went to ABORTING on its own."""
    if state.control_state == ControlState.ABORTING:
        return Violation(
            SafetyCode.OBJECT_ABORTED, state.object_id, 1.0, 0.0, state.stamp_ns, "local stop"
        )
    return None


def not_finite(state: ObjectState) -> Violation | None:
    """A state that holds a value that is no number says nothing about where the object is."""
    if state.is_finite:
        return None
    return Violation(SafetyCode.STATE_NOT_FINITE, state.object_id, math.nan, 0.0, state.stamp_ns)


def tracking_error(state: ObjectState, limits: Limits) -> Violation | None:
    """The object's own report of its distance from the reference; no number counts as too far."""
    if not state.reference_id:
        return None
    for code, value, limit in (
        (
            SafetyCode.ERROR_LONGITUDINAL,
            abs(state.error_longitudinal_m),
            limits.error_longitudinal_m,
        ),
        (SafetyCode.ERROR_LATERAL, abs(state.error_lateral_m), limits.error_lateral_m),
        (SafetyCode.ERROR_YAW, abs(state.error_yaw_rad), limits.error_yaw_rad),
    ):
        if not value <= limit:
            return Violation(code, state.object_id, value, limit, state.stamp_ns)
    return None


def over_speed(state: ObjectState, limits: Limits) -> Violation | None:
    """The object drives faster than the site allows."""
    if abs(state.speed_mps) > limits.speed_mps:
        return Violation(
            SafetyCode.OVER_SPEED,
            state.object_id,
            abs(state.speed_mps),
            limits.speed_mps,
            state.stamp_ns,
        )
    return None


def outside_geofence(
    state: ObjectState, geofence: Sequence[tuple[float, float]]
) -> Violation | None:
    """A corner of the object lies outside the fence; measured is the number of such corners."""
    outside = sum(not point_in_polygon(x, y, geofence) for x, y in state.box.corners())
    if outside:
        return Violation(
            SafetyCode.OUTSIDE_GEOFENCE,
            state.object_id,
            float(outside),
            0.0,
            state.stamp_ns,
            "corners outside",
        )
    return None


def violations(
    vut: ObjectState,
    targets: Sequence[ObjectState],
    limits: Limits,
    geofence: Sequence[tuple[float, float]],
) -> list[Violation]:
    """All limits that the states of one instant pass, the gravest first.

    Args:
        vut: state of the VUT.
        targets: states of the object targets at the VUT's stamp.
        limits: the site's.
        geofence: polygon, m, frame map.
    """
    broken = [violation for state in [vut, *targets] if (violation := not_finite(state))]
    if broken:
        return broken
    found: list[Violation] = []
    everyone = [vut, *targets]
    for i, a in enumerate(everyone):
        for b in everyone[i + 1 :]:
            violation = separation(a, b, limits)
            if violation is not None:
                found.append(violation)
    for state in everyone:
        checks = (over_speed(state, limits), outside_geofence(state, geofence))
        found += [check for check in checks if check is not None]
    for state in targets:
        error = tracking_error(state, limits)
        if error is not None:
            found.append(error)
    return sorted(found, key=lambda v: v.code != SafetyCode.COLLISION)


# What an abort for this reason makes of the run; codes that aren't here fail on safety.
_ABORTED = {
    SafetyCode.OPERATOR,
    SafetyCode.OBJECT_SILENT,
    SafetyCode.VUT_SILENT,
    SafetyCode.HEARTBEAT_LOST,
    SafetyCode.ACK_MISSING,
    SafetyCode.REFERENCE_REFUSED,
    SafetyCode.STATE_STALE,
}
_HARNESS = {
    SafetyCode.RECORDER,
    SafetyCode.WORLD_SILENT,
    SafetyCode.PARTICIPANT_LOST,
    SafetyCode.OVERRUN,
    SafetyCode.EVENT_MISSING,
}


def verdict_for(code: SafetyCode) -> Verdict:
    """The verdict of a run whose first reason has this code."""
    if code in _HARNESS:
        return Verdict.INVALID_HARNESS
    if code in _ABORTED:
        return Verdict.ABORTED
    return Verdict.FAILED_SAFETY
