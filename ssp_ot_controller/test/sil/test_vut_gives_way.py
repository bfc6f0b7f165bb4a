"""The built-in driver turns left across an oncoming object that has priority."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import pytest

from ssp_core.geometry import box_distance
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.participants import Driver, GiveWay, Motion, ParticipantSpec
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import BodyState, step_body
from ssp_ot_controller.sil.vut_driver import VutDriver
from tests.support.states import object_state, state_of_body

DT = 0.05
CAR = ObjectClass.CAR
# Along y = 0 up to x = 60, then a left turn of 12 m radius, and on northwards.
ARC = [(60.0 + 12.0 * math.sin(a), 12.0 - 12.0 * math.cos(a)) for a in np.linspace(0, math.pi / 2)]
PATH = [(0.0, 0.0), *ARC, (72.0, 80.0)]
# The oncoming lane is at y = 3.5; both corridors overlap from 64 to 76 m of the VUT's path.
ONCOMING = [(260.0, 3.5), (0.0, 3.5)]
PLACE = GiveWay(
    line_m=62.0, zone_m=(64.0, 76.0), priority_path=ONCOMING, priority_zone_m=(187.0, 197.0)
)
TURNING = Driver(cruise_mps=6.0, gives_way=[PLACE])


@dataclass(frozen=True)
class Drive:
    words: list[str]
    states: list[ObjectState]
    nearest_m: float

    @property
    def slowest_mps(self) -> float:
        """Least speed of the VUT before the turn's end, once it is at cruise speed."""
        return min(s.speed_mps for s in self.states[round(6.0 / DT) :] if s.y_m < 20.0)


def turn_left(arrives_s: float, driver: Driver = TURNING, speed_mps: float = 10.0) -> Drive:
    """Drives the VUT; an oncoming car's front is at the conflict zone at a session time."""
    run = RunSpec.model_construct(
        vut=ParticipantSpec(
            id="vut",
            object_class="car",
            start=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
            approach=Motion(path=PATH, cruise_mps=6.0),
        ),
        driver=driver,
        faults=[],
        limits=Limits(speed_mps=15.0, acceleration_mps2=5.0, stop_deceleration_mps2=4.0),
        step_s=DT,
    )
    one, body = VutDriver(run), BodyState(0.0, 0.0, 0.0)
    words, states, nearest = [], [], math.inf
    for k in range(round(25.0 / DT)):
        vut = state_of_body(body, round(k * DT * 1e9), "vut")
        x = 73.0 + object_state().size.front_m + speed_mps * (arrives_s - k * DT)
        car = object_state("ot1", CAR, x, 3.5, math.pi, speed_mps)
        words += [w for w in one.priority_words if not words or w != words[-1]]
        states.append(vut)
        nearest = min(nearest, box_distance(vut.box, car.box))
        body = step_body(CAR, body, one.command(vut, [car], None, drives=True), DT)
    return Drive(words, states, nearest)


# A VUT that nobody hinders has its front at the line after 11.5 s.
FREE_S = 11.5


@pytest.mark.parametrize(
    ("shift_s", "word"), [(-2.0, "go"), (0.0, "yield"), (2.0, "wait"), (4.6, "go")]
)
def test_a_shift_of_the_oncoming_car_by_two_seconds_changes_what_it_does(
    shift_s: float, word: str
) -> None:
    drive = turn_left(FREE_S + shift_s)
    assert drive.words[:2] == ["approach", word]
    assert drive.nearest_m > 1.0
    assert drive.states[-1].y_m > 40.0
    slowest = {"go": (5.5, 6.1), "yield": (1.0, 5.0), "wait": (0.0, 0.5)}[word]
    assert slowest[0] <= drive.slowest_mps <= slowest[1]


def test_one_who_gives_nobody_way_is_hit() -> None:
    assert turn_left(FREE_S + 1.0, TURNING.model_copy(update={"gives_way": []})).nearest_m == 0.0


# Who gives way first stops or slows down, then goes; who goes doesn't change its mind.
ALLOWED = [
    ["approach", "go"],
    ["approach", "yield", "go"],
    ["approach", "wait", "go"],
    ["approach", "wait", "yield", "go"],
]


@pytest.mark.parametrize("speed_mps", [5.0, 14.0])
def test_whenever_the_car_comes_it_does_not_dither_and_touches_nobody(speed_mps: float) -> None:
    for arrives_s in np.arange(9.0, 18.0, 1.0):
        drive = turn_left(float(arrives_s), speed_mps=speed_mps)
        assert drive.nearest_m > 0.5, arrives_s
        assert drive.words in ALLOWED, arrives_s
