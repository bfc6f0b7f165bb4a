"""The built-in driver in closed loop: keeps its lane and speed, avoids contact, then goes on."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import pytest

from ssp_core.geometry import Polyline, box_distance
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.participants import Driver
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.car_following import following_acceleration
from ssp_core.world.obstacles import find_obstacles
from ssp_ot_controller.bodies.dynamics import BodyState, step_body
from ssp_ot_controller.sil.vut_driver import drive
from tests.support.states import object_state, state_of_body

DT = 0.02
PATH = Polyline([(0.0, 0.0), (250.0, 0.0)])
DRIVER = Driver(cruise_mps=13.9)
CAR = ObjectClass.CAR
FRONT = DEFAULT_SIZES[CAR].front_m


@dataclass(frozen=True)
class Outcome:
    nearest_m: float
    slowest_mps: float
    hardest_mps2: float
    end: BodyState


def simulate(
    others: Callable[[float], list[ObjectState]],
    seconds: float,
    body: BodyState | None = None,
    driver: Driver = DRIVER,
) -> Outcome:
    body = body or BodyState(20.0, 0.0, 0.0, 13.9)
    nearest, slowest, hardest = math.inf, math.inf, 0.0
    for k in range(round(seconds / DT)):
        around = others(k * DT)
        vut = state_of_body(body, object_id="vut")
        nearest = min([nearest, *(box_distance(vut.box, o.box) for o in around)])
        body = step_body(CAR, body, drive(vut, around, PATH, driver, DT), DT)
        slowest = min(slowest, body.speed_mps)
        hardest = min(hardest, body.acceleration_mps2)
    return Outcome(nearest, slowest, hardest, body)


def cut_in(t_s: float) -> list[ObjectState]:
    """A car at 11 m/s whose rear is 12 m ahead, from the right lane in 2.5 s."""
    u = min(t_s / 2.5, 1.0)
    y = -3.5 + 3.5 * u**3 * (10.0 + u * (6.0 * u - 15.0))
    rear = DEFAULT_SIZES[CAR].rear_m
    return [object_state("ot1", CAR, 20.0 + FRONT + 12.0 + rear + 11.0 * t_s, y, 0.0, 11.0)]


def crossing(delay_s: float, speed_mps: float = 1.4) -> Callable[[float], list[ObjectState]]:
    """Steps off 4 m beside the path, delay_s after the VUT is 3.5 s away, and walks over it."""
    x = 20.0 + FRONT + 3.5 * 13.9

    def at(t_s: float) -> list[ObjectState]:
        y = min(-4.0 + speed_mps * max(t_s - delay_s, 0.0), 6.0)
        walking = t_s >= delay_s and y < 6.0
        v = speed_mps if walking else 0.0
        return [object_state("ot1", ObjectClass.PEDESTRIAN, x, y, math.pi / 2, v)]

    return at


def test_a_slower_car_cutting_in_is_followed_without_contact() -> None:
    out = simulate(cut_in, 8.0)
    assert out.nearest_m > 4.0
    assert out.hardest_mps2 > -4.0
    assert out.end.speed_mps < 11.5


def test_without_reaction_the_same_cut_in_is_hit() -> None:
    out = simulate(cut_in, 8.0, driver=Driver(cruise_mps=13.9, reacts=False))
    assert out.nearest_m == 0.0
    assert out.end.speed_mps == pytest.approx(13.9, abs=0.1)


@pytest.mark.parametrize("delay_s", [-1.0, -0.5, 0.0, 0.5, 1.0, 1.5])
def test_a_crossing_pedestrian_is_let_over_and_then_it_goes_on(delay_s: float) -> None:
    out = simulate(crossing(delay_s), 14.0)
    assert out.nearest_m > 1.0
    assert out.slowest_mps < 12.0
    assert out.end.speed_mps > 11.0


def test_at_the_specified_crossing_braking_stays_moderate() -> None:
    assert simulate(crossing(0.0), 10.0).hardest_mps2 > -4.0


def test_a_pedestrian_at_the_kerb_is_no_reason_to_brake() -> None:
    waiting = object_state("ot1", ObjectClass.PEDESTRIAN, 70.0, -4.0, math.pi / 2)
    out = simulate(lambda _: [waiting], 6.0)
    assert out.slowest_mps > 13.8


def test_a_pedestrian_who_left_the_corridor_is_forgotten() -> None:
    gone = object_state("ot1", ObjectClass.PEDESTRIAN, 40.0, 1.6, math.pi / 2, 1.4)
    assert (
        find_obstacles(
            state_of_body(BodyState(20.0, 0.0, 0.0, 10.0), object_id="vut"), [gone], PATH, DRIVER
        )
        == []
    )


@pytest.mark.parametrize(
    ("x_m", "y_m", "speed_mps", "meets"),
    [
        (60.0, -3.0, 1.4, True),
        # Over and away long before the VUT, which is 8 s off, comes by.
        (140.0, -3.0, 2.0, False),
        # Still on the way when the VUT has long passed.
        (60.0, -20.0, 1.4, False),
        # Walks away from the corridor.
        (60.0, -3.0, -1.4, False),
    ],
)
def test_who_crosses_counts_when_both_would_be_there(
    x_m: float, y_m: float, speed_mps: float, meets: bool
) -> None:
    vut = state_of_body(BodyState(20.0, 0.0, 0.0, 13.9), object_id="vut")
    yaw = math.copysign(math.pi / 2, speed_mps)
    walker = object_state("ot1", ObjectClass.PEDESTRIAN, x_m, y_m, yaw, abs(speed_mps))
    assert bool(find_obstacles(vut, [walker], PATH, DRIVER)) is meets


def test_it_stops_before_somebody_standing_in_the_lane_and_waits() -> None:
    standing = object_state("ot1", ObjectClass.PEDESTRIAN, 120.0, 0.3, math.pi / 2)
    out = simulate(lambda _: [standing], 20.0)
    assert out.end.speed_mps == 0.0
    assert 2.0 < out.nearest_m < 5.0


def test_it_stops_behind_a_standing_car_with_its_gap() -> None:
    out = simulate(lambda _: [object_state("ot1", CAR, 120.0, 0.0)], 20.0)
    assert out.end.speed_mps == 0.0
    assert out.nearest_m == pytest.approx(DRIVER.standstill_gap_m, abs=0.5)


@pytest.mark.parametrize("y_m", [3.5, -3.5])
def test_a_car_in_the_next_lane_is_no_obstacle(y_m: float) -> None:
    vut = state_of_body(BodyState(20.0, 0.0, 0.0, 13.9), object_id="vut")
    assert find_obstacles(vut, [object_state("ot1", CAR, 40.0, y_m)], PATH, DRIVER) == []


def test_what_is_behind_is_no_obstacle() -> None:
    vut = state_of_body(BodyState(60.0, 0.0, 0.0, 13.9), object_id="vut")
    behind = [
        object_state("ot1", CAR, 40.0, 0.0),
        object_state("ot1", ObjectClass.PEDESTRIAN, 50.0, 0.0),
    ]
    assert find_obstacles(vut, behind, PATH, DRIVER) == []


def test_gap_and_speed_are_along_the_path() -> None:
    vut = state_of_body(BodyState(20.0, 0.0, 0.0, 13.9), object_id="vut")
    [o] = find_obstacles(vut, [object_state("ot1", CAR, 40.0, 0.0, 0.0, 9.0)], PATH, DRIVER)
    assert o.gap_m == pytest.approx(20.0 - FRONT - DEFAULT_SIZES[CAR].rear_m)
    assert o.speed_mps == pytest.approx(9.0)


def test_it_reaches_cruise_speed_keeps_it_and_stands_at_the_paths_end() -> None:
    fast = simulate(lambda _: [], 10.0, BodyState(0.0, 0.4, 0.05))
    assert fast.end.speed_mps == pytest.approx(13.9, abs=0.6)
    assert abs(fast.end.y_m) < 0.02
    end = simulate(lambda _: [], 30.0, BodyState(0.0, 0.0, 0.0))
    assert end.end.speed_mps == 0.0
    assert end.end.x_m == pytest.approx(250.0, abs=0.3)
    assert end.hardest_mps2 > -3.0


@pytest.mark.parametrize("acceleration_mps2", [-3.0, 0.0, 2.0])
def test_the_nearer_the_harder(acceleration_mps2: float) -> None:
    gaps = [3.5, 5.0, 10.0, 20.0, 40.0, 80.0]
    wanted = [following_acceleration(12.0, g, 8.0, acceleration_mps2, DRIVER) for g in gaps]
    assert wanted == sorted(wanted)
    assert all(math.isfinite(a) for a in wanted)


def test_a_standing_obstacle_is_braked_for_at_least_as_physics_asks() -> None:
    gap = 40.0
    room = gap - DRIVER.standstill_gap_m
    needed = 13.9**2 / (2.0 * room)
    for still in (0.0, -2.0):
        assert following_acceleration(13.9, gap, 0.0, still, DRIVER) <= -needed


@pytest.mark.parametrize(
    ("y_m", "yaw_rad", "speed_mps", "gaps_m"),
    [
        pytest.param(-8.0, math.pi / 2, 6.0, 1, id="a car that crosses from the right"),
        pytest.param(8.0, -math.pi / 2, 6.0, 1, id="a car that crosses from the left"),
        pytest.param(8.0, math.pi / 2, 6.0, 0, id="one that has crossed"),
        pytest.param(-8.0, math.pi / 2, 0.0, 0, id="one that waits"),
        pytest.param(-8.0, -math.pi / 2, 6.0, 0, id="one that drives away"),
        pytest.param(-8.0, 0.3, 6.0, 0, id="one that drives along"),
        pytest.param(-80.0, math.pi / 2, 6.0, 0, id="one that comes much later"),
    ],
)
def test_a_vehicle_that_crosses_is_yielded_to(
    y_m: float, yaw_rad: float, speed_mps: float, gaps_m: int
) -> None:
    vut = state_of_body(BodyState(10.0, 0.0, 0.0, 9.0), object_id="vut")
    car = object_state("ot1", CAR, 40.0, y_m, yaw_rad, speed_mps=speed_mps)
    found = find_obstacles(vut, [car], PATH, DRIVER)
    assert len(found) == gaps_m
    # It is as one that stands: its motion along the path is no reason to close in on it.
    assert all(obstacle.speed_mps == 0.0 for obstacle in found)
