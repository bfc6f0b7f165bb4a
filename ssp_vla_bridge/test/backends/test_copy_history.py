"""The control that copies its history: hand-computed plans, and no plan where history is short."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from ssp_vla_bridge.adapters.registry import adapt
from ssp_vla_bridge.backend import make_backend, respond
from ssp_vla_bridge.messages import EgoSample


@pytest.fixture
def run(make_request):
    def call(history, **changes):
        request = replace(make_request(history=history), **changes)
        response = respond(make_backend("copy_history", {}), "m", request).response
        return response, adapt("waypoints", response).trajectory

    return call


def test_on_a_straight_line_it_goes_on(run, straight_history):
    response, plan = run(straight_history(8.0))
    assert plan.t_s == (0.0, 0.5, 1.0, 1.5, 2.0)
    assert plan.x_m == pytest.approx((0, 4, 8, 12, 16))
    assert plan.y_m == pytest.approx((0, 0, 0, 0, 0))
    assert response.text == "I keep my speed and stay in my lane."


def test_braking_is_undone(run, straight_history):
    # 8 m/s now, braking at 2 m/s²: it was at −(8·1 + 2·1/2) = −9 m a second ago, −20 m two ago.
    response, plan = run(straight_history(8.0, -2.0))
    assert plan.x_m[2] == pytest.approx(9.0)
    assert plan.x_m[4] == pytest.approx(20.0)
    assert response.text == "I accelerate and stay in my lane."


def test_a_speeding_up_vehicle_slows_down(run, straight_history):
    response, plan = run(straight_history(8.0, 2.0))
    assert plan.x_m[2] == pytest.approx(7.0)
    assert response.text == "I slow down and stay in my lane."


@pytest.mark.parametrize(("side", "words"), [(1.0, "steer to the left"), (-1.0, "to the right")])
def test_a_circle_goes_on_to_its_own_side(run, side, words):
    """Radius 20 m at 10 m/s: a second on it is at (20 sin 0.5, ±20 (1 − cos 0.5))."""
    history = tuple(
        EgoSample(
            t,
            20 * math.sin(0.5 * t),
            side * 20 * (1 - math.cos(0.5 * t)),
            side * 0.5 * t,
            10.0,
            side * 0.5,
        )
        for t in (k * 0.05 for k in range(-40, 1))
    )
    response, plan = run(history)
    assert plan.x_m[2] == pytest.approx(20 * math.sin(0.5))
    assert plan.y_m[2] == pytest.approx(side * 20 * (1 - math.cos(0.5)))
    assert words in response.text


def test_standing_stays_standing(run, straight_history):
    response, plan = run(straight_history(0.0))
    assert set(plan.x_m) == {0.0}
    assert response.text == "I stop and stay in my lane."


def test_between_samples_it_is_linear(run, straight_history):
    coarse = straight_history(8.0, -2.0)[::4]  # every 0.4 s
    _, plan = run(coarse)
    # −0.5 s lies between −0.8 s (x = −7.04) and −0.4 s (x = −3.36), a quarter of the way.
    assert plan.x_m[1] == pytest.approx(3.36 + 0.25 * (7.04 - 3.36))


def test_a_short_or_unknown_history_has_no_plan(run, straight_history):
    response, plan = run(straight_history(8.0)[1:])  # 1.9 s
    assert plan is None
    assert response.arrays == ()
    assert response.text == "I know less than the last 2 s of my motion to repeat."
    for history, changes in (((), {}), (straight_history(8.0), {"ego_provenance": "unknown"})):
        response, plan = run(history, **changes)
        assert (plan, response.arrays) == (None, ())
        assert "not known" in response.text


def test_frames_are_never_looked_at(make_request, straight_history):
    request = make_request(history=straight_history(8.0))
    backend = make_backend("copy_history", {})
    assert backend.answer(request) == backend.answer(replace(request, frames=()))
