"""The driver of the VUT: the built-in one with its changes and faults, or an external one."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Fault, Limits, RunSpec
from ssp_core.run_file.participants import Driver, Motion, ParticipantSpec, SpeedChange
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import BodyState, Command, step_body
from ssp_ot_controller.sil.vut_driver import DRIVER_TIMEOUT_S, VutDriver
from tests.support.states import object_state, state_of_body

STEP_NS = 20_000_000
STOP = 4.0
Play = Callable[[int, ObjectState], tuple[float, Command] | None]


def make_run(driver: Driver, *faults: Fault) -> RunSpec:
    """Nothing of a run but what a driver looks at."""
    start = Start(x_m=0.0, y_m=0.0, yaw_rad=0.0)
    path = Motion(path=[(0.0, 0.0), (900.0, 0.0)], cruise_mps=10.0)
    return RunSpec.model_construct(
        vut=ParticipantSpec(id="vut", object_class="car", start=start, approach=path),
        driver=driver,
        faults=list(faults),
        limits=Limits(speed_mps=15.0, acceleration_mps2=5.0, stop_deceleration_mps2=STOP),
        step_s=0.02,
    )


def play(
    run: RunSpec, seconds: float, others: Any = (), external: Play = lambda k, vut: None
) -> tuple[VutDriver, list[ObjectState]]:
    """Drives a car for some seconds; gives its state in each step."""
    driver, body = VutDriver(run), BodyState(0.0, 0.0, 0.0)
    states = []
    for k in range(round(seconds / 0.02)):
        vut = state_of_body(body, k * STEP_NS, "vut")
        states.append(vut)
        command = driver.command(vut, others, external(k, vut), drives=True)
        body = step_body(ObjectClass.CAR, body, command, 0.02)
    return driver, states


def speed_at(states: list[ObjectState], t_s: float) -> float:
    return states[round(t_s / 0.02)].speed_mps


def standing_car(x_m: float) -> ObjectState:
    return object_state(x_m=x_m)


def test_it_changes_its_mind_about_its_speed_when_it_is_time() -> None:
    changes = [SpeedChange(at_s=15.0, cruise_mps=12.0), SpeedChange(at_s=10.0, cruise_mps=6.0)]
    _, states = play(make_run(Driver(cruise_mps=10.0, later=changes)), 25.0)
    assert speed_at(states, 9.9) == pytest.approx(10.0, abs=0.3)
    assert speed_at(states, 14.9) == pytest.approx(6.0, abs=0.3)
    assert speed_at(states, 24.9) == pytest.approx(12.0, abs=0.5)


def test_a_later_speed_of_nothing_is_a_standstill() -> None:
    stop = SpeedChange(at_s=8.0, cruise_mps=0.0)
    _, states = play(make_run(Driver(cruise_mps=10.0, later=[stop])), 16.0)
    assert speed_at(states, 15.9) == 0.0
    assert min(s.acceleration_mps2 for s in states) == pytest.approx(-2.5, abs=0.05)


@pytest.mark.parametrize(("value", "hardest"), [(None, 2.5), (1.0, 1.0), (6.0, 6.0)])
def test_a_vut_that_stops_brakes_as_hard_as_the_fault_says_and_goes_on_after_it(
    value: float | None, hardest: float
) -> None:
    fault = Fault(kind="vut_stop", target="vut", at_s=6.0, duration_s=12.0, value=value)
    driver, states = play(make_run(Driver(cruise_mps=10.0), fault), 20.0)
    assert speed_at(states, 5.9) > 8.0
    assert speed_at(states, 17.9) == 0.0
    assert min(s.acceleration_mps2 for s in states) == pytest.approx(-hardest, abs=0.05)
    assert speed_at(states, 19.9) > 1.0
    assert [(c.kind, c.active) for c in driver.fault_changes] == [
        ("vut_stop", True),
        ("vut_stop", False),
    ]


def test_a_driver_that_does_not_react_is_stopped_by_the_emergency_brake_alone() -> None:
    driver = Driver(cruise_mps=10.0, reacts=False, aeb_deceleration_mps2=6.0)
    _, states = play(make_run(driver), 15.0, [standing_car(80.0)])
    gap = 80.0 - 0.9 - states[-1].x_m - 3.6
    assert states[-1].speed_mps == 0.0
    assert gap > 0.0
    assert min(s.acceleration_mps2 for s in states) == pytest.approx(-6.0, abs=0.05)
    without = driver.model_copy(update={"aeb_deceleration_mps2": None})
    _, states = play(make_run(without), 15.0, [standing_car(80.0)])
    assert states[-1].x_m > 80.0


def test_a_driver_that_reacts_leaves_the_emergency_brake_nothing_to_do() -> None:
    with_brake = Driver(cruise_mps=10.0, aeb_deceleration_mps2=6.0)
    without = Driver(cruise_mps=10.0)
    ends = [play(make_run(d), 20.0, [standing_car(120.0)])[1][-1] for d in (with_brake, without)]
    assert ends[0] == ends[1]
    assert ends[0].speed_mps < 0.1


# -- external driver ---------------------------------------------------------------------------

EXTERNAL = Driver(cruise_mps=10.0, external=True)
GO = Command(1.5, 0.0, 0.0)


def test_an_external_driver_is_obeyed() -> None:
    driver, states = play(make_run(EXTERNAL), 4.0, external=lambda k, vut: (0.0, GO))
    assert speed_at(states, 3.9) == pytest.approx(1.5 * 3.9, abs=0.5)
    assert not driver.external_is_silent


def test_who_never_says_anything_stands_and_is_missed_after_the_timeout() -> None:
    run = make_run(EXTERNAL)
    driver, states = play(run, DRIVER_TIMEOUT_S + 0.02)
    assert not driver.external_is_silent
    driver, states = play(run, DRIVER_TIMEOUT_S + 0.04)
    assert driver.external_is_silent
    assert driver.external_silence_s == pytest.approx(DRIVER_TIMEOUT_S + 0.02)
    assert {s.x_m for s in states} == {0.0}


def test_who_falls_silent_is_braked_to_a_standstill() -> None:
    def until_4_s(k: int, vut: ObjectState) -> tuple[float, Command]:
        return max(k - 200, 0) * 0.02, GO

    driver, states = play(make_run(EXTERNAL), 10.0, external=until_4_s)
    assert driver.external_is_silent
    fastest = max(s.speed_mps for s in states)
    assert fastest == pytest.approx(1.5 * (4.0 + DRIVER_TIMEOUT_S), abs=0.5)
    assert min(s.acceleration_mps2 for s in states) == pytest.approx(-STOP, abs=0.05)
    assert states[-1].speed_mps == 0.0


def test_a_command_that_is_no_number_is_no_command() -> None:
    def nonsense(k: int, vut: ObjectState) -> tuple[float, Command]:
        return 0.0, replace(GO, curvature_1pm=math.nan) if k > 100 else GO

    driver, states = play(make_run(EXTERNAL), 6.0, external=nonsense)
    assert driver.external_is_silent
    assert states[-1].speed_mps == 0.0
