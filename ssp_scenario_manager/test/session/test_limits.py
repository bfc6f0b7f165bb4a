"""Limits of the session: at, just inside and just outside; and a verdict for every code."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.safety.codes import MEANINGS, SafetyCode
from ssp_core.vocabulary import ControlState, Verdict
from ssp_scenario_manager.session import limits
from ssp_scenario_manager.session.limits import Violation, verdict_for, violations

S = 1_000_000_000
FENCE = [(-100.0, -100.0), (1000.0, -100.0), (1000.0, 100.0), (-100.0, 100.0)]
# Values that binary fractions hold exactly, so that "at the limit" is exactly that.
LIMITS = Limits(
    speed_mps=15.0,
    acceleration_mps2=5.0,
    separation_m=0.5,
    ack_s=0.5,
    heartbeat_s=0.25,
    state_age_s=0.125,
    error_longitudinal_m=2.0,
    error_lateral_m=0.75,
    error_yaw_rad=0.25,
    duration_s=60.0,
    clock_offset_s=0.0625,
    position_std_m=0.5,
)
StateMaker = Callable[..., ObjectState]


@pytest.fixture
def spec(run: RunSpec) -> RunSpec:
    return run.model_copy(update={"limits": LIMITS, "geofence": FENCE})


# -- separation -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gap_m", "code"),
    [(0.0, SafetyCode.COLLISION), (0.5 - 2.0**-20, SafetyCode.SEPARATION), (0.5, None)],
)
def test_separation(state: StateMaker, gap_m: float, code: SafetyCode | None) -> None:
    size = replace(state().size, front_m=3.5, rear_m=1.0, width_m=2.0)
    vut, other = state("vut", size=size, stamp_ns=7), state("ot1", size=size, x_m=4.5 + gap_m)
    found = limits.too_near([vut, other], LIMITS)
    assert [(v.code, v.object_id, v.stamp_ns, v.detail, v.measured) for v in found] == (
        [] if code is None else [(code, "ot1", 7, "vut and ot1", gap_m)]
    )


@pytest.mark.parametrize("gap_m", [0.0, 0.25])
def test_in_a_driven_run_only_objects_keep_apart(
    state: StateMaker, spec: RunSpec, gap_m: float
) -> None:
    """The VUT's separation is the driver's matter there, that between objects is a limit still."""
    driven = Driven(driver="no_response", first_request_s=1.0, hand_over_s=2.0, end_s=9.0)
    length_m = state().size.front_m + state().size.rear_m
    places = {"vut": 0.0, "ot1": length_m + gap_m, "ot2": 2.0 * (length_m + gap_m)}
    everyone = [state(one, x_m=x_m, **DRIVING) for one, x_m in places.items()]
    code = SafetyCode.COLLISION if gap_m == 0.0 else SafetyCode.SEPARATION
    for run, pairs in (
        (spec, ["vut and ot1", "ot1 and ot2"]),
        (spec.model_copy(update={"driven": driven}), ["ot1 and ot2"]),
    ):
        found = violations(everyone, run)
        assert [(one.code, one.detail) for one in found] == [(code, pair) for pair in pairs]


# -- times ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("limit_s", [0.125, 2.0])
def test_silence(limit_s: float) -> None:
    def violation_at(age_s: float) -> Violation | None:
        return limits.silent(SafetyCode.RECORDER, "monitor", age_s, limit_s, 3)

    for age_s in (0.0, math.nextafter(limit_s, 0.0), limit_s):
        assert violation_at(age_s) is None
    for age_s in (math.nextafter(limit_s, 9.0), math.inf):
        assert violation_at(age_s) == Violation(SafetyCode.RECORDER, "monitor", age_s, limit_s, 3)
    assert violation_at(math.nan) is not None


@pytest.mark.parametrize("allowance_ns", [0, S // 4])
@pytest.mark.parametrize(
    ("ahead_ns", "passed"), [(-9 * S, 0), (0, 0), (S // 16 - 1, 0), (S // 16, 0), (S // 16 + 1, 1)]
)
def test_a_stamp_ahead_of_time(
    state: StateMaker, ahead_ns: int, passed: bool, allowance_ns: int
) -> None:
    stamped = state("ot1", stamp_ns=5 * S + ahead_ns + allowance_ns)
    found = limits.stamp_ahead(stamped, 5 * S, allowance_ns / S, LIMITS)
    assert (found is not None) == passed
    if found is not None:
        assert (found.code, found.object_id, found.limit, found.stamp_ns) == (
            SafetyCode.CLOCK_OFFSET,
            "ot1",
            0.0625,
            5 * S,
        )
        # Heartbeats measure the same.
        assert found.detail == "its states are stamped ahead of time"


# -- counts ---------------------------------------------------------------------------------------


def test_one_is_too_many() -> None:
    assert limits.too_many(SafetyCode.RECORDER, 0, 7, "x") is None
    for count in (1, 12):
        found = limits.too_many(SafetyCode.RECORDER, count, 7, "x")
        assert found == Violation(SafetyCode.RECORDER, "", count, 0.0, 7, "x")


# -- together -------------------------------------------------------------------------------------

DRIVING = {"reference_id": "r", "control_state": ControlState.RUNNING}
OF_A_STATE: list[tuple[SafetyCode, dict[str, Any], dict[str, Any]]] = [
    (SafetyCode.OVER_SPEED, {"speed_mps": 15.0}, {"speed_mps": 15.0 + 1e-9}),
    (SafetyCode.OVER_SPEED, {"speed_mps": -15.0}, {"speed_mps": -15.0 - 1e-9}),
    (SafetyCode.LOCALISATION, {"position_std_m": 0.5}, {"position_std_m": 0.5 + 1e-9}),
    (SafetyCode.LOCALISATION, {}, {"position_std_m": math.nan}),
    # Its front is 3.6 m ahead of its reference point.
    (SafetyCode.OUTSIDE_GEOFENCE, {"x_m": 996.4 - 1e-6}, {"x_m": 996.4 + 1e-6}),
    *(
        (code, {"reference_id": "r", name: -limit}, {"reference_id": "r", name: outside})
        for code, name, limit, outside in (
            (SafetyCode.ERROR_LONGITUDINAL, "error_longitudinal_m", 2.0, -2.0 - 1e-9),
            (SafetyCode.ERROR_LATERAL, "error_lateral_m", 0.75, 0.75 + 1e-9),
            (SafetyCode.ERROR_YAW, "error_yaw_rad", 0.25, math.nan),
        )
    ),
    (
        SafetyCode.OVER_ACCELERATION,
        {"acceleration_mps2": -5.0, **DRIVING},
        {"acceleration_mps2": -5.0 - 1e-9, **DRIVING},
    ),
]


@pytest.mark.parametrize(("code", "inside", "outside"), OF_A_STATE)
@pytest.mark.parametrize("who", ["vut", "ot1"])
def test_what_one_state_passes(
    state: StateMaker,
    spec: RunSpec,
    who: str,
    code: SafetyCode,
    inside: dict[str, Any],
    outside: dict[str, Any],
) -> None:
    assert violations([state(who, **inside)], spec) == []
    (found,) = violations([state(who, **outside)], spec)
    assert (found.code, found.object_id) == (code, who)


@pytest.mark.parametrize("changed", [{"reference_id": ""}, {"control_state": ControlState.POSTRUN}])
def test_hard_braking_counts_only_on_a_reference(
    state: StateMaker, spec: RunSpec, changed: dict[str, Any]
) -> None:
    """A vehicle under test may brake as hard as it can; so may an object that stops."""
    given = {**DRIVING, "acceleration_mps2": -9.0, **changed}
    if not given["reference_id"]:
        given["error_lateral_m"] = 9.0  # says nothing then
    braking = state("ot1", **given)
    assert violations([braking], spec) == []


@pytest.mark.parametrize(
    "field", ["x_m", "y_m", "yaw_rad", "speed_mps", "acceleration_mps2", "yaw_rate_radps"]
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("who", ["vut", "ot1"])
def test_no_number_is_a_violation_and_hides_no_other(
    state: StateMaker, spec: RunSpec, field: str, value: float, who: str
) -> None:
    states = {"vut": state("vut"), "ot1": state("ot1", x_m=50.0)}
    states[who] = replace(states[who], **{field: value})
    fast = state("ot2", x_m=90.0, speed_mps=20.0)
    found = violations([*states.values(), fast], spec)
    assert [(v.code, v.object_id) for v in found] == [
        (SafetyCode.STATE_NOT_FINITE, who),
        (SafetyCode.OVER_SPEED, "ot2"),
    ]


def test_all_pairs_are_looked_at_and_collisions_come_first(
    state: StateMaker, spec: RunSpec
) -> None:
    a = state("ot1", x_m=50.0, reference_id="r", error_lateral_m=1.0)
    b = state("ot2", x_m=54.75)  # 0.25 m ahead of ot1
    c = state("ot3", x_m=56.0)  # in ot2
    found = violations([state("vut"), a, b, c], spec)
    assert [(v.code, v.detail or v.object_id) for v in found] == [
        (SafetyCode.COLLISION, "ot2 and ot3"),
        (SafetyCode.SEPARATION, "ot1 and ot2"),
        (SafetyCode.ERROR_LATERAL, "ot1"),
    ]
    assert violations([state("vut"), state("ot1", x_m=50.0)], spec) == []


def test_the_reason_names_everything() -> None:
    violation = Violation(SafetyCode.SEPARATION, "ot1", 0.31234, 0.5, 0, "vut and ot1")
    assert violation.text == "separation: ot1: 0.312 m, limit 0.5 m (vut and ot1)"
    assert Violation(SafetyCode.RECORDER, "", 3.0, 0.0, 0).text == "recorder: 3, limit 0"


# -- verdicts -------------------------------------------------------------------------------------

VERDICTS = {
    Verdict.ABORTED: "OPERATOR OBJECT_SILENT VUT_SILENT HEARTBEAT_LOST ACK_MISSING "
    "REFERENCE_REFUSED STATE_STALE REPLY_MISSING CLOCK_OFFSET LINK_DELAY CONNECTION_LOST",
    Verdict.INVALID_HARNESS: "RECORDER WORLD_SILENT PARTICIPANT_LOST OVERRUN FOREIGN_MANAGER",
    Verdict.OFF_SPEC: "EVENT_MISSING",
    Verdict.FAILED_SAFETY: "STATE_NOT_FINITE OUTSIDE_GEOFENCE OVER_SPEED OVER_ACCELERATION "
    "ERROR_LONGITUDINAL ERROR_LATERAL ERROR_YAW LOCALISATION POSITION_JUMP STATE_FROZEN "
    "STOPPING_ROOM SEPARATION COLLISION OBJECT_ABORTED DURATION NOT_STOPPING "
    "OBJECT_CONTRADICTS STATE_CONTRADICTS",
}
EXPECTED = {SafetyCode[name]: v for v, codes in VERDICTS.items() for name in codes.split()}


@pytest.mark.parametrize("code", SafetyCode)
def test_every_code_has_a_meaning_and_its_verdict(code: SafetyCode) -> None:
    meaning = MEANINGS[code]
    assert meaning.limit_name == code.name.lower()
    assert meaning.text.endswith(".")
    assert verdict_for(code) is EXPECTED[code]
    assert verdict_for(code) not in (Verdict.NONE, Verdict.VALID)


@pytest.mark.parametrize("off_s", [1.8e9, -1.8e9, 3600.0, -2.1, 2.1])
def test_an_event_of_another_clock_or_run_counts_now_and_says_so(off_s: float) -> None:
    now_ns = 12_000_000_000
    seen = limits.Violation(
        SafetyCode.OVER_SPEED, "ot1", 9.0, 8.0, now_ns + round(off_s * 1e9), "seen by x"
    )
    taken = limits.in_session_time(seen, now_ns)
    assert taken.stamp_ns == now_ns
    assert taken.text == (
        "over_speed: ot1: 9 m/s, limit 8 m/s "
        f"(seen by x, stamped {off_s:+.3g} s from the session's time)"
    )


@pytest.mark.parametrize("off_s", [-2.0, -0.5, 0.0, 2.0])
def test_an_event_that_was_under_way_keeps_its_time(off_s: float) -> None:
    stamp_ns = 12 * S + round(off_s * S)
    seen = limits.Violation(SafetyCode.OVER_SPEED, "ot1", 9.0, 8.0, stamp_ns, "seen by x")
    assert limits.in_session_time(seen, 12 * S) is seen


# -- the manager's own lateness -------------------------------------------------------------------

SEEM_SO_TO_A_LATE_MANAGER = {
    SafetyCode.OBJECT_ABORTED,
    SafetyCode.HEARTBEAT_LOST,
    SafetyCode.WORLD_SILENT,
    SafetyCode.VUT_SILENT,
    SafetyCode.OBJECT_SILENT,
    SafetyCode.REPLY_MISSING,
    SafetyCode.ACK_MISSING,
    SafetyCode.CLOCK_OFFSET,
    SafetyCode.LINK_DELAY,
    SafetyCode.PARTICIPANT_LOST,
    SafetyCode.RECORDER,
}


@pytest.mark.parametrize("code", SafetyCode)
def test_a_manager_that_stood_still_takes_only_silences_and_delays_on_itself(
    code: SafetyCode,
) -> None:
    """Two that collided meanwhile did collide."""
    violation = Violation(code, "ot1", 3.0, 0.5, 7)
    reason = limits.own_lateness(violation, 3.0, 0.5)
    if code in SEEM_SO_TO_A_LATE_MANAGER:
        assert (reason.code, reason.object_id) == (SafetyCode.OVERRUN, "scenario_manager")
        assert (reason.measured, reason.limit, reason.stamp_ns) == (3.0, 0.5, 7)
        assert f"{MEANINGS[code].limit_name} of ot1" in reason.detail
    else:
        assert reason is violation


def test_messages_that_a_recorder_lost_are_lost_however_late_the_manager_was() -> None:
    loss = limits.too_many(SafetyCode.RECORDER, 3, 7, "messages lost by the recorder")
    assert loss is not None
    assert limits.own_lateness(loss, 3.0, 0.5) is loss


@pytest.mark.parametrize(
    ("code", "late_s", "is_own"),
    [
        (SafetyCode.OBJECT_ABORTED, 0.75, False),
        (SafetyCode.OBJECT_ABORTED, 1.0, False),
        (SafetyCode.OBJECT_ABORTED, 1.25, True),
        (SafetyCode.HEARTBEAT_LOST, 0.75, False),
        (SafetyCode.HEARTBEAT_LOST, 1.25, True),
        # What the manager itself finds needs no heartbeat.
        (SafetyCode.OBJECT_SILENT, 0.75, True),
    ],
)
def test_an_object_that_bears_a_longer_pause_stopped_for_a_reason_of_its_own(
    code: SafetyCode, late_s: float, is_own: bool
) -> None:
    """Its heartbeat limit is 1 s."""
    violation = Violation(code, "ot1", 3.0, 0.3, 0)
    reason = limits.own_lateness(violation, late_s, 1.0)
    assert (reason.code is SafetyCode.OVERRUN) is is_own
    assert is_own or reason is violation
