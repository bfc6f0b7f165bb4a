"""Limits while a session is armed and runs: events, verdicts, the end."""

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
    ("changed", "code", "verdict"),
    [
        ({"x_m": 3.0, "y_m": 0.0}, SafetyCode.COLLISION, Verdict.FAILED_SAFETY),
        ({"x_m": 4.9, "y_m": 0.0}, SafetyCode.SEPARATION, Verdict.FAILED_SAFETY),
        (
            {"reference_id": "r", "error_lateral_m": 0.81},
            SafetyCode.ERROR_LATERAL,
            Verdict.FAILED_SAFETY,
        ),
        ({"x_m": math.nan}, SafetyCode.STATE_NOT_FINITE, Verdict.FAILED_SAFETY),
        ({"yaw_rad": math.inf}, SafetyCode.STATE_NOT_FINITE, Verdict.FAILED_SAFETY),
    ],
)
@pytest.mark.parametrize("phase", ["RUNNING", "STOPPING"])
def test_a_limit_aborts_with_its_event_and_verdict(
    driver: Any, tools: Any, phase: str, changed: dict[str, Any], code: SafetyCode, verdict: Verdict
) -> None:
    run_with(driver)
    driver.move("vut", speed_mps=1.0)
    if phase == "STOPPING":
        driver.session._move(SessionEvent.COMPLETE, 0, "")
    driver.move("ot1", **changed)
    driver.step()
    assert tools.violations(driver.session.outbox) == [code]
    assert driver.session.state is SessionPhase.ABORTING
    assert driver.session.verdict is verdict
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


def test_an_object_that_aborts_is_given_time_to_say_why(driver: Any, tools: Any) -> None:
    run_with(driver)
    driver.step(control_state=ControlState.ABORTING)
    for _ in range(4):
        driver.step()
        assert driver.session.state is SessionPhase.RUNNING
    driver.step()
    assert tools.violations(driver.session.outbox) == [SafetyCode.OBJECT_ABORTED]


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
    assert sent == [Reference, outbox.Triggered, Violation, outbox.StateChanged]
    assert "trigger gap fired" in driver.session.reasons[0]


def test_the_first_reason_gives_the_verdict(driver: Any, tools: Any) -> None:
    run_with(driver)
    driver.session.fail(Violation(SafetyCode.RECORDER, "monitor", 3.0, 2.0, 1))
    driver.session.fail(Violation(SafetyCode.OVER_SPEED, "ot1", 20.0, 15.0, 2))
    assert driver.session.verdict is Verdict.INVALID_HARNESS
    assert len(driver.session.reasons) == 2
    assert tools.changes(driver.session.outbox) == [("RUNNING", "abort", "ABORTING")]


def test_older_states_do_not_replace_newer_ones(driver: Any) -> None:
    run_with(driver)
    driver.step(100 * MS)
    driver.session.on_vut_state(driver.state("vut", stamp_ns=50 * MS, x_m=9.0))
    driver.session.on_target_state(driver.state("ot1", stamp_ns=50 * MS, x_m=9.0))
    assert driver.session.vut.x_m == 0.0
    assert driver.session.targets["ot1"].x_m == 40.0
