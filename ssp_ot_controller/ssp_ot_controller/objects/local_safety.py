"""The safety decision that an object makes by itself: go on, or stop.

The predicates are those of ssp_core.safety.limits, which the manager judges by too; here is which
of them count when.
"""

from __future__ import annotations

from collections.abc import Sequence

from ssp_core.clock import ns_to_seconds
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.safety import limits as judge
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.limits import LimitViolation
from ssp_core.value_class import value_class
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.control.tracker import TrackingError

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


_MOVING = (ControlState.RUNNING, ControlState.POSTRUN, ControlState.REMOTE_CONTROLLED)


def reference_over(reference: Reference | None, now_ns: int) -> bool:
    """Tell whether no reference asks for motion: none, not begun, or driven to its end."""
    return reference is None or now_ns < reference.execute_at_ns or now_ns >= reference.end_ns


def is_idle(control_state: ControlState, reference: Reference | None, now_ns: int) -> bool:
    """Tell whether nothing asks for motion: the object brakes to a standstill and holds it."""
    return control_state is not ControlState.RUNNING or reference_over(reference, now_ns)


@value_class(frozen=True, slots=True)
class SafetyInputs:
    """The inputs of an object's safety decision at one step.

    Args:
        heartbeat_age_s: since the manager's last heartbeat, inf before the first.
        other_managers: how many others send heartbeats too.
        running_s: since it was started, 0 when it isn't RUNNING.
        lost: what says that the object doesn't know where it is (``lost_its_place``).
        reference: the one being tracked; None when there is none.
        error: of the last tracking step; None when there was none.
        outside_m: how far it sticks out of the fence, 0 for inside.
        room_excess_m: how far a stop from here would end outside the fence, 0 for inside.
        refused: number of the refusal of a reference in this step, 0 for none.
        others: states of other objects at the stamp of the own one.
    """

    heartbeat_age_s: float
    state: ObjectState
    reference: Reference | None
    error: TrackingError | None
    running_s: float = 0.0
    lost: LimitViolation | None = None
    other_managers: int = 0
    outside_m: float = 0.0
    room_excess_m: float = 0.0
    refused: int = 0
    others: Sequence[ObjectState] = ()


def lost_its_place(
    state: ObjectState, now_ns: int, continuity: Sequence[LimitViolation], limits: Limits
) -> LimitViolation | None:
    """Return the first sign that an object's own state can't be believed, None when there is none.

    Args:
        state: the newest own state.
        now_ns: on the object's clock.
        continuity: what ``ssp_core.safety.limits.follow`` says of it.
        limits: of the run.
    """
    age_s = ns_to_seconds(now_ns - state.stamp_ns)
    return (
        judge.state_stale(age_s, limits)
        # A clock that was set back: however long nothing new comes, the state would look young.
        or judge.stamp_ahead(age_s, limits)
        or judge.state_not_finite(state)
        or judge.localisation(state, limits)
        or (continuity[0] if continuity else None)
    )


def decide(
    inputs: SafetyInputs,
    *,
    now_ns: int,
    control_state: ControlState,
    limits: Limits,
) -> LimitViolation | None:
    """Return the first limit that is passed; None where the object may go on.

    Where one is passed the object must stop and latch.

    Outside WATCHED the object stands or is stopping anyway, so nothing is checked.
    Tracking errors and acceleration count only while a reference is being driven: an object that
    brakes for another reason leaves its reference and brakes harder than one.

    Args:
        inputs: measured values of the step.
        now_ns: on the object's clock.
        control_state: of the object.
        limits: of the run.
    """
    if control_state not in WATCHED:
        return None
    running = control_state is ControlState.RUNNING
    passed = (
        judge.heartbeat_lost(inputs.heartbeat_age_s, limits)
        or _foreign_manager(inputs.other_managers)
        or inputs.lost
        or judge.outside_geofence(inputs.outside_m)
        or judge.over_speed(inputs.state, limits)
        or judge.duration(inputs.running_s, limits)
    )
    if passed is None and control_state in _MOVING:
        passed = _too_close(inputs, limits)
    if passed is None and running:
        passed = _refusal_violation(inputs.refused) or _stopping_room(inputs.room_excess_m)
    if passed is None and not is_idle(control_state, inputs.reference, now_ns):
        passed = judge.over_acceleration(inputs.state, limits) or _off_reference(
            inputs.error, limits
        )
    return passed


def _foreign_manager(others: int) -> LimitViolation | None:
    return LimitViolation(SafetyCode.FOREIGN_MANAGER, float(others), 0.0) if others else None


def _refusal_violation(number: int) -> LimitViolation | None:
    return LimitViolation(SafetyCode.REFERENCE_REFUSED, float(number), 0.0) if number else None


def _stopping_room(excess_m: float) -> LimitViolation | None:
    return None if excess_m <= 0.0 else LimitViolation(SafetyCode.STOPPING_ROOM, excess_m, 0.0)


def _too_close(inputs: SafetyInputs, limits: Limits) -> LimitViolation | None:
    for other in inputs.others:
        passed = judge.separation(inputs.state, other, limits)
        if passed is not None:
            return passed
    return None


def _off_reference(error: TrackingError | None, limits: Limits) -> LimitViolation | None:
    if error is None:
        return None
    return (
        judge.error_longitudinal(error.longitudinal_m, limits)
        or judge.error_lateral(error.lateral_m, limits)
        or judge.error_yaw(error.yaw_rad, limits)
    )
