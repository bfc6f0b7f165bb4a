"""One window of states: its bounds, and the mistake that is named for what contradicts in it."""

from __future__ import annotations

import math

import pytest

from ssp_core.safety.window import (
    CLOCKWISE,
    EMPTY_TWIST,
    MAP_AXES,
    NED_YAW,
    NOT_MPS,
    OTHER_SPEED,
    TURNED,
    UNITS,
    SpeedFactors,
    Window,
    either,
    kind_of,
    known_factors,
    speed_bound_mps,
)

OTHER_YAW = "yaw contradicts the way"
DIRECTION_RAD = math.radians(20.0)


def window(course_rad: float, way_mps: float, speed_mps: float, yaw_rad: float) -> Window:
    c, s = math.cos(course_rad), math.sin(course_rad)
    return Window(0.5, way_mps * c, way_mps * s, speed_mps, yaw_rad)


@pytest.mark.parametrize(
    ("stated", "way", "noise", "bound"),
    [
        (4.0, 1.0, 0.0, 1.0),
        (-4.0, 1.0, 0.0, 1.0),
        (1.0, 4.0, 0.0, 1.0),
        (1.0, 1.0, 0.0, 0.5),
        (4.0, 4.0, 1.5, 1.5),
    ],
)
def test_a_speed_may_be_off_by_a_quarter_or_half_a_metre_per_second_or_the_noise(
    stated: float, way: float, noise: float, bound: float
) -> None:
    assert speed_bound_mps(stated, way, noise) == bound
    if noise == 0.0:
        assert speed_bound_mps(stated, way) == bound


@pytest.mark.parametrize(
    ("speed_mps", "signed", "turned_rad"),
    [
        (5.0, True, 2.5),
        (0.0, True, 2.5),
        (-5.0, True, 2.5 - math.pi),
        (5.0, False, 2.5 - math.pi),
        (-5.0, False, 2.5 - math.pi),
    ],
)
def test_the_way_lies_to_the_left_of_where_yaw_and_sign_of_the_speed_lead(
    speed_mps: float, signed: bool, turned_rad: float
) -> None:
    turned = window(1.5, 4.0, speed_mps, -1.0).turned_rad(signed=signed)
    assert turned == pytest.approx(turned_rad)


def test_the_excess_of_a_speed_is_that_of_its_amount_over_the_way() -> None:
    assert window(1.0, 4.0, -5.0, 0.0).speed_excess_mps == pytest.approx(1.0)
    assert window(1.0, 4.0, 3.0, 0.0).speed_excess_mps == pytest.approx(-1.0)


@pytest.mark.parametrize(
    ("course_rad", "way_mps", "speed_mps", "yaw_rad", "kind"),
    [
        # What faces west and states the speed along the map's x, backwards.
        (math.pi, 10.0, -10.0, math.pi, MAP_AXES),
        # North-east, at the share of the speed that lies along x.
        (1.2, 10.0, 10.0 * math.cos(1.2), 1.2, MAP_AXES),
        # Its speed lies nearer to x than to the way along its yaw, by half.
        (1.0, 10.0, 7.4, -1.0, MAP_AXES),
        (0.2, 10.0, 5.0, -1.0, OTHER_SPEED),
        # It goes forwards, if only just, and states the opposite.
        (2.5, 10.0, 10.0 * math.cos(2.5), 1.3, MAP_AXES),
        (1.0, 1.0, 0.54, 2.0, OTHER_YAW),
        (1.0, 1.0, 0.54, 0.3, OTHER_YAW),
        (0.0, 10.0, 7.5, 0.6, OTHER_YAW),
        (0.0, 10.0, 5.0, 0.0, OTHER_SPEED),
        (0.0, 10.0, 36.0, 0.0, OTHER_SPEED),
        (0.0, 10.0, 7.6, 0.6, OTHER_YAW),
        (0.0, 10.0, 7.4, 0.6, OTHER_SPEED),
        (0.0, 1.0, 1.49, 0.6, OTHER_YAW),
        (0.0, 1.0, 1.51, 0.6, OTHER_SPEED),
        (0.0, 10.0, 10.0, math.pi, TURNED),
        (0.0, 10.0, 10.0, math.pi - 0.17, TURNED),
        (0.0, 10.0, 10.0, math.pi - 0.18, OTHER_YAW),
        (0.0, 10.0, -10.0, 0.0, TURNED),
        (0.3, 10.0, 10.0, math.pi / 2.0 - 0.3, NED_YAW),
        (0.3, 10.0, 10.0, -0.3, CLOCKWISE),
        (1.2, 10.0, -10.0, math.pi - 1.2, CLOCKWISE),
        (0.3, 10.0, 10.0, 0.9, OTHER_YAW),
        # It says that it goes backwards, and does; that its speed fits x as well proves nothing.
        (0.4 + math.pi, 10.0, -10.0 * math.cos(0.4), 0.4, OTHER_YAW),
    ],
)
def test_the_mistake_is_named_that_explains_the_window(
    course_rad: float, way_mps: float, speed_mps: float, yaw_rad: float, kind: str
) -> None:
    one = window(course_rad, way_mps, speed_mps, yaw_rad)
    assert kind_of(one, abs(speed_mps), DIRECTION_RAD, signed=True) == kind


def test_a_speed_that_a_delay_explains_is_no_other_one() -> None:
    late = window(math.pi, 10.0, 5.0, 0.0)
    assert kind_of(late, 5.0, DIRECTION_RAD, signed=True) == OTHER_SPEED
    assert kind_of(late, 5.0, DIRECTION_RAD, signed=True, speed_fits=True) == TURNED


def test_the_sign_of_an_unsigned_speed_says_nothing_of_the_yaw() -> None:
    one = window(0.3, 2.0, -2.0, 0.3 + math.pi)
    assert kind_of(one, 2.0, DIRECTION_RAD, signed=False) == TURNED
    assert kind_of(one, 2.0, DIRECTION_RAD, signed=True) == OTHER_YAW


@pytest.mark.parametrize(
    ("course_rad", "way_mps", "fastest_mps", "yaw_rad", "kind"),
    [
        (0.0, 2.0, 0.0, 0.0, EMPTY_TWIST),
        (0.0, 2.0, 0.05, 0.0, EMPTY_TWIST),
        (0.0, 2.0, 0.06, 0.0, OTHER_SPEED),
        # To the north a twist in map axes is nearly none, but not quite.
        (math.pi / 2.0, 2.0, 1e-12, math.pi / 2.0, MAP_AXES),
        (math.pi / 2.0, 2.0, 0.0, math.pi / 2.0, EMPTY_TWIST),
        # A twentieth of the way may lie along x, by the places or by the yaw; of a slow one 5 cm/s.
        (math.acos(0.049), 10.0, 0.01, 0.0, MAP_AXES),
        (math.acos(0.051), 10.0, 0.01, 0.0, EMPTY_TWIST),
        (0.0, 10.0, 0.01, math.acos(0.049), MAP_AXES),
        (0.0, 10.0, 0.01, math.acos(0.051), EMPTY_TWIST),
        (math.acos(0.09), 0.5, 0.01, 0.0, MAP_AXES),
        (math.acos(0.11), 0.5, 0.01, 0.0, EMPTY_TWIST),
    ],
)
def test_who_states_no_speed_and_goes_has_an_empty_twist_or_one_in_map_axes(
    course_rad: float, way_mps: float, fastest_mps: float, yaw_rad: float, kind: str
) -> None:
    one = window(course_rad, way_mps, fastest_mps, yaw_rad)
    assert kind_of(one, fastest_mps, DIRECTION_RAD, signed=True) == kind


def test_who_hardly_goes_has_no_empty_twist() -> None:
    assert kind_of(Window(0.5, 0.05, 0.0, 0.0, 1.0), 0.0, 0.4, signed=True) == OTHER_YAW
    assert kind_of(Window(0.5, 0.051, 0.0, 0.0, 1.0), 0.0, 0.4, signed=True) == EMPTY_TWIST


@pytest.mark.parametrize(
    ("low", "high", "found", "known"),
    [
        (3.6, 3.6, ("km/h",), True),
        # The scale of a sound source may be off by 4 %, and no more.
        (3.74, 3.74, ("km/h",), True),
        (3.76, 3.76, (), False),
        (3.47, 3.47, ("km/h",), True),
        (3.45, 3.45, (), False),
        # One that is known by less than 12 % may be another.
        (3.31, 3.6, ("km/h",), True),
        (3.29, 3.6, ("km/h",), False),
        (3.6, 3.87, ("km/h",), True),
        (3.6, 3.89, ("km/h",), False),
        (1.94384, 2.23694, ("miles per hour", "knots"), False),
        (0.0, math.inf, ("km/h", "miles per hour", "knots"), False),
        (10.0, 11.0, (), False),
    ],
)
def test_a_factor_is_known_within_its_bounds(
    low: float, high: float, found: tuple[str, ...], known: bool
) -> None:
    assert known_factors(low, high, UNITS) == (found, known)


def test_words_are_joined_as_an_alternative() -> None:
    assert [either(words) for words in (["a"], ["a", "b"], ["a", "b", "c"])] == [
        "a",
        "a or b",
        "a, b or c",
    ]


def kind_after(*rounds: tuple[list[tuple[float, float]], float]) -> str:
    """The unit after windows of a way and a stated speed for each delay, with their noise."""
    factors = SpeedFactors()
    for ways, noise_mps in rounds:
        factors.take([window(0.7, way, speed, 0.0) for way, speed in ways], noise_mps)
    return factors.kind


def test_the_unit_is_one_that_all_windows_with_one_delay_allow() -> None:
    assert kind_after(([(10.0, -36.0)], 0.0)) == "speed in km/h"
    assert kind_after(([(10.0, 36.0)], 0.0), ([(10.0, 37.0)], 0.0)) == "speed in km/h"
    assert kind_after(([(0.5, 1.8)], 0.0)) == "speed in km/h"
    # Two that lie apart by more than twice the scale of a sound source are one of no unit.
    assert kind_after(([(10.0, 36.0)], 0.0), ([(10.0, 40.0)], 0.0)) == OTHER_SPEED
    assert kind_after(([(10.0, 40.0)], 0.0), ([(10.0, 36.0)], 0.0)) == OTHER_SPEED
    # By the noise of the way it may be any; a window with less of it says which.
    unsure = [(10.0, 36.0)], 10.0
    assert kind_after(unsure) == f"{NOT_MPS}, maybe in km/h, miles per hour or knots"
    assert kind_after(unsure, ([(10.0, 22.4)], 0.1)) == "speed in miles per hour"
    assert kind_after(([(0.0, 36.0)], 0.0)) == OTHER_SPEED
    # Each delay has a range of its own, and one that no factor fits is out.
    two = [(10.0, 36.0), (10.0, 22.4)], 0.0
    assert kind_after(two) == f"{NOT_MPS}, maybe in km/h or miles per hour"
    assert kind_after(two, ([(10.0, 36.0), (10.0, 30.0)], 0.0)) == "speed in km/h"
