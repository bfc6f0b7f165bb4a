"""The limits of states, clocks and answers, from the arming of a session to its end."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from ssp_core.motion.reference import Reference
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import FollowPath
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, SessionPhase, Verdict
from ssp_scenario_manager.session import outbox
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.state_machine import SessionEvent

MS = 1_000_000
S = 1_000_000_000


def run_with(driver: Any) -> None:
    driver.until("RUNNING")
    driver.acknowledge()


@pytest.mark.parametrize(
    ("changed", "code"),
    [
        ({"x_m": 3.0, "y_m": 0.0}, SafetyCode.COLLISION),
        ({"x_m": 4.9, "y_m": 0.0}, SafetyCode.SEPARATION),
        ({"y_m": 14.0}, SafetyCode.OUTSIDE_GEOFENCE),
        ({"speed_mps": 15.1}, SafetyCode.OVER_SPEED),
        ({"position_std_m": 0.6}, SafetyCode.LOCALISATION),
        ({"reference_id": "r", "error_lateral_m": 0.81}, SafetyCode.ERROR_LATERAL),
        ({"x_m": math.nan}, SafetyCode.STATE_NOT_FINITE),
        ({"yaw_rad": math.inf}, SafetyCode.STATE_NOT_FINITE),
    ],
)
@pytest.mark.parametrize("phase", ["ARMED", "RUNNING", "STOPPING"])
def test_a_limit_aborts_with_its_event_and_verdict(
    driver: Any, tools: Any, phase: str, changed: dict[str, Any], code: SafetyCode
) -> None:
    driver.until("ARMED" if phase == "ARMED" else "RUNNING")
    driver.acknowledge()
    driver.move("vut", speed_mps=1.0)
    if phase == "STOPPING":
        driver.session._move(SessionEvent.COMPLETE, 0, "")
    driver.move("ot1", **changed)
    driver.step()
    assert tools.violations(driver.session.outbox) == [code]
    assert driver.session.state is SessionPhase.ABORTING
    assert driver.session.verdict is Verdict.FAILED_SAFETY
    assert len(driver.session.reasons) == 1


@pytest.mark.parametrize("changed", [{"x_m": math.nan}, {"speed_mps": math.inf}, {"x_m": 80.0}])
def test_no_trigger_is_judged_on_a_state_that_cannot_be_believed(
    make_driver: Callable[[RunSpec], Any], run_mapping: dict[str, Any], changed: dict[str, float]
) -> None:
    """This one would fire whatever the VUT does; nothing may be sent with the abort."""
    run_mapping["limits"]["jump_m"] = 1.0
    run_mapping["triggers"][0]["condition"] = {"type": "elapsed_time", "after_s": 0.03}
    driver = make_driver(RunSpec.model_validate(run_mapping))
    run_with(driver)
    driver.step()
    driver.move("vut", **changed)
    driver.step()
    assert driver.session.state.name.startswith("ABORT")
    assert not [f for f in driver.session.outbox if isinstance(f, Reference)]


def test_a_collision_while_aborting_is_a_further_reason_once(driver: Any, tools: Any) -> None:
    run_with(driver)
    driver.move("vut", speed_mps=5.0)
    driver.step()
    driver.command("abort")
    driver.move("ot1", x_m=3.0, y_m=0.0)
    for _ in range(5):
        driver.step()
    assert tools.violations(driver.session.outbox) == [SafetyCode.OPERATOR, SafetyCode.COLLISION]
    assert driver.session.verdict is Verdict.ABORTED
    first, second = driver.session.reasons
    assert first == "abort by test at 0.02 s"
    assert second.startswith("collision: ot1:")


@pytest.mark.parametrize("phase", ["ARMED", "RUNNING"])
def test_silence_of_either_side(driver: Any, tools: Any, phase: str) -> None:
    """The limit is 0.3 s: the last state may be that old."""
    driver.until(phase)
    driver.acknowledge()
    driver.session.step(300 * MS)
    assert driver.session.state.name == phase
    driver.session.step(300 * MS + 1)
    assert set(tools.violations(driver.session.outbox)) == {
        SafetyCode.VUT_SILENT,
        SafetyCode.OBJECT_SILENT,
    }
    assert driver.session.verdict is Verdict.ABORTED


def test_an_unanswered_reference(driver: Any, tools: Any) -> None:
    driver.until("RUNNING")
    for _ in range(25):
        driver.step()
    assert driver.now_ns == 500 * MS
    assert driver.session.state is SessionPhase.RUNNING
    driver.step()
    assert tools.violations(driver.session.outbox) == [SafetyCode.ACK_MISSING]


def test_a_refused_reference(driver: Any) -> None:
    driver.until("RUNNING")
    driver.session.on_ack("nobody's", False, 7, "", 0)
    assert driver.session.state is SessionPhase.RUNNING
    driver.session.on_ack("ot1-1", False, 7, "leaves the geofence", 5)
    (passed,) = [f for f in driver.session.outbox if isinstance(f, Violation)]
    assert passed == Violation(
        SafetyCode.REFERENCE_REFUSED, "ot1", 7.0, 0.0, 5, "leaves the geofence"
    )
    assert driver.session.state is SessionPhase.ABORTING
    driver.session.on_ack("ot1-1", False, 7, "leaves the geofence", 6)  # a duplicate
    assert len(driver.session.reasons) == 1


NOT_RUNNING = (False, 1, "object is ABORTING; references are taken in RUNNING")


@pytest.mark.parametrize("first", ["state", "event", "refusal"])
def test_a_refusal_by_an_object_that_stopped_is_no_reason_of_its_own(
    driver: Any, tools: Any, first: str
) -> None:
    """Event, state and answer of the object may come in any order."""
    driver.until("RUNNING")
    driver.move("ot1", control_state=ControlState.ABORTING)
    said = Violation(SafetyCode.STATE_STALE, "ot1", 0.4, 0.3, driver.now_ns)
    if first == "state":
        driver.step()
    if first == "event":
        driver.session.fail(said, announced=True)
    driver.session.on_ack("ot1-1", *NOT_RUNNING, driver.now_ns)
    assert first == "event" or driver.session.state is SessionPhase.RUNNING
    driver.step()
    driver.session.fail(said, announced=True)
    for _ in range(10):
        driver.step()
    (reason,) = driver.session.reasons
    assert reason.startswith("state_stale: ot1")


@pytest.mark.parametrize("control", [ControlState.RUNNING, ControlState.ABORTING])
def test_an_object_that_is_not_running_ends_the_session_without_saying_why(
    driver: Any, tools: Any, control: ControlState
) -> None:
    driver.until("RUNNING")
    driver.session.on_ack("ot1-1", *NOT_RUNNING, driver.now_ns)
    for _ in range(5):
        assert driver.session.state is SessionPhase.RUNNING
        driver.step(control_state=control)
    if control is ControlState.ABORTING:
        driver.step()
    aborted = control is ControlState.ABORTING
    code = SafetyCode.OBJECT_ABORTED if aborted else SafetyCode.REFERENCE_REFUSED
    assert tools.violations(driver.session.outbox) == [code]


@pytest.mark.parametrize("control", [ControlState.ARMED, ControlState.DISARMED, None])
def test_an_object_that_never_began_is_not_waited_for(
    driver: Any, control: ControlState | None
) -> None:
    """Nor is one that was never heard but by its refusal."""
    driver.until("RUNNING")
    driver.hear(control)
    if control is None:
        del driver.session.targets["ot1"]
    driver.session.on_ack("ot1-1", *NOT_RUNNING, driver.now_ns)
    assert driver.session.state is SessionPhase.ABORTING
    assert driver.session.reasons[0].startswith("reference_refused: ot1: 1")


def test_an_object_that_aborts_before_the_start_ends_the_session(driver: Any, tools: Any) -> None:
    driver.until("ARMED")
    driver.step(control_state=ControlState.ABORTING)
    assert tools.violations(driver.session.outbox) == [SafetyCode.OBJECT_ABORTED]


def test_an_object_that_aborts_is_given_time_to_say_why(driver: Any, tools: Any) -> None:
    run_with(driver)
    driver.step(control_state=ControlState.ABORTING)
    for _ in range(4):
        driver.step()
        assert driver.session.state is SessionPhase.RUNNING
    driver.step()
    assert tools.violations(driver.session.outbox) == [SafetyCode.OBJECT_ABORTED]


@pytest.mark.parametrize("mode", ["lockstep", "realtime", "live"])
@pytest.mark.parametrize("says_why", [True, False])
def test_an_object_that_aborts_as_the_run_stops_leaves_no_valid_run(
    make_driver: Callable[[RunSpec], Any], run: RunSpec, mode: str, says_why: bool
) -> None:
    driver = make_driver(run.model_copy(update={"mode": mode}))
    run_with(driver)
    driver.session._run.event.resolved_ns = driver.now_ns
    for _ in range(60):
        driver.step()
    driver.command("stop")
    for _ in range(5):
        driver.step(control_state=ControlState.ABORTING)
        assert driver.session.state is SessionPhase.STOPPING
    if says_why:
        said = Violation(SafetyCode.STATE_STALE, "ot1", 0.4, 0.3, driver.now_ns)
        driver.session.fail(said, announced=True)
    driver.step()
    assert driver.session.state.name.startswith("ABORT")
    reason = driver.session.reasons[0]
    assert reason.startswith("state_stale: ot1" if says_why else "object_aborted: ot1")


def test_duration_and_a_missing_event(
    tools: Any, make_driver: Callable[[RunSpec], Any], run_mapping: dict[str, Any]
) -> None:
    run_mapping["end"] = {"at_latest_s": 1.0}
    run_mapping["limits"]["state_age_s"] = 5.0
    driver = make_driver(RunSpec.model_validate(run_mapping))
    run_with(driver)
    driver.step(S - 1)
    assert driver.session.state is SessionPhase.RUNNING
    driver.step(1)
    assert tools.violations(driver.session.outbox) == [SafetyCode.EVENT_MISSING]
    assert driver.session.verdict is Verdict.OFF_SPEC
    assert "phase reached: approach" in driver.session.reasons[0]

    run_mapping["end"] = {"at_latest_s": 50.0}
    run_mapping["limits"]["duration_s"] = 2.0
    driver = make_driver(RunSpec.model_validate(run_mapping))
    run_with(driver)
    driver.step(2 * S)
    assert driver.session.state is SessionPhase.RUNNING
    driver.step(1)
    assert tools.violations(driver.session.outbox) == [SafetyCode.DURATION]
    assert driver.session.verdict is Verdict.FAILED_SAFETY


def test_a_manoeuvre_that_cannot_be_driven_aborts_with_the_reason(driver: Any, tools: Any) -> None:
    """The gap is reached while the OT still stands: there is nothing to change lane with."""
    run_with(driver)
    driver.move("vut", x_m=25.0, speed_mps=5.0)
    driver.step()
    assert tools.violations(driver.session.outbox) == [SafetyCode.EVENT_MISSING]
    assert "trigger gap fired" in driver.session.reasons[0]
    assert not [f for f in driver.session.outbox if isinstance(f, Reference)]


def test_nothing_is_sent_after_the_abort_that_was_found_with_it(
    make_driver: Callable[[RunSpec], Any], run: RunSpec, tools: Any
) -> None:
    """Three triggers fire at once, and the manoeuvre of the second can't be driven."""
    first = run.triggers[0]
    ahead = FollowPath(kind="follow_path", motion=run.targets[0].approach)
    given = [
        first.model_copy(update={"id": "first", "manoeuvre": ahead}),
        first,
        first.model_copy(update={"id": "third", "manoeuvre": ahead}),
    ]
    driver = make_driver(run.model_copy(update={"triggers": given}))
    run_with(driver)
    driver.move("vut", x_m=25.0, speed_mps=5.0)
    driver.step()
    sent = [type(fact) for fact in driver.session.outbox]
    assert sent == [Reference, outbox.TriggerDecision, Violation, outbox.StateChanged]
    assert "trigger gap fired" in driver.session.reasons[0]


def test_the_first_reason_gives_the_verdict(driver: Any, tools: Any) -> None:
    run_with(driver)
    driver.session.fail(Violation(SafetyCode.RECORDER, "monitor", 3.0, 2.0, 1))
    driver.session.fail(Violation(SafetyCode.OVER_SPEED, "ot1", 20.0, 15.0, 2))
    assert driver.session.verdict is Verdict.INVALID_HARNESS
    assert len(driver.session.reasons) == 2
    assert tools.changes(driver.session.outbox) == [("RUNNING", "abort", "ABORTING")]


def test_the_abort_for_a_limit_says_which_and_has_its_time(driver: Any) -> None:
    run_with(driver)
    violation = Violation(SafetyCode.OVER_SPEED, "ot1", 20.0, 15.0, 3 * S)
    driver.session.fail(violation)
    event, change = driver.session.outbox
    assert event is violation
    assert (change.stamp_ns, change.reason) == (3 * S, "over_speed: ot1: 20 m/s, limit 15 m/s")


@pytest.mark.parametrize(("late_s", "reason"), [(0.75, "object_aborted"), (1.25, "overrun")])
def test_a_pause_that_an_object_bears_is_no_reason_for_its_stop(
    make_driver: Callable[[RunSpec], Any], run: RunSpec, late_s: float, reason: str
) -> None:
    limits = run.limits.model_copy(update={"heartbeat_s": 1.0})
    driver = make_driver(run.model_copy(update={"mode": "realtime", "limits": limits}))
    run_with(driver)
    driver.session.late_s = late_s
    stop = Violation(SafetyCode.OBJECT_ABORTED, "ot1", 1.0, 0.0, driver.now_ns)
    driver.session.fail(stop, announced=True)
    assert driver.session.reasons[0].partition(":")[0] == reason


@pytest.mark.parametrize(
    ("late_s", "code"), [(0.0, SafetyCode.OBJECT_ABORTED), (0.75, SafetyCode.OVERRUN)]
)
def test_what_passes_a_limit_in_an_abort_without_a_run_is_announced_and_changes_nothing(
    driver: Any, tools: Any, late_s: float, code: SafetyCode
) -> None:
    driver.command("abort")
    driver.session.outbox.clear()
    driver.session.late_s = late_s
    driver.session.fail(Violation(SafetyCode.OBJECT_ABORTED, "ot1", 1.0, 0.0, 0))
    assert tools.violations(driver.session.outbox) == [code]
    assert len(driver.session.outbox) == 1
    assert driver.session.state is SessionPhase.ABORTING


def test_older_states_do_not_replace_newer_ones(driver: Any) -> None:
    run_with(driver)
    driver.step(100 * MS)
    driver.session.on_vut_state(driver.state("vut", stamp_ns=50 * MS, x_m=9.0))
    driver.session.on_target_state(driver.state("ot1", stamp_ns=50 * MS, x_m=9.0))
    assert driver.session.vut.x_m == 0.0
    assert driver.session.targets["ot1"].x_m == 40.0


@pytest.mark.parametrize("who", ["vut", "ot1"])
def test_an_old_state_that_comes_again_and_again_hides_no_contradiction(
    driver: Any, tools: Any, who: str
) -> None:
    run_with(driver)
    driver.step()
    first = driver.vut if who == "vut" else driver.targets[who]
    for _ in range(60):
        driver.step()
    for k in range(70):
        driver.move(who, x_m=first.x_m + 0.1 * k, speed_mps=11.0)
        driver.step()
        if k % 20 == 0:
            assert driver.session.on_vut_state(first) or driver.session.on_target_state(first)
    assert SafetyCode.STATE_CONTRADICTS in tools.violations(driver.session.outbox)


# -- from the arming on ---------------------------------------------------------------------------


@pytest.mark.parametrize("phase", ["LOADED", "CONNECTED"])
def test_before_it_is_armed_nothing_is_watched_but_reports_count(
    driver: Any, tools: Any, phase: str
) -> None:
    """Everybody may still be moved about by hand; an object that stops by itself ends it."""
    driver.until(phase)
    driver.move("ot1", x_m=3.0, y_m=0.0)
    driver.step()
    assert driver.session.state.name == phase
    driver.session.fail(Violation(SafetyCode.STATE_STALE, "ot1", 1.0, 0.3, 5), announced=True)
    assert driver.session.state is SessionPhase.ABORTING
    assert tools.violations(driver.session.outbox) == []


@pytest.mark.parametrize("phase", ["LOADED", "CONNECTED", "ARMED", "RUNNING", "ABORTING"])
@pytest.mark.parametrize(
    ("mode", "early_s", "is_old"),
    [("live", 2, False), ("live", 3, True), ("realtime", 3, False), ("lockstep", 3, False)],
)
def test_a_report_from_before_the_load_ends_no_live_session_that_waits(
    make_driver: Callable[[RunSpec], Any],
    run: RunSpec,
    tools: Any,
    phase: str,
    mode: str,
    early_s: int,
    is_old: bool,
) -> None:
    driver = make_driver(run.model_copy(update={"mode": mode}))
    driver.now_ns = 1000 * S
    tools.bring(driver, phase)
    driver.session.outbox.clear()
    stamp_ns = driver.now_ns - early_s * S
    report = Violation(SafetyCode.STATE_STALE, "ot1", 1.0, 0.3, stamp_ns, "seen by object_target")
    driver.session.take_report(report, driver.now_ns)
    if is_old and phase in ("LOADED", "CONNECTED"):
        assert driver.session.state.name == phase
        text = "not counted, since it is from before the load: state_stale: ot1: 1 s, limit 0.3 s"
        (note,) = driver.session.outbox
        assert note == outbox.Note(driver.now_ns, f"{text} (seen by object_target)")
    else:
        assert driver.session.state is SessionPhase.ABORTING
        assert any(reason.startswith("state_stale: ot1") for reason in driver.session.reasons)


# -- objects that don't take part any more ---------------------------------------------------------


@pytest.mark.parametrize("control", ["OFF", "INIT", "DISARMED", "PRE_ARMING", "POSTRUN"])
def test_an_object_that_has_left_the_run_ends_it(driver: Any, tools: Any, control: str) -> None:
    """Started anew in the midst of a run it is well, stands, and drives no event."""
    run_with(driver)
    driver.step()
    assert driver.session.state is SessionPhase.RUNNING
    driver.step(control_state=ControlState[control])
    assert tools.violations(driver.session.outbox) == [SafetyCode.OBJECT_ABORTED]
    assert f"it is {control} while the session runs" in driver.session.reasons[0]
    assert driver.session.state.name.startswith("ABORT")


@pytest.mark.parametrize("control", [ControlState.ARMED, ControlState.PRE_RUNNING])
def test_an_object_may_need_a_while_to_hear_of_the_start_and_to_begin(
    driver: Any, tools: Any, control: ControlState
) -> None:
    """An object of ISO 22133 is PRE_RUNNING in between."""
    run_with(driver)
    for _ in range(40):  # the silence that it may bear, and the age that its states may have
        driver.step(control_state=control)
    assert driver.session.state is SessionPhase.RUNNING
    driver.step(control_state=control)
    assert tools.violations(driver.session.outbox) == [SafetyCode.OBJECT_ABORTED]


def test_objects_leave_a_run_that_stops(driver: Any) -> None:
    run_with(driver)
    driver.command("stop")
    driver.move("ot1", speed_mps=1.0)
    for control in (ControlState.POSTRUN, ControlState.DISARMED):
        driver.step(control_state=control)
        assert driver.session.state is SessionPhase.STOPPING


# -- clocks ---------------------------------------------------------------------------------------


def test_states_of_strangers_are_not_taken(driver: Any) -> None:
    run_with(driver)
    stranger = driver.state("ot9", x_m=0.5, stamp_ns=1)
    assert not driver.session.on_target_state(stranger)
    assert not driver.session.on_target_state(driver.state("vut", x_m=9.0, stamp_ns=1))
    assert not driver.session.on_vut_state(driver.state("ot1", x_m=9.0, stamp_ns=1))
    assert set(driver.session.targets) == {"ot1"}
    assert driver.session.vut.x_m == 0.0
    driver.step()
    assert driver.session.state is SessionPhase.RUNNING


# -- what comes after the end ---------------------------------------------------------------------


def test_the_verdict_of_a_finished_run_stays(driver: Any, tools: Any) -> None:
    run_with(driver)
    driver.session._run.event.resolved_ns = 0
    driver.command("stop")
    driver.step(control_state=ControlState.DISARMED)
    assert driver.session.verdict is Verdict.VALID
    driver.command("abort")
    driver.move("ot1", x_m=3.0, y_m=0.0)
    driver.move("vut", speed_mps=1.0)
    driver.step()
    assert SafetyCode.COLLISION in tools.violations(driver.session.outbox)
    assert (driver.session.verdict, driver.session.reasons) == (Verdict.VALID, ())
