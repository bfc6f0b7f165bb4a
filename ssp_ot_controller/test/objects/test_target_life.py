"""One object target over its whole life, on the real plant, and what no sequence may do."""

from __future__ import annotations

import math
from copy import deepcopy
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along, lane_change
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, ObjectClass, SessionPhase
from ssp_ot_controller.bodies.dynamics import LIMITS, BodyState
from ssp_ot_controller.objects.references import RefusalCode
from ssp_ot_controller.objects.state_machine import ObjectEvent
from ssp_ot_controller.objects.target import Target, TargetStep
from tests.support.target_rig import STEP_NS, VERSION, Rig, S, reference, straight


@pytest.fixture
def rig() -> Rig:
    return Rig()


# -- the whole life -------------------------------------------------------------------------------


def test_a_whole_life(rig: Rig) -> None:
    target = rig.target
    assert target.state is ControlState.OFF
    target.power_on()
    assert target.state is ControlState.INIT
    rig.step()
    assert target.state is ControlState.DISARMED
    assert target.command(ObjectEvent.ARM, VERSION, 0.0).accepted
    assert target.state is ControlState.PRE_ARMING
    rig.step()
    assert target.state is ControlState.ARMED
    rig.session = SessionPhase.RUNNING
    rig.step()
    assert target.state is ControlState.RUNNING
    assert rig.body.speed_mps == 0.0

    execute_at_ns = rig.now_ns + S // 2
    assert rig.take(reference("a", execute_at_ns, straight())) is None
    while rig.now_ns < execute_at_ns:
        assert rig.step().report.reference_id == ""
    worst_m = 0.0
    while rig.body.x_m < 120.0:
        report = rig.step().report
        assert report.reference_id == "a"
        worst_m = max(worst_m, abs(report.error_longitudinal_m), abs(report.error_lateral_m))
    assert worst_m < 0.1
    assert rig.body.speed_mps == pytest.approx(8.0, abs=0.05)

    # To the next lane, taking over where the approach will be.
    at_ns = rig.now_ns + S // 5
    along = Polyline([(40.0, 3.5), (300.0, 3.5)])
    station = rig.body.x_m - 40.0 + 8.0 * 0.2
    change = lane_change(along, station, 8.0, -3.5, 2.5, 8.0, 2.0)
    assert rig.take(reference("b", at_ns, change)) is None
    while rig.now_ns < at_ns + 4 * S:
        report = rig.step().report
    assert report.reference_id == "b"
    assert rig.body.y_m == pytest.approx(0.0, abs=0.05)

    rig.session = SessionPhase.STOPPING
    rig.step()
    assert target.state is ControlState.POSTRUN
    for _ in range(200):
        rig.step()
    assert target.state is ControlState.DISARMED
    assert rig.body.speed_mps == 0.0
    assert rig.body.y_m == pytest.approx(0.0, abs=0.05)  # it kept to its path while braking
    assert rig.step().report.reference_id == ""


def test_what_was_accepted_is_accepted_again_however_late_the_copy_comes() -> None:
    rig = Rig()
    rig.start()
    sent = reference("a", rig.now_ns + S // 10, straight())
    late = replace(reference("b", rig.now_ns + S // 10, straight()), purpose="adapted")
    assert rig.take(sent) is None
    for _ in range(30):
        rig.step()
    assert rig.take(sent) is None
    refusal = rig.take(late)
    assert refusal is not None
    assert refusal.code is RefusalCode.LATE
    assert rig.step().report.reference_id == "a"


@pytest.mark.parametrize(("purpose", "goes_on"), [("adapted", True), ("manoeuvre", False)])
def test_an_adapted_reference_that_comes_too_late_stops_nobody_who_drives(
    purpose: str, goes_on: bool
) -> None:
    rig = Rig()
    rig.start()
    assert rig.target.on_reference(reference("a", rig.now_ns + S // 10, straight()), 0) is None
    for _ in range(30):
        rig.step()
    late = replace(reference("b", rig.now_ns - S // 10, straight()), purpose=purpose)
    refusal = rig.take(late)
    assert refusal is not None
    assert refusal.code is RefusalCode.LATE
    assert (rig.step().stopped is None) == goes_on


def test_an_adapted_reference_that_was_overtaken_does_not_replace_the_newer_one() -> None:
    """The manager had the newer one accepted, and plans on from it."""
    rig = Rig()
    rig.start()
    now_ns = rig.now_ns
    older, newer = (
        replace(
            reference(name, now_ns + S // 10 + k * STEP_NS, straight(), now_ns + k),
            purpose="adapted",
        )
        for k, name in enumerate(("older", "newer"))
    )
    assert rig.target.on_reference(newer, now_ns) is None
    refusal = rig.target.on_reference(older, now_ns)
    assert refusal is not None
    assert refusal.code is RefusalCode.LATE
    assert "newer" in refusal.message
    for _ in range(30):
        assert rig.step().stopped is None
    assert rig.step().report.reference_id == "newer"


def test_a_walker_waits_and_crosses() -> None:
    rig = Rig(ObjectClass.PEDESTRIAN)
    rig.body = BodyState(40.0, 3.5, math.pi / 2)
    rig.arm()
    rig.session = SessionPhase.RUNNING
    for _ in range(50):
        rig.step()
    assert (rig.body.x_m, rig.body.y_m) == (40.0, 3.5)
    path = Polyline([(40.0, 3.5), (40.0, 9.5)])
    points = drive_along(path, 0.0, 0.0, 1.5, 1.5, 1.5)
    at_ns = rig.now_ns + S // 10
    assert rig.take(reference("c", at_ns, points)) is None
    while rig.now_ns < at_ns + 8 * S:
        rig.step()
    assert (rig.body.x_m, rig.body.y_m) == pytest.approx((40.0, 9.5), abs=0.1)
    assert rig.body.speed_mps == 0.0
    assert rig.target.state is ControlState.RUNNING


# -- silence of the manager -----------------------------------------------------------------------


@pytest.mark.parametrize("cruise_mps", [3.0, 8.0, 13.0])
def test_silence_stops_it_within_the_blind_distance(cruise_mps: float) -> None:
    """v * timeout + v^2 / 2a, and what the lag of the brakes and the steps add."""
    rig = Rig()
    rig.drive(cruise_mps, 10.0)
    speed = rig.body.speed_mps
    assert speed == pytest.approx(cruise_mps, abs=0.1)
    rig.silence()
    from_x_m, silent_ns = rig.body.x_m, rig.silent_ns
    while rig.step().stopped is None:
        assert rig.now_ns - silent_ns < S
    assert rig.last is not None
    stopped = rig.last.stopped
    assert stopped is not None
    assert stopped.code is SafetyCode.HEARTBEAT_LOST
    assert stopped.limit == 0.5
    # At the limit it goes on; one step later it stops.
    assert stopped.measured == pytest.approx(0.52)
    assert rig.target.state is ControlState.ABORTING
    while rig.body.speed_mps > 0.0:
        assert rig.step().stopped is None  # said once
    limits, body = rig.run.limits, LIMITS[ObjectClass.CAR]
    blind_m = speed * limits.heartbeat_s + speed**2 / (2 * limits.stop_deceleration_mps2)
    build_up_s = body.acceleration_lag_s + limits.stop_deceleration_mps2 / (
        body.acceleration_rate_mps3
    )
    margin_m = speed * (build_up_s + 2 * STEP_NS / S)
    assert blind_m * 0.9 < rig.body.x_m - from_x_m < blind_m + margin_m
    assert rig.target.state is ControlState.ABORTING


def test_a_returning_manager_does_not_start_it_again(rig: Rig) -> None:
    rig.drive()
    rig.silence()
    for _ in range(60):
        rig.step()
    rig.heartbeat_ns = rig.now_ns
    for _ in range(300):
        assert rig.step().command.acceleration_mps2 <= 0.0
    assert rig.target.state is ControlState.ABORTING
    assert rig.body.speed_mps == 0.0


# -- its own clock --------------------------------------------------------------------------------


def test_a_clock_that_is_set_back_stops_it(rig: Rig) -> None:
    """Nothing new is believed then, and the last state would look young for as long as that."""
    rig.drive()
    last = rig.own
    rig.now_ns -= 10 * S
    outcome = rig.target.step(last, rig.now_ns, 0.0)
    assert outcome.stopped is not None
    assert outcome.stopped.code is SafetyCode.CLOCK_OFFSET
    assert outcome.stopped.measured == pytest.approx(10.0)
    assert outcome.command.emergency_stop
    assert rig.target.state is ControlState.ABORTING


def test_a_stamp_from_ahead_before_it_is_armed_hides_no_jump(rig: Rig) -> None:
    rig.target.power_on()
    rig.step()
    rig.step(stamp_ns=rig.now_ns + 18 * S)
    rig.step()
    assert rig.target.command(ObjectEvent.ARM, VERSION, 0.0).accepted
    rig.session = SessionPhase.ARMED
    assert rig.step().stopped is None
    outcome = rig.step(x_m=rig.body.x_m + 5.0)
    assert outcome.stopped is not None
    assert outcome.stopped.code is SafetyCode.POSITION_JUMP


def test_no_run_lasts_longer_than_the_site_allows_though_the_manager_goes_on(rig: Rig) -> None:
    rig.arm()
    rig.session = SessionPhase.RUNNING
    began_ns = rig.now_ns
    while (outcome := rig.step()).stopped is None:
        assert rig.now_ns - began_ns <= 61 * S
    assert outcome.stopped.code is SafetyCode.DURATION
    assert outcome.stopped.measured == pytest.approx(60.02)
    # It was another run's time.
    rig.session = SessionPhase.ABORTED
    rig.step()
    rig.session = SessionPhase.IDLE
    assert rig.target.command(ObjectEvent.ALL_CLEAR, VERSION, 0.0).accepted
    assert rig.target.command(ObjectEvent.ARM, VERSION, 0.0).accepted
    rig.session = SessionPhase.RUNNING
    for _ in range(10):
        assert rig.step().stopped is None
    assert rig.target.state is ControlState.RUNNING


# -- what no sequence may do ----------------------------------------------------------------------

events = st.one_of(
    st.tuples(st.just("step"), st.integers(1, 20)),
    st.tuples(st.just("command"), st.sampled_from([e for e in ObjectEvent if e != 7])),
    st.tuples(st.just("session"), st.sampled_from(list(SessionPhase))),
    st.tuples(st.just("reference"), st.integers(-5, 50)),
    st.tuples(st.just("silence")),
    st.tuples(st.just("beat")),
    st.tuples(
        st.just("broken"),
        st.sampled_from(["x_m", "y_m", "yaw_rad", "speed_mps"]),
        st.sampled_from([math.nan, math.inf, -1e9, 1e9, 0.5]),
    ),
)


@cache
def driving() -> Rig:
    """A target that has driven for four seconds."""
    rig = Rig()
    rig.drive(seconds=4.0)
    return rig


@settings(
    max_examples=60,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
@given(
    before=st.lists(events, max_size=8),
    cause=st.sampled_from(["command", "session", "silence", "nan"]),
    after=st.lists(events, max_size=15),
)
def test_after_an_abort_nothing_makes_it_accelerate(
    before: list[tuple[Any, ...]], cause: str, after: list[tuple[Any, ...]]
) -> None:
    """The target accelerates again only after all_clear, which the commands here leave out."""
    rig = deepcopy(driving())

    def apply(event: tuple[Any, ...]) -> None:
        if event[0] == "step":
            for _ in range(event[1]):
                check(rig.step())
        elif event[0] == "command":
            rig.target.command(event[1], VERSION, 0.0)
        elif event[0] == "session":
            rig.session = event[1]
        elif event[0] == "reference":
            at_ns = rig.now_ns + event[1] * STEP_NS
            x_m = rig.body.x_m + rig.body.speed_mps * max(event[1], 0) * STEP_NS / S
            path = Polyline([(x_m, rig.body.y_m), (x_m + 150.0, rig.body.y_m)])
            points = drive_along(path, 0.0, rig.body.speed_mps, 12.0, 2.0, 2.0)
            rig.take(reference(f"n{rig.now_ns}", at_ns, points))
        elif event[0] == "silence":
            if rig.heartbeat_ns is not None:
                rig.silence()
        elif event[0] == "beat":
            rig.heartbeat_ns = rig.now_ns
        else:
            check(rig.step(**{event[1]: event[2]}))

    aborted = False

    def check(outcome: TargetStep) -> None:
        assert outcome.command.is_finite
        if aborted:
            assert outcome.command.emergency_stop or outcome.command.acceleration_mps2 < 0.0
            assert rig.target.state is ControlState.ABORTING

    for event in before:
        apply(event)
    if cause == "command":
        rig.target.command(ObjectEvent.ABORT, "", 0.0)
    elif cause == "session":
        rig.session, rig.heartbeat_ns = SessionPhase.ABORTING, rig.now_ns
        rig.step()
    elif cause == "silence":
        rig.silence()
        for _ in range(30):
            rig.step()
    else:
        rig.step(y_m=math.nan)
    # A stop by itself is for an object that may move; one that stands disarmed needs none.
    if rig.target.state is not ControlState.ABORTING:
        assert cause in ("silence", "nan")
        return
    aborted = True
    for event in after:
        apply(event)
    for _ in range(250):
        check(rig.step())
    assert rig.body.speed_mps == 0.0


def test_an_object_whose_states_contradict_its_places_stops_and_is_not_armed() -> None:
    rig = Rig()
    rig.drive(seconds=4.0)
    for _ in range(60):
        outcome = rig.step(speed_mps=0.6 * rig.body.speed_mps)
        if outcome.stopped is not None:
            break
    assert outcome.stopped is not None
    assert outcome.stopped.code is SafetyCode.STATE_CONTRADICTS
    assert outcome.command.emergency_stop
    while rig.body.speed_mps > 0.0:
        rig.step(speed_mps=0.6 * rig.body.speed_mps)
    for _ in range(100):
        rig.step()
    rig.session = SessionPhase.ABORTED
    rig.step()
    rig.session = SessionPhase.CONNECTED
    rig.step()
    assert rig.target.command(ObjectEvent.ALL_CLEAR, VERSION, 0.0).accepted
    refusal = rig.target.command(ObjectEvent.ARM, VERSION, 0.0)
    assert not refusal.accepted
    assert "its states contradict its places: speed contradicts the way" in refusal.error_msg


@pytest.mark.parametrize(("start_rad", "stops"), [(0.3, False), (math.pi, True)])
def test_an_object_whose_heading_is_unknown_at_rest_stops_where_it_leaves_the_other_way(
    start_rad: float, stops: bool
) -> None:
    rig = Rig()
    one = rig.run.targets[0]
    start = one.start.model_copy(update={"yaw_rad": start_rad})
    limits = rig.run.limits.model_copy(update={"heading_by_course": ["ot1"]})
    targets = [one.model_copy(update={"start": start})]
    rig.target = Target("ot1", rig.run.model_copy(update={"limits": limits, "targets": targets}))
    rig.start()
    assert rig.take(reference("a", rig.now_ns + S // 2, straight(8.0))) is None
    outcomes = [rig.step() for _ in range(150)]
    stopped = [one.stopped for one in outcomes if one.stopped is not None]
    assert [one.code for one in stopped] == ([SafetyCode.STATE_CONTRADICTS] if stops else [])
    assert (rig.body.x_m < 42.0) is stops


def test_an_object_with_an_empty_twist_is_not_cleared_while_it_moves() -> None:
    rig = Rig()
    rig.drive(seconds=4.0)
    rig.session = SessionPhase.ABORTING
    rig.step(speed_mps=0.0)
    rig.session = SessionPhase.CONNECTED
    while rig.body.speed_mps > 0.5:
        rig.step(speed_mps=0.0)
        assert not rig.target.command(ObjectEvent.ALL_CLEAR, VERSION, 0.0).accepted
