"""The driver's place among nodes: which ticks it answers, and when."""

from __future__ import annotations

from dataclasses import replace

from ssp_core.cdr.steps import WorldTick
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.driven import Driven
from ssp_core.run_file.model import RunSpec
from ssp_core.world.driver import DriveMode
from ssp_ot_controller.driving.baselines import make_driver
from ssp_ot_controller.driving.pilot import Pilot
from ssp_ot_controller.driving.seat import DriverSeat
from tests.support.runs import cut_in_run
from tests.support.states import object_state

STEP_NS = 20_000_000


def seat() -> DriverSeat:
    run = RunSpec.model_validate(cut_in_run())
    driven = Driven(driver="oracle", first_request_s=0.2, hand_over_s=1.0, end_s=9.0)
    return DriverSeat(Pilot(run, driven, make_driver("oracle", {})))


def vut(step: int) -> ObjectState:
    state = object_state("vut", x_m=0.2 * step, speed_mps=10.0, stamp_ns=step * STEP_NS)
    return replace(state, sequence=step + 1)


def tick(step: int, *, running: bool = True) -> WorldTick:
    return WorldTick(step * STEP_NS, step, running, True, 0, step, (vut(step),))


def test_before_the_first_state_a_tick_has_an_answer_without_a_command() -> None:
    one = seat()
    one.take_tick(tick(0, running=False))
    answer = one.step()
    assert answer is not None
    assert (answer.step, answer.command, answer.report) == (0, None, None)


def test_a_tick_waits_for_the_states_that_precede_it_and_is_answered_once() -> None:
    one = seat()
    one.take_state(vut(0))
    for _ in range(3):
        one.take_tick(tick(0, running=False))
        answer = one.step()
        assert answer is not None
        assert answer.command is not None
    one.take_tick(tick(1))
    assert one.step() is None
    one.take_state(vut(1))
    answer = one.step()
    assert answer is not None
    assert answer.report is not None
    assert (answer.step, answer.report.mode) == (1, DriveMode.COMMAND)
    assert one.step() is None
    # A world that holds at its end says its last step again.
    one.take_tick(tick(1, running=False))
    assert one.step() is None
