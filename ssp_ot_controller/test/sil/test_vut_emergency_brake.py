"""The emergency brake begins when it must, is enough, and ends when it may."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.run_file.participants import Driver
from ssp_core.world.obstacles import Obstacle
from ssp_ot_controller.sil.vut_driver import (
    BUILD_UP_S,
    MARGIN_M,
    brakes_in_emergency,
    needed_deceleration,
)

DRIVER = Driver(cruise_mps=14.0, comfortable_deceleration_mps2=2.5, aeb_deceleration_mps2=6.0)


def closest_m(speed: float, obstacle: Obstacle, deceleration: float) -> float:
    """Smallest gap, by small steps, when the VUT brakes after the build-up."""
    gap, v, ahead, t, dt = obstacle.gap_m, speed, obstacle.speed_mps, 0.0, 0.001
    least = gap
    while v > 0.0 and t < 60.0:
        gap += (ahead - v) * dt
        ahead = max(ahead + min(obstacle.acceleration_mps2, 0.0) * dt, 0.0)
        v -= deceleration * dt if t >= BUILD_UP_S else 0.0
        t += dt
        least = min(least, gap)
        if v <= ahead and obstacle.acceleration_mps2 == 0.0:
            break
    return least


@given(
    st.floats(1.0, 25.0), st.floats(2.0, 80.0), st.floats(0.0, 25.0), st.sampled_from([0.0, -2, -5])
)
def test_what_is_needed_is_enough(
    speed: float, gap: float, ahead: float, acceleration: float
) -> None:
    obstacle = Obstacle("o", gap, ahead, acceleration)
    needed = needed_deceleration(speed, obstacle)
    if needed == math.inf or needed > 12.0 or needed < 0.05:
        return
    # What the one ahead brakes during the build-up isn't foreseen: at most a v·t of its change.
    slack = 0.02 + abs(acceleration) * BUILD_UP_S * speed / max(needed, 0.5)
    assert closest_m(speed, obstacle, needed) > MARGIN_M - slack - 0.05


def test_against_a_standing_obstacle_it_is_the_formula() -> None:
    room = 20.0 - MARGIN_M - 10.0 * BUILD_UP_S
    assert needed_deceleration(10.0, Obstacle("o", 20.0, 0.0, 0.0)) == pytest.approx(50.0 / room)


@pytest.mark.parametrize(
    ("obstacle", "needed"),
    [
        (Obstacle("faster", 5.0, 12.0, 0.0), 0.0),
        (Obstacle("as fast", 5.0, 10.0, 0.0), 0.0),
        (Obstacle("speeds up", 5.0, 10.0, 2.0), 0.0),
        (Obstacle("too near", 0.4, 5.0, 0.0), math.inf),
    ],
)
def test_bounds(obstacle: Obstacle, needed: float) -> None:
    assert needed_deceleration(10.0, obstacle) == needed


def test_it_begins_above_comfortable_braking_and_not_at_it() -> None:
    # v^2 / (2 b) = 20 m with 2.5 m/s^2 from 10 m/s; 2 m close while brakes build up.
    at = 20.0 + MARGIN_M + 10.0 * BUILD_UP_S
    assert not brakes_in_emergency(False, 10.0, [Obstacle("o", at + 0.01, 0.0, 0.0)], DRIVER)
    assert brakes_in_emergency(False, 10.0, [Obstacle("o", at - 0.01, 0.0, 0.0)], DRIVER)
    assert not brakes_in_emergency(False, 10.0, [], DRIVER)
    assert not brakes_in_emergency(
        False, 10.0, [Obstacle("o", 1.0, 0.0, 0.0)], Driver(cruise_mps=14.0)
    )


def test_it_ends_when_nothing_ahead_is_slower_and_holds_at_standstill() -> None:
    far, stands = Obstacle("o", 200.0, 3.0, 0.0), Obstacle("o", 5.0, 0.0, 0.0)
    assert brakes_in_emergency(True, 3.1, [far], DRIVER)
    assert not brakes_in_emergency(True, 3.0, [far], DRIVER)
    assert not brakes_in_emergency(True, 0.0, [far], DRIVER)
    assert not brakes_in_emergency(True, 5.0, [], DRIVER)
    assert brakes_in_emergency(True, 0.0, [stands], DRIVER)
    assert not brakes_in_emergency(False, 0.0, [stands], DRIVER)
