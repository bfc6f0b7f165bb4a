"""The ticks that become frames, and the distances that move legs."""

from __future__ import annotations

import math

import pytest

from ssp_core.clock import NS_PER_S
from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.camera.frames import Odometer, Schedule, steps_per_frame
from tests.support.states import object_state


def walker(x_m: float, y_m: float, yaw_rad: float = 0.0) -> ObjectState:
    return object_state("w", ObjectClass.PEDESTRIAN, x_m, y_m, yaw_rad, 1.0)


@pytest.mark.parametrize(
    ("rate_hz", "step_s", "expected"), [(10.0, 0.02, 5), (24.0, 0.02, 2), (60.0, 0.1, 1)]
)
def test_steps_per_frame(rate_hz: float, step_s: float, expected: int) -> None:
    assert steps_per_frame(rate_hz, step_s) == expected


def test_frame_steps_while_running() -> None:
    schedule = Schedule(5)
    frames = []
    for step in [0, 0, 1, 2, 3, 4, 5, 5, 6, 10]:
        wanted, schedule = schedule.decide(step, running=True, now_ns=step)
        if wanted:
            frames.append(step)
    assert frames == [0, 5, 10]


def test_one_frame_a_second_while_holding() -> None:
    schedule = Schedule(5)
    taken = []
    for tenth in range(25):
        now_ns = tenth * NS_PER_S // 10
        wanted, schedule = schedule.decide(0, running=False, now_ns=now_ns)
        if wanted:
            taken.append(tenth)
    assert taken == [0, 10, 20]
    assert schedule.decide(0, running=True, now_ns=25 * NS_PER_S)[0] is False
    assert schedule.decide(5, running=True, now_ns=25 * NS_PER_S)[0] is True


def test_odometer_sums_the_way_along_the_heading() -> None:
    odometer = Odometer()
    odometer.update([walker(0.0, 0.0)])
    odometer.update([walker(1.0, 0.0)])
    before = odometer.snapshot()
    odometer.update([walker(1.0, 0.0)])
    odometer.update([walker(1.0, 2.0, math.pi / 2)])
    assert before["w"] == 1.0
    assert odometer.snapshot()["w"] == pytest.approx(3.0)
    odometer.update([walker(1.0, 1.5, math.pi / 2)])  # a step back
    assert odometer.snapshot()["w"] == pytest.approx(2.5)
