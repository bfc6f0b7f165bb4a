"""How long a manager waits for objects to arm, and for the end of an abort."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from ssp_core import names
from ssp_core.vocabulary import ControlState, SessionPhase
from ssp_scenario_manager.session.supervision import (
    ABORT_STANDSTILL_S,
    ARM_CONFIRMATION_S,
    LivenessMonitor,
    Supervisor,
)

S = 1_000_000_000
ARM_NS = round(ARM_CONFIRMATION_S * S)


def armed(driver: Any) -> Supervisor:
    """Of an armed session, in which nobody falls silent."""
    driver.until("ARMED")
    liveness = LivenessMonitor()
    for who in (names.SIL_WORLD, names.VUT_ID, "ot1", names.MONITOR):
        liveness.hear(who, 300 * S)
    return Supervisor(driver.session, liveness)


def said(driver: Any) -> list[str]:
    return [f.reason for f in driver.session.outbox if getattr(f, "event", "") == "arm_failed"]


@pytest.mark.parametrize("heard", [None, ControlState.PRE_ARMING, ControlState.DISARMED])
def test_objects_have_their_time_to_arm(driver: Any, heard: ControlState | None) -> None:
    supervisor, targets = armed(driver), driver.session.targets
    if heard is None:
        del targets["ot1"]
    else:
        targets["ot1"] = replace(targets["ot1"], control_state=heard)
    supervisor.look(99 * S, driver.now_ns)  # nobody was told to
    supervisor.objects_were_told_to_arm(100 * S)
    supervisor.look(100 * S + ARM_NS, driver.now_ns)
    assert (said(driver), driver.session.state) == ([], SessionPhase.ARMED)
    supervisor.look(100 * S + ARM_NS + 1, driver.now_ns)
    supervisor.look(200 * S, driver.now_ns)
    assert said(driver) == ["ot1 did not arm in 3 s"]
    assert driver.session.state is SessionPhase.CONNECTED


@pytest.mark.parametrize("phase", ["ARMED", "CONNECTED"])
def test_nothing_to_wait_for(driver: Any, phase: str) -> None:
    supervisor, targets = armed(driver), driver.session.targets
    waiting = replace(targets["ot1"], control_state=ControlState.DISARMED)
    supervisor.objects_were_told_to_arm(0)
    if phase == "CONNECTED":
        driver.command("disarm")
    else:
        targets["ot1"] = replace(waiting, control_state=ControlState.ARMED)
    supervisor.look(S, driver.now_ns)
    # That it was settled once is enough, whatever comes later.
    targets["ot1"] = waiting
    supervisor.look(9 * S, driver.now_ns)
    assert (said(driver), driver.session.state.name) == ([], phase)


class Aborting:
    """An aborting session whose OT moves, and who was last heard when, s on the steady clock."""

    def __init__(self, driver: Any) -> None:
        driver.until("RUNNING")
        driver.command("abort")
        driver.move("vut", speed_mps=0.0)
        driver.move("ot1", speed_mps=3.0)
        driver.step(control_state=ControlState.ABORTING)
        self.driver = driver
        self._liveness = LivenessMonitor()
        self._supervisor = Supervisor(driver.session, self._liveness)

    def gives_up(self, at_s: float, world_s: float, ot1_s: float) -> bool:
        self._liveness.hear(names.SIL_WORLD, round(world_s * S))
        self._liveness.hear("ot1", round(ot1_s * S))
        return self._supervisor.look(round(at_s * S), self.driver.now_ns)


def test_a_living_world_is_given_time_for_the_standstill(driver: Any) -> None:
    aborting = Aborting(driver)
    for t in (100.0, 101.0, 105.0, 100.0 + ABORT_STANDSTILL_S):
        assert not aborting.gives_up(t, t, t)
    end_s = 100.1 + ABORT_STANDSTILL_S
    assert aborting.gives_up(end_s, end_s, end_s)


def test_a_dead_world_confirms_nothing(driver: Any) -> None:
    """It was silent when the abort began, and is given a second from then to go on."""
    aborting = Aborting(driver)
    assert [aborting.gives_up(t, 96.0, 101.1) for t in (100.0, 101.0, 101.1)] == [
        False,
        False,
        True,
    ]


@pytest.mark.parametrize(("silent_s", "given_up"), [(1.5, True), (0.5, False)])
def test_an_object_that_is_silent_is_not_waited_for(
    driver: Any, silent_s: float, given_up: bool
) -> None:
    """Nobody hears it, and all others stand."""
    assert Aborting(driver).gives_up(100.0, 100.0, 100.0 - silent_s) is given_up


def test_the_wait_begins_anew_with_each_abort(driver: Any) -> None:
    aborting, session = Aborting(driver), driver.session
    assert not aborting.gives_up(1.0, 1.0, 1.0)
    driver.move("ot1", speed_mps=0.0)
    driver.step(control_state=ControlState.ABORTING)
    assert session.state is SessionPhase.ABORTED
    assert not aborting.gives_up(99.0, 0.0, 0.0)
    driver.move("ot1", speed_mps=3.0)
    session.state = SessionPhase.ABORTING
    assert not aborting.gives_up(99.0, 99.0, 99.0)
