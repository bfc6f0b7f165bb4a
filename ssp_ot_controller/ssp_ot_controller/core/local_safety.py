"""What an object watches by itself: may it go on, or must it stop without being told?

Every predicate has a name of its own, takes a measured value and its limit, and is true when the
limit is passed; a value at the limit hasn't passed it. All are written so that a value that isn't
finite counts as passed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds
from ssp_core.reference import Reference
from ssp_core.run_spec import Limits
from ssp_core.safety_codes import MEANINGS, SafetyCode
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState
from ssp_ot_controller.core.fence import box_excess_m
from ssp_ot_controller.core.tracking import TrackingError

# States in which an object may move or is about to: here it needs the manager and a good state.
WATCHED = frozenset(
    {
        ControlState.PRE_ARMING,
        ControlState.ARMED,
        ControlState.PRE_RUNNING,
        ControlState.RUNNING,
        ControlState.POSTRUN,
        ControlState.REMOTE_CONTROLLED,
    }
)


@dataclass(frozen=True, slots=True)
class Continue:
    """No limit is passed.

    Args:
        brake: True: no reference asks for motion now, so brake to a standstill and hold it.
    """

    brake: bool


@dataclass(frozen=True, slots=True)
class StopNow:
    """A limit is passed: stop and latch. Fields as in SafetyEvent.msg."""

    code: SafetyCode
    limit_name: str
    measured: float
    limit: float
    unit: str


def heartbeat_lost(age_s: float, limit_s: float) -> bool:
    return not age_s <= limit_s


def state_stale(age_s: float, limit_s: float) -> bool:
    return not age_s <= limit_s


def state_not_finite(state: ObjectState) -> bool:
    return not state.is_finite


def outside_geofence(excess_m: float) -> bool:
    return not excess_m <= 0.0


def over_speed(speed_mps: float, limit_mps: float) -> bool:
    return not abs(speed_mps) <= limit_mps


def over_acceleration(acceleration_mps2: float, limit_mps2: float) -> bool:
    return not abs(acceleration_mps2) <= limit_mps2


def error_longitudinal(error_m: float, limit_m: float) -> bool:
    return not abs(error_m) <= limit_m


def error_lateral(error_m: float, limit_m: float) -> bool:
    return not abs(error_m) <= limit_m


def error_yaw(error_rad: float, limit_rad: float) -> bool:
    return not abs(error_rad) <= limit_rad


def reference_over(reference: Reference | None, now_ns: int) -> bool:
    """True when no reference asks for motion: none, not begun, or driven to its end."""
    return reference is None or now_ns < reference.execute_at_ns or now_ns >= reference.end_ns


def _stop(code: SafetyCode, measured: float, limit: float) -> StopNow:
    meaning = MEANINGS[code]
    return StopNow(code, meaning.limit_name, measured, limit, meaning.unit)


def decide(
    *,
    now_ns: int,
    control_state: ControlState,
    heartbeat_ns: int | None,
    state: ObjectState | None,
    reference: Reference | None,
    error: TrackingError | None,
    limits: Limits,
    geofence: Sequence[tuple[float, float]],
) -> Continue | StopNow:
    """Goes on, or stops with the first limit that is passed.

    Outside WATCHED the object stands or is stopping anyway, so nothing is checked and it brakes.
    Tracking errors and acceleration count only while a reference is being driven: an object that
    brakes for another reason leaves its reference and brakes harder than one.

    Args:
        now_ns: time on the clock of the watchdogs (simulated in lockstep, else steady), ns.
        control_state: of the object.
        heartbeat_ns: when the last heartbeat arrived, on the same clock; None before the first.
        state: the newest own state, its stamp on the same clock; None before the first.
        reference: the one being tracked; None when there is none.
        error: of the last tracking step; None when there was none.
        limits: of the site.
        geofence: polygon, m, frame map.
    """
    if control_state not in WATCHED:
        return Continue(brake=True)
    silence_s = math.inf if heartbeat_ns is None else ns_to_seconds(now_ns - heartbeat_ns)
    if heartbeat_lost(silence_s, limits.heartbeat_s):
        return _stop(SafetyCode.HEARTBEAT_LOST, silence_s, limits.heartbeat_s)
    age_s = math.inf if state is None else ns_to_seconds(now_ns - state.stamp_ns)
    if state is None or state_stale(age_s, limits.state_age_s):
        return _stop(SafetyCode.STATE_STALE, age_s, limits.state_age_s)
    if state_not_finite(state):
        return _stop(SafetyCode.STATE_NOT_FINITE, math.nan, 0.0)
    excess_m = box_excess_m(state.box, geofence)
    if outside_geofence(excess_m):
        return _stop(SafetyCode.OUTSIDE_GEOFENCE, excess_m, 0.0)
    if over_speed(state.speed_mps, limits.speed_mps):
        return _stop(SafetyCode.OVER_SPEED, state.speed_mps, limits.speed_mps)
    idle = control_state is not ControlState.RUNNING or reference_over(reference, now_ns)
    if not idle:
        stop = _decide_driving(state, error, limits)
        if stop is not None:
            return stop
    return Continue(brake=idle)


def _decide_driving(
    state: ObjectState, error: TrackingError | None, limits: Limits
) -> StopNow | None:
    if over_acceleration(state.acceleration_mps2, limits.acceleration_mps2):
        return _stop(
            SafetyCode.OVER_ACCELERATION, state.acceleration_mps2, limits.acceleration_mps2
        )
    if error is None:
        return None
    if error_longitudinal(error.longitudinal_m, limits.error_longitudinal_m):
        return _stop(
            SafetyCode.ERROR_LONGITUDINAL, error.longitudinal_m, limits.error_longitudinal_m
        )
    if error_lateral(error.lateral_m, limits.error_lateral_m):
        return _stop(SafetyCode.ERROR_LATERAL, error.lateral_m, limits.error_lateral_m)
    if error_yaw(error.yaw_rad, limits.error_yaw_rad):
        return _stop(SafetyCode.ERROR_YAW, error.yaw_rad, limits.error_yaw_rad)
    return None
