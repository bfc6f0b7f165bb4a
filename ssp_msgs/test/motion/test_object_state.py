"""States at other times, their boxes, and integer time."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.vocabulary import OBJECTS, ObjectClass, Role

S = 1_000_000_000
STATE = ObjectState(
    "ot1",
    ObjectClass.CAR,
    Role.OT,
    2 * S,
    10.0,
    5.0,
    math.pi / 2,
    4.0,
    0.0,
    0.0,
    DEFAULT_SIZES[ObjectClass.CAR],
)


def test_straight_on_and_back() -> None:
    later = STATE.extrapolated(3 * S)
    assert (later.x_m, later.y_m) == pytest.approx((10.0, 9.0))
    assert later.stamp_ns == 3 * S
    assert later.speed_mps == 4.0
    earlier = STATE.extrapolated(S)
    assert (earlier.x_m, earlier.y_m) == pytest.approx((10.0, 1.0))


def test_a_quarter_of_a_circle() -> None:
    """Radius 4 m/s over pi/2 rad/s, to the left from north: to the west."""
    later = replace(STATE, yaw_rate_radps=math.pi / 2).extrapolated(3 * S)
    radius = 8.0 / math.pi
    assert (later.x_m, later.y_m) == pytest.approx((10.0 - radius, 5.0 + radius))
    assert abs(later.yaw_rad) == pytest.approx(math.pi)


@settings(max_examples=100, deadline=None)
@given(
    yaw=st.floats(-3.1, 3.1),
    speed=st.floats(-5.0, 20.0),
    rate=st.floats(-1.0, 1.0),
    dt_ms=st.integers(-500, 500),
)
def test_there_and_back_again(yaw: float, speed: float, rate: float, dt_ms: int) -> None:
    start = replace(STATE, yaw_rad=yaw, speed_mps=speed, yaw_rate_radps=rate)
    back = start.extrapolated(start.stamp_ns + dt_ms * 1_000_000).extrapolated(start.stamp_ns)
    assert (back.x_m, back.y_m) == pytest.approx((start.x_m, start.y_m), abs=1e-9)
    assert math.cos(back.yaw_rad - yaw) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "field", ["x_m", "y_m", "yaw_rad", "speed_mps", "acceleration_mps2", "yaw_rate_radps"]
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_is_finite(field: str, value: float) -> None:
    assert STATE.is_finite
    assert not replace(STATE, **{field: value}).is_finite  # type: ignore[arg-type] # a float field


def test_the_box_lies_around_the_reference_point() -> None:
    size = STATE.size
    assert STATE.box.corners()[0] == pytest.approx((10.0 - size.width_m / 2, 5.0 + size.front_m))


@pytest.mark.parametrize("word", OBJECTS)
def test_every_class_has_a_size_and_its_word(word: str) -> None:
    object_class = ObjectClass.from_word(word)
    assert object_class.word == word
    assert DEFAULT_SIZES[object_class].length_m > 0.0
    assert min(DEFAULT_SIZES[object_class].width_m, DEFAULT_SIZES[object_class].height_m) > 0.0


@given(ns=st.integers(-(10**15), 10**15))
def test_seconds_and_back(ns: int) -> None:
    """Exact for runs of up to eleven days."""
    assert seconds_to_ns(ns_to_seconds(ns)) == ns
