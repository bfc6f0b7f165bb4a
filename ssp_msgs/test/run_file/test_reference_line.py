"""METHOD 2.4: the block transform, there and back, and the places where there is none."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.special import fresnel  # type: ignore[import-untyped] # has no types

from ssp_core.geometry import FloatArray, Polyline, Pose2
from ssp_core.run_file.road import CurvePiece, Lane, Road
from ssp_core.run_file.values import Start
from ssp_core.world.reference_line import NotOneToOne, Panels, ReferenceLine

angles = st.floats(-7.0, 7.0)
metres = st.floats(-5000.0, 5000.0)
origins = st.builds(Pose2, metres, metres, angles)


def straight(length_m: float) -> CurvePiece:
    return CurvePiece(length_m=length_m)


def arc(length_m: float, curvature_1pm: float) -> CurvePiece:
    return CurvePiece(
        length_m=length_m, start_curvature_1pm=curvature_1pm, end_curvature_1pm=curvature_1pm
    )


def clothoid(length_m: float, start_1pm: float, end_1pm: float) -> CurvePiece:
    return CurvePiece(length_m=length_m, start_curvature_1pm=start_1pm, end_curvature_1pm=end_1pm)


# Slow machines aren't what these tests are about.
calm = settings(deadline=None)

HOME = Pose2(0.0, 0.0, 0.0)
BEND = (straight(80.0), clothoid(30.0, 0.0, 0.01), arc(90.0, 0.01), clothoid(30.0, 0.01, 0.0))
S_BEND = (arc(60.0, 0.02), clothoid(40.0, 0.02, -0.015), arc(50.0, -0.015), straight(40.0))


@st.composite
def lines(draw: st.DrawFn) -> ReferenceLine:
    """Roads of up to six pieces with radii of at least 20 m, that turn by less than half a turn."""
    pieces = []
    k = 0.0
    turned = 0.0
    for _ in range(draw(st.integers(1, 6))):
        length = draw(st.floats(0.5, 120.0))
        kind = draw(st.sampled_from(["straight", "arc", "clothoid"]))
        start = 0.0 if kind == "straight" else draw(st.floats(-0.05, 0.05))
        end = start if kind != "clothoid" else draw(st.floats(-0.05, 0.05))
        turned += max(abs(start), abs(end)) * length
        pieces.append(clothoid(length, start, end))
        k = max(k, abs(start), abs(end))
    assume(turned < 3.0)
    line = ReferenceLine(draw(origins), pieces)
    return line.reversed() if draw(st.booleans()) else line


def largest(line: ReferenceLine) -> float:
    return max(max(abs(p.start_curvature_1pm), abs(p.end_curvature_1pm)) for p in line.pieces)


# -- the line itself ------------------------------------------------------------------------------


def test_a_straight_line_is_a_rigid_motion() -> None:
    line = ReferenceLine(Pose2(10.0, 20.0, math.pi / 2), [straight(30.0), straight(70.0)])
    assert line.is_straight
    assert line.length_m == 100.0
    assert line.to_map(40.0, 3.0) == pytest.approx((7.0, 60.0), abs=1e-12)
    assert line.to_local(7.0, 60.0) == pytest.approx((40.0, 3.0), abs=1e-12)
    assert line.pose(40.0).yaw_rad == pytest.approx(math.pi / 2)


def test_an_arc_has_its_centre_where_geometry_says() -> None:
    line = ReferenceLine(HOME, [arc(50.0 * math.pi, 0.01)])
    pose = line.pose(50.0 * math.pi)
    assert (pose.x_m, pose.y_m) == pytest.approx((100.0, 100.0), abs=1e-10)
    assert pose.yaw_rad == pytest.approx(math.pi / 2)
    assert line.to_map(25.0 * math.pi, 40.0) == pytest.approx(
        (60.0 * math.sqrt(0.5), 100.0 - 60.0 * math.sqrt(0.5)), abs=1e-10
    )
    assert line.curvature_1pm(20.0) == 0.01
    assert line.curvature_1pm(-1.0) == line.curvature_1pm(200.0) == 0.0


@pytest.mark.parametrize(("length_m", "end_1pm"), [(60.0, 0.02), (200.0, -0.06), (5.0, 1e-4)])
def test_a_clothoid_agrees_with_fresnel_integrals(length_m: float, end_1pm: float) -> None:
    line = ReferenceLine(HOME, [clothoid(length_m, 0.0, end_1pm)])
    rate = abs(end_1pm) / length_m
    scale = math.sqrt(math.pi / rate)
    for s in np.linspace(0.0, length_m, 9):
        y, x = fresnel(s / scale)
        pose = line.pose(float(s))
        assert pose.x_m == pytest.approx(scale * x, abs=1e-9)
        assert pose.y_m == pytest.approx(math.copysign(scale * y, end_1pm), abs=1e-9)


@calm
@given(line=lines(), share=st.floats(0.0, 1.0))
def test_the_line_is_continuous_and_runs_where_it_heads(line: ReferenceLine, share: float) -> None:
    s = share * line.length_m
    before, after = line.pose(s - 1e-4), line.pose(s + 1e-4)
    dx, dy = after.x_m - before.x_m, after.y_m - before.y_m
    assert math.hypot(dx, dy) == pytest.approx(2e-4, abs=1e-8)
    yaw = line.pose(s).yaw_rad
    assert math.remainder(math.atan2(dy, dx) - yaw, 2 * math.pi) == pytest.approx(0.0, abs=1e-4)


# -- there and back -------------------------------------------------------------------------------


@calm
@given(origin=origins, s=st.floats(-200.0, 600.0), offset=st.floats(-300.0, 300.0))
def test_round_trip_on_rotated_straight_blocks(origin: Pose2, s: float, offset: float) -> None:
    line = ReferenceLine(origin, [straight(400.0)])
    assert line.to_local(*line.to_map(s, offset)) == pytest.approx((s, offset), abs=1e-6)


@settings(max_examples=300, deadline=None)
@given(line=lines(), share=st.floats(-0.3, 1.3), part=st.floats(-0.95, 0.95))
def test_round_trip_on_curved_blocks(line: ReferenceLine, share: float, part: float) -> None:
    s = share * line.length_m
    offset = part / max(largest(line), 0.005)
    assert line.to_local(*line.to_map(s, offset)) == pytest.approx((s, offset), abs=1e-6)


@settings(max_examples=200, deadline=None)
@given(line=lines(), x=st.floats(-250.0, 250.0), y=st.floats(-250.0, 250.0))
def test_round_trip_from_places(line: ReferenceLine, x: float, y: float) -> None:
    place = line.origin.x_m + x, line.origin.y_m + y
    try:
        s, offset = line.to_local(*place)
    except NotOneToOne:
        return
    assert line.to_map(s, offset) == pytest.approx(place, abs=1e-6)
    # No other place of the line is nearer.
    stations = np.linspace(-300.0, line.length_m + 300.0, 4001)
    nearest = min(
        math.hypot(pose.x_m - place[0], pose.y_m - place[1])
        for pose in (line.pose(float(at)) for at in stations[::40])
    )
    assert abs(offset) <= nearest + 1e-6


@calm
@given(line=lines(), share=st.floats(-0.2, 1.2), part=st.floats(-0.9, 0.9))
def test_the_reversed_line_mirrors_coordinates(
    line: ReferenceLine, share: float, part: float
) -> None:
    s, offset = share * line.length_m, part / max(largest(line), 0.005)
    back = line.reversed()
    place = line.to_map(s, offset)
    assert back.to_map(line.length_m - s, -offset) == pytest.approx(place, abs=1e-6)
    assert back.to_local(*place) == pytest.approx((line.length_m - s, -offset), abs=1e-6)
    again = back.reversed()
    assert again.to_map(s, offset) == pytest.approx(place, abs=1e-6)
    assert back.curvature_1pm(line.length_m + 1.0) == 0.0


@calm
@given(line=lines(), a=st.floats(-0.2, 1.2), b=st.floats(-0.2, 1.2), at=st.floats(0.0, 1.0))
def test_a_section_keeps_its_places(line: ReferenceLine, a: float, b: float, at: float) -> None:
    low, high = sorted((a * line.length_m, b * line.length_m))
    assume(high - low > 0.01)
    part = line.section(low, high)
    assert part.length_m == pytest.approx(high - low, abs=1e-9)
    s = at * (high - low)
    assert part.to_map(s, 2.0) == pytest.approx(line.to_map(low + s, 2.0), abs=1e-7)
    middle = 0.5 * (high - low)
    assume(all(abs(low + middle - joint) > 1e-6 for joint in joints(line)))
    assert part.curvature_1pm(middle) == pytest.approx(line.curvature_1pm(low + middle), abs=1e-9)


def joints(line: ReferenceLine) -> list[float]:
    ends = np.cumsum([piece.length_m for piece in line.pieces])
    return [0.0, *map(float, ends)]


# -- where there is no coordinate -----------------------------------------------------------------


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_at_and_beyond_the_centre_of_curvature_is_an_error(side: float) -> None:
    line = ReferenceLine(HOME, [straight(50.0), arc(120.0, side * 0.01), straight(50.0)])
    s = 110.0
    inside = line.to_map(s, side * 99.0)
    assert line.to_local(*inside) == pytest.approx((s, side * 99.0), abs=1e-6)
    for offset in (100.0, 100.5, 130.0, 250.0):
        with pytest.raises(NotOneToOne, match="centre of curvature"):
            line.to_map(s, side * offset)
    pose = line.pose(s)
    with pytest.raises(NotOneToOne, match="no single foot"):
        line.to_local(*pose.to_parent(0.0, side * 100.0))
    assert np.isnan(line.to_local_many(np.array([pose.to_parent(0.0, side * 100.0)]))).all()
    # On the outer side there is no limit.
    assert line.to_local(*line.to_map(s, side * -5000.0)) == pytest.approx(
        (s, side * -5000.0), abs=1e-6
    )


def test_a_place_between_two_legs_of_a_hairpin_is_an_error() -> None:
    line = ReferenceLine(HOME, [straight(100.0), arc(20.0 * math.pi, 0.05), straight(100.0)])
    assert line.to_local(50.0, 19.0) == pytest.approx((50.0, 19.0), abs=1e-9)
    with pytest.raises(NotOneToOne):
        line.to_local(50.0, 20.0)
    # Locally a coordinate, but the place is nearer to the other leg, which owns it.
    with pytest.raises(NotOneToOne):
        line.to_map(50.0, 21.0)
    assert line.to_map(50.0, 19.0) == pytest.approx((50.0, 19.0), abs=1e-9)


@calm
@given(
    turns=st.lists(st.tuples(st.floats(1.0, 80.0), st.floats(-0.08, 0.08)), min_size=2, max_size=6),
    share=st.floats(-0.3, 1.3),
    offset=st.floats(-20.0, 20.0),
)
def test_a_line_that_turns_round_has_the_places_that_it_gives_back(
    turns: list[tuple[float, float]], share: float, offset: float
) -> None:
    """A place is its own by what is known of the line, or by a search for its feet."""
    line = ReferenceLine(HOME, [arc(length, k) for length, k in turns])
    s = share * line.length_m
    pose = line.pose(s)
    place = pose.to_parent(0.0, offset)
    back = line.to_local_many(np.array([place]))[0]
    own = bool(np.abs(back - (s, offset)).max() <= 1e-6)
    try:
        told: tuple[float, float] | None = line.to_map(s, offset)
    except NotOneToOne:
        told = None
    assert (told is not None) is own


def test_the_middle_of_a_line_around_a_ring_is_known_without_a_search(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Each path along a route over a ring took a search for all of its points."""
    around = ReferenceLine(
        HOME, [straight(100.0), arc(15.0, -0.05), arc(80.0, 0.05), arc(15.0, -0.05), straight(90.0)]
    )
    crossing = ReferenceLine(HOME, [straight(100.0), arc(94.0, 0.05), straight(100.0)])
    with monkeypatch.context() as changed:
        changed.setattr(Panels, "feet", lambda *_: pytest.fail("feet are looked for"))
        assert len(around.path(0.0, around.length_m, 0.0)) > 100
        assert len(around.path(20.0, 150.0, 3.0)) > 50
    searched = []
    feet = Panels.feet

    def counted(self: Panels, xy: FloatArray) -> FloatArray:
        searched.append(len(xy))
        return feet(self, xy)

    monkeypatch.setattr(Panels, "feet", counted)
    crossing.path(0.0, crossing.length_m, 0.0)
    assert searched


# -- paths ----------------------------------------------------------------------------------------


def test_a_straight_stretch_has_two_points() -> None:
    line = ReferenceLine(HOME, [straight(30.0), straight(70.0), arc(50.0, 0.01)])
    assert line.path(10.0, 90.0, 3.5) == [
        pytest.approx((10.0, 3.5)),
        pytest.approx((90.0, 3.5)),
    ]
    assert line.path(90.0, 10.0, 0.0) == [pytest.approx((90.0, 0.0)), pytest.approx((10.0, 0.0))]
    assert line.path(20.0, 20.0, 1.0) == [pytest.approx((20.0, 1.0))]


@calm
@given(
    line=lines(),
    a=st.floats(-0.2, 1.2),
    b=st.floats(-0.2, 1.2),
    part=st.floats(-0.8, 0.8),
    error=st.sampled_from([0.005, 0.05]),
)
def test_chords_keep_to_the_curve(
    line: ReferenceLine, a: float, b: float, part: float, error: float
) -> None:
    low, high = a * line.length_m, b * line.length_m
    offset = part / max(largest(line), 0.02)
    points = np.array(line.path(low, high, offset, error))
    assert tuple(points[0]) == pytest.approx(line.to_map(low, offset), abs=1e-6)
    assert tuple(points[-1]) == pytest.approx(line.to_map(high, offset), abs=1e-6)
    middles = 0.5 * (points[1:] + points[:-1])
    if len(middles):
        found = line.to_local_many(middles)
        assert np.abs(found[:, 1] - offset).max() <= error + 1e-6


def test_a_path_beyond_the_centre_is_an_error() -> None:
    line = ReferenceLine(HOME, [straight(50.0), arc(50.0, 0.05), straight(50.0)])
    with pytest.raises(NotOneToOne):
        line.path(0.0, 150.0, 21.0)


# -- bad and extreme input ------------------------------------------------------------------------


def test_bad_lines_are_refused() -> None:
    with pytest.raises(ValueError, match="at least one piece"):
        ReferenceLine(HOME, [])
    with pytest.raises(ValueError, match="finite"):
        ReferenceLine(Pose2(math.nan, 0.0, 0.0), [straight(1.0)])
    endless = CurvePiece.model_construct(
        length_m=math.inf, start_curvature_1pm=0.0, end_curvature_1pm=0.0
    )
    with pytest.raises(ValueError, match="finite"):
        ReferenceLine(HOME, [endless])
    with pytest.raises(ValueError, match="turns at most"):
        ReferenceLine(HOME, [arc(1e6, 1.0)])
    with pytest.raises(ValueError, match="turns at most"):
        ReferenceLine(HOME, [arc(1e7, 100.0)])
    with pytest.raises(ValueError, match="within"):
        ReferenceLine(HOME, [straight(1e8)] * 20)
    with pytest.raises(ValueError, match="within"):
        ReferenceLine(Pose2(1e12, 0.0, 0.0), [straight(1.0)])


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1e300])
def test_bad_coordinates_are_refused(bad: float) -> None:
    line = ReferenceLine(HOME, BEND)
    for call in (line.to_map, line.to_local):
        with pytest.raises(ValueError, match="within"):
            call(bad, 0.0)
        with pytest.raises(ValueError, match="within"):
            call(0.0, bad)
    with pytest.raises(ValueError, match="within"):
        line.pose(bad)
    with pytest.raises(ValueError, match="within"):
        line.to_local_many(np.array([[bad, 0.0]]))
    with pytest.raises(ValueError, match="within"):
        line.to_map_many(np.array([0.0, bad]), 0.0)
    with pytest.raises(ValueError, match="from < to"):
        line.section(10.0, 10.0)


def test_small_and_large_roads() -> None:
    for origin in (HOME, Pose2(4.5e6, 5.6e6, 2.0)):
        line = ReferenceLine(origin, [straight(1e-6), arc(0.02, 0.5), clothoid(2e4, 1e-5, -1e-5)])
        for s, offset in ((0.01, 0.5), (9000.0, -40.0), (-300.0, 7.0), (30000.0, 2.0)):
            assert line.to_local(*line.to_map(s, offset)) == pytest.approx((s, offset), abs=1e-6)


def test_the_line_of_a_run_road() -> None:
    lanes = [Lane(y_m=0.0, width_m=3.5, direction="forward")]
    start = Start(x_m=1.0, y_m=2.0, yaw_rad=0.5)
    plain = ReferenceLine.of_road(Road(origin=start, length_m=40.0, lanes=lanes))
    assert plain.is_straight
    assert plain.length_m == 40.0
    assert plain.to_map(0.0, 0.0) == (1.0, 2.0)
    bent = ReferenceLine.of_road(
        Road(origin=start, length_m=190.0, pieces=list(S_BEND), lanes=lanes)
    )
    assert not bent.is_straight
    assert bent.length_m == pytest.approx(190.0)


def test_a_line_in_very_many_pieces_has_as_many_points_as_its_shape_needs() -> None:
    """5,000 pieces of half a metre: each of them was a corner of a fence."""
    bends = [0.0005 * math.sin(i / 400.0) for i in range(5000)]
    line = ReferenceLine(
        Pose2(0.0, 0.0, 0.3),
        [CurvePiece(length_m=0.5, start_curvature_1pm=k, end_curvature_1pm=k) for k in bends],
    )
    stations = np.linspace(0.0, line.length_m, 4001)
    for offset, error in ((0.0, 0.005), (-8.0, 0.02)):
        points = line.path(0.0, line.length_m, offset, error)
        assert len(points) < 500
        assert points[0] == pytest.approx(line.to_map(0.0, offset))
        assert points[-1] == pytest.approx(line.to_map(line.length_m, offset))
        chords = Polyline(points)
        true = [(float(x), float(y)) for x, y in line.to_map_many(stations, offset)]
        assert max(abs(d) for _, d in chords.project_all(true)) <= error
        back = line.path(line.length_m, 0.0, offset, error)
        assert np.allclose(back[::-1], points, atol=error)
