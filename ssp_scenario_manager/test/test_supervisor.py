"""Limits of the session: at, just inside and just outside; and a verdict for every code."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import pytest

from ssp_core.run_spec import Limits
from ssp_core.safety_codes import MEANINGS, SafetyCode
from ssp_core.state import ObjectState
from ssp_core.vocab import ControlState, Verdict
from ssp_scenario_manager.core import supervisor
from ssp_scenario_manager.core.supervisor import Violation, verdict_for, violations

S = 1_000_000_000
FENCE = [(-100.0, -100.0), (1000.0, -100.0), (1000.0, 100.0), (-100.0, 100.0)]
# Values that binary fractions hold exactly, so that "at the limit" is exactly that.
LIMITS = Limits(
    speed_mps=15.0,
    acceleration_mps2=5.0,
    separation_m=0.5,
    ack_s=0.5,
    error_longitudinal_m=2.0,
    error_lateral_m=0.75,
    error_yaw_rad=0.25,
    duration_s=60.0,
)
StateMaker = Callable[..., ObjectState]


# -- separation -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gap_m", "code"),
    [
        (-0.25, SafetyCode.COLLISION),
        (0.0, SafetyCode.COLLISION),  # touching
        (2.0**-20, SafetyCode.SEPARATION),
        (0.5 - 2.0**-20, SafetyCode.SEPARATION),
        (0.5, None),
        (0.5 + 2.0**-20, None),
        (30.0, None),
    ],
)
def test_separation(state: StateMaker, gap_m: float, code: SafetyCode | None) -> None:
    size = replace(state().size, front_m=3.5, rear_m=1.0, width_m=2.0)
    vut = state("vut", size=size, stamp_ns=7)
    for other in (
        state("ot1", size=size, x_m=4.5 + gap_m),  # ahead
        state("ot1", size=size, x_m=-4.5 - gap_m),  # behind
        state("ot1", size=size, y_m=2.0 + gap_m),  # beside
    ):
        found = supervisor.separation(vut, other, LIMITS)
        if code is None:
            assert found is None
            continue
        assert found is not None
        assert (found.code, found.object_id, found.stamp_ns) == (code, "ot1", 7)
        assert found.measured == pytest.approx(max(gap_m, 0.0), abs=1e-12)
        assert found.limit == (0.5 if code is SafetyCode.SEPARATION else 0.0)


def test_separation_of_large_and_turned_objects_is_not_skipped(state: StateMaker) -> None:
    """The quick test by distance must not hide a near miss of corners."""
    size = replace(state().size, front_m=9.0, rear_m=3.0, width_m=2.5)
    bus = state("ot1", size=size)
    for degrees in range(0, 360, 15):
        yaw = math.radians(degrees)
        corner = max(state("vut", yaw_rad=yaw).box.corners(), key=lambda p: p[0])
        # The VUT's foremost corner 0.2 m behind the bus, at the middle of its rear.
        vut = state("vut", yaw_rad=yaw, x_m=-3.2 - corner[0], y_m=-corner[1])
        found = supervisor.separation(vut, bus, LIMITS)
        assert found is not None
        assert found.measured == pytest.approx(0.2)


def test_separation_does_not_depend_on_the_place(state: StateMaker) -> None:
    """A walker right of a turned bus's tail, all far from the origin."""
    size = replace(state().size, front_m=2.0, rear_m=9.0, width_m=2.5)
    for x_m, y_m in ((300.0, -80.0), (-300.0, 80.0), (300.0, 80.0)):
        bus = state("ot1", size=size, x_m=x_m, y_m=y_m, yaw_rad=math.pi / 2)
        for dx_m, dy_m in ((1.6, -8.9), (-1.6, -8.9), (0.0, -9.35), (0.0, 2.35)):
            walker = state(
                "ot2",
                size=replace(size, front_m=0.1, rear_m=0.1, width_m=0.2),
                x_m=x_m + dx_m,
                y_m=y_m + dy_m,
            )
            found = supervisor.separation(bus, walker, LIMITS)
            assert found is not None
            assert found.measured == pytest.approx(0.25)
        away = replace(walker, y_m=y_m + 2.7)
        assert supervisor.separation(bus, away, LIMITS) is None


# -- times ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("age_s", "passed"), [(0.0, False), (0.5, False), (0.5 + 1e-9, True), (math.inf, True)]
)
def test_silent(age_s: float, passed: bool) -> None:
    found = supervisor.silent(SafetyCode.VUT_SILENT, "vut", age_s, 0.5, 3)
    assert found == (Violation(SafetyCode.VUT_SILENT, "vut", age_s, 0.5, 3) if passed else None)


@pytest.mark.parametrize(("age_ns", "passed"), [(S // 2 - 1, 0), (S // 2, 0), (S // 2 + 1, 1)])
def test_ack_missing(age_ns: int, passed: bool) -> None:
    found = supervisor.ack_missing("ot1", 2 * S, 2 * S + age_ns, LIMITS)
    assert (found is not None) == passed
    if found is not None:
        assert (found.code, found.object_id, found.limit) == (SafetyCode.ACK_MISSING, "ot1", 0.5)


@pytest.mark.parametrize(("age_ns", "passed"), [(60 * S - 1, 0), (60 * S, 0), (60 * S + 1, 1)])
def test_duration(age_ns: int, passed: bool) -> None:
    found = supervisor.duration(S, S + age_ns, LIMITS)
    assert (found is not None) == passed
    if found is not None:
        assert (found.code, found.limit) == (SafetyCode.DURATION, 60.0)


# -- reports of objects ---------------------------------------------------------------------------


@pytest.mark.parametrize("control_state", ControlState)
def test_own_abort(state: StateMaker, control_state: ControlState) -> None:
    found = supervisor.own_abort(state("ot1", control_state=control_state))
    assert (found is not None) == (control_state is ControlState.ABORTING)


ERRORS = {
    "error_longitudinal_m": (SafetyCode.ERROR_LONGITUDINAL, 2.0),
    "error_lateral_m": (SafetyCode.ERROR_LATERAL, 0.75),
    "error_yaw_rad": (SafetyCode.ERROR_YAW, 0.25),
}


@pytest.mark.parametrize("name", ERRORS)
@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("factor", "passed"),
    [(0.0, False), (1 - 1e-12, False), (1.0, False), (1 + 1e-12, True), (math.nan, True),
     (math.inf, True)],
)  # fmt: skip
def test_tracking_error(
    state: StateMaker, name: str, sign: float, factor: float, passed: bool
) -> None:
    code, limit = ERRORS[name]
    reported = state("ot1", reference_id="r", **{name: sign * factor * limit})
    found = supervisor.tracking_error(reported, LIMITS)
    assert (found is not None) == passed
    if found is not None:
        assert (found.code, found.object_id, found.limit) == (code, "ot1", limit)
    # Without a reference the fields say nothing.
    assert supervisor.tracking_error(replace(reported, reference_id=""), LIMITS) is None


@pytest.mark.parametrize(
    "field", ["x_m", "y_m", "yaw_rad", "speed_mps", "acceleration_mps2", "yaw_rate_radps"]
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("who", ["vut", "ot1"])
def test_no_number_is_a_violation_and_nothing_else(
    state: StateMaker, field: str, value: float, who: str
) -> None:
    states = {"vut": state("vut"), "ot1": state("ot1", x_m=50.0)}
    states[who] = replace(states[who], **{field: value})
    (found,) = violations(states["vut"], [states["ot1"]], LIMITS, FENCE)
    assert (found.code, found.object_id) == (SafetyCode.STATE_NOT_FINITE, who)


# -- together -------------------------------------------------------------------------------------


def test_all_pairs_are_looked_at_and_collisions_come_first(state: StateMaker) -> None:
    a = state("ot1", x_m=50.0, reference_id="r", error_lateral_m=1.0)
    b = state("ot2", x_m=54.75)  # 0.25 m ahead of ot1
    c = state("ot3", x_m=56.0)  # in ot2
    found = violations(state("vut"), [a, b, c], LIMITS, FENCE)
    assert [(v.code, v.detail or v.object_id) for v in found] == [
        (SafetyCode.COLLISION, "ot2 and ot3"),
        (SafetyCode.SEPARATION, "ot1 and ot2"),
        (SafetyCode.ERROR_LATERAL, "ot1"),
    ]
    assert violations(state("vut"), [state("ot1", x_m=50.0)], LIMITS, FENCE) == []


def test_the_reason_names_everything() -> None:
    violation = Violation(SafetyCode.SEPARATION, "ot1", 0.31234, 0.5, 0, "vut and ot1")
    assert violation.text == "separation: ot1: 0.312 m, limit 0.5 m (vut and ot1)"
    assert Violation(SafetyCode.RECORDER, "", 3.0, 0.0, 0).text == "recorder: 3, limit 0"


# -- verdicts -------------------------------------------------------------------------------------

VERDICTS = {
    Verdict.ABORTED: "OPERATOR OBJECT_SILENT VUT_SILENT HEARTBEAT_LOST ACK_MISSING "
    "REFERENCE_REFUSED STATE_STALE",
    Verdict.INVALID_HARNESS: "RECORDER WORLD_SILENT PARTICIPANT_LOST OVERRUN EVENT_MISSING",
    Verdict.FAILED_SAFETY: "STATE_NOT_FINITE OUTSIDE_GEOFENCE OVER_SPEED OVER_ACCELERATION "
    "ERROR_LONGITUDINAL ERROR_LATERAL ERROR_YAW LOCALISATION SEPARATION COLLISION OBJECT_ABORTED "
    "DURATION",
}
EXPECTED = {SafetyCode[name]: v for v, codes in VERDICTS.items() for name in codes.split()}


@pytest.mark.parametrize("code", SafetyCode)
def test_every_code_has_a_meaning_and_its_verdict(code: SafetyCode) -> None:
    meaning = MEANINGS[code]
    assert meaning.limit_name == code.name.lower()
    assert meaning.text.endswith(".")
    assert verdict_for(code) is EXPECTED[code]
    assert verdict_for(code) not in (Verdict.NONE, Verdict.VALID)


def test_speed_limit_holds_for_the_vut_too(state: StateMaker) -> None:
    limit = LIMITS.speed_mps
    for speed, passed in ((limit - 1e-6, False), (limit, False), (limit + 1e-6, True)):
        for name in ("vut", "ot1"):
            found = supervisor.over_speed(state(name, speed_mps=speed), LIMITS)
            assert (found is not None) is passed
            if found is not None:
                assert (found.code, found.object_id) == (SafetyCode.OVER_SPEED, name)


def test_a_corner_beyond_the_fence_counts(state: StateMaker) -> None:
    inside = state("ot1", x_m=1000.0 - state("ot1").size.front_m - 1e-6)
    beyond = state("ot1", x_m=1000.0 - state("ot1").size.front_m + 1e-6)
    assert supervisor.outside_geofence(inside, FENCE) is None
    found = supervisor.outside_geofence(beyond, FENCE)
    assert found is not None
    assert (found.code, found.measured) == (SafetyCode.OUTSIDE_GEOFENCE, 2.0)
    codes = {v.code for v in violations(beyond, [], LIMITS, FENCE)}
    assert codes == {SafetyCode.OUTSIDE_GEOFENCE}
