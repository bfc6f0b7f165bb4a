"""The prediction's VUT gives way as the simulated one does."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ssp_core.motion.encounter import encounter
from ssp_core.run_file.model import Limits, RunSpec
from ssp_core.run_file.participants import (
    Driver,
    GiveWay,
    Hold,
    Motion,
    ParticipantSpec,
    TimeToArrival,
    TriggerSpec,
)
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import BodyState, step_body
from ssp_ot_controller.sil.vut_driver import VutDriver
from ssp_scenario_manager.scenarios.motions import STEP_S, Motions
from ssp_scenario_manager.scenarios.prediction import Players
from tests.support.states import state_of_body

# Along y = 0 up to x = 60, and left in a turn of 12 m radius; oncoming cars come along y = 3.5.
ARC = [(60.0 + 12.0 * math.sin(a), 12.0 - 12.0 * math.cos(a)) for a in np.linspace(0, math.pi / 2)]
PATH = [(0.0, 0.0), *ARC, (72.0, 120.0)]
PLACE = GiveWay(
    line_m=62.0,
    zone_m=(64.0, 76.0),
    priority_path=[(300.0, 3.5), (0.0, 3.5)],
    priority_zone_m=(227.0, 237.0),
)


def turning(car_from_m: float) -> Motions:
    """A VUT that turns, and a car that comes from a place on the oncoming lane."""
    return Motions(
        vut=ParticipantSpec(
            id="vut",
            object_class="car",
            start=Start(x_m=0.0, y_m=0.0, yaw_rad=0.0),
            approach=Motion(path=PATH, cruise_mps=6.0),
        ),
        driver=Driver(cruise_mps=6.0, gives_way=[PLACE]),
        targets=(
            ParticipantSpec(
                id="ot1",
                object_class="car",
                start=Start(x_m=car_from_m, y_m=3.5, yaw_rad=math.pi),
                approach=Motion(path=[(car_from_m, 3.5), (0.0, 3.5)], cruise_mps=10.0),
            ),
        ),
        trigger=TriggerSpec(
            id="t",
            condition=TimeToArrival(type="time_to_arrival", anchor=(60.0, 0.0), below_s=1.0),
            object_id="ot1",
            manoeuvre=Hold(kind="hold"),
        ),
        initiator_id="ot1",
    )


@pytest.mark.parametrize(
    ("car_from_m", "words"),
    [
        (135.0, ["approach", "go"]),
        (155.0, ["approach", "yield", "go"]),
        (185.0, ["approach", "wait", "go"]),
        (240.0, ["approach", "go"]),
    ],
)
def test_the_foreseen_driver_gives_way_as_the_simulated_one_does(
    car_from_m: float, words: list[str]
) -> None:
    plan = turning(car_from_m)
    players, body = Players(plan), BodyState(0.0, 0.0, 0.0)
    run = RunSpec.model_construct(
        vut=plan.vut,
        driver=plan.driver,
        faults=[],
        limits=Limits(speed_mps=15.0, acceleration_mps2=5.0, stop_deceleration_mps2=4.0),
        step_s=STEP_S,
    )
    simulated, told, said = VutDriver(run), list[str](), list[str]()
    for k in range(round(20.0 / STEP_S)):
        t = k * STEP_S
        vut, car = state_of_body(body, round(t * 1e9), "vut"), players.target(plan.targets[0], t)
        players.advance([(car, encounter(players.vut(t), car, players.path))], STEP_S)
        command = simulated.command(vut, [car], None, drives=True)
        body = step_body(ObjectClass.CAR, body, command, STEP_S)
        for words_now, heard in (
            (players.priority_words, told),
            (simulated.priority_words, said),
        ):
            heard += [w for w in words_now if heard[-1:] != [w]]
        station = players.path.project(body.x_m, body.y_m)[0]
        assert abs(players.station_m - station) < 1.5, t
    assert told == said == words
