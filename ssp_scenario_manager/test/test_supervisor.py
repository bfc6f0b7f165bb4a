"""What is looked at on the steady clock: facts, silence, arming, the end of an abort."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from ssp_core import names
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.codes import SafetyCode
from ssp_core.vocabulary import ControlState, SessionPhase, Verdict
from ssp_scenario_manager.session.limits import Violation
from ssp_scenario_manager.session.supervision import (
    WORLD_SILENT_LOCKSTEP_S,
    LivenessMonitor,
    Supervisor,
)

S = 1_000_000_000


def hear_all(liveness: LivenessMonitor, steady_ns: int) -> None:
    for who in (names.SIL_WORLD, names.VUT_ID, "ot1", names.MONITOR):
        liveness.hear(who, steady_ns)


def test_the_session_is_told_the_facts(driver: Any) -> None:
    driver.until("LOADED")
    liveness = LivenessMonitor()
    watchdog = Supervisor(driver.session, liveness)
    liveness.hear_recorder(True, (), 0, 2 * S)
    watchdog.look(3 * S, 0)
    assert driver.session.facts.recorder_ready
    assert driver.session.facts.recorder_age_s == 1.0


@pytest.mark.parametrize("phase", ["ARMED", "RUNNING"])
def test_who_falls_silent_ends_the_session(driver: Any, tools: Any, phase: str) -> None:
    driver.until(phase)
    liveness = LivenessMonitor()
    watchdog = Supervisor(driver.session, liveness)
    hear_all(liveness, S)
    watchdog.look(S, 0)
    assert driver.session.state.name == phase
    late_ns = S + round(WORLD_SILENT_LOCKSTEP_S * S) + 1
    for steady_ns in range(S, late_ns, S // 4):
        watchdog.wake(steady_ns)
    liveness.hear(names.MONITOR, late_ns)
    watchdog.look(late_ns, 0)
    told = tools.violations(driver.session.outbox)
    assert told[0] is SafetyCode.WORLD_SILENT
    assert (SafetyCode.OBJECT_SILENT in told) == (phase == "ARMED")
    assert driver.session.state is SessionPhase.ABORTING


@pytest.mark.parametrize("phase", ["IDLE", "LOADED", "CONNECTED", "ABORTING"])
def test_nobody_is_waited_for_before_or_after(driver: Any, tools: Any, phase: str) -> None:
    tools.bring(driver, phase)
    driver.session.outbox.clear()
    Supervisor(driver.session, LivenessMonitor()).look(900 * S, driver.now_ns)
    assert driver.session.state.name == phase
    assert tools.violations(driver.session.outbox) == []


@pytest.mark.parametrize(("mode", "given_up"), [("realtime", True), ("live", False)])
def test_a_live_session_waits_for_no_world(
    make_driver: Any, run: RunSpec, mode: str, given_up: bool
) -> None:
    """Its objects brake for as long as they need; a world that died would never say so."""
    driver = make_driver(run.model_copy(update={"mode": mode}))
    driver.until("RUNNING")
    driver.command("abort")
    driver.move("ot1", speed_mps=3.0)
    driver.step(control_state=ControlState.ABORTING)
    liveness = LivenessMonitor()
    watchdog = Supervisor(driver.session, liveness)
    for steady_ns in (S, 3 * S):
        liveness.hear("ot1", steady_ns)
        liveness.hear(names.VUT_ID, steady_ns)
        unconfirmed = watchdog.look(steady_ns, driver.now_ns)
    assert unconfirmed is given_up


@pytest.mark.parametrize("late_s", [1.0, 3.0])
def test_a_manager_that_stood_still_blames_itself(
    run_mapping: dict[str, Any], make_driver: Any, late_s: float
) -> None:
    run = RunSpec.model_validate({**run_mapping, "mode": "realtime"})
    driver = make_driver(run)
    driver.until("RUNNING")
    liveness = LivenessMonitor()
    watchdog = Supervisor(driver.session, liveness)
    hear_all(liveness, S)
    watchdog.wake(S)
    now_ns = S + round(late_s * S)
    driver.session.outbox.clear()
    watchdog.look(now_ns, driver.now_ns)
    assert driver.session.state is SessionPhase.ABORTING
    assert driver.session.verdict is Verdict.INVALID_HARNESS
    assert driver.session.reasons == (
        f"overrun: scenario_manager: {late_s:.3g} s, limit 0.5 s (instead of world_silent of "
        "sil_world) at 0.00 s",
    )


def test_what_objects_say_of_that_pause_is_the_managers_own_too_and_later_it_is_theirs(
    driver: Any, tools: Any
) -> None:
    driver.until("RUNNING")
    watchdog = Supervisor(driver.session, LivenessMonitor())
    lost = Violation(SafetyCode.HEARTBEAT_LOST, "ot1", 0.52, 0.5, driver.now_ns, "seen by x")
    watchdog.wake(S)
    watchdog.wake(2 * S)
    driver.session.outbox.clear()
    driver.session.fail(lost, announced=True)
    assert tools.violations(driver.session.outbox) == [SafetyCode.OVERRUN]
    for steady_ns in range(2 * S, 4 * S, S // 4):
        watchdog.wake(steady_ns)
    driver.session.fail(lost, announced=True)
    assert [reason.partition(":")[0] for reason in driver.session.reasons] == [
        "overrun",
        "heartbeat_lost",
    ]


def test_a_vut_from_the_future_ends_the_run_by_name_and_sets_no_time(driver: Any) -> None:
    driver.until("RUNNING")
    ahead = replace(driver.vut, stamp_ns=driver.now_ns + 3600 * S)
    assert driver.session.is_ahead(ahead, driver.now_ns)
    assert driver.session.reasons[0].startswith("clock_offset: vut: 3.6e+03 s, limit 0.05 s")
    assert driver.session.vut.stamp_ns == driver.now_ns
