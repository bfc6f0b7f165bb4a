"""The adapter ``lightemma``: hand-computed points, left and right, and the same traps in short."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ssp_vla_bridge.native_history import lightemma_history

FORM = "({}, {})"


def listed(cases, rows):
    return f"[{cases.pairs(rows, FORM)}]"


def test_straight_ahead_covers_half_the_speed_per_step(cases):
    adapted = cases.read("lightemma", listed(cases, [(10.0, 0.0)] * 6))
    assert adapted.trajectory.t_s == tuple(0.5 * i for i in range(7))
    assert cases.points(adapted) == [(5.0 * i, 0.0) for i in range(7)]
    assert adapted.info.notes == ()
    assert not adapted.info.origin_added


@pytest.mark.parametrize(("curvature_pm", "side"), [(0.02, 1.0), (-0.02, -1.0)])
def test_native_turns_behind_each_step(cases, curvature_pm, side):
    adapted = cases.read("lightemma", listed(cases, [(10.0, curvature_pm)] * 6))
    # Steps of 5 m with headings 0, 0.1 and 0.2 rad.
    by_hand = [
        (0.0, 0.0),
        (5.0, 0.0),
        (5.0 + 5.0 * math.cos(0.1), side * 5.0 * math.sin(0.1)),
        (
            5.0 + 5.0 * math.cos(0.1) + 5.0 * math.cos(0.2),
            side * 5 * (math.sin(0.1) + math.sin(0.2)),
        ),
    ]
    assert np.array(cases.points(adapted)[:4]) == pytest.approx(np.array(by_hand))
    assert cases.points(adapted)[3] == pytest.approx((14.8754, side * 1.4925), abs=1e-4)


@pytest.mark.parametrize(("curvature_pm", "side"), [(0.02, 1.0), (-0.02, -1.0)])
def test_corrected_meets_a_circle_exactly(cases, curvature_pm, side):
    adapted = cases.read("lightemma:corrected", listed(cases, [(10.0, curvature_pm)] * 6))
    by_hand = [(50 * math.sin(0.1 * i), side * 50 * (1 - math.cos(0.1 * i))) for i in range(7)]
    assert np.array(cases.points(adapted)) == pytest.approx(np.array(by_hand), abs=1e-12)


def test_the_echo_of_the_history_is_no_answer(cases):
    steps_m = [5.0, 4.9, 4.8, 4.6, 4.5, 4.3, 4.2]
    request = cases.request_with(cases.straight_history(steps_m))
    history = [(2 * step_m, 0.0) for step_m in steps_m[1:]]
    plan = [(8.0, 0.01)] * 6
    assert cases.read("lightemma", listed(cases, history), request).invalid == ("missing",)
    both = cases.read("lightemma", listed(cases, history) + "\n" + listed(cases, plan), request)
    assert both.trajectory == cases.read("lightemma", listed(cases, plan)).trajectory


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("[]", "missing"),
        ("[10.0, 10.0, 10.0, 10.0, 10.0, 10.0]", "shape"),
        ("[(10.0, 0.0), (10.0, 0.0), (10.0", "shape"),
        ("[(10.0, 0.0), (10.0, 0.0)", "shape"),
        ("[(36 px, 0.0), (36 px, 0.0)]", "shape"),
        ("[(10.0, 0.0)]", "coverage"),
        ("[(10.0, NaN), (10.0, 0.0)]", "non_finite"),
    ],
)
def test_names_why_there_is_no_trajectory(cases, text, reason):
    adapted = cases.read("lightemma", text)
    assert adapted.trajectory is None
    assert adapted.invalid == (reason,)


def test_pairs_in_square_brackets_are_noted(cases):
    adapted = cases.read("lightemma", cases.pairs([(10.0, 0.0)] * 6))
    assert adapted.info.notes == ("square brackets",)


def test_the_echo_with_fewer_decimals_is_no_answer(cases):
    request = cases.request_with(cases.straight_history([2.61, 2.78, 2.94, 3.13, 3.31, 3.47]))
    past = lightemma_history(request).rows
    echo = cases.pairs([[f"{v:.1f}", f"{c:.1f}"] for v, c in past], "({}, {})")
    adapted = cases.read("lightemma", f"[{echo}]", request)
    assert (adapted.trajectory, adapted.invalid) == (None, ("missing",))
    assert "the echo of the history, rounded, was left out" in adapted.info.notes
    plan = cases.pairs([[f"{v + 0.1:.1f}", "0.0"] for v, _ in past], "({}, {})")
    assert cases.read("lightemma", f"[{plan}]", request).invalid == ()
    steady = cases.request_with(cases.straight_history([2.61, 2.62, 2.60, 2.61, 2.59, 2.61]))
    assert cases.read("lightemma", f"[{', '.join(['(5.2, 0.0)'] * 6)}]", steady).invalid == ()
