"""When indicators blink: while a vehicle moves sideways along the road, and before."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import (
    Condition,
    ElapsedTime,
    LaneChange,
    RelativeDistance,
    TimeHeadway,
    TimeToArrival,
)
from ssp_core.run_file.road import CurvePiece, Lane, Road
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.reference_line import ReferenceLine
from ssp_ot_controller.camera.clip import foreseen
from ssp_ot_controller.camera.renderer.scene import (
    AHEAD_S,
    OFF,
    Foreseen,
    Indicator,
    Indicators,
    is_lit,
    sideways_mps,
)
from ssp_ot_controller.camera.storyboards import storyboard
from support.runs import small_run
from support.states import object_state

LANES = [Lane(y_m=0.0, width_m=3.5, direction="forward")]
ROAD = Road(origin=Start(x_m=0.0, y_m=0.0, yaw_rad=0.5), length_m=200.0, lanes=LANES)


def car(
    x_m: float = 30.0, y_m: float = 0.0, yaw_rad: float = 0.5, speed_mps: float = 10.0,
    object_id: str = "ot1", object_class: ObjectClass = ObjectClass.CAR,
) -> ObjectState:  # fmt: skip
    return object_state(object_id, object_class, x_m, y_m, yaw_rad, speed_mps)


def never(_: Mapping[str, ObjectState], __: int) -> dict[str, Indicator]:
    return {}


def test_sideways_is_across_the_road_where_the_vehicle_is() -> None:
    line = ReferenceLine.of_road(ROAD)
    assert sideways_mps(car(), line) == pytest.approx(0.0)
    assert sideways_mps(car(yaw_rad=0.6), line) == pytest.approx(1.0, abs=0.01)
    # Who comes the other way and turns to its own left.
    assert sideways_mps(car(yaw_rad=0.6 - 3.14159265), line) == pytest.approx(1.0, abs=0.01)
    assert sideways_mps(car(yaw_rad=1.5), line) == 0.0  # turns off
    assert sideways_mps(car(yaw_rad=0.6, speed_mps=0.5), line) == 0.0
    assert sideways_mps(car(yaw_rad=0.6, object_class=ObjectClass.CYCLIST), line) == 0.0


def test_a_vehicle_that_follows_a_bend_does_not_indicate() -> None:
    bend = [CurvePiece(length_m=200.0, start_curvature_1pm=0.01, end_curvature_1pm=0.01)]
    road = ROAD.model_copy(update={"pieces": bend})
    line = ReferenceLine.of_road(road)
    shown = Indicators(road, never)
    for s in range(20, 180, 8):
        pose = line.pose(float(s))
        state = car(pose.x_m, pose.y_m, pose.yaw_rad)
        assert shown.update([state], seconds_to_ns(s / 10.0)) == {}


def test_it_blinks_while_moving_sideways_and_a_little_longer() -> None:
    shown = Indicators(ROAD, never)
    assert shown.update([car()], 0) == {}
    assert shown.update([car(yaw_rad=0.6)], seconds_to_ns(1.0)) == {"ot1": Indicator.LEFT}
    assert shown.update([car()], seconds_to_ns(1.2)) == {"ot1": Indicator.LEFT}
    assert shown.update([car()], seconds_to_ns(1.5)) == {}
    assert shown.update([car(yaw_rad=0.4)], seconds_to_ns(2.0)) == {"ot1": Indicator.RIGHT}


def test_what_is_foreseen_blinks_once_and_not_for_ever() -> None:
    def right(_: Mapping[str, ObjectState], __: int) -> dict[str, Indicator]:
        return {"ot1": Indicator.RIGHT, "gone": Indicator.LEFT}

    shown = Indicators(ROAD, right)
    assert shown.update([car()], 0) == {"ot1": Indicator.RIGHT}
    assert shown.update([car(yaw_rad=0.4)], seconds_to_ns(1.0)) == {"ot1": Indicator.RIGHT}
    assert shown.update([car()], seconds_to_ns(3.0)) == {}  # done; the condition still holds
    waiting = Indicators(ROAD, right)
    assert waiting.update([car()], 0) == {"ot1": Indicator.RIGHT}
    assert waiting.update([car()], seconds_to_ns(5.0)) == {}  # it didn't come


@given(stamp_ns=st.integers(0, 10**12))
def test_lamps_shine_half_of_the_time(stamp_ns: int) -> None:
    assert is_lit(stamp_ns) != is_lit(stamp_ns + 333_333_333) or stamp_ns % 666_666_666 in (
        *range(2),
        *range(333_333_331, 333_333_335),
        *range(666_666_663, 666_666_666),
    )


PATH = [(0.0, 0.0), (400.0, 0.0)]


@pytest.mark.parametrize(
    ("condition", "away_m", "fires"),
    [
        # The VUT's front is 3.6 m before its reference point, the OT's tail 0.9 m behind its.
        (RelativeDistance(type="relative_distance", object_id="ot1", below_m=20.0), 29.0, True),
        (RelativeDistance(type="relative_distance", object_id="ot1", below_m=20.0), 34.0, False),
        (TimeHeadway(type="time_headway", object_id="ot1", below_s=2.0), 29.0, True),
        (TimeToArrival(type="time_to_arrival", anchor=(40.0, 0.0), below_s=3.0), 90.0, True),
        (TimeToArrival(type="time_to_arrival", anchor=(60.0, 0.0), below_s=3.0), 90.0, False),
        (ElapsedTime(type="elapsed_time", after_s=1.0), 90.0, True),
        (ElapsedTime(type="elapsed_time", after_s=2.0), 90.0, False),
    ],
)
def test_a_lane_change_is_foreseen_when_its_trigger_is_about_to_fire(
    condition: Condition, away_m: float, fires: bool, a_run: RunSpec
) -> None:
    change = LaneChange(kind="lane_change", lateral_shift_m=-3.5, duration_s=2.0, cruise_mps=8.0)
    trigger = a_run.triggers[0].model_copy(update={"condition": condition, "manoeuvre": change})
    run = a_run.model_copy(update={"triggers": [trigger]})
    states = {
        "vut": car(0.0, yaw_rad=0.0, speed_mps=10.0, object_id="vut"),
        "ot1": car(away_m, 3.5, 0.0, 6.0),
    }
    assert Foreseen(run)(states, 0) == ({"ot1": Indicator.RIGHT} if fires else {})


@pytest.fixture
def a_run() -> RunSpec:
    start = {"x_m": 0.0, "y_m": 0.0, "yaw_rad": 0.0}
    run = small_run(
        vut={
            "id": "vut",
            "object_class": "car",
            "start": start,
            "approach": {"path": PATH, "cruise_mps": 10.0},
        },
        targets=[{"id": "ot1", "object_class": "car", "start": start}],
        triggers=[
            {
                "id": "t",
                "object_id": "ot1",
                "condition": {"type": "elapsed_time", "after_s": 1.0},
                "manoeuvre": {"kind": "brake", "to_mps": 0.0, "deceleration_mps2": 3.0},
            }
        ],
        geofence=[(-10, -10), (410, -10), (410, 10)],
    )
    return RunSpec.model_validate(run)


def test_a_braking_is_no_reason_to_indicate(a_run: RunSpec) -> None:
    assert Foreseen(a_run)({"vut": car(0.0, object_id="vut"), "ot1": car()}, 10**10) == {}


def test_in_a_clip_the_car_indicates_before_it_cuts_in() -> None:
    board = storyboard("cut_in", 1)
    shown = Indicators(board.road, foreseen(board))
    line = ReferenceLine.of_road(board.road)
    blinks, moves = [], []
    for t_s in board.times():
        states = board.states(t_s)
        side = shown.update(states, seconds_to_ns(t_s)).get("ot1", OFF)
        ot = next(s for s in states if s.object_id == "ot1")
        if side is not OFF:
            assert side is Indicator.RIGHT
            blinks.append(t_s)
        if sideways_mps(replace(ot), line) < -0.3:
            moves.append(t_s)
    assert moves[0] - blinks[0] == pytest.approx(AHEAD_S, abs=0.1)
    assert moves[-1] <= blinks[-1] < moves[-1] + 1.0
