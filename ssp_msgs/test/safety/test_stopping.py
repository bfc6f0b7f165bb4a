"""The stated bound of stopping distances."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.geometry import FloatArray
from ssp_core.motion.state import Size
from ssp_core.run_file.model import Limits
from ssp_core.safety.stopping import (
    BRAKE_LAG_S,
    SERVICE_BRAKE_MPS2,
    Stopping,
    arc_places,
    blind_excess_m,
    blind_s,
    blind_stopping,
    grown,
    stopping_of,
)
from ssp_core.vocabulary import ObjectClass

SITE = Limits(speed_mps=15.0, acceleration_mps2=5.0)


def test_the_bound_is_blind_time_plus_braking_plus_margin() -> None:
    stopping = Stopping(reaction_s=0.3, deceleration_mps2=4.0, margin_m=0.5)
    assert stopping.distance_m(10.0, 0.5) == pytest.approx(10.0 * 0.8 + 100.0 / 8.0 + 0.5)
    assert stopping.duration_s(10.0, 0.5) == pytest.approx(0.8 + 2.5)
    assert stopping.distance_m(0.0, 0.5) == 0.5


def test_who_may_speed_up_until_it_notices_gets_as_much_farther() -> None:
    """0.8 s at 2 m/s^2 lead from 10 to 11.6 m/s."""
    stopping = Stopping(reaction_s=0.3, deceleration_mps2=4.0, margin_m=0.5)
    farthest_m = 10.0 * 0.8 + 0.5 * 2.0 * 0.8**2 + 11.6**2 / 8.0 + 0.5
    assert stopping.distance_m(10.0, 0.5, 2.0) == pytest.approx(farthest_m)
    assert stopping.distance_m(-10.0, 0.5, 2.0) == pytest.approx(farthest_m)
    assert stopping.duration_s(-10.0, 0.5) == pytest.approx(0.8 + 2.5)
    assert Stopping(0.3, 4.0).distance_m(0.0, 0.0) == 0.3


def test_who_is_blind_notices_by_the_longer_silence_and_brakes_as_hard_as_it_can() -> None:
    late, frozen = (
        SITE.model_copy(update={"state_age_s": age_s, "frozen_s": frozen_s})
        for age_s, frozen_s in ((0.5, 0.2), (0.1, 0.4))
    )
    assert (blind_s(late), blind_s(frozen)) == (0.5, 0.4)
    assert blind_stopping(ObjectClass.CAR, SITE, 0.02) == Stopping(0.04 + 0.25, 8.5, 0.3)
    assert grown(Size(4.0, 1.0, 2.0, 1.5)) == Size(4.2, 1.2, 2.4, 1.5)


def test_places_on_an_arc_are_so_near_that_chords_keep_to_it() -> None:
    for way_m, radius_m in ((10.0, 8.0), (30.0, 20.0), (60.0, -15.0)):
        between_m = way_m / (arc_places(way_m, 1.0 / radius_m) - 1)
        assert 0.004 <= between_m**2 / (8.0 * abs(radius_m)) <= 0.005
    assert [arc_places(way_m, 0.0) for way_m in (0.0, 3.9, 4.0, 40.0, 1e6)] == [2, 2, 3, 12, 514]


def held(x_m: float, yaw_rad: float, speed_mps: float, curvature_1pm: float) -> FloatArray:
    """One point of a reference."""
    return np.array([[0.0], [x_m], [0.0], [yaw_rad], [speed_mps], [0.0], [curvature_1pm]])


# 0.3 s late and 0.29 s slow at 10 m/s, 8.5 m/s^2, the margin and the slack.
BLIND_M = 10.0 * (0.3 + 0.29) + 100.0 / 17.0 + 0.3 + 0.2
LATE = SITE.model_copy(update={"state_age_s": 0.3, "frozen_s": 0.2})
BODY = Size(4.0, 1.0, 2.0, 1.5)


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 2.0, math.pi])
def test_a_blind_stop_needs_its_way_and_the_slack_on_each_side(yaw_rad: float) -> None:
    """The fence is the box that the stop sweeps, turned as it drives."""
    columns = held(3.0, yaw_rad, 10.0, 0.0)
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)

    def excess_m(front_m: float = 0.0, rear_m: float = 0.0, side_m: float = 0.0) -> float:
        along = (-1.0 - rear_m, BLIND_M + 4.2 + front_m)
        across = (-1.2 - side_m, 1.2 + side_m)
        corners = [(along[0], across[0]), (along[1], across[0])]
        corners += [(along[1], across[1]), (along[0], across[1])]
        fence = [(3.0 + c * u - s * v, s * u + c * v) for u, v in corners]
        (found,) = blind_excess_m(columns, ObjectClass.CAR, BODY, LATE, fence, 0.02)
        return float(found)

    assert excess_m(1e-6, 1e-6, 1e-6) == 0.0
    assert excess_m(-0.01, 1e-6, 1e-6) == pytest.approx(0.01, abs=1e-5)
    assert excess_m(1e-6, -0.01, 1e-6) == pytest.approx(0.01, abs=1e-5)
    assert excess_m(1e-6, 1e-6, -0.01) == pytest.approx(0.01, abs=1e-5)


def test_a_blind_stop_goes_on_along_the_arc_but_a_walkers_straight_on() -> None:
    def right_m(cls: ObjectClass, low_m: float, speed_mps: float) -> float:
        fence = [(-20.0, low_m), (100.0, low_m), (100.0, 50.0), (-20.0, 50.0)]
        columns = held(0.0, 0.0, speed_mps, -0.05)
        (found,) = blind_excess_m(columns, cls, BODY, LATE, fence, 0.02)
        return float(found)

    turned = 0.05 * BLIND_M
    lowest_m = -20.0 * (1.0 - math.cos(turned)) - 4.2 * math.sin(turned) - 1.2 * math.cos(turned)
    assert right_m(ObjectClass.CAR, lowest_m - 0.001, 10.0) == 0.0
    assert right_m(ObjectClass.CAR, lowest_m + 0.01, 10.0) == pytest.approx(0.01, abs=0.001)
    assert right_m(ObjectClass.PEDESTRIAN, -1.2 - 1e-6, 2.0) == 0.0


def test_a_fast_stop_on_a_narrow_arc_is_swept_to_half_a_centimetre() -> None:
    """It goes round a circle of 10 m; the front right corner of its slack leads outermost."""
    low_m = 0.02 - math.hypot(10.0 + 1.2, 4.2)
    fence = [(-40.0, low_m), (40.0, low_m), (40.0, 40.0), (-40.0, 40.0)]
    for turn in range(12):
        c, s = math.cos(0.5 * turn), math.sin(0.5 * turn)
        columns = held(0.0, 0.5 * turn, 30.0, 0.1)
        columns[1:3, 0] = 10.0 * s, -10.0 * c
        (found,) = blind_excess_m(columns, ObjectClass.CAR, BODY, LATE, fence, 0.02)
        assert found == pytest.approx(0.02, abs=0.006)


def test_the_worst_place_of_a_blind_stop_counts_for_each_point() -> None:
    columns = np.hstack([held(x_m, 0.0, 10.0, 0.0) for x_m in (0.0, 50.0, 60.0)])
    notched = [(-20.0, -5.0), (100.0, -5.0), (100.0, 5.0), (70.0, 5.0), (70.0, 0.9), (69.0, 0.9)]
    fence = [*notched, (69.0, 5.0), (-20.0, 5.0)]
    excess = blind_excess_m(columns, ObjectClass.CAR, BODY, LATE, fence, 0.02)
    assert excess.tolist() == [0.0, 0.0, pytest.approx(0.3)]


def test_a_site_and_a_body_both_bound_the_deceleration() -> None:
    assert stopping_of(ObjectClass.CAR, SITE, 0.02).deceleration_mps2 == 4.0
    assert stopping_of(ObjectClass.PEDESTRIAN, SITE, 0.02).deceleration_mps2 == 3.0
    gentle = SITE.model_copy(update={"acceleration_mps2": 2.0})
    assert stopping_of(ObjectClass.CAR, gentle, 0.02).deceleration_mps2 == 2.0
    assert stopping_of(ObjectClass.CAR, SITE, 0.02).reaction_s == pytest.approx(0.29)


def test_every_class_with_a_body_is_stated() -> None:
    classes = set(ObjectClass) - {ObjectClass.UNKNOWN}
    assert set(BRAKE_LAG_S) == set(SERVICE_BRAKE_MPS2) == classes


@given(st.floats(0.0, 40.0), st.floats(0.0, 2.0), st.sampled_from(sorted(SERVICE_BRAKE_MPS2)))
def test_more_speed_or_a_longer_silence_never_stops_sooner(
    speed_mps: float, timeout_s: float, cls: ObjectClass
) -> None:
    stopping = stopping_of(cls, SITE, 0.02)
    here = stopping.distance_m(speed_mps, timeout_s)
    assert stopping.distance_m(speed_mps + 0.1, timeout_s) > here
    assert stopping.distance_m(speed_mps, timeout_s + 0.1) >= here
