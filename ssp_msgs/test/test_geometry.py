"""Plane geometry against hand-computed values and against itself."""

from __future__ import annotations

import math
import tracemalloc

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core import geometry
from ssp_core.geometry import (
    Box,
    Polyline,
    Pose2,
    box_distance,
    boxes_overlap,
    point_in_polygon,
    wrap_angle,
)

metres = st.floats(-500.0, 500.0)
angles = st.floats(-20.0, 20.0)
poses = st.builds(Pose2, metres, metres, angles)
boxes = st.builds(
    Box, poses, front_m=st.floats(0.1, 9.0), rear_m=st.floats(0.1, 3.0), width_m=st.floats(0.2, 3.0)
)


# -- angles and poses -----------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("given_rad", "wrapped_rad"),
    [
        (0.0, 0.0),
        (math.pi, math.pi),
        (-math.pi, math.pi),
        (3 * math.pi, math.pi),
        (-3 * math.pi, math.pi),
        (1.5 * math.pi, -0.5 * math.pi),
        (-0.1, -0.1),
        (2 * math.pi + 0.25, 0.25),
    ],
)
def test_wrap_angle(given_rad: float, wrapped_rad: float) -> None:
    assert wrap_angle(given_rad) == pytest.approx(wrapped_rad, abs=1e-12)


@given(angle=st.floats(-1e6, 1e6))
def test_wrap_angle_is_the_same_direction_in_the_half_open_interval(angle: float) -> None:
    wrapped = wrap_angle(angle)
    assert -math.pi < wrapped <= math.pi
    assert math.cos(wrapped) == pytest.approx(math.cos(angle), abs=1e-9)
    assert math.sin(wrapped) == pytest.approx(math.sin(angle), abs=1e-9)


def test_pose_turns_then_shifts() -> None:
    pose = Pose2(10.0, 20.0, math.pi / 2)
    assert pose.to_parent(3.0, 1.0) == pytest.approx((9.0, 23.0))
    assert pose.to_local(9.0, 23.0) == pytest.approx((3.0, 1.0))


@given(pose=poses, x=metres, y=metres)
def test_pose_round_trip(pose: Pose2, x: float, y: float) -> None:
    """METHOD 2.4: local -> map -> local is exact to 1e-6 m."""
    assert pose.to_local(*pose.to_parent(x, y)) == pytest.approx((x, y), abs=1e-6)


# -- boxes ----------------------------------------------------------------------------------------


def box(x: float, y: float, yaw: float = 0.0) -> Box:
    return Box(Pose2(x, y, yaw), front_m=3.0, rear_m=1.0, width_m=2.0)


def test_corners_counter_clockwise_from_front_left() -> None:
    assert box(0.0, 0.0).corners() == [(3.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (3.0, -1.0)]
    turned = np.array(box(5.0, 5.0, math.pi / 2).corners())
    assert turned == pytest.approx(np.array([(4, 8), (4, 4), (6, 4), (6, 8)]))


@pytest.mark.parametrize(
    ("other", "distance_m"),
    [
        (box(4.5, 0.0), 0.5),  # ahead: its rear at 3.5
        (box(4.0, 0.0), 0.0),  # touching
        (box(-4.25, 0.0), 0.25),  # behind
        (box(0.0, 2.75), 0.75),  # beside
        (box(7.0, 6.0), 5.0),  # 3 ahead and 4 beside: corner to corner
        (box(1.0, 0.0), 0.0),  # overlapping
        (box(1.0, 0.0, 1.0), 0.0),
        (box(3.0, 5.0, -math.pi / 2), 1.0),  # faces down, its front at y = 2
        # A corner of a box at 45 degrees points at the front: 3 + 0.5 to the corner.
        (Box(Pose2(3.5 + math.sqrt(2.0), 0.0, math.pi / 4), 1.0, 1.0, 2.0), 0.5),
    ],
)
def test_box_distance(other: Box, distance_m: float) -> None:
    assert box_distance(box(0.0, 0.0), other) == pytest.approx(distance_m, abs=1e-12)
    assert box_distance(other, box(0.0, 0.0)) == pytest.approx(distance_m, abs=1e-12)


def test_a_cross_overlaps_though_no_corner_is_inside() -> None:
    long_x = Box(Pose2(0.0, 0.0, 0.0), 5.0, 5.0, 1.0)
    long_y = Box(Pose2(0.0, 0.0, math.pi / 2), 5.0, 5.0, 1.0)
    assert boxes_overlap(long_x, long_y)
    assert box_distance(long_x, long_y) == 0.0


@given(a=boxes, b=boxes)
def test_distance_is_symmetric_and_zero_exactly_when_overlapping(a: Box, b: Box) -> None:
    distance = box_distance(a, b)
    assert distance == pytest.approx(box_distance(b, a), abs=1e-9)
    assert (distance == 0.0) == boxes_overlap(a, b)
    centres = math.dist((a.pose.x_m, a.pose.y_m), (b.pose.x_m, b.pose.y_m))
    assert distance <= centres + 1e-9


@given(a=boxes, b=boxes, frame=poses)
def test_distance_does_not_depend_on_the_frame(a: Box, b: Box, frame: Pose2) -> None:
    def moved(old: Box) -> Box:
        x, y = frame.to_parent(old.pose.x_m, old.pose.y_m)
        return Box(
            Pose2(x, y, old.pose.yaw_rad + frame.yaw_rad), old.front_m, old.rear_m, old.width_m
        )

    assert box_distance(moved(a), moved(b)) == pytest.approx(box_distance(a, b), abs=1e-6)


# -- polygon --------------------------------------------------------------------------------------

NOTCHED = [(0.0, 0.0), (10.0, 0.0), (10.0, 10.0), (5.0, 4.0), (0.0, 10.0)]


@pytest.mark.parametrize(
    ("x", "y", "inside"),
    [(5, 1, True), (1, 8, True), (9, 8, True), (5, 5, False), (-1, 1, False), (11, 5, False)],
)
def test_point_in_a_notched_polygon(x: float, y: float, inside: bool) -> None:
    assert point_in_polygon(x, y, NOTCHED) is inside
    assert point_in_polygon(x, y, NOTCHED[::-1]) is inside


def test_nothing_that_is_no_number_is_inside() -> None:
    assert not point_in_polygon(math.nan, 1.0, NOTCHED)
    assert not point_in_polygon(5.0, math.nan, NOTCHED)


# -- paths ----------------------------------------------------------------------------------------

BENT = Polyline([(0.0, 0.0), (10.0, 0.0), (10.0, 5.0)])


def test_stations_and_poses_of_a_bent_path() -> None:
    assert BENT.length_m == 15.0
    assert BENT.pose(4.0) == Pose2(4.0, 0.0, 0.0)
    along = BENT.pose(12.0, 1.0)
    assert (along.x_m, along.y_m, along.yaw_rad) == pytest.approx((9.0, 2.0, math.pi / 2))


def test_a_path_goes_on_straight_beyond_its_ends() -> None:
    assert BENT.pose(-3.0) == Pose2(-3.0, 0.0, 0.0)
    end = BENT.pose(17.0)
    assert (end.x_m, end.y_m) == pytest.approx((10.0, 7.0))


@pytest.mark.parametrize(
    ("point", "station_m", "offset_m"),
    [
        ((-3.0, 4.0), -3.0, 4.0),
        ((9.0, 8.0), 18.0, 1.0),
        ((12.0, 8.0), 18.0, -2.0),
        ((4.0, -2.0), 4.0, -2.0),
        ((10.0, 5.0), 15.0, 0.0),
        ((0.0, 0.0), 0.0, 0.0),
    ],
)
def test_projection_beyond_the_ends(
    point: tuple[float, float], station_m: float, offset_m: float
) -> None:
    assert BENT.project_beyond(*point) == pytest.approx((station_m, offset_m))


@given(station=st.floats(0.0, 15.0), offset=st.floats(-0.5, 0.5))
def test_projection_undoes_pose_away_from_the_corner(station: float, offset: float) -> None:
    if abs(station - 10.0) > 1.0:
        pose = BENT.pose(station, offset)
        assert BENT.project(pose.x_m, pose.y_m) == pytest.approx((station, offset), abs=1e-6)


def test_curvature_of_a_circle() -> None:
    angles_rad = np.linspace(0.0, math.pi, 181)
    left = Polyline(np.stack((20 * np.cos(angles_rad), 20 * np.sin(angles_rad)), axis=1))
    assert left.curvature(left.length_m / 2) == pytest.approx(1 / 20, rel=1e-3)
    right = Polyline(left.points[::-1])
    assert right.curvature(right.length_m / 2) == pytest.approx(-1 / 20, rel=1e-3)


def test_curvature_between_segments_of_different_lengths() -> None:
    """Turn over the mean of the two lengths, linear in between, none at the ends."""
    path = Polyline([(0.0, 0.0), (1.0, 0.0), (1.0, 2.0), (5.0, 2.0)])
    assert path.curvature(1.0) == pytest.approx(math.pi / 2 / 1.5)
    assert path.curvature(3.0) == pytest.approx(-math.pi / 2 / 3.0)
    assert path.curvature(2.0) == pytest.approx((math.pi / 3 - math.pi / 6) / 2)
    assert path.curvature(0.0) == path.curvature(7.0) == 0.0


@pytest.mark.parametrize(
    "points",
    [
        [],
        [(0.0, 0.0)],
        [(0.0, 0.0), (0.0, 0.0)],
        [(0.0, 0.0), (math.nan, 1.0)],
        [(0.0, 0.0), (math.inf, 1.0)],
        [(0.0, 0.0, 0.0), (1.0, 1.0, 1.0)],
    ],
)
def test_what_is_no_path(points: list[tuple[float, ...]]) -> None:
    with pytest.raises(ValueError, match="path"):
        Polyline(points)


@given(
    st.lists(st.tuples(st.integers(-50, 50), st.integers(-50, 50)), min_size=3, max_size=9),
    st.lists(st.tuples(st.floats(-60, 60), st.floats(-60, 60)), min_size=1, max_size=4),
)
def test_a_path_gone_through_piece_by_piece_gives_the_same_as_at_once(
    corners: list[tuple[int, int]], points: list[tuple[float, float]]
) -> None:
    """Results are equal to the last bit: only the path's length decides which search is used."""
    distinct = [a for a, b in zip(corners, [*corners[1:], None], strict=True) if a != b]
    if len(distinct) < 2:
        return
    path = Polyline(distinct)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(geometry, "_FEW_PIECES", 0)
        at_once = path.project_all(points)
    assert path.project_all(points) == at_once


@pytest.mark.parametrize("way", ["straight", "circles", "loops back", "far from the origin"])
@pytest.mark.parametrize("spread_m", [0.0, 1.0, 40.0, 900.0])
def test_a_long_path_searched_by_stretches_gives_the_same_as_piece_by_piece(
    way: str, spread_m: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Results are equal to the last bit, even if several pieces are equally near."""
    random = np.random.default_rng(1)
    n = np.arange(2000)
    points = {
        "straight": np.column_stack([n * 0.5, 0.0 * n]),
        "circles": 30.0 * np.column_stack([np.cos(n / 60.0), np.sin(n / 60.0)]),
        "loops back": np.column_stack([n % 40, n // 40 % 9 + 0.0]),
        "far from the origin": np.column_stack([6e6 + 0.5 * n, 5e5 + 20.0 * np.sin(n / 20.0)]),
    }[way]
    monkeypatch.setattr(geometry, "_MANY_PIECES", 100)
    monkeypatch.setattr(geometry, "_STRETCH", 8)
    path = Polyline(points)
    places = points[np.sort(random.integers(0, len(points), 20))]
    places = places + random.normal(0.0, spread_m, places.shape)
    for some in (places, places[:5], places[[0, 19, 3]]):
        asked = [(float(x), float(y)) for x, y in some]
        assert path.project_all(asked) == [path._project_one(x, y) for x, y in asked]
    odd = [(math.nan, 1.0), *asked]
    with np.errstate(invalid="ignore"):
        found = path.project_all(odd)
    assert math.isnan(found[0][0])
    assert found[1:] == path.project_all(asked)


def test_a_long_drive_is_projected_in_little_memory() -> None:
    n = np.arange(40_000)
    path = Polyline(np.column_stack([n * 0.5, 20.0 * np.sin(n / 50.0)]))
    drive = [(2.0 * i, 1.0) for i in range(2000)]
    tracemalloc.start()
    path.project_all(drive)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 30e6  # all at once took 640 MB an array


def test_a_place_that_is_no_number_is_nowhere_on_a_path() -> None:
    station, offset = Polyline([(0.0, 0.0), (10.0, 0.0)]).project(math.nan, 1.0)
    assert math.isnan(station)
    assert math.isnan(offset)
