"""The prediction's VUT gives way, and stops for who crosses, as the simulated one does."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

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
from ssp_ot_controller.sil.vut_driver import VutDriver, drive
from ssp_scenario_manager.scenarios.motions import STEP_S, Motions
from ssp_scenario_manager.scenarios.prediction import Players
from tests.support.states import object_state, state_of_body

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
        players.advance(players.vut(t), [car], STEP_S)
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


@pytest.mark.parametrize(
    ("object_class", "x_m", "y_m", "speed_mps", "slows"),
    [
        # Over and away before the VUT comes by.
        ("cyclist", 110.0, -3.0, 4.0, False),
        ("pedestrian", 110.0, -3.0, 2.0, False),
        # Still on the way when it has passed.
        ("cyclist", 60.0, -60.0, 3.0, False),
        ("cyclist", 60.0, -20.0, 3.0, True),
        ("pedestrian", 60.0, -8.0, 1.4, True),
    ],
)
def test_the_foreseen_driver_slows_for_who_crosses_as_the_simulated_one_does(
    object_class: str, x_m: float, y_m: float, speed_mps: float, *, slows: bool
) -> None:
    plan = turning(300.0)
    straight = Motion(path=[(0.0, 0.0), (400.0, 0.0)], cruise_mps=10.0)
    plan = replace(
        plan,
        vut=plan.vut.model_copy(update={"approach": straight}),
        driver=Driver(cruise_mps=10.0),
    )
    players = Players(plan)
    vut_x_m, vut_mps, slowest_mps = 0.0, 10.0, 10.0
    players.speed_mps = vut_mps
    for k in range(round(12.0 / STEP_S)):
        t = k * STEP_S
        at = y_m + speed_mps * t
        who = object_state(
            "ot1", ObjectClass[object_class.upper()], x_m, at, math.pi / 2, speed_mps
        )
        players.advance(players.vut(t), [who], STEP_S)
        vut = state_of_body(BodyState(vut_x_m, 0.0, 0.0, vut_mps), round(t * 1e9), "vut")
        rate = drive(vut, [who], players.path, plan.driver, STEP_S).acceleration_mps2
        faster = max(vut_mps + rate * STEP_S, 0.0)
        vut_x_m, vut_mps = vut_x_m + 0.5 * (vut_mps + faster) * STEP_S, faster
        slowest_mps = min(slowest_mps, players.speed_mps)
        assert players.speed_mps == pytest.approx(vut_mps, abs=0.2), t
    assert (slowest_mps < 9.0) is slows
