"""Profiles: consistent in themselves, inside their limits, standing where they should."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from ssp_core.geometry import FloatArray, Polyline
from ssp_core.motion.approach import approach_points
from ssp_core.motion.manoeuvre import brake_along, drive_along, lane_change
from ssp_core.motion.reference import PLACES_S, Points, Reference, ReferencePoint, between, sample
from ssp_core.motion.speed_profile import SpeedProfile
from ssp_core.run_file.participants import Motion

STRAIGHT = Polyline([(0.0, 0.0), (300.0, 0.0)])


def arc(radius_m: float = 40.0, points: int = 120) -> Polyline:
    a = np.linspace(0.0, math.pi / 2.0, points)
    return Polyline(np.stack((radius_m * np.sin(a), radius_m * (1.0 - np.cos(a))), axis=1))


def columns(points: list[ReferencePoint]) -> FloatArray:
    return np.array(
        [
            (p.t_s, p.x_m, p.y_m, p.yaw_rad, p.speed_mps, p.acceleration_mps2, p.curvature_1pm)
            for p in points
        ]
    ).T


def assert_consistent(
    points: list[ReferencePoint], position_m: float, yaw_rad: float, speed_mps: float = 0.01
) -> None:
    """Integrating speed, yaw, acceleration and curvature gives the points again, step by step."""
    t, x, y, yaw, v, a, k = columns(points)
    dt = np.diff(t)
    assert (dt > 0.0).all()
    middle = yaw[:-1] + 0.5 * np.angle(np.exp(1j * np.diff(yaw)))
    moved = 0.5 * (v[:-1] + v[1:]) * dt
    assert np.abs(np.diff(x) - moved * np.cos(middle)).max() < position_m
    assert np.abs(np.diff(y) - moved * np.sin(middle)).max() < position_m
    assert np.abs(np.diff(v) - 0.5 * (a[:-1] + a[1:]) * dt).max() < speed_mps
    turned = np.angle(np.exp(1j * np.diff(yaw)))
    assert np.abs(turned - 0.5 * (k[:-1] + k[1:]) * moved).max() < yaw_rad


profiles = st.tuples(
    st.floats(0.0, 15.0),
    st.floats(0.5, 20.0),
    st.floats(1.0, 200.0),
    st.floats(0.5, 4.0),
    st.floats(0.5, 6.0),
    st.floats(0.0, 0.8),
)


@given(profiles)
@settings(max_examples=100, deadline=None)
def test_a_speed_profile_keeps_its_limits_and_stands_at_its_end(
    values: tuple[float, float, float, float, float, float],
) -> None:
    v0, cruise, room, a_max, d_max, ramp = values
    room += v0 * v0 / (2.0 * d_max) + 0.5 * v0 * ramp
    p = SpeedProfile(v0, cruise, room, a_max, d_max, ramp)
    assert p.at(0.0)[:2] == pytest.approx((0.0, v0), abs=1e-9)
    assert p.at(p.duration_s) == (room, 0.0, 0.0)
    # The end isn't reached by the closing statement but by the motion itself.
    assert p.at(p.duration_s - 1e-7)[:2] == pytest.approx((room, 0.0), abs=1e-4)
    times = np.linspace(0.0, p.duration_s, 200)
    s, v, a = np.array([p.at(float(t)) for t in times]).T
    assert (np.diff(s) >= -1e-9).all()
    assert v.min() >= 0.0
    assert v.max() <= max(v0, cruise) + 1e-9
    assert a.max() <= a_max + 1e-9
    assert a.min() >= -d_max - 1e-9


def test_cruise_speed_is_reached_and_held() -> None:
    p = SpeedProfile(0.0, 10.0, 150.0, 2.0, 2.0)
    assert p.at(8.0)[1:] == pytest.approx((10.0, 0.0))
    assert p.at(9.0)[1:] == pytest.approx((10.0, 0.0))


@pytest.mark.parametrize("path", [STRAIGHT, arc()])
@pytest.mark.parametrize("offset_m", [0.0, -1.5])
def test_braking_goes_down_at_once_and_holds_to_the_end(path: Polyline, offset_m: float) -> None:
    """Braking from 10 to 4 m/s at 4 m/s^2 takes 1.5 s and the ramp."""
    start = path.length_m - 45.0
    points = brake_along(path, start, 10.0, 4.0, 4.0, offset_m)
    assert_consistent(points, 0.02, 0.02)
    t, x, y, _, v, a, _ = columns(points)
    assert v[0] == pytest.approx(10.0)
    assert (np.diff(v) <= 1e-9).all()
    assert v[(t > 1.95) & (t < 3.0)] == pytest.approx(4.0)
    assert a.min() == pytest.approx(-4.0)
    end = path.pose(path.length_m, offset_m)
    assert (x[-1], y[-1], v[-1]) == pytest.approx((end.x_m, end.y_m, 0.0), abs=0.01)


def test_braking_to_a_standstill_ends_where_it_stands() -> None:
    """10 m/s at 5 m/s^2: 10 m, and 2 m more while deceleration builds up over 0.4 s."""
    t, x, _, _, v, a, _ = columns(brake_along(STRAIGHT, 100.0, 10.0, 0.0, 5.0))
    assert (x[-1], v[-1]) == pytest.approx((112.0, 0.0))
    assert t[-1] == pytest.approx(2.4)
    assert a.min() == pytest.approx(-5.0)
    assert a[t <= 0.4] == pytest.approx(-12.5 * t[t <= 0.4])


@pytest.mark.parametrize(
    ("start_m", "speed", "to", "says"),
    [
        (0.0, 4.0, 4.0, "from 4.00 m/s to 4.00 m/s"),
        (0.0, 0.0, 0.0, "from a speed to a lower one"),
        (0.0, 5.0, -1.0, "from a speed to a lower one"),
        (289.0, 10.0, 0.0, "11.00 m is too short"),
        (289.0, 10.0, 3.0, "11.00 m is too short"),
    ],
)
def test_a_braking_that_is_none_is_refused(
    start_m: float, speed: float, to: float, says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        brake_along(STRAIGHT, start_m, speed, to, 5.0)


@pytest.mark.parametrize(
    "change",
    [
        {"start_mps": -0.1},
        {"cruise_mps": 0.0},
        {"acceleration_mps2": 0.0},
        {"deceleration_mps2": -1.0},
        {"distance_m": 24.9},
        {"distance_m": math.nan},
    ],
)
def test_an_impossible_speed_profile_is_refused(change: dict[str, float]) -> None:
    good = {
        "start_mps": 10.0,
        "cruise_mps": 10.0,
        "distance_m": 25.1,
        "acceleration_mps2": 2.0,
        "deceleration_mps2": 2.0,
        "ramp_s": 0.0,
    }
    SpeedProfile(**good)
    with pytest.raises(ValueError, match=r"must be|too short|finite"):
        SpeedProfile(**{**good, **change})


def test_driving_along_an_arc_is_consistent() -> None:
    points = drive_along(arc(), 0.0, 0.0, 8.0, 2.0, 2.0)
    assert_consistent(points, 0.01, 2e-3)
    middle = points[len(points) // 2]
    assert middle.curvature_1pm == pytest.approx(1.0 / 40.0, rel=0.01)


@pytest.mark.parametrize("shift_m", [3.5, -3.5])
@pytest.mark.parametrize("cruise_mps", [9.0, 12.0, 14.0])
def test_a_lane_change_ends_parallel_to_the_path_at_its_end(
    shift_m: float, cruise_mps: float
) -> None:
    points = lane_change(STRAIGHT, 30.0, 12.0, shift_m, 2.5, cruise_mps, 2.0)
    assert_consistent(points, 2e-3, 1e-3)
    assert (points[0].y_m, points[0].yaw_rad, points[0].curvature_1pm) == (0.0, 0.0, 0.0)
    after = [p for p in points if p.t_s >= 2.5]
    assert after[0].t_s == 2.5
    assert all(p.y_m == pytest.approx(shift_m, abs=1e-9) for p in after)
    assert all(abs(p.yaw_rad) < 1e-9 and abs(p.curvature_1pm) < 1e-9 for p in after)
    assert max(p.speed_mps for p in after) == pytest.approx(cruise_mps, abs=1e-9)
    assert (points[-1].x_m, points[-1].speed_mps) == (300.0, 0.0)


@pytest.mark.parametrize("shift_m", [3.5, -3.5])
@pytest.mark.parametrize("turn_rad", [0.3, -0.3])
def test_beside_a_bend_that_begins_and_ends_at_once_speed_and_acceleration_agree(
    shift_m: float, turn_rad: float
) -> None:
    """Far behind a lane change a gentle bend has chords of 12 m: heading turns at its vertices."""
    sharp = np.cumsum(np.r_[np.zeros(20), np.full(10, turn_rad / 10), np.zeros(20)])
    xy = 12.0 * np.cumsum(np.stack((np.cos(sharp), np.sin(sharp)), axis=1), axis=0)
    path = Polyline(xy)
    points = lane_change(path, 5.0, 10.0, shift_m, 2.5, 8.0, 2.0)
    t, x, y, _, v, a, _ = columns(points)
    assert np.abs(np.diff(v) - 0.5 * (a[:-1] + a[1:]) * np.diff(t)).max() < 5e-3
    assert v[(t > 4.0) & (t < t[-1] - 6.0)] == pytest.approx(8.0)
    end = path.pose(path.length_m, shift_m)
    assert (x[-1], y[-1], v[-1]) == pytest.approx((end.x_m, end.y_m, 0.0), abs=1e-3)


def test_no_way_leads_beside_a_bend_around_its_middle() -> None:
    with pytest.raises(ValueError, match=r"beside its path by up to 9\.00 m"):
        lane_change(arc(8.0), 0.5, 4.0, 9.0, 1.0, 4.0, 2.0)


def test_a_lane_change_can_start_beside_the_path_and_end_before_its_end() -> None:
    points = lane_change(
        STRAIGHT, 0.0, 12.0, 2.0, 2.5, 12.0, 2.0, start_offset_m=1.0, end_station_m=200.0
    )
    assert points[0].y_m == pytest.approx(1.0)
    assert (points[-1].x_m, points[-1].y_m) == pytest.approx((200.0, 3.0))


@pytest.mark.parametrize(
    ("start_mps", "duration_s", "station_m"), [(0.0, 2.5, 0.0), (10.0, 0.0, 0.0), (4.0, 9.0, 290.0)]
)
def test_a_lane_change_needs_a_moving_object(
    start_mps: float, duration_s: float, station_m: float
) -> None:
    with pytest.raises(ValueError, match="lane change"):
        lane_change(STRAIGHT, station_m, start_mps, 3.5, duration_s, 12.0, 2.0)


S = 1_000_000_000


def reference(points: list[ReferencePoint], execute_at_ns: int = 5 * S) -> Reference:
    return Reference("r1", "ot", "sha256:0", "approach", 0, execute_at_ns, 9 * S, tuple(points))


def accelerating(a: float = 2.0, v0: float = 3.0, step_s: float = 0.5) -> Reference:
    """Constant acceleration along x, ended by an artificial standstill point."""
    times = [i * step_s for i in range(5)]
    points = [
        ReferencePoint(t, v0 * t + 0.5 * a * t * t, 1.0, 0.0, v0 + a * t, a, 0.0) for t in times
    ]
    return reference(points)


def test_before_the_first_point_it_is_held_without_acceleration() -> None:
    p = sample(accelerating(), 4 * S)
    assert (p.x_m, p.y_m, p.speed_mps, p.acceleration_mps2) == (0.0, 1.0, 3.0, 0.0)
    assert p.t_s == -1.0


def test_after_the_last_point_it_stands_there() -> None:
    last = accelerating().points[-1]
    for t_ns in (7 * S, 100 * S):
        p = sample(accelerating(), t_ns)
        assert (p.x_m, p.y_m, p.yaw_rad) == (last.x_m, last.y_m, last.yaw_rad)
        assert (p.speed_mps, p.acceleration_mps2) == (0.0, 0.0)


@given(st.floats(0.0, 1.999))
@settings(max_examples=100, deadline=None)
def test_constant_acceleration_is_interpolated_exactly(t_s: float) -> None:
    t_ns = round(t_s * S)
    t_s = t_ns / S
    p = sample(accelerating(), 5 * S + t_ns)
    assert p.x_m == pytest.approx(3.0 * t_s + t_s * t_s, abs=1e-9)
    assert p.speed_mps == pytest.approx(3.0 + 2.0 * t_s, abs=1e-9)


def test_a_circle_is_met_within_a_millimetre_between_coarse_points() -> None:
    radius, speed = 30.0, 8.0
    points = []
    for i in range(6):
        t = 0.25 * i
        yaw = speed * t / radius
        x, y = radius * math.sin(yaw), radius * (1.0 - math.cos(yaw))
        points.append(ReferencePoint(t, x, y, yaw, speed, 0.0, 1.0 / radius))
    r = reference(points, execute_at_ns=0)
    for k in range(100):
        p = sample(r, round(k * 0.0124 * S))
        assert math.hypot(p.x_m, p.y_m - radius) == pytest.approx(radius, abs=1e-3)


def test_heading_goes_the_short_way_over_pi() -> None:
    a = ReferencePoint(0.0, 0.0, 0.0, math.pi - 0.1, 1.0, 0.0, 0.0)
    b = ReferencePoint(1.0, -1.0, 0.0, -math.pi + 0.1, 1.0, 0.0, 0.0)
    p = sample(reference([a, b], 0), S // 2)
    assert abs(p.yaw_rad) == pytest.approx(math.pi, abs=1e-12)


def test_places_lie_on_the_way_between_points_that_are_far_apart() -> None:
    points = [
        ReferencePoint(0.0, 0.0, 0.0, math.pi - 0.1, 3.0, 1.0, 0.1),
        ReferencePoint(1.25, -4.5, 0.2, -math.pi + 0.1, 4.25, 0.0, -0.1),
        # From here on as dense as need be, and in the end it stands for long.
        ReferencePoint(1.35, -4.9, 0.2, -math.pi + 0.1, 0.0, 0.0, 0.0),
        ReferencePoint(9.0, -4.9, 0.2, -math.pi + 0.1, 0.0, 0.0, 0.0),
    ]
    places = Points(reference(points).places)
    times = places.columns[0].tolist()
    assert [t for t in times if t in {p.t_s for p in points}] == [p.t_s for p in points]
    assert len(times) == len(points) + 12
    assert max(np.diff(times)[:-1]) <= PLACES_S + 1e-6
    for place in places:
        a = max((p for p in points[:-1] if p.t_s <= place.t_s), key=lambda p: p.t_s)
        there = between(a, points[points.index(a) + 1], place.t_s)
        for field in ReferencePoint.__dataclass_fields__:
            assert getattr(place, field) == pytest.approx(getattr(there, field), abs=1e-12)


def test_points_that_are_close_are_the_places() -> None:
    close = reference(drive_along(STRAIGHT, 0.0, 0.0, 20.0, 2.0, 2.0, dt_s=0.1))
    assert close.places is close.columns


def timed(times_s: list[float] | None = None) -> Motion:
    """Return a motion along a quarter circle of 20 m, with an own time for each place if given."""
    places = [(20.0 * math.sin(a), 20.0 * (1.0 - math.cos(a))) for a in np.linspace(0.0, 1.5, 61)]
    return Motion(path=places, cruise_mps=8.0, times_s=times_s)


def test_a_motion_without_times_is_written_as_before_there_were_any() -> None:
    assert "times_s" not in timed().model_dump(mode="json")
    given = timed([float(k) for k in range(61)])
    assert Motion.model_validate(given.model_dump(mode="json")) == given


@pytest.mark.parametrize(
    ("times_s", "why"),
    [([0.0, 1.0], "2 times for 61 places"), ([0.0, *range(60)], "must rise")],
)
def test_times_that_are_no_times_of_the_path_are_refused(times_s: list[float], why: str) -> None:
    with pytest.raises(ValidationError, match=why):
        timed(times_s)


def test_a_timed_motion_is_at_each_place_at_its_time_and_stands_at_both_ends() -> None:
    # Along the arc as u^2 (3 - 2 u), so that it begins and ends smoothly.
    u = np.linspace(0.0, 1.0, 601)
    share = np.linspace(0.0, 1.0, 61)
    at = np.interp(share, u * u * (3.0 - 2.0 * u), 10.0 * u)
    points = approach_points(timed(at.tolist()))
    t, x, y, yaw, speed, acceleration, curvature = points.columns
    assert t == pytest.approx(at)
    assert x == pytest.approx(20.0 * np.sin(1.5 * share))
    assert y == pytest.approx(20.0 * (1.0 - np.cos(1.5 * share)))
    assert (speed[0], speed[-1]) == (0.0, 0.0)
    # Fastest in the middle: 1.5 times the mean of 30 m in 10 s.
    assert speed.max() == pytest.approx(4.5, rel=0.01)
    middle = slice(15, -15)
    assert yaw[middle] == pytest.approx(1.5 * share[middle], abs=0.01)
    assert curvature[middle] == pytest.approx(0.05, abs=0.003)
    assert abs(acceleration[30]) < 0.05


def test_a_timed_motion_that_never_moves_is_told() -> None:
    still = Motion(path=[(0.0, 0.0), (0.1, 0.0)], cruise_mps=1.0, times_s=[0.0, 10.0])
    with pytest.raises(ValueError, match="no place of its path"):
        approach_points(still)
