"""The road-curvature diagnostic, on paths whose answer is known."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_eval.data.ego_path import Pose, recorded_paths
from ssp_eval.statistics.curvature import arc_shift_m, curve_at, curves

SPEED = 10.0
STEP = 0.1


def arc(curvature, t_s, yaw0=0.0):
    """Constant speed along a circle (or a straight line) through the origin."""
    if curvature == 0:
        x, y, turn = SPEED * t_s, 0.0, 0.0
    else:
        turn = curvature * SPEED * t_s
        x, y = math.sin(turn) / curvature, (1 - math.cos(turn)) / curvature
    c, s = math.cos(yaw0), math.sin(yaw0)
    return Pose(t_s, x * c - y * s, x * s + y * c, yaw0 + turn)


def path(curvature, yaw0=0.0, end_s=4.0):
    return [arc(curvature, k * STEP, yaw0) for k in range(round(end_s / STEP) + 1)]


def request(t_s, of, history_s=2.0):
    """A line of requests.jsonl: the path before t_s, in the VUT's frame then."""
    now = of(t_s)
    c, s = math.cos(now.yaw_rad), math.sin(now.yaw_rad)
    history = []
    for k in range(round(history_s / STEP) + 1):
        back = -history_s + k * STEP
        if t_s + back < -1e-9:
            continue
        there = of(t_s + back)
        dx, dy = there.x_m - now.x_m, there.y_m - now.y_m
        history.append(
            {
                "t_s": back,
                "x_m": dx * c + dy * s,
                "y_m": dy * c - dx * s,
                "yaw_rad": there.yaw_rad - now.yaw_rad,
            }
        )
    return {"label_t_s": t_s, "stamp_ns": round(t_s * 1e9), "history": history}


@given(
    curvature=st.sampled_from([-0.02, -0.005, 0.0, 0.001, 0.01, 0.05]),
    yaw0=st.floats(-math.pi, math.pi),
)
def test_on_an_arc_all_of_the_shift_follows_from_the_curve(curvature, yaw0):
    found = curve_at(path(curvature, yaw0), 1.5, 0.0)
    expected = 0.0 if curvature == 0 else (1 - math.cos(curvature * SPEED)) / curvature
    assert found.shift_m == pytest.approx(expected, abs=1e-9)
    # The path is a chain of chords, which are a little shorter than the arc.
    assert found.curvature_per_m == pytest.approx(curvature, rel=0.02, abs=1e-12)
    assert found.curve_m == pytest.approx(expected, rel=0.02, abs=1e-9)


def test_a_curve_alone_reads_as_a_lateral_action():
    """κ = 0.01 / m at 10 m/s: 0.4996 m within a second, more than 0.3 m."""
    assert curve_at(path(0.01), 1.5, 0.0).reads_as == "left"
    assert curve_at(path(-0.01), 1.5, 0.0).reads_as == "right"
    assert curve_at(path(0.005), 1.5, 0.0).reads_as == "straight"


def test_nothing_of_a_whole_change_of_lane_follows_from_a_curve():
    """3.5 m to the left within the two seconds about t, heading as before at both ends."""
    y = [3.5 * 0.5 * (1 - math.cos(math.pi * k / 20)) for k in range(21)]
    slope = [3.5 * 0.5 * math.pi / 20 * math.sin(math.pi * k / 20) for k in range(21)]
    poses = [Pose(k * STEP, float(k), y[k], math.atan(slope[k])) for k in range(21)]
    found = curve_at(poses, 1.0, 0.0)
    assert found.curvature_per_m == pytest.approx(0.0, abs=1e-12)
    assert found.curve_m == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("curvature", [0.0, 0.02])
def test_histories_are_laid_end_to_end(curvature):
    def of(t_s):
        return arc(curvature, t_s)

    requests = [request(0.5 * k, of) for k in range(9)]
    (whole,) = recorded_paths(requests)
    assert [pose.t_s for pose in whole] == pytest.approx([STEP * k for k in range(41)])
    found = curves(requests)
    assert [one.label_t_s for one in found] == [0.5 * k for k in range(9)]
    expected = 0.0 if curvature == 0 else (1 - math.cos(curvature * SPEED)) / curvature
    for one in found:
        known = one.label_t_s <= 3.0
        assert (one.shift_m is not None) == known
        assert (one.curve_m is not None) == (known and one.label_t_s >= 1.0)
        if known:
            assert one.shift_m == pytest.approx(expected, abs=1e-6)
        if one.curve_m is not None:
            assert one.curve_m == pytest.approx(expected, rel=0.02, abs=1e-6)


def test_histories_with_a_gap_between_stay_apart():
    def of(t_s):
        return arc(0.01, t_s)

    requests = [request(t, of, 1.0) for t in (1.0, 1.5, 5.0, 5.5)]
    assert [round(p[0].t_s, 6) for p in recorded_paths(requests)] == [0.0, 4.0]
    assert [one.shift_m is None for one in curves(requests)] == [True] * 4


def test_what_was_not_asked_has_no_path():
    lost = {"label_t_s": 0.5, "missing": "too late", "kind": "late"}
    assert [one.shift_m for one in curves([lost, {"label_t_s": 1.0, "stamp_ns": 10**9}])] == [
        None,
        None,
    ]


@given(curvature=st.floats(1e-9, 0.1), distance=st.floats(0.1, 30))
def test_the_shift_of_an_arc_has_one_formula_near_0_too(curvature, distance):
    assert arc_shift_m(curvature, distance) == -arc_shift_m(-curvature, distance)
    small = curvature * distance**2 / 2
    assert arc_shift_m(curvature, distance) <= small * (1 + 1e-12)
    if curvature * distance < 1e-3:
        assert arc_shift_m(curvature, distance) == pytest.approx(small, rel=1e-6)
    assert arc_shift_m(0.0, distance) == 0.0
