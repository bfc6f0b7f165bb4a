"""Boxes and geofences: corners, notches, what can't be located."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Box, Pose2
from ssp_core.motion.state import Size
from ssp_core.safety.fence import (
    KnownRoom,
    _deepest_m,
    _is_inside,
    _is_inside_few,
    box_excess_m,
    moved_excess_m,
    room_m,
    rooms_m,
    way_excess_m,
    way_room_m,
)

SQUARE = [(0.0, 0.0), (100.0, 0.0), (100.0, 50.0), (0.0, 50.0)]
NOTCHED = [(0.0, 0.0), (100.0, 0.0), (100.0, 50.0), (52.0, 50.0), (50.0, 25.0), (48.0, 50.0)]
NOTCHED += [(0.0, 50.0)]


def walled(wall_m: float) -> list[tuple[float, float]]:
    """A thin notch that closes two lanes and more: no box can be on both sides of it."""
    left, right = 50.0 - wall_m / 2, 50.0 + wall_m / 2
    wall = [(right, 50.0), (right, 20.0), (left, 20.0), (left, 50.0)]
    return [*SQUARE[:3], *wall, SQUARE[3]]


WALLED = walled(0.01)
SIZE = Size(4.0, 1.0, 2.0, 1.5)


def box(x_m: float, y_m: float, yaw_rad: float = 0.0) -> Box:
    return Box(Pose2(x_m, y_m, yaw_rad), 4.0, 1.0, 2.0)


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


@pytest.mark.parametrize("wall_m", [1e-6, 0.01, 0.1, 1.0])
def test_a_wall_that_passes_through_the_box_counts(wall_m: float) -> None:
    fence = walled(wall_m)
    for x_m in np.arange(40.0, 60.0, 0.25):
        front_m, rear_m = x_m + 4.0, x_m - 1.0
        crosses = front_m > 50.0 - wall_m / 2 and rear_m < 50.0 + wall_m / 2
        assert (box_excess_m(box(x_m, 30.0), fence) > 0.0) == crosses
    assert box_excess_m(box(48.0, 30.0), fence) >= 1.0
    # Below its end at 20 m there is room.
    assert box_excess_m(box(48.0, 19.0), fence) == 0.0
    assert box_excess_m(box(48.0, 19.1), fence) == pytest.approx(0.1)


@pytest.mark.parametrize("mirrored", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("yaw_rad", [0.0, 2.0])
def test_an_edge_that_cuts_off_one_corner_counts_wherever_it_begins_and_ends(
    mirrored: tuple[int, int], order: int, yaw_rad: float
) -> None:
    """Its ends lie ahead of and beside the box, whose front left corner is 2.5 m and 1 m away."""
    c, s = math.cos(yaw_rad), math.sin(yaw_rad)

    def fence(wider: float) -> list[tuple[float, float]]:
        cut = [(20.0, -5.0), (3.5 * wider, 0.0), (0.0, 2.0 * wider), (-5.0, 20.0)]
        around = [(-20.0, -20.0), (20.0, -20.0), *cut, (-20.0, 20.0)][::order]
        turned = [(mirrored[0] * u, mirrored[1] * v) for u, v in around]
        return [(7.0 + c * u - s * v, -3.0 + s * u + c * v) for u, v in turned]

    # The middle of the box lies 1.5 m ahead of its reference point.
    here = box(7.0 - 1.5 * c, -3.0 - 1.5 * s, yaw_rad)
    assert box_excess_m(here, fence(1.0)) > 0.1
    assert box_excess_m(here, fence(1.3)) == 0.0
    assert moved_excess_m(here.pose, here, fence(1.0)) > 0.1


@pytest.mark.parametrize("order", [1, -1])
@pytest.mark.parametrize("first", [0, 1, 2])
def test_a_corner_that_is_level_with_a_box_outside_makes_it_no_inside(
    first: int, order: int
) -> None:
    for side in (1.0, -1.0):
        corners = [(side * 10.0, 5.0), (side * 30.0, -15.0), (side * 30.0, 25.0)][::order]
        fence = corners[first:] + corners[:first]
        for yaw_rad in (0.0, math.pi):
            assert box_excess_m(box(-side * 5.0, 5.0, yaw_rad), fence) > 10.0
        assert box_excess_m(box(side * 25.0, 5.0), fence) == 0.0


@pytest.mark.parametrize("step_m", [100.0, 0.4])
@pytest.mark.parametrize("out_m", [0.3, 0.6, 0.9, 1.5])
def test_a_small_box_right_outside_is_outside_whichever_way_it_faces(
    out_m: float, step_m: float
) -> None:
    fence = with_corners_each(step_m, SQUARE)
    middles = [(50.0, -out_m), (100.0 + out_m, 25.0), (50.0, 50.0 + out_m), (-out_m, 25.0)]
    for x_m, y_m in middles:
        for turn in range(4):
            walker = Box(Pose2(x_m, y_m, turn * math.pi / 2.0), 0.25, 0.25, 0.5)
            assert box_excess_m(walker, fence) == pytest.approx(out_m + 0.25)
            inside = Box(Pose2(50.0, 0.3, turn * math.pi / 2.0), 0.25, 0.25, 0.5)
            assert box_excess_m(inside, fence) == 0.0


@pytest.mark.parametrize(("half_x", "half_y"), [(2.5, 1.0), (0.3, 1.0), (1.0, 1.0)])
def test_a_segment_is_as_deep_in_a_rectangle_as_its_deepest_point(
    half_x: float, half_y: float
) -> None:
    random = np.random.default_rng(10)
    ends = random.uniform(-3.0, 3.0, (2, 400, 1, 2))
    ends[1, :60, 0, 0] = ends[0, :60, 0, 0]  # along one axis, along the other, and of no length
    ends[1, 40:100, 0, 1] = ends[0, 40:100, 0, 1]
    found = _deepest_m(ends[0], ends[1], half_x, half_y)
    t = np.linspace(0.0, 1.0, 2001)[:, None]
    x, y = np.moveaxis(ends[0, :, 0] + t[..., None] * (ends[1] - ends[0])[:, 0], -1, 0)
    depth = np.minimum(half_x - np.abs(x), half_y - np.abs(y)).max(axis=0)
    assert found == pytest.approx(np.maximum(depth, 0.0), abs=0.01)
    assert np.count_nonzero(found) > 100


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi / 2.0])
def test_a_wall_through_a_box_that_is_wider_than_long_counts(yaw_rad: float) -> None:
    wide = Box(Pose2(50.1, 30.0, yaw_rad), 0.3, 0.3, 2.0)
    sideways_m = 0.3 if yaw_rad else 0.3 - 0.095
    assert box_excess_m(wide, WALLED) == pytest.approx(sideways_m)


def drive(*poses: tuple[float, float, float]) -> list[float]:
    x, y, yaw = np.array(poses).T
    return [float(one) for one in way_excess_m(x, y, yaw, SIZE, WALLED)]


def test_what_lies_between_two_poses_counts() -> None:
    assert drive((40.0, 30.0, 0.0), (60.0, 30.0, 0.0)) == [0.0, 1.0]
    assert drive((40.0, 10.0, 0.0), (60.0, 10.0, 0.0)) == [0.0, 0.0]
    assert drive((40.0, 19.0, 0.0), (60.0, 19.0, 0.0)) == [0.0, 0.0]
    # Sideways past the end of the wall, which neither box touches.
    assert drive((44.0, 22.0, 0.0), (51.0, 15.0, 0.0))[1] > 0.0
    # A turn on the spot into the wall and on beyond it.
    assert drive((48.0, 22.0, 2.0), (48.0, 22.0, -2.0)) == [0.0, 0.0]
    assert drive((48.0, 22.0, 1.9), (48.0, 22.0, 1.0))[1] > 0.5


@pytest.mark.parametrize("yaw_rad", [0.0, math.pi])
def test_a_way_that_is_level_with_the_end_of_a_wall_counts_where_it_meets_it(
    yaw_rad: float,
) -> None:
    for x_m, to_m in ((20.0, 40.0), (40.0, 20.0), (60.0, 80.0), (80.0, 60.0)):
        assert drive((x_m, 20.0, yaw_rad), (to_m, 20.0, yaw_rad)) == [0.0, 0.0]
    assert drive((20.0, 20.0, yaw_rad), (80.0, 20.0, yaw_rad))[1] > 0.9


def test_a_way_that_turns_a_little_counts_from_its_beginning_to_its_end() -> None:
    """It is cut into parts, here two, and each part lies where it belongs."""
    assert drive((40.0, 30.0, 0.0), (70.0, 30.0, 0.03))[1] > 0.9
    assert drive((30.0, 30.0, 0.0), (60.0, 30.0, 0.03))[1] > 0.9
    # What lies before the beginning, or behind the end, is no part of it.
    assert drive((52.0, 30.0, 0.0), (90.0, 30.0, 0.03)) == [0.0, 0.0]
    assert drive((8.0, 30.0, 0.0), (45.0, 30.0, 0.03)) == [0.0, 0.0]


def test_a_way_counts_from_pose_to_pose() -> None:
    x, yaw = np.array([[30.0, 40.0, 60.0, 70.0], [70.0, 80.0, 90.0, 98.0]]), np.zeros((2, 4))
    excess = way_excess_m(x, np.full((2, 4), 30.0), yaw, SIZE, WALLED)
    assert excess.tolist() == [[0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, pytest.approx(2.0)]]


def test_one_box_that_moved_is_judged_as_on_a_way() -> None:
    random = np.random.default_rng(3)
    for _ in range(500):
        before = random.uniform((-5.0, -5.0, -3.1), (105.0, 55.0, 3.1))
        after = before + random.normal(0.0, (1.0, 1.0, 0.05))
        x, y, yaw = np.stack((before, after)).T
        swept = float(way_excess_m(x, y, yaw, SIZE, WALLED)[1])
        assert moved_excess_m(Pose2(*before.tolist()), box(*after.tolist()), WALLED) == swept


@pytest.mark.parametrize(
    ("before", "after"),
    [
        ((40.0, 30.0, 0.0), (60.0, 30.0, 0.0)),
        ((60.0, 30.0, 0.0), (40.0, 30.0, 0.0)),
        # It ends 3 m clear of the wall that it came through, in y, in x, and by a turn.
        ((48.0, 30.0, 0.0), (48.0, 16.0, 0.0)),
        ((51.0, 21.5, 3.141592653589793), (58.0, 21.5, 0.0)),
        ((44.0, 22.0, 0.0), (51.0, 15.0, 0.0)),
        ((48.0, 22.0, 1.9), (48.0, 22.0, 1.0)),
        ((48.5, 21.0, 1.5707963267948966), (48.5, 21.0, -1.5)),
    ],
)
def test_one_box_that_came_through_a_wall_was_outside_wherever_it_is_now(
    before: tuple[float, float, float], after: tuple[float, float, float]
) -> None:
    swept = drive(before, after)[1]
    assert swept > 0.0
    # Around the origin too, where places before and after have other signs.
    for x_m, y_m in ((0.0, 0.0), (50.0, 23.0), (50.0, 30.0), (200.0, 200.0)):
        fence = [(x - x_m, y - y_m) for x, y in WALLED]
        came = Pose2(before[0] - x_m, before[1] - y_m, before[2])
        here = box(after[0] - x_m, after[1] - y_m, after[2])
        assert moved_excess_m(came, here, fence) == pytest.approx(swept)


def test_one_box_that_went_far_or_turned_far_is_judged_as_on_a_way() -> None:
    random = np.random.default_rng(4)
    found = {True: 0, False: 0}
    for k in range(600):
        before = random.uniform((40.0, 14.0, -3.1), (60.0, 40.0, 3.1))
        spread = ((6.0, 0.0, 0.0), (0.0, 6.0, 0.0), (0.0, 0.0, 2.0), (4.0, 4.0, 1.0))[k % 4]
        after = before + random.normal(0.0, spread)
        swept = drive((*before,), (*after,))[1]
        assert moved_excess_m(Pose2(*before.tolist()), box(*after.tolist()), WALLED) == swept
        found[swept == 0.0] += 1
    assert min(found.values()) > 100, found


@pytest.mark.parametrize("yaw_rad", [0.0, 2.0, -1.5])
def test_what_is_still_where_it_was_is_as_far_out_as_before(yaw_rad: float) -> None:
    for x_m, y_m in ((50.0, 0.5), (48.0, 24.5), (20.0, 25.0)):
        here = box(x_m, y_m, yaw_rad)
        excess_m = box_excess_m(here, WALLED)
        assert moved_excess_m(here.pose, here, WALLED) == excess_m


def test_a_corner_that_is_given_twice_changes_no_room() -> None:
    twice = [*NOTCHED[:2], NOTCHED[1], *NOTCHED[2:], NOTCHED[-1]]
    random = np.random.default_rng(7)
    x, y = random.uniform(-10.0, 110.0, 100), random.uniform(-10.0, 60.0, 100)
    assert rooms_m(x, y, twice) == pytest.approx(rooms_m(x, y, NOTCHED))
    for k in range(100):
        assert room_m(x[k], y[k], twice) == pytest.approx(room_m(x[k], y[k], NOTCHED))


def with_corners_each(step_m: float, fence: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The same outline in edges of at most so many metres."""
    found = []
    for (xa, ya), (xb, yb) in zip(fence, [*fence[1:], fence[0]], strict=True):
        count = math.ceil(math.hypot(xb - xa, yb - ya) / step_m)
        found += [(xa + (xb - xa) * k / count, ya + (yb - ya) * k / count) for k in range(count)]
    return found


@pytest.mark.parametrize("step_m", [0.7, 9.0])
def test_corners_on_an_edge_change_nothing(step_m: float) -> None:
    fine = with_corners_each(step_m, NOTCHED)
    random = np.random.default_rng(8)
    x, y = random.uniform(-5.0, 105.0, 60), random.uniform(-5.0, 55.0, 60)
    yaw = random.uniform(-3.1, 3.1, 60)
    assert rooms_m(x, y, fine) == pytest.approx(rooms_m(x, y, NOTCHED))
    alone = x[:, None], y[:, None], yaw[:, None]
    excess_m = way_excess_m(*alone, SIZE, NOTCHED)
    assert way_excess_m(*alone, SIZE, fine) == pytest.approx(excess_m)
    for k in range(60):
        at, here = (x[k], y[k]), box(x[k], y[k], yaw[k])
        assert room_m(*at, fine) == pytest.approx(room_m(*at, NOTCHED))
        assert box_excess_m(here, fine) == pytest.approx(box_excess_m(here, NOTCHED))
        to = (x[k - 1], y[k - 1])
        assert way_room_m(at, to, fine) == pytest.approx(way_room_m(at, to, NOTCHED), abs=1e-9)


@pytest.mark.parametrize(
    ("x_m", "y_m", "radius_m", "holds"),
    [
        (50.0, 25.0, 24.9, True),
        (50.0, 25.0, 25.0, False),
        (50.0, 10.0, 9.9, True),
        (50.0, 10.0, 10.0, False),
        (0.0, 25.0, 0.0, False),
        (-5.0, 25.0, 1.0, False),
    ],
)
def test_a_room_that_was_never_measured_is_measured_at_once(
    x_m: float, y_m: float, radius_m: float, holds: bool
) -> None:
    assert KnownRoom(SQUARE).holds(x_m, y_m, radius_m) is holds
    # A place that was measured before answers for others, and is replaced where it doesn't.
    for first in ((50.0, 25.0), (10.0, 10.0), (99.0, 49.0), (-9.0, -9.0)):
        known = KnownRoom(SQUARE)
        known.holds(*first, 1.0)
        assert known.holds(x_m, y_m, radius_m) is holds


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_cannot_be_located_is_outside(bad: float) -> None:
    assert box_excess_m(box(50.0, bad), SQUARE) == math.inf
    assert box_excess_m(box(50.0, 25.0, bad), SQUARE) == math.inf
    x = np.array([50.0, 50.0, bad, 50.0, 50.0])
    excess = way_excess_m(x, np.full(5, 25.0), np.zeros(5), SIZE, SQUARE)
    assert excess.tolist() == [0.0, 0.0, math.inf, math.inf, 0.0]


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
    x, y, yaw = (np.array([v]) for v in (x_m, y_m, yaw_rad))
    (alone,) = way_excess_m(x, y, yaw, SIZE, NOTCHED)
    assert box_excess_m(box(x_m, y_m, yaw_rad), NOTCHED) == alone


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


def test_rooms_of_many_points_are_those_of_each() -> None:
    random = np.random.default_rng(5)
    x, y = random.uniform(-10.0, 110.0, 300), random.uniform(-10.0, 60.0, 300)
    rooms = rooms_m(x, y, NOTCHED)
    for k in range(300):
        assert rooms[k] == pytest.approx(room_m(x[k], y[k], NOTCHED), abs=1e-9)


def test_the_room_of_a_way_is_that_of_its_nearest_point() -> None:
    random = np.random.default_rng(6)
    ways = random.uniform((-5.0, -5.0, -5.0, -5.0), (105.0, 55.0, 105.0, 55.0), (500, 4))
    for xa, ya, xb, yb in ways.tolist():
        t = np.linspace(0.0, 1.0, 2001)
        least = float(rooms_m(xa + t * (xb - xa), ya + t * (yb - ya), NOTCHED).min())
        room = way_room_m((xa, ya), (xb, yb), NOTCHED)
        if least > 0.03:
            assert least - 0.03 <= room <= least + 1e-9
        elif least < -0.03:
            assert room <= 0.0
    assert way_room_m((20.0, 20.0), (20.0, 20.0), NOTCHED) == room_m(20.0, 20.0, NOTCHED)
    assert not way_room_m((20.0, 20.0), (20.0, math.nan), NOTCHED) > 0.0


# -- long fences ----------------------------------------------------------------------------------


def ring(corners: int) -> list[tuple[float, float]]:
    """A bay with a jagged shore."""
    turns = [2.0 * math.pi * k / corners for k in range(corners)]
    return [
        ((100.0 + 4.0 * math.sin(31.0 * at)) * math.cos(at), 60.0 * math.sin(at)) for at in turns
    ]


@given(
    st.floats(-110.0, 110.0),
    st.floats(-65.0, 65.0),
    st.floats(-7.0, 7.0),
    st.sampled_from([40, 512, 2000]),
)
@settings(max_examples=150, deadline=None)
def test_a_long_fence_is_judged_as_edge_by_edge(
    x_m: float, y_m: float, yaw_rad: float, corners: int
) -> None:
    fence, at = ring(corners), box(x_m, y_m, yaw_rad)
    assert _is_inside(at, fence) == _is_inside_few(at, fence)
    assert _is_inside(at, tuple(fence)) == _is_inside_few(at, fence)


def test_a_long_fence_with_long_edges_is_judged_as_edge_by_edge() -> None:
    """One side has all corners; each other one leads slantwise."""
    corners = [(-60.0, -30.0), (50.0, -70.0), (80.0, 40.0), (-30.0, 60.0)]
    random = np.random.default_rng(9)
    inside = 0
    for first in range(4):
        (xa, ya), *others = corners[first:] + corners[:first]
        xb, yb = others[0]
        side = [(xa + (xb - xa) * k / 600, ya + (yb - ya) * k / 600) for k in range(600)]
        for _ in range(150):
            x_m, y_m, yaw_rad = random.uniform((-110.0, -110.0, -7.0), (110.0, 110.0, 7.0)).tolist()
            at = box(x_m, y_m, yaw_rad)
            is_inside = _is_inside_few(at, corners)
            assert _is_inside(at, [*side, *others]) is is_inside
            inside += is_inside
    assert inside > 100


def test_a_long_fence_that_changes_in_its_place_is_judged_anew() -> None:
    fence = ring(600)
    assert box_excess_m(box(0.0, 0.0), fence) == 0.0
    fence[:] = [(x + 500.0, y) for x, y in fence]
    assert box_excess_m(box(0.0, 0.0), fence) > 300.0
    fence[0:300] = fence[300:600]
    assert box_excess_m(box(math.nan, 0.0), fence) == math.inf


def test_a_known_room_holds_no_circle_that_is_not_inside() -> None:
    """The places lie along random ways: near the notch, far from it, and beyond the fence."""
    random = np.random.default_rng(5)
    held = 0
    for _ in range(40):
        known = KnownRoom(NOTCHED)
        x_m, y_m = random.uniform(-10.0, 110.0), random.uniform(-10.0, 60.0)
        step_x, step_y = random.uniform(-1.0, 1.0, 2)
        for _ in range(60):
            x_m, y_m, radius_m = x_m + step_x, y_m + step_y, random.uniform(0.1, 12.0)
            holds = known.holds(x_m, y_m, radius_m)
            held += holds
            assert not holds or room_m(x_m, y_m, NOTCHED) > radius_m
    assert held > 300


def test_a_known_room_is_no_room_on_the_other_side_of_the_origin() -> None:
    """The fence leads farther to the left of it and below than to the right and above."""
    around = [(x - 70.0, y - 35.0) for x, y in SQUARE]
    for known_at, asked_at in (((-30.0, 0.0), (29.0, 0.0)), ((-20.0, -10.0), (-20.0, 10.0))):
        known = KnownRoom(around)
        assert known.holds(*known_at, 5.0)
        assert not known.holds(*asked_at, 8.0)
        assert known.holds(*known_at, 5.0)


def test_a_way_that_begins_or_ends_outside_or_at_the_edge_has_no_room() -> None:
    inside, near, edge, beyond = (50.0, 10.0), (50.0, 0.5), (50.0, 0.0), (50.0, -1.0)
    assert way_room_m(inside, near, SQUARE) == way_room_m(near, inside, SQUARE) == 0.5
    for other in (edge, beyond):
        assert way_room_m(inside, other, SQUARE) <= 0.0
        assert way_room_m(other, inside, SQUARE) <= 0.0
        assert way_room_m(other, other, SQUARE) <= 0.0
    assert way_room_m(beyond, (60.0, -1.0), SQUARE) == -math.inf
    # A metre long, beside the notch and through it.
    assert way_room_m((49.5, 24.0), (50.5, 24.0), NOTCHED) == pytest.approx(1.0)
    assert way_room_m((50.0, 23.5), (50.0, 24.5), NOTCHED) == pytest.approx(0.5)
    assert way_room_m((45.0, 30.0), (55.0, 30.0), NOTCHED) == 0.0
    # The wall right behind the beginning, and right before the end.
    assert way_room_m((49.8, 30.0), (60.0, 30.0), WALLED) == 0.0
    assert way_room_m((60.0, 30.0), (49.8, 30.0), WALLED) == 0.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_a_known_room_holds_nothing_that_cannot_be_located(bad: float) -> None:
    known = KnownRoom(SQUARE)
    assert known.holds(50.0, 25.0, 5.0)
    assert not known.holds(bad, 25.0, 5.0)
    assert not known.holds(50.0, 25.0, bad)
    assert known.holds(50.0, 25.0, 5.0)
