"""Boxes and geofences: corners, notches, what can't be located."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Box, Pose2
from ssp_core.motion.state import Size
from ssp_core.safety.fence import box_excess_m, corners_of, excess_m, room_m, rooms_m, row_excess_m

SQUARE = [(0.0, 0.0), (100.0, 0.0), (100.0, 50.0), (0.0, 50.0)]
NOTCHED = [(0.0, 0.0), (100.0, 0.0), (100.0, 50.0), (52.0, 50.0), (50.0, 25.0), (48.0, 50.0)]
NOTCHED += [(0.0, 50.0)]


def box(x_m: float, y_m: float, yaw_rad: float = 0.0) -> Box:
    return Box(Pose2(x_m, y_m, yaw_rad), 4.0, 1.0, 2.0)


def test_corners_are_those_of_a_box() -> None:
    size = Size(4.0, 1.0, 2.0, 1.5)
    yaw = 0.7
    got = corners_of(np.array([3.0]), np.array([-2.0]), np.array([yaw]), size)
    assert np.allclose(got[0], box(3.0, -2.0, yaw).corners())


@pytest.mark.parametrize(
    ("x_m", "y_m", "excess"),
    [(50.0, 25.0, 0.0), (95.9, 25.0, 0.0), (96.5, 25.0, 0.5), (50.0, 0.25, 0.75), (200, 25, 104.0)],
)
def test_excess_is_how_far_the_worst_corner_is_out(x_m: float, y_m: float, excess: float) -> None:
    assert box_excess_m(box(x_m, y_m), SQUARE) == pytest.approx(excess)


def test_a_notch_inside_the_box_counts() -> None:
    inside_all_corners = box(48.0, 24.5)
    assert box_excess_m(inside_all_corners, SQUARE) == 0.0
    assert box_excess_m(inside_all_corners, NOTCHED) == pytest.approx(0.5)
    assert box_excess_m(box(48.0, 23.0), NOTCHED) == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_cannot_be_located_is_outside(bad: float) -> None:
    corners = np.array([box(50.0, 25.0).corners(), box(50.0, 25.0).corners()])
    corners[1, 2, 0] = bad
    assert excess_m(corners, SQUARE).tolist() == [0.0, math.inf]


@given(st.floats(-20.0, 120.0), st.floats(-20.0, 70.0), st.floats(-3.0, 3.0))
@settings(max_examples=100, deadline=None)
def test_in_a_rectangle_it_is_the_distance_of_the_worst_corner(
    x_m: float, y_m: float, yaw_rad: float
) -> None:
    b = box(x_m, y_m, yaw_rad)
    worst = max(math.hypot(max(-x, 0.0, x - 100.0), max(-y, 0.0, y - 50.0)) for x, y in b.corners())
    assert box_excess_m(b, SQUARE) == pytest.approx(worst, abs=1e-9)


@given(st.floats(-10.0, 110.0), st.floats(-10.0, 60.0), st.floats(-3.2, 3.2))
@settings(max_examples=200, deadline=None)
def test_one_box_is_judged_as_in_a_row_of_them(x_m: float, y_m: float, yaw_rad: float) -> None:
    b = box(x_m, y_m, yaw_rad)
    assert box_excess_m(b, NOTCHED) == excess_m(np.array([b.corners()]), NOTCHED)[0]


@pytest.mark.parametrize(
    ("x_m", "y_m", "room"),
    [
        (50.0, 5.0, 5.0),
        (97.0, 25.0, 3.0),
        (50.0, 20.0, 5.0),
        (50.0, 30.0, -0.4),
        (-3.0, -4.0, -5.0),
    ],
)
def test_room_is_the_distance_to_the_outline(x_m: float, y_m: float, room: float) -> None:
    assert room_m(x_m, y_m, NOTCHED) == pytest.approx(room, abs=0.01)


def test_there_is_no_room_nowhere() -> None:
    assert not room_m(math.nan, 5.0, SQUARE) > 0.0
    assert not room_m(5.0, math.inf, SQUARE) > 0.0


def test_a_row_of_boxes_is_judged_as_one_by_one() -> None:
    random = np.random.default_rng(5)
    x, y = random.uniform(-10.0, 110.0, 300), random.uniform(-10.0, 60.0, 300)
    yaw = random.uniform(-3.2, 3.2, 300)
    size = Size(4.0, 1.0, 2.0, 1.5)
    x[7], yaw[9] = math.nan, math.nan
    x[9], y[9] = 20.0, 20.0
    row = row_excess_m(x, y, yaw, size, NOTCHED)
    assert (row == excess_m(corners_of(x, y, yaw, size), NOTCHED)).all()
    assert row[7] == row[9] == math.inf
    rooms = rooms_m(x, y, NOTCHED)
    for k in range(10, 300):
        assert rooms[k] == pytest.approx(room_m(x[k], y[k], NOTCHED), abs=1e-9)
