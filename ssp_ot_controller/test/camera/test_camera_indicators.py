"""Indicators blink while a vehicle moves sideways along the road, and a little longer."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.clock import seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.road import CurvePiece, Lane, Road
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.reference_line import ReferenceLine
from ssp_ot_controller.camera.renderer.scene import Indicator, Indicators, is_lit, sideways_mps
from tests.support.states import object_state

LANES = [Lane(y_m=0.0, width_m=3.5, direction="forward")]
ROAD = Road(origin=Start(x_m=0.0, y_m=0.0, yaw_rad=0.5), length_m=200.0, lanes=LANES)


def car(
    x_m: float = 30.0,
    y_m: float = 0.0,
    yaw_rad: float = 0.5,
    speed_mps: float = 10.0,
    object_class: ObjectClass = ObjectClass.CAR,
) -> ObjectState:
    return object_state("ot1", object_class, x_m, y_m, yaw_rad, speed_mps)


@pytest.mark.parametrize(
    ("state", "sideways"),
    [
        (car(), 0.0),
        (car(yaw_rad=0.6), 1.0),
        (car(yaw_rad=0.6 - 3.14159265), 1.0),  # comes the other way and turns to its own left
        (car(yaw_rad=1.5), 0.0),  # turns off
        (car(yaw_rad=0.6, speed_mps=0.5), 0.0),
        (car(yaw_rad=0.6, object_class=ObjectClass.CYCLIST), 0.0),
    ],
)
def test_sideways_is_across_the_road_where_the_vehicle_is(
    state: ObjectState, sideways: float
) -> None:
    assert sideways_mps(state, ReferenceLine.of_road(ROAD)) == pytest.approx(sideways, abs=0.01)


def test_a_vehicle_that_follows_a_bend_does_not_indicate() -> None:
    bend = [CurvePiece(length_m=200.0, start_curvature_1pm=0.01, end_curvature_1pm=0.01)]
    road = ROAD.model_copy(update={"pieces": bend})
    line, shown = ReferenceLine.of_road(road), Indicators(road)
    for s in range(20, 180, 8):
        pose = line.pose(float(s))
        state = car(pose.x_m, pose.y_m, pose.yaw_rad)
        assert shown.update([state], seconds_to_ns(s / 10.0)) == {}


def test_it_blinks_while_moving_sideways_and_a_little_longer() -> None:
    shown = Indicators(ROAD)
    assert shown.update([car()], 0) == {}
    assert shown.update([car(yaw_rad=0.6)], seconds_to_ns(1.0)) == {"ot1": Indicator.LEFT}
    assert shown.update([car()], seconds_to_ns(1.2)) == {"ot1": Indicator.LEFT}
    assert shown.update([car()], seconds_to_ns(1.5)) == {}
    assert shown.update([car(yaw_rad=0.4)], seconds_to_ns(2.0)) == {"ot1": Indicator.RIGHT}
    assert shown.update([], seconds_to_ns(2.1)) == {}


@given(stamp_ns=st.integers(0, 10**12))
def test_lamps_shine_half_of_the_time(stamp_ns: int) -> None:
    assert is_lit(stamp_ns) != is_lit(stamp_ns + 333_333_333) or stamp_ns % 666_666_666 in (
        *range(2),
        *range(333_333_331, 333_333_335),
        *range(666_666_663, 666_666_666),
    )
