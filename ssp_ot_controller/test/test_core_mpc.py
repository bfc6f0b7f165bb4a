"""Model-predictive tracking: as accurate as the regulators, and within the limits."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ssp_core.errors import HostError
from ssp_core.geometry import FloatArray, Polyline
from ssp_core.manoeuvre_points import drive_along, lane_change
from ssp_core.reference import Reference, sample
from ssp_core.state import DEFAULT_SIZES, ObjectState
from ssp_core.vocab import ObjectClass, Role
from ssp_ot_controller.core.bodies import LIMITS, BodyState, Command, step_body
from ssp_ot_controller.core.gains import DEFAULT_GAINS
from ssp_ot_controller.core.mpc import MpcTracker
from ssp_ot_controller.core.trackers import make_tracker
from ssp_ot_controller.core.tracking import Tracker

DT_S, DT_NS = 0.02, 20_000_000
STRAIGHT = Polyline([(0.0, 0.0), (200.0, 0.0)])
CAR = ObjectClass.CAR


def reference(points: Any) -> Reference:
    return Reference("r", "ot", "v", "approach", 0, 0, 10**12, points)


def observed(body: BodyState, now_ns: int, cls: ObjectClass = CAR) -> ObjectState:
    return ObjectState(
        "ot", cls, Role.OT, now_ns, body.x_m, body.y_m, body.yaw_rad, body.speed_mps,
        body.acceleration_mps2, body.yaw_rate_radps, DEFAULT_SIZES[cls],
    )  # fmt: skip


def closed_loop(
    tracker: Tracker, body: BodyState, ref: Reference, seconds: float, cls: ObjectClass = CAR
) -> tuple[FloatArray, list[Command]]:
    """Longitudinal and lateral errors, shape (n, 2), and the commands."""
    errors, commands = [], []
    for k in range(round(seconds / DT_S)):
        command, e = tracker.track(observed(body, k * DT_NS, cls), ref, k * DT_NS)
        errors.append((e.longitudinal_m, e.lateral_m))
        commands.append(command)
        body = step_body(cls, body, command, DT_S)
    return np.array(errors), commands


CHANGE = reference(lane_change(STRAIGHT, 10.0, 13.0, 3.5, 2.5, 13.0, 2.0))


def test_it_follows_a_lane_change() -> None:
    tracker = MpcTracker(CAR, dt_s=DT_S)
    errors, _ = closed_loop(tracker, BodyState(10.0, 0.0, 0.0, 13.0), CHANGE, 5.0)
    rms = np.sqrt((errors**2).mean(axis=0))
    assert rms[0] <= 0.05
    assert rms[1] <= 0.02
    assert tracker.fallbacks == 0


def test_where_no_limit_is_in_reach_it_is_the_regulator() -> None:
    """Off a straight reference at steady speed there is nothing ahead that the two treat apart."""
    ref = reference(drive_along(STRAIGHT, 0.0, 0.0, 10.0, 2.0, 2.0))
    gains = replace(DEFAULT_GAINS, acceleration_weight=1.0, plan_weight=1.0)
    plain, mpc = Tracker(CAR, gains=gains), MpcTracker(CAR, gains=gains)
    now_ns = 9_000_000_000
    at = sample(ref, now_ns)
    for ahead_m, left_m, faster_mps in ((0.3, 0.1, 0.0), (-0.5, -0.2, 0.4), (0.0, 0.3, -0.3)):
        body = BodyState(at.x_m + ahead_m, left_m, 0.01, at.speed_mps + faster_mps)
        a, _ = plain.track(observed(body, now_ns), ref, now_ns)
        b, _ = mpc.track(observed(body, now_ns), ref, now_ns)
        assert b.acceleration_mps2 == pytest.approx(a.acceleration_mps2, abs=1e-3)
        assert b.curvature_1pm == pytest.approx(a.curvature_1pm, rel=0.02, abs=1e-5)


def test_it_plans_within_the_limits_of_its_body() -> None:
    """Far off, at speed: both ask for all that there is, and no more."""
    tracker = MpcTracker(CAR, dt_s=DT_S)
    body = BodyState(-10.0, 6.0, 0.0, 13.0)
    _, commands = closed_loop(tracker, body, CHANGE, 2.0)
    limits = LIMITS[CAR]
    grip = limits.lateral_acceleration_mps2 / 12.0**2
    assert max(abs(c.curvature_1pm) for c in commands) <= grip * 1.2
    assert max(c.acceleration_mps2 for c in commands) <= limits.acceleration_mps2 + 1e-6
    assert min(c.acceleration_mps2 for c in commands) >= -limits.deceleration_mps2 - 1e-6
    assert tracker.fallbacks == 0


def test_without_a_plan_the_regulators_command_is_taken_and_counted(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("ssp_ot_controller.core.mpc._Problem.plan", lambda *_: None)
    tracker, plain = MpcTracker(CAR, dt_s=DT_S), Tracker(CAR, dt_s=DT_S)
    body = BodyState(12.0, 0.2, 0.0, 13.0)
    for k in range(5):
        state = observed(body, k * DT_NS)
        assert tracker.track(state, CHANGE, k * DT_NS) == plain.track(state, CHANGE, k * DT_NS)
    assert tracker.fallbacks == 5
    assert plain.fallbacks == 0


def test_a_problem_without_numbers_has_no_plan() -> None:
    tracker = MpcTracker(CAR, dt_s=DT_S)
    body = BodyState(12.0, 0.2, 0.0, 13.0, float("nan"))
    command, _ = tracker.track(observed(body, 0), CHANGE, 0)
    assert tracker.fallbacks == 1
    assert not np.isfinite(command.acceleration_mps2)  # Target doesn't ask for such a state


def test_the_same_state_gives_the_same_command_whatever_came_before() -> None:
    fresh, used = MpcTracker(CAR, dt_s=DT_S), MpcTracker(CAR, dt_s=DT_S)
    closed_loop(used, BodyState(10.0, 0.5, 0.0, 12.0), CHANGE, 1.0)
    state = observed(BodyState(30.0, 0.4, 0.02, 13.0), 60 * DT_NS)
    assert fresh.track(state, CHANGE, 60 * DT_NS) == used.track(state, CHANGE, 60 * DT_NS)


def test_a_walker_walks_as_ever() -> None:
    cls = ObjectClass.PEDESTRIAN
    ref = reference(drive_along(Polyline([(0.0, 0.0), (6.0, 0.0)]), 0.0, 0.0, 1.4, 1.5, 1.5))
    errors = [
        closed_loop(make_tracker(kind, cls), BodyState(0.0, 0.0, 0.0), ref, 3.0, cls)[0]
        for kind in ("lqr", "mpc")
    ]
    assert (errors[0] == errors[1]).all()


def test_a_missing_package_is_said_at_the_start(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "osqp", None)
    with pytest.raises(HostError, match="osqp"):
        make_tracker("mpc", CAR)
    make_tracker("lqr", CAR)
