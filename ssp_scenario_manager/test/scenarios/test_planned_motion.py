"""A manoeuvre at another pace: the same path, continuous, and on time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import FloatArray, Polyline
from ssp_core.motion.manoeuvre import lane_change
from ssp_scenario_manager.dispatch.planned_motion import as_planned, play, required_rate, toward

S = 1_000_000_000
COLUMNS: FloatArray = lane_change(
    Polyline([(0.0, 0.0), (300.0, 0.0)]), 40.0, 9.0, -3.5, 2.5, 6.0, 2.0
).columns
rates = st.floats(0.6, 1.4)


def test_as_planned_it_is_the_manoeuvre_itself() -> None:
    assert np.allclose(play(COLUMNS, as_planned(5 * S)).columns, COLUMNS, atol=1e-12)


@given(rates, st.floats(0.1, 3.0), rates, st.floats(0.05, 2.0))
@settings(max_examples=60, deadline=None)
def test_whatever_is_wished_the_path_stays_and_the_motion_is_continuous(
    first: float, after_s: float, second: float, until_s: float
) -> None:
    start = 5 * S
    one = toward(as_planned(start), start, first, 4.0)
    again = start + round(after_s * S)
    two = toward(one, again, second, after_s + until_s)
    before, after = one.at(again), two.at(again)
    assert after == pytest.approx(before, abs=1e-9)
    t, x, y, yaw, v, a, k = play(COLUMNS, two).columns
    assert (np.diff(t) > 0.0).all()
    assert (v >= 0.0).all()
    assert v[-1] == 0.0
    # Every later point of the manoeuvre is passed, at the place and curvature that it had.
    kept = COLUMNS[:, -(len(t) - 1) :]
    assert (x[1:].tolist(), y[1:].tolist()) == (kept[1].tolist(), kept[2].tolist())
    assert (yaw[1:].tolist(), k[1:].tolist()) == (kept[3].tolist(), kept[6].tolist())
    # Speeds move it as far as it moves, accelerations change its speed as much as it changes.
    dt = np.diff(t)
    assert np.abs(np.hypot(np.diff(x), np.diff(y)) - 0.5 * (v[:-1] + v[1:]) * dt).max() < 0.01
    assert np.abs(np.diff(v) - 0.5 * (a[:-1] + a[1:]) * dt).max() < 0.05


@given(rates, st.floats(0.0, 1.0), st.floats(0.5, 5.0), st.floats(0.8, 1.25))
@settings(max_examples=100, deadline=None)
def test_an_own_time_is_reached_when_it_should(
    before: float, after_s: float, in_s: float, average: float
) -> None:
    old = toward(as_planned(0), 0, before, 50.0)
    start = round(after_s * S)
    own = old.at(start)[0] + average * in_s
    wanted = required_rate(old, start, own, in_s)
    if not 0.3 < wanted < 3.0:
        return
    new = toward(old, start, wanted, own)
    assert new.arrival_ns(own) == pytest.approx(start + in_s * S, abs=1000)
    assert new.at(start + round(in_s * S))[0] == pytest.approx(own, abs=1e-6)
    # The same wish a little later changes nothing.
    later = start + round(0.3 * in_s * S)
    assert required_rate(new, later, own, 0.7 * in_s) == pytest.approx(wanted, abs=1e-4)


def test_after_its_own_time_the_pace_goes_back_to_the_planned_one() -> None:
    pace = toward(as_planned(0), 0, 1.3, 2.0)
    own, rate, change = pace.at(20 * S)
    assert (rate, change) == pytest.approx((1.0, 0.0), abs=1e-6)
    assert own > 20.0
    assert toward(pace, 21 * S, 0.7, 2.0).target == 1.0


def test_what_is_due_at_once_needs_no_finite_pace() -> None:
    assert required_rate(as_planned(0), S, 2.0, 0.0) == float("inf")
    assert required_rate(as_planned(0), S, 2.0, -1.0) == float("inf")


def test_before_it_begins_an_object_waits_where_it_begins() -> None:
    """A lead makes the own time negative at first; a faster pace shortens the waiting."""
    waiting = np.concatenate((COLUMNS[:, :1], COLUMNS), axis=1)
    waiting[0, 0], waiting[4, 0] = -2.0, 0.0
    waiting[4, 1] = 0.0
    played = play(waiting, toward(as_planned(2 * S), 0, 1.4, 0.5)).columns
    assert (played[0, 0], played[4, 0]) == (0.0, 0.0)
    assert 1.3 < played[0, 1] < 2.0
    assert played[1, 0] == played[1, 1] == COLUMNS[1, 0]
