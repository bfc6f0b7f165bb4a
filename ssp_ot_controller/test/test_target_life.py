"""One object target over its whole life, on the real plant, and what no sequence may do."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along, lane_change
from ssp_core.motion.reference import Reference, ReferencePoint
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, ObjectClass, SessionPhase
from ssp_ot_controller.bodies.dynamics import LIMITS, BodyState, step_body
from ssp_ot_controller.objects.references import Refusal, RefusalCode
from ssp_ot_controller.objects.state_machine import ObjectEvent
from ssp_ot_controller.objects.target import Target, TargetStep
from support.runs import small_run
from support.states import make_reference, state_of_body

S = 1_000_000_000
STEP_NS = 20_000_000
VERSION = "sha256:event"


def run_of(object_class: str = "car") -> RunSpec:
    start = {"x_m": 40.0, "y_m": 3.5, "yaw_rad": 0.0}
    return RunSpec.model_validate(
        small_run(
            vut={"id": "vut", "object_class": "car", "start": {**start, "x_m": 10.0}},
            targets=[{"id": "ot1", "object_class": object_class, "start": start}],
        )
    )


def reference(
    name: str, execute_at_ns: int, points: list[ReferencePoint], dispatched_ns: int = 0
) -> Reference:
    return make_reference(
        points,
        reference_id=name,
        event_version=VERSION,
        dispatched_ns=dispatched_ns,
        execute_at_ns=execute_at_ns,
        expires_at_ns=execute_at_ns + S,
    )


def straight(cruise_mps: float = 8.0, end_x_m: float = 200.0) -> list[ReferencePoint]:
    path = Polyline([(40.0, 3.5), (end_x_m, 3.5)])
    return drive_along(path, 0.0, 0.0, cruise_mps, 2.0, 2.0)


class Rig:
    """A target and its body in closed loop, stepped as the SIL world does."""

    def __init__(self, object_class: ObjectClass = ObjectClass.CAR) -> None:
        self.run = run_of(object_class.word)
        self.target = Target("ot1", self.run)
        self.cls = object_class
        self.body = BodyState(40.0, 3.5, 0.0)
        self.now_ns = 0
        self.heartbeat_ns: int | None = 0
        self.session = SessionPhase.CONNECTED
        self.last: TargetStep | None = None

    @property
    def own(self) -> ObjectState:
        return state_of_body(self.body, self.now_ns, "ot1", self.cls)

    def step(self, **broken: Any) -> TargetStep:
        """Heartbeat, judgement, and the body's motion until the next step."""
        if self.heartbeat_ns is not None:
            self.heartbeat_ns = self.now_ns
            self.target.on_session_state(self.session)
        since_ns = self.heartbeat_ns if self.heartbeat_ns is not None else self.silent_ns
        own = replace(self.own, **broken)
        outcome = self.target.step(own, self.now_ns, (self.now_ns - since_ns) / S)
        command = outcome.command
        self.body = step_body(self.cls, self.body, command, STEP_NS / S)
        self.now_ns += STEP_NS
        self.last = outcome
        return outcome

    def silence(self) -> None:
        """The manager is heard for the last time in the step before."""
        self.silent_ns, self.heartbeat_ns = self.now_ns - STEP_NS, None

    def arm(self) -> None:
        self.target.power_on()
        self.step()
        assert self.target.command(ObjectEvent.ARM, VERSION, 0.0).accepted
        self.session = SessionPhase.ARMED
        self.step()
        assert self.target.state is ControlState.ARMED

    def start(self) -> None:
        """Armed and started; nothing is asked of it yet."""
        self.arm()
        self.session = SessionPhase.RUNNING
        self.step()

    def take(self, reference: Reference) -> Refusal | None:
        return self.target.on_reference(reference, self.now_ns)

    def drive(self, cruise_mps: float = 8.0, seconds: float = 8.0) -> None:
        """Armed, started, on its way at cruise speed."""
        self.start()
        assert self.take(reference("a", self.now_ns + S // 2, straight(cruise_mps))) is None
        while self.now_ns < seconds * S:
            self.step()


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


# -- references -----------------------------------------------------------------------------------


REFUSED: dict[str, tuple[Callable[[int], Reference], RefusalCode]] = {
    "late": (lambda now: reference("x", now - 1, straight()), RefusalCode.LATE),
    "somebody else's": (
        lambda now: replace(reference("x", now, straight()), object_id="ot2"),
        RefusalCode.MALFORMED,
    ),
    "starts elsewhere": (lambda now: reference("x", now, straight()), RefusalCode.DISCONTINUOUS),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_refused_reference_stops_it_along_its_old_one(rig: Rig, name: str) -> None:
    make, code = REFUSED[name]
    rig.drive()
    refusal = rig.take(make(rig.now_ns))
    assert isinstance(refusal, Refusal)
    assert refusal.code is code
    outcome = rig.step()
    assert outcome.stopped is not None
    assert outcome.stopped.code is SafetyCode.REFERENCE_REFUSED
    assert outcome.stopped.measured == code
    assert not outcome.command.emergency_stop
    for _ in range(200):
        outcome = rig.step()
        assert outcome.stopped is None
        assert outcome.report.reference_id == "a"
    assert rig.target.state is ControlState.ABORTING
    assert rig.body.speed_mps == 0.0
    assert rig.body.y_m == pytest.approx(3.5, abs=0.02)


def test_a_refusal_does_not_stop_an_object_that_stands_unarmed(rig: Rig) -> None:
    rig.target.power_on()
    rig.step()
    assert rig.take(reference("a", rig.now_ns, straight())) is not None
    assert rig.step().stopped is None
    assert rig.target.state is ControlState.DISARMED


def test_without_a_further_reference_it_stands_at_the_end(rig: Rig) -> None:
    rig.drive(seconds=40.0)
    assert rig.body.speed_mps == 0.0
    assert rig.body.x_m == pytest.approx(200.0, abs=0.2)
    assert rig.target.state is ControlState.RUNNING


def test_a_manoeuvre_that_waits_at_an_abort_never_begins(rig: Rig) -> None:
    rig.drive()
    at_ns = rig.now_ns + S // 5
    along = Polyline([(40.0, 3.5), (300.0, 3.5)])
    change = lane_change(along, rig.body.x_m - 40.0 + 1.6, 8.0, -3.5, 2.5, 8.0, 2.0)
    assert rig.take(reference("b", at_ns, change)) is None
    rig.session = SessionPhase.ABORTING
    for _ in range(200):
        assert rig.step().report.reference_id == "a"
    assert rig.body.speed_mps == 0.0
    assert rig.body.y_m == pytest.approx(3.5, abs=0.05)


# -- its own state --------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "field", ["x_m", "y_m", "yaw_rad", "speed_mps", "acceleration_mps2", "yaw_rate_radps"]
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_a_state_that_is_no_number_stops_it(rig: Rig, field: str, value: float) -> None:
    rig.drive()
    outcome = rig.step(**{field: value})
    assert outcome.stopped is not None
    assert outcome.stopped.code is SafetyCode.STATE_NOT_FINITE
    assert rig.target.state is ControlState.ABORTING
    assert outcome.command.is_finite
    assert outcome.command.emergency_stop
    outcome = rig.step(**{field: value})
    assert outcome.command.is_finite


def test_no_number_keeps_it_from_leaving_init_and_from_arming(rig: Rig) -> None:
    rig.target.power_on()
    rig.step(x_m=math.nan)
    assert rig.target.state is ControlState.INIT
    rig.step()
    rig.target.command(ObjectEvent.ARM, VERSION, 0.0)
    rig.step(speed_mps=0.03)
    assert rig.target.state is ControlState.PRE_ARMING
    rig.step(speed_mps=0.02)
    assert rig.target.state is ControlState.ARMED


def test_leaving_the_fence_stops_it(rig: Rig) -> None:
    """Pushed sideways where it stands armed: no jump, and no path that it could be off."""
    rig.arm()
    for k in range(30):
        outcome = rig.step(y_m=3.5 + 0.3 * k)
        if 3.5 + 0.3 * k + 0.9 > 12.0:
            break
        assert outcome.stopped is None
    assert outcome.stopped is not None
    assert outcome.stopped.code is SafetyCode.OUTSIDE_GEOFENCE


# -- commands -------------------------------------------------------------------------------------


def test_all_clear_only_at_standstill(rig: Rig) -> None:
    rig.drive()
    rig.session = SessionPhase.ABORTING
    rig.step()
    reply = rig.target.command(ObjectEvent.ALL_CLEAR, "", 0.0)
    assert (reply.accepted, reply.error_code) == (False, 2)
    assert rig.target.state is ControlState.ABORTING
    rig.session = SessionPhase.ABORTED
    for _ in range(200):
        rig.step()
    assert rig.target.command(ObjectEvent.ALL_CLEAR, "", 0.0).accepted
    assert rig.target.state is ControlState.DISARMED
    rig.session = SessionPhase.IDLE
    assert rig.step().report.reference_id == ""  # the old reference is forgotten


def test_an_all_clear_clears_the_abort_that_it_names_and_no_other(rig: Rig) -> None:
    rig.drive()
    target, clear = rig.target, partial(rig.target.command, ObjectEvent.ALL_CLEAR, "", 0.0)
    target.local_stop()
    for _ in range(200):
        rig.step()
    # The session hasn't aborted for this stop yet; what clears an older abort comes late.
    assert clear(abort_id="m/1").error_msg == "another abort than that stops it"
    assert target.state is ControlState.ABORTING
    target.on_session_state(SessionPhase.ABORTED, "m/2")
    assert not clear(abort_id="m/1").accepted
    assert not clear(abort_id="").accepted
    assert clear(abort_id="m/2").accepted
    assert target.state is ControlState.DISARMED
    # Asked again because the answer was lost; a heartbeat that was under way changes nothing.
    assert clear(abort_id="m/2").accepted
    target.on_session_state(SessionPhase.ABORTED, "m/2")
    assert target.state is ControlState.DISARMED
    assert not clear(abort_id="m/1").accepted
    target.on_session_state(SessionPhase.ABORTING, "m/3")
    assert target.state is ControlState.ABORTING
    assert not clear(abort_id="m/2").accepted


def test_arming_needs_the_same_event_version(rig: Rig) -> None:
    rig.target.power_on()
    rig.step()
    reply = rig.target.command(ObjectEvent.ARM, "sha256:another", 0.0)
    assert (reply.accepted, reply.error_code) == (False, 3)
    assert rig.target.state is ControlState.DISARMED


@pytest.mark.parametrize(
    "event", ["INIT_DONE", "PRE_ARM_DONE", "STANDSTILL", "RUN_DONE", "LOCAL_STOP"]
)
def test_what_the_object_notices_by_itself_is_no_command(rig: Rig, event: str) -> None:
    """Whoever sends such a number must not get an object armed that doesn't stand."""
    rig.target.power_on()
    rig.step()
    rig.target.command(ObjectEvent.ARM, VERSION, 0.0)
    reply = rig.target.command(ObjectEvent[event], VERSION, 0.0)
    assert (reply.accepted, reply.error_code) == (False, 1)
    assert rig.target.state is ControlState.PRE_ARMING


@pytest.mark.parametrize(
    "session", [p for p in SessionPhase if p.name not in ("RUNNING", "STOPPING", "FINISHED")]
)
def test_a_manager_that_is_elsewhere_aborts_a_running_object(
    rig: Rig, session: SessionPhase
) -> None:
    """A manager that was started anew knows nothing of this run."""
    rig.drive()
    rig.session = session
    rig.step()
    assert rig.target.state is ControlState.ABORTING


def test_an_unarmed_object_is_not_started(rig: Rig) -> None:
    rig.target.power_on()
    rig.session = SessionPhase.RUNNING
    for _ in range(5):
        rig.step()
    assert rig.target.state is ControlState.DISARMED


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


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(
    before=st.lists(events, max_size=8),
    cause=st.sampled_from(["command", "session", "silence", "nan"]),
    after=st.lists(events, max_size=15),
)
def test_after_an_abort_nothing_makes_it_accelerate(
    before: list[tuple[Any, ...]], cause: str, after: list[tuple[Any, ...]]
) -> None:
    """Until all_clear, which is left out of the commands here."""
    rig = Rig()
    rig.drive(seconds=4.0)

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


def test_an_object_that_does_not_hear_the_manager_is_not_armed(rig: Rig) -> None:
    rig.target.power_on()
    rig.step()
    # Whoever is armed on an older one may have to stop at the next look.
    limit_s = 0.5 * rig.target._run.limits.heartbeat_s
    before = rig.target.state
    for age_s in (float("inf"), float("nan"), limit_s + 0.001):
        reply = rig.target.command(ObjectEvent.ARM, VERSION, age_s)
        assert (reply.accepted, reply.error_code) == (False, 2)
        assert "no heartbeat" in reply.error_msg
        assert rig.target.state is before
    assert rig.target.command(ObjectEvent.ARM, VERSION, limit_s).accepted


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
