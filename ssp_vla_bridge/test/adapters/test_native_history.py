"""The ego history as the systems' prompts print it: units, signs, order, and what is missing."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_vla_bridge.messages import EgoSample
from ssp_vla_bridge.native_history import lightemma_history, llavida_history, openemma_history


def test_openemma_prints_metres_per_half_second_oldest_first(cases):
    steps_m = [4.0, 4.1, 4.2, 4.3, 4.4, 4.5, 4.6, 4.7, 4.8, 5.0]
    history = openemma_history(cases.request_with(cases.straight_history(steps_m)))
    assert history.rows == tuple((step_m, 0.0) for step_m in steps_m)
    assert history.pairs_text.startswith("[4.0,0.0], [4.1,0.0], ")
    assert history.pairs_text.endswith(", [5.0,0.0]")


@pytest.mark.parametrize(("radius_m", "k"), [(50.0, 2.0), (-50.0, -2.0)])
def test_openemma_prints_hundredths_of_the_curvature_with_left_positive(cases, radius_m, k):
    # A chord of 50 m · 2 sin(0.05) is 4.998 m.
    history = openemma_history(cases.request_with(cases.circle_history(radius_m, 0.1, 11)))
    assert history.rows == ((5.0, k),) * 10


def test_openemma_prints_what_there_is_of_a_short_history(cases):
    assert openemma_history(cases.request_with(cases.straight_history([3.0, 4.0]))).rows == (
        (3.0, 0.0),
        (4.0, 0.0),
    )
    assert openemma_history(cases.request_with(cases.straight_history([]))).rows == ()
    assert openemma_history(cases.request_with(())).rows == ()


def test_openemma_prints_no_more_than_ten_of_a_long_history(cases):
    history = openemma_history(
        cases.request_with(cases.straight_history([float(i) for i in range(1, 15)]))
    )
    assert [v for v, _ in history.rows] == [float(i) for i in range(5, 15)]


def test_a_denser_history_gives_the_same_pairs(cases):
    dense = cases.request_with(cases.straight_history([1.0] * 50, step_s=0.1))
    assert openemma_history(dense).rows == ((5.0, 0.0),) * 10


def test_a_hole_ends_the_history(cases):
    samples = cases.straight_history([5.0] * 10)
    history = openemma_history(cases.request_with(samples[:6] + samples[7:]))
    assert history.rows == ((5.0, 0.0),) * 3


def test_at_rest_there_is_no_curvature(cases):
    steps = [(0.02, 0.0), (0.0, 0.03), (-0.02, 0.01), (0.0, 0.0)]
    samples = [EgoSample(-0.5 * (3 - i), x, y, 0.0, 0.0, 0.0) for i, (x, y) in enumerate(steps)]
    assert openemma_history(cases.request_with(tuple(samples))).rows == ((0.0, 0.0),) * 3


def test_lightemma_prints_true_speeds_and_curvatures_in_two_lists(cases):
    # A chord of 2 · 50 m · sin(0.05) in 0.5 s.
    speed_mps = round(2 * 50 * math.sin(0.05) / 0.5, 3)
    history = lightemma_history(cases.request_with(cases.circle_history(-50.0, 0.1, 8)))
    assert history.rows == ((speed_mps, -0.02),) * 6
    assert history.column_text(0) == "[" + ", ".join(["9.996"] * 6) + "]"
    assert history.column_text(1) == "[" + ", ".join(["-0.02"] * 6) + "]"


def test_lightemma_takes_slow_for_rest_and_a_hairpin_for_straight(cases):
    history = lightemma_history(
        cases.request_with(cases.straight_history([0.09, 0.09, 0.09, 0.11]))
    )
    assert [v for v, _ in history.rows] == [0.0, 0.0, 0.22]
    history = lightemma_history(cases.request_with(cases.circle_history(4.0, 0.5, 4)))
    assert [c for _, c in history.rows] == [0.0, 0.0]


def test_llavida_prints_lateral_then_forward_with_right_positive(cases):
    # At −1 s on a left circle of 50 m that ends at the origin: 9.93 m behind and 1.0 m left.
    history = llavida_history(cases.request_with(cases.circle_history(50.0, 0.1, 3)))
    assert history.rows == ((-1.0, -9.93), (-0.25, -4.99))
    assert history.points_text == "[(-1.00,-9.93), (-0.25,-4.99)]"


@pytest.mark.parametrize("make", [openemma_history, lightemma_history, llavida_history])
def test_an_unknown_history_is_empty(cases, make):
    history = make(cases.request_with(cases.straight_history([5.0] * 10), "unknown"))
    assert history.rows == ()
    assert history.pairs_text == ""


@settings(max_examples=100, deadline=None)
@given(
    st.lists(st.builds(EgoSample, *[st.floats() | st.sampled_from([0.0, -0.5, -1.0])] * 6)).map(
        tuple
    )
)
def test_no_history_raises(cases, samples):
    for make in (openemma_history, lightemma_history, llavida_history):
        assert len(make(cases.request_with(samples)).rows) <= 10
