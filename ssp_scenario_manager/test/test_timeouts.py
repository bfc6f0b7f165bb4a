"""How long a manager waits for objects to arm, and for the end of an abort."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from ssp_core import names
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.session.supervision import (
    ABORT_STANDSTILL_S,
    ARM_CONFIRMATION_S,
    LivenessMonitor,
    Timeouts,
)

S = 1_000_000_000
ARM_NS = round(ARM_CONFIRMATION_S * S)


@pytest.mark.parametrize("heard", [None, ControlState.PRE_ARMING, ControlState.DISARMED])
def test_objects_have_their_time_to_arm(driver: Any, heard: ControlState | None) -> None:
    timeouts, armed = Timeouts(), SessionPhase.ARMED
    targets = {} if heard is None else {"ot1": replace(driver.targets["ot1"], control_state=heard)}
    assert timeouts.not_armed(driver.run, armed, targets, 99 * S) is None  # nobody was told to
    timeouts.arms(100 * S)
    assert timeouts.not_armed(driver.run, armed, targets, 100 * S + ARM_NS) is None
    reason = timeouts.not_armed(driver.run, armed, targets, 100 * S + ARM_NS + 1)
    assert reason == "ot1 did not arm in 3 s"
    assert timeouts.not_armed(driver.run, armed, targets, 200 * S) is None  # said once


@pytest.mark.parametrize(
    ("control", "phase"),
    [
        (ControlState.ARMED, SessionPhase.ARMED),
        (ControlState.DISARMED, SessionPhase.RUNNING),
        (ControlState.DISARMED, SessionPhase.CONNECTED),
    ],
)
def test_nothing_to_wait_for(driver: Any, control: ControlState, phase: SessionPhase) -> None:
    timeouts = Timeouts()
    timeouts.arms(0)
    targets = {"ot1": replace(driver.targets["ot1"], control_state=control)}
    assert timeouts.not_armed(driver.run, phase, targets, S) is None
    # That it was settled once is enough, whatever comes later.
    waiting = {"ot1": replace(driver.targets["ot1"], control_state=ControlState.DISARMED)}
    assert timeouts.not_armed(driver.run, SessionPhase.ARMED, waiting, 9 * S) is None


def liveness(world_s: float = 0.0, ot1_s: float = 0.0) -> LivenessMonitor:
    """Who was last heard when: seconds on the steady clock."""
    made = LivenessMonitor()
    made.hear(names.SIL_WORLD, round(world_s * S))
    made.hear("ot1", round(ot1_s * S))
    return made


def aborting(driver: Any, speed_mps: float = 3.0) -> Any:
    """An aborting session whose objects move."""
    driver.until("RUNNING")
    driver.command("abort")
    driver.move("vut", speed_mps=0.0)
    driver.move("ot1", speed_mps=speed_mps)
    driver.step(control_state=ControlState.ABORTING)
    return driver.session


def test_a_living_world_is_given_time_for_the_standstill(driver: Any) -> None:
    session, timeouts = aborting(driver), Timeouts()
    for t in (0.0, 1.0, 5.0, ABORT_STANDSTILL_S):
        heard = liveness(100.0 + t, 100.0 + t)
        steady_ns = round((100.0 + t) * S)
        assert not timeouts.standstill_unconfirmed(session, heard, steady_ns, driver.now_ns)
    end_ns = round((100.1 + ABORT_STANDSTILL_S) * S)
    heard = liveness(100.1 + ABORT_STANDSTILL_S, 100.1 + ABORT_STANDSTILL_S)
    assert timeouts.standstill_unconfirmed(session, heard, end_ns, driver.now_ns)


def test_a_dead_world_confirms_nothing(driver: Any) -> None:
    """It was silent when the abort began, and is given a second from then to go on."""
    session, timeouts = aborting(driver), Timeouts()
    heard = liveness(world_s=96.0, ot1_s=101.1)
    for steady_s, given_up in ((100.0, False), (101.0, False), (101.1, True)):
        steady_ns = round(steady_s * S)
        found = timeouts.standstill_unconfirmed(session, heard, steady_ns, driver.now_ns)
        assert found is given_up


@pytest.mark.parametrize(("speed_mps", "silent_s", "given_up"), [
    (3.0, 1.5, True),  # nobody hears it, and all others stand
    (3.0, 0.5, False),
])  # fmt: skip
def test_an_object_that_is_silent_is_not_waited_for(
    driver: Any, speed_mps: float, silent_s: float, given_up: bool
) -> None:
    session, timeouts = aborting(driver, speed_mps), Timeouts()
    heard = liveness(world_s=100.0, ot1_s=100.0 - silent_s)
    found = timeouts.standstill_unconfirmed(session, heard, 100 * S, driver.now_ns)
    assert found is given_up


def test_the_wait_begins_anew_with_each_abort(make_driver: Any, run: RunSpec) -> None:
    timeouts, first, second = Timeouts(), make_driver(run), make_driver(run)
    session = aborting(first)
    assert not timeouts.standstill_unconfirmed(session, liveness(1.0, 1.0), S, first.now_ns)
    first.move("ot1", speed_mps=0.0)
    first.step(control_state=ControlState.ABORTING)
    assert session.state is SessionPhase.ABORTED
    assert not timeouts.standstill_unconfirmed(session, liveness(), 99 * S, first.now_ns)
    heard = liveness(99.0, 99.0)
    assert not timeouts.standstill_unconfirmed(aborting(second), heard, 99 * S, second.now_ns)
