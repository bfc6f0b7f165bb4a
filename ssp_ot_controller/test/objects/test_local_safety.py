"""Local safety: every limit from both sides of its boundary, and what isn't watched."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.fence import box_excess_m
from ssp_core.safety.limits import LimitViolation
from ssp_core.vocabulary import ControlState
from ssp_ot_controller.control.tracker import TrackingError
from ssp_ot_controller.objects import local_safety
from tests.support.states import object_state

S = 1_000_000_000
NOW = 20 * S
FENCE = [(-10.0, -5.0), (110.0, -5.0), (110.0, 5.0), (-10.0, 5.0)]
LIMITS = Limits(
    speed_mps=15.0,
    acceleration_mps2=3.0,
    heartbeat_s=0.5,
    state_age_s=0.3,
    error_longitudinal_m=2.0,
    error_lateral_m=0.8,
    error_yaw_rad=0.35,
)
POINTS = tuple(drive_along(Polyline([(0.0, 0.0), (100.0, 0.0)]), 0.0, 0.0, 10.0, 2.0, 2.0))
REFERENCE = Reference("r", "ot", "v", "approach", 0, 18 * S, 19 * S, POINTS)
STATE = object_state("ot", x_m=50.0, speed_mps=10.0, stamp_ns=NOW)
ZERO = TrackingError(0.0, 0.0, 0.0)


def decide(
    control_state: ControlState = ControlState.RUNNING, **changes: Any
) -> LimitViolation | None:
    seen: dict[str, Any] = {
        "heartbeat_age_s": 0.0,
        "state": STATE,
        "reference": REFERENCE,
        "error": ZERO,
        **changes,
    }
    # As Target does; what isn't located isn't judged by continuity.
    seen.setdefault("lost", local_safety.lost_its_place(seen["state"], NOW, (), LIMITS))
    seen.setdefault("outside_m", box_excess_m(seen["state"].box, FENCE))
    return local_safety.decide(
        local_safety.SafetyInputs(**seen), now_ns=NOW, control_state=control_state, limits=LIMITS
    )


def state(**changes: Any) -> dict[str, Any]:
    return {"state": replace(STATE, **changes)}


def beside(gap_m: float) -> ObjectState:
    """Another car so far to the left."""
    return replace(STATE, object_id="vut", y_m=1.8 + gap_m)


def test_all_well_goes_on() -> None:
    assert decide() is None
    assert not local_safety.is_idle(ControlState.RUNNING, REFERENCE, NOW)


BOUNDARIES = [
    (SafetyCode.HEARTBEAT_LOST, {"heartbeat_age_s": 0.5}, {"heartbeat_age_s": 0.5 + 1e-9}),
    (SafetyCode.HEARTBEAT_LOST, {}, {"heartbeat_age_s": math.inf}),
    (SafetyCode.FOREIGN_MANAGER, {}, {"other_managers": 1}),
    (SafetyCode.STATE_STALE, state(stamp_ns=NOW - 3 * S // 10), state(stamp_ns=NOW - S // 3)),
    (SafetyCode.CLOCK_OFFSET, state(stamp_ns=NOW + S // 20), state(stamp_ns=NOW + S // 20 + 1)),
    (SafetyCode.DURATION, {"running_s": 60.0}, {"running_s": 60.0 + 1e-9}),
    (SafetyCode.LOCALISATION, state(position_std_m=0.5), state(position_std_m=0.5 + 1e-9)),
    (SafetyCode.POSITION_JUMP, {}, {"lost": LimitViolation(SafetyCode.POSITION_JUMP, 1.2, 1.0)}),
    (SafetyCode.STOPPING_ROOM, {"room_excess_m": 0.0}, {"room_excess_m": 1e-9}),
    (SafetyCode.REFERENCE_REFUSED, {"refused": 0}, {"refused": 2}),
    (SafetyCode.SEPARATION, {"others": [beside(0.5 + 1e-9)]}, {"others": [beside(0.5 - 1e-9)]}),
    (SafetyCode.SEPARATION, {}, {"others": [beside(3.0), beside(0.1)]}),
    (SafetyCode.COLLISION, {}, {"others": [beside(-0.1)]}),
    (SafetyCode.STATE_NOT_FINITE, {}, state(y_m=math.nan)),
    (SafetyCode.STATE_NOT_FINITE, {}, state(speed_mps=math.inf)),
    (SafetyCode.OUTSIDE_GEOFENCE, state(y_m=4.1), state(y_m=4.1 + 1e-6)),
    (SafetyCode.OUTSIDE_GEOFENCE, state(x_m=106.4), state(x_m=106.4 + 1e-6)),
    (SafetyCode.OVER_SPEED, state(speed_mps=15.0), state(speed_mps=15.0 + 1e-9)),
    (SafetyCode.OVER_SPEED, state(speed_mps=-15.0), state(speed_mps=-15.0 - 1e-9)),
    (
        SafetyCode.OVER_ACCELERATION,
        state(acceleration_mps2=-3.0),
        state(acceleration_mps2=-3.0 - 1e-9),
    ),
    (
        SafetyCode.ERROR_LONGITUDINAL,
        {"error": TrackingError(-2.0, 0.0, 0.0)},
        {"error": TrackingError(-2.0 - 1e-9, 0.0, 0.0)},
    ),
    (
        SafetyCode.ERROR_LATERAL,
        {"error": TrackingError(0.0, 0.8, 0.0)},
        {"error": TrackingError(0.0, 0.8 + 1e-9, 0.0)},
    ),
    (
        SafetyCode.ERROR_YAW,
        {"error": TrackingError(0.0, 0.0, -0.35)},
        {"error": TrackingError(0.0, 0.0, -0.35 - 1e-9)},
    ),
    (SafetyCode.ERROR_LATERAL, {}, {"error": TrackingError(0.0, math.nan, 0.0)}),
]


@pytest.mark.parametrize(("code", "inside", "outside"), BOUNDARIES)
def test_limits_at_their_boundaries(
    code: SafetyCode, inside: dict[str, Any], outside: dict[str, Any]
) -> None:
    assert decide(**inside) is None
    stop = decide(**outside)
    assert stop is not None
    assert stop.code is code
    if code is SafetyCode.SEPARATION:
        assert stop.measured < stop.limit
    elif code is SafetyCode.COLLISION:
        assert stop.measured == 0.0
    else:
        assert not abs(stop.measured) <= stop.limit


def test_measured_value_and_limit_are_told() -> None:
    stop = decide(error=TrackingError(0.0, -1.25, 0.0))
    assert stop == LimitViolation(SafetyCode.ERROR_LATERAL, -1.25, 0.8)


@pytest.mark.parametrize("control", list(ControlState), ids=lambda s: s.name)
def test_silence_counts_wherever_an_object_may_move(control: ControlState) -> None:
    watched = {"PRE_ARMING", "ARMED", "PRE_RUNNING", "RUNNING", "POSTRUN", "REMOTE_CONTROLLED"}
    stop = decide(control_state=control, heartbeat_age_s=1.0)
    assert (stop is not None) == (control.name in watched)


@pytest.mark.parametrize("control", list(ControlState), ids=lambda s: s.name)
def test_only_running_moves(control: ControlState) -> None:
    idle = local_safety.is_idle(control, REFERENCE, NOW)
    assert (decide(control_state=control), idle) == (None, control is not ControlState.RUNNING)


@pytest.mark.parametrize(
    ("reference", "brake"),
    [
        (None, True),
        (replace(REFERENCE, execute_at_ns=NOW + 1), True),
        (replace(REFERENCE, execute_at_ns=NOW), False),
        (replace(REFERENCE, execute_at_ns=NOW - REFERENCE.end_ns + 18 * S), True),
        (replace(REFERENCE, execute_at_ns=NOW - REFERENCE.end_ns + 18 * S + 1), False),
    ],
    ids=["none", "not_begun", "begins", "ends", "last_instant"],
)
def test_without_a_reference_that_asks_for_motion_it_brakes(
    reference: Reference | None, brake: bool
) -> None:
    assert decide(reference=reference) is None
    assert local_safety.is_idle(ControlState.RUNNING, reference, NOW) is brake


def test_errors_and_braking_do_not_count_while_it_brakes_for_another_reason() -> None:
    hard = {**state(acceleration_mps2=-6.0), "error": TrackingError(9.0, 9.0, 3.0)}
    assert decide(reference=None, **hard) is None
    assert decide(control_state=ControlState.POSTRUN, **hard) is None
    assert decide(**hard) is not None


def test_the_first_step_has_no_error_yet() -> None:
    assert decide(error=None) is None
