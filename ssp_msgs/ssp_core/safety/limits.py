"""The limits of a session: one named predicate each, for the objects and for the manager.

A predicate returns None while its limit is kept, else what was measured and the limit. Limits are
inclusive: a value equal to its limit is still allowed (METHOD 6.11). Every comparison is written so
that a value that is no number has passed its limit.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import box_distance
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState, Size
from ssp_core.run_file.model import Limits
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.consistency import ConsistencyWatch
from ssp_core.safety.contradiction import HOLDS_S
from ssp_core.value_class import value_class
from ssp_core.vocabulary import ControlState, ObjectClass

# What is slower stands.
STANDSTILL_MPS = 0.05
# Far more than the rounding of map coordinates.
_ROUNDING_M = 1e-6
# No length or width of a real body is a smaller share of the typical one of its class.
_LEAST_SHARE = 0.5


@dataclass(frozen=True, slots=True)
class LimitViolation:
    """A limit that was passed; units as in MEANINGS.

    Args:
        measured: with its sign where it has one.
        limit: that its amount may be at most.
        words: what happened, where the numbers alone don't say it.
    """

    code: SafetyCode
    measured: float
    limit: float
    words: str = ""


def _judge(code: SafetyCode, measured: float, limit: float) -> LimitViolation | None:
    return None if abs(measured) <= limit else LimitViolation(code, measured, limit)


def heartbeat_lost(silence_s: float, limits: Limits) -> LimitViolation | None:
    """Check how long the manager has been silent, s."""
    return _judge(SafetyCode.HEARTBEAT_LOST, silence_s, limits.heartbeat_s)


def state_stale(age_s: float, limits: Limits) -> LimitViolation | None:
    """Check the age of the newest state, s; an age below zero is the clock's matter."""
    return _judge(SafetyCode.STATE_STALE, max(age_s, 0.0), limits.state_age_s)


def state_not_finite(state: ObjectState) -> LimitViolation | None:
    """Check a state for values that are no numbers: they don't say where the object is."""
    return None if state.is_finite else LimitViolation(SafetyCode.STATE_NOT_FINITE, math.nan, 0.0)


def other_body(state: ObjectState, cls: ObjectClass) -> str:
    """Say what an object states that a body of its class isn't; empty: nothing.

    Fence and separation are judged by the stated extent: one that is too small is never too near.

    Args:
        state: with finite values.
        cls: that the run file gives it; a state without a class may belong to any.
    """
    if state.object_class not in (cls, ObjectClass.UNKNOWN):
        return f"that it is a {state.object_class.word}, and run.yaml that it is a {cls.word}"
    stated, typical = state.size, DEFAULT_SIZES[cls]
    least_length_m, least_width_m = (_LEAST_SHARE * m for m in (typical.length_m, typical.width_m))
    if stated.length_m < least_length_m or stated.width_m < least_width_m:
        least = f"{least_length_m:g} × {least_width_m:g} m"
        return f"an extent of {_extent(stated)}, the least for a {cls.word} is {least}"
    return ""


def body_changed(before: ObjectState, state: ObjectState) -> LimitViolation | None:
    """Find another class or extent than an object had in the state before."""
    if state.size == before.size and state.object_class is before.object_class:
        return None
    words = (
        f"states a {state.object_class.word} of {_extent(state.size)}, and stated a "
        f"{before.object_class.word} of {_extent(before.size)}"
    )
    gone_s = ns_to_seconds(state.stamp_ns - before.stamp_ns)
    return LimitViolation(SafetyCode.STATE_CONTRADICTS, gone_s, 0.0, words)


def _extent(size: Size) -> str:
    return f"{size.length_m:g} × {size.width_m:g} m"


def outside_geofence(excess_m: float) -> LimitViolation | None:
    """Check how far the object's box sticks out of the fence, m.

    ``ssp_core.safety.fence`` computes it, here and on the way since the last state.
    """
    return _judge(SafetyCode.OUTSIDE_GEOFENCE, excess_m, 0.0)


def _least_gap_m(a: ObjectState, b: ObjectState) -> float:
    """Return a gap that no two points of two boxes fall below: the widest along one of their axes.

    Negative when there is none. Cheap, because most pairs need not be measured any closer.
    """
    ca, sa, cb, sb = (
        math.cos(a.yaw_rad),
        math.sin(a.yaw_rad),
        math.cos(b.yaw_rad),
        math.sin(b.yaw_rad),
    )
    za, zb = a.size, b.size
    # Half lengths, half widths, and middles ahead of the reference points.
    la, lb = 0.5 * (za.front_m + za.rear_m), 0.5 * (zb.front_m + zb.rear_m)
    wa, wb = 0.5 * za.width_m, 0.5 * zb.width_m
    ma, mb = 0.5 * (za.front_m - za.rear_m), 0.5 * (zb.front_m - zb.rear_m)
    dx = b.x_m + cb * mb - a.x_m - ca * ma
    dy = b.y_m + sb * mb - a.y_m - sa * ma
    cosine, sine = abs(ca * cb + sa * sb), abs(ca * sb - sa * cb)
    return max(
        abs(ca * dx + sa * dy) - la - lb * cosine - wb * sine,
        abs(ca * dy - sa * dx) - wa - lb * sine - wb * cosine,
        abs(cb * dx + sb * dy) - lb - la * cosine - wa * sine,
        abs(cb * dy - sb * dx) - wb - la * sine - wa * cosine,
    )


def near_pairs(states: Sequence[ObjectState], within_m: float) -> list[tuple[int, int]]:
    """Return the pairs of objects whose boxes may be within a distance of each other.

    Among many objects few are near each other, and most pairs need not be looked at.

    Args:
        states: with finite poses, at one instant.
        within_m: distance between two boxes.

    Returns:
        Indexes of the two, the lower one first, in rising order; no pair that is as near is left
        out, some that aren't may be in it.
    """
    spans = []
    for i, state in enumerate(states):
        reach_m = state.size.reach_m + _ROUNDING_M
        if not math.isfinite(reach_m):
            reach_m = math.inf
        spans.append((state.x_m - reach_m, state.x_m + reach_m + within_m, reach_m, i))
    spans.sort()
    pairs: list[tuple[int, int]] = []
    ahead: list[tuple[float, float, int]] = []
    for begin_m, end_m, reach_m, i in spans:
        ahead = [other for other in ahead if other[0] >= begin_m]
        y_m = states[i].y_m
        for _, other_reach_m, j in ahead:
            if abs(states[j].y_m - y_m) <= reach_m + other_reach_m + within_m:
                pairs.append((i, j) if i < j else (j, i))
        ahead.append((end_m, reach_m, i))
    return sorted(pairs)


def separation(a: ObjectState, b: ObjectState, limits: Limits) -> LimitViolation | None:
    """Check the distance of two objects' boxes at the same instant, m; touching is a collision."""
    if _least_gap_m(a, b) > limits.separation_m:
        return None
    distance_m = box_distance(a.box, b.box)
    if distance_m == 0.0:
        return LimitViolation(SafetyCode.COLLISION, 0.0, 0.0)
    if not distance_m >= limits.separation_m:
        return LimitViolation(SafetyCode.SEPARATION, distance_m, limits.separation_m)
    return None


def over_speed(state: ObjectState, limits: Limits) -> LimitViolation | None:
    """Check the speed, forwards or backwards, m/s."""
    return _judge(SafetyCode.OVER_SPEED, state.speed_mps, limits.speed_mps)


def over_acceleration(state: ObjectState, limits: Limits) -> LimitViolation | None:
    """Check how hard an object accelerates or brakes, m/s^2 along the heading."""
    return _judge(SafetyCode.OVER_ACCELERATION, state.acceleration_mps2, limits.acceleration_mps2)


def error_longitudinal(error_m: float, limits: Limits) -> LimitViolation | None:
    """Check how far an object is ahead of (+) or behind (-) the reference, m."""
    return _judge(SafetyCode.ERROR_LONGITUDINAL, error_m, limits.error_longitudinal_m)


def error_lateral(error_m: float, limits: Limits) -> LimitViolation | None:
    """Check how far an object is left (+) or right (-) of the reference, m."""
    return _judge(SafetyCode.ERROR_LATERAL, error_m, limits.error_lateral_m)


def error_yaw(error_rad: float, limits: Limits) -> LimitViolation | None:
    """Check how far an object is turned left (+) or right (-) of the reference, rad."""
    return _judge(SafetyCode.ERROR_YAW, error_rad, limits.error_yaw_rad)


def localisation(state: ObjectState, limits: Limits) -> LimitViolation | None:
    """Check the stated uncertainty of the position, m, one sigma."""
    return _judge(SafetyCode.LOCALISATION, state.position_std_m, limits.position_std_m)


def statement_violations(state: ObjectState, limits: Limits) -> list[LimitViolation]:
    """Check what a state says of itself beside place and speed: uncertainty, and errors.

    Errors count off the reference that it states, if it does.
    """
    violations = [localisation(state, limits)]
    if state.reference_id and state.control_state is ControlState.RUNNING:
        # Who brakes for another reason leaves its reference, and brakes harder than one asks.
        violations.append(over_acceleration(state, limits))
    if state.reference_id:
        violations.append(
            error_longitudinal(state.error_longitudinal_m, limits)
            or error_lateral(state.error_lateral_m, limits)
            or error_yaw(state.error_yaw_rad, limits)
        )
    return [passed for passed in violations if passed is not None]


def position_jump(before: ObjectState, state: ObjectState, limits: Limits) -> LimitViolation | None:
    """Check how far the position is from where the state before it led, m.

    The state before is extrapolated with its speed and yaw rate. States that were lost in between
    leave more time to accelerate, so that the limit grows by a t^2 / 2 with the acceleration limit.

    Args:
        before: an earlier state of the same object.
        state: the newer one.
        limits: of the run.
    """
    x_m, y_m = before.point_at(state.stamp_ns)
    away_m = math.hypot(state.x_m - x_m, state.y_m - y_m)
    passed_s = ns_to_seconds(state.stamp_ns - before.stamp_ns)
    limit_m = limits.jump_m + 0.5 * limits.acceleration_mps2 * passed_s**2
    return _judge(SafetyCode.POSITION_JUMP, away_m, limit_m)


def state_frozen(stood_s: float, limits: Limits) -> LimitViolation | None:
    """Check how long the position stood in states that say that the object moves, s."""
    return _judge(SafetyCode.STATE_FROZEN, stood_s, limits.frozen_s)


def clock_offset(
    offset_s: float, limits: Limits, uncertainty_s: float = 0.0
) -> LimitViolation | None:
    """Check how far an object's clock is ahead of (+) or behind (-) the manager's, s.

    Args:
        offset_s: the object's clock minus the manager's.
        limits: of the run.
        uncertainty_s: of the measured offset, to either side.
    """
    return _judge(SafetyCode.CLOCK_OFFSET, offset_s, limits.clock_offset_s + uncertainty_s)


def stamp_ahead(age_s: float, limits: Limits, allowance_s: float = 0.0) -> LimitViolation | None:
    """Check how far a state is stamped ahead of now, s.

    The clocks that made its stamp and its age are too far apart then.

    Args:
        age_s: of the state; below zero for a stamp ahead of time.
        limits: of the run.
        allowance_s: how far the clock of ``age_s`` may lag behind by itself.
    """
    return None if age_s >= 0.0 else clock_offset(max(-age_s - allowance_s, 0.0), limits)


def duration(running_s: float, limits: Limits) -> LimitViolation | None:
    """Check how long the run goes on, s."""
    return _judge(SafetyCode.DURATION, running_s, limits.duration_s)


def link_delay(delay_s: float, limits: Limits) -> LimitViolation | None:
    """Check the time that a message to an object and its answer take, s, there and back."""
    return _judge(SafetyCode.LINK_DELAY, delay_s, limits.link_delay_s)


# Who stands goes no farther in this time, net, than this and two deviations of its place.
STOOD_S = 1.0
STOOD_WAY_M = 0.1


def state_contradicts(watch: ConsistencyWatch) -> LimitViolation | None:
    """Find a motion whose statement hasn't fitted its places for too long, s."""
    contradiction = watch.contradiction
    if contradiction is None or not contradiction.holds:
        return None
    return LimitViolation(SafetyCode.STATE_CONTRADICTS, contradiction.held_s, HOLDS_S)


def net_way_m(watch: ConsistencyWatch) -> tuple[float, float] | None:
    """Return how far an object went in STOOD_S, and the limit, both in m.

    None: its places show standstill, as far as they are known.
    """
    way_m, _ = watch.net_way_m(STOOD_S)
    limit_m = STOOD_WAY_M + 2.0 * watch.position_std_m
    return None if way_m <= limit_m else (way_m, limit_m)


def is_standing(state: ObjectState, watch: ConsistencyWatch) -> bool:
    """Tell whether speed and places say that the object stands, as far as places are known."""
    return abs(state.speed_mps) <= STANDSTILL_MPS and net_way_m(watch) is None


def link_violations(offset_s: float, delay_s: float, limits: Limits) -> list[LimitViolation]:
    """List the violations of a link measured by a message and its answer, the delay first.

    The two ways may take different times. The offset is known to half of the delay, and a clock is
    wrong only if it is wrong for any share of the delay on either way.

    Args:
        offset_s: the object's clock minus the manager's.
        delay_s: there and back.
        limits: of the run.
    """
    violations = (
        link_delay(delay_s, limits),
        clock_offset(offset_s, limits, 0.5 * max(delay_s, 0.0)),
    )
    return [passed for passed in violations if passed is not None]


# An object whose own state says that it is faster than this can't stay where it is.
MOVING_MPS = 0.2
# It has stayed when it is still so near; receivers repeat a position to the last digit.
STOOD_M = 0.01


@value_class(frozen=True, slots=True)
class Continuity:
    """The memory of one object's states.

    Args:
        before: the newest state that could be judged; None before the first.
        rest_state: the first state at the present position of an object that moves, as it says, or
            that must move; None while the position moves, or while the object may stand.
    """

    before: ObjectState | None = None
    rest_state: ObjectState | None = None

    def before_motion(self, state: ObjectState) -> Continuity:
        """Return the memory by which a state is judged while its object may not move yet.

        An older state begins anew, so that a clock that was ahead doesn't outlast its correction.
        """
        before = self.before
        return Continuity() if before is not None and state.stamp_ns < before.stamp_ns else self


def follow(
    memory: Continuity, state: ObjectState, limits: Limits, asked_mps: float = 0.0
) -> tuple[Continuity, list[LimitViolation]]:
    """Judge a state by those before it.

    A state with a value that is no number is not judged and not remembered, nor is one that is
    older than the newest. After a jump the new position is believed, so that it is reported once.

    Args:
        memory: what the states before led to; at first ``Continuity()``.
        state: the newest one of the object.
        limits: of the run.
        asked_mps: speed that an object which isn't ahead of its reference is asked for, 0 for
            none. A state that froze while the object stood says that it stands for ever.

    Returns:
        The memory with this state, and the limits that it passes.
    """
    before = memory.before
    if not state.is_finite or (before is not None and state.stamp_ns <= before.stamp_ns):
        return memory, []
    violations = []
    if before is not None and (jumped := position_jump(before, state, limits)) is not None:
        violations.append(jumped)
    if before is not None and (changed := body_changed(before, state)) is not None:
        violations.append(changed)
    rest_state = _rest_state(memory, state, asked_mps)
    if rest_state is not None and rest_state is not state:
        stood_s = ns_to_seconds(state.stamp_ns - rest_state.stamp_ns)
        if (frozen := state_frozen(stood_s, limits)) is not None:
            violations.append(frozen)
    return Continuity(state, rest_state), violations


def _rest_state(memory: Continuity, state: ObjectState, asked_mps: float) -> ObjectState | None:
    if max(abs(state.speed_mps), asked_mps) <= MOVING_MPS:
        return None
    since = memory.rest_state
    if since is None:
        return state
    moved_m = math.hypot(state.x_m - since.x_m, state.y_m - since.y_m)
    return since if moved_m <= STOOD_M else state
