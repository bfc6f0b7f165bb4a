"""The messages that an object target refuses and obeys: references, its own state, commands."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import pytest

from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import lane_change
from ssp_core.motion.reference import Reference
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_ot_controller.objects.references import Refusal, RefusalCode
from ssp_ot_controller.objects.state_machine import ObjectEvent
from tests.support.target_rig import VERSION, Rig, S, reference, straight


@pytest.fixture
def rig() -> Rig:
    return Rig()


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
    """A command with such a number must not arm an object that doesn't stand."""
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
