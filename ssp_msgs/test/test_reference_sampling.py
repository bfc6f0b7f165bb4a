"""Sampling of references: hold before, interpolate within, stand after."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.motion.reference import Reference, ReferencePoint, sample

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


def test_points_themselves_are_met_exactly() -> None:
    r = accelerating()
    for point in r.points[:-1]:
        got = sample(r, 5 * S + round(point.t_s * S))
        assert got == point


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


def test_columns_are_the_points() -> None:
    r = accelerating()
    assert r.columns.shape == (7, 5)
    assert r.columns[:, 2].tolist() == [1.0, 4.0, 1.0, 0.0, 5.0, 2.0, 0.0]
    assert reference([]).columns.shape == (7, 0)
    assert r.end_ns == 7 * S
