"""A driver's plan becomes a reference in the map frame, or is refused (METHOD 8.4)."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.geometry import Pose2
from ssp_core.motion.reference import sample
from ssp_core.motion.trajectory import Trajectory
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import BodyState, step_body
from ssp_ot_controller.control.tracker import Tracker
from ssp_ot_controller.driving.plan import MapPlan, fallback_of, plan_of
from tests.support.states import object_state, state_of_body

VECTORS = json.loads((Path(__file__).parent / "plan_vectors.json").read_text())
STEP_S = 0.02
NAMES = [one["name"] for one in (*VECTORS["accepted"], *VECTORS["refused"])]


def trajectory_of(vector: dict[str, Any]) -> Trajectory:
    columns = ([math.nan if v is None else v for v in vector[name]] for name in ("t", "x", "y"))
    return Trajectory(*(tuple(column) for column in columns))


def planned(trajectory: Trajectory, pose: Pose2, stamp_ns: int = 0) -> MapPlan | str:
    return plan_of(trajectory, pose, stamp_ns, STEP_S, "plan-1", "sha256:x")


def accepted(trajectory: Trajectory, pose: Pose2, stamp_ns: int = 0) -> MapPlan:
    plan = planned(trajectory, pose, stamp_ns)
    assert isinstance(plan, MapPlan), plan
    return plan


@pytest.mark.parametrize("vector", VECTORS["accepted"], ids=lambda v: v["name"])
def test_points_in_reference_and_commands_out(vector: dict[str, Any]) -> None:
    plan = accepted(trajectory_of(vector), Pose2(*vector["pose"]))
    for t_s, expected in vector["expect"].items():
        at = sample(plan.reference, round(float(t_s) * 1e9))
        found = (at.x_m, at.y_m, at.yaw_rad, at.speed_mps, at.acceleration_mps2, at.curvature_1pm)
        assert found == pytest.approx(expected, abs=vector["tol"]), t_s
    tracker = Tracker(ObjectClass.CAR, dt_s=STEP_S)
    for t_s, expected in vector["command"].items():
        now_ns = round(float(t_s) * 1e9)
        at = sample(plan.reference, now_ns)
        state = object_state(
            "vut",
            x_m=at.x_m,
            y_m=at.y_m,
            yaw_rad=at.yaw_rad,
            speed_mps=at.speed_mps,
            acceleration_mps2=at.acceleration_mps2,
            yaw_rate_radps=at.speed_mps * at.curvature_1pm,
        )
        command, _ = tracker.track(state, plan.reference, now_ns)
        tolerances = vector.get("command_tol", [1e-6, 1e-6])
        found_command = (command.acceleration_mps2, command.curvature_1pm)
        for value, wanted, within in zip(found_command, expected, tolerances, strict=True):
            assert value == pytest.approx(wanted, abs=within)


@pytest.mark.parametrize("vector", VECTORS["refused"], ids=lambda v: v["name"])
def test_a_plan_that_no_vut_can_drive_is_refused_with_its_value(vector: dict[str, Any]) -> None:
    why = planned(trajectory_of(vector), Pose2(0.0, 0.0, 0.0))
    assert isinstance(why, str)
    assert vector["why"] in why


def test_a_bend_has_the_yaw_and_curvature_of_its_tangent() -> None:
    t = np.arange(31) * 0.1
    angle = 10.0 * t / 50.0
    arc = Trajectory(tuple(t), tuple(50.0 * np.sin(angle)), tuple(50.0 * (1.0 - np.cos(angle))))
    at = sample(accepted(arc, Pose2(0.0, 0.0, 0.0)).reference, 1_500_000_000)
    assert at.yaw_rad == pytest.approx(0.3, abs=2e-3)
    assert at.speed_mps == pytest.approx(10.0, abs=0.02)
    assert at.curvature_1pm == pytest.approx(1.0 / 50.0, abs=2e-3)


def test_a_plan_of_more_points_than_anybody_needs_is_refused_unread() -> None:
    t = tuple(i * 1e-3 for i in range(10_001))
    why = planned(Trajectory(t, t, t), Pose2(0.0, 0.0, 0.0))
    assert why == "10001 points, at most 10000"


@pytest.mark.parametrize(("points_s", "asked_s"), [(0.5, 10.0), (0.1, 0.5)])
def test_a_plan_at_2_hz_through_30_m_of_braking_is_tracked(points_s: float, asked_s: float) -> None:
    """Errors stay within 0.2 m and 0.3 m/s, with a point, or a renewed plan, every 0.5 s."""
    speed, begin_s = 13.0, 2.0
    slows = speed**2 / (2.0 * 30.0)

    def meant_m(t_s: float) -> float:
        brakes_s = min(max(t_s - begin_s, 0.0), speed / slows)
        return speed * (min(t_s, begin_s) + brakes_s) - 0.5 * slows * brakes_s**2

    times = tuple(points_s * k for k in range(round(8.0 / points_s) + 1))
    body = BodyState(0.0, 0.0, 0.0, speed_mps=speed)
    tracker = Tracker(ObjectClass.CAR, dt_s=STEP_S)
    off = []
    for step in range(round(7.5 / STEP_S)):
        now_s, now_ns = step * STEP_S, round(step * STEP_S * 1e9)
        if step % round(asked_s / STEP_S) == 0:
            ahead = tuple(meant_m(now_s + t) - body.x_m for t in times)
            ego = Trajectory(times, ahead, (0.0,) * len(times))
            plan = accepted(ego, Pose2(body.x_m, body.y_m, body.yaw_rad), now_ns)
        command, _ = tracker.track(state_of_body(body, now_ns, "vut"), plan.reference, now_ns)
        at = sample(plan.reference, now_ns)
        off.append((abs(body.x_m - at.x_m), abs(body.speed_mps - at.speed_mps)))
        body = step_body(ObjectClass.CAR, body, command, STEP_S)
    worst_m, worst_mps = np.array(off).max(axis=0)
    assert (worst_m <= 0.2, worst_mps <= 0.3) == (True, True), (worst_m, worst_mps)
    assert body.x_m == pytest.approx(speed * begin_s + 30.0, abs=0.3)


@pytest.mark.parametrize(("points_s", "asked_s"), [(0.5, 2.0), (0.1, 0.1), (0.1, 0.4)])
def test_a_plan_through_a_bend_is_tracked(points_s: float, asked_s: float) -> None:
    """The cubic's curvature jumps at its points; a VUT that is led by it doesn't swing.

    Each plan begins beside the VUT, on the lane: straight on, then a bend of 11.5 m radius.
    """
    speed, radius_m, begins_m = 5.0, 11.5, 15.0

    def lane(station_m: float) -> tuple[float, float]:
        angle = max(station_m - begins_m, 0.0) / radius_m
        along = min(station_m, begins_m) + radius_m * math.sin(angle)
        return along, radius_m * (1.0 - math.cos(angle))

    def beside(x_m: float, y_m: float) -> tuple[float, float]:
        if x_m <= begins_m:
            return x_m, y_m
        to_middle = math.hypot(x_m - begins_m, radius_m - y_m)
        turned = math.atan2(x_m - begins_m, radius_m - y_m)
        return begins_m + radius_m * turned, radius_m - to_middle

    times = tuple(points_s * k for k in range(round(5.0 / points_s) + 1))
    body = BodyState(0.0, 0.0, 0.0, speed_mps=speed)
    tracker, off = Tracker(ObjectClass.CAR, dt_s=STEP_S), []
    for step in range(round(6.0 / STEP_S)):
        now_ns = round(step * STEP_S * 1e9)
        station_m, off_m = beside(body.x_m, body.y_m)
        off.append(off_m)
        if step % round(asked_s / STEP_S) == 0:
            pose = Pose2(body.x_m, body.y_m, body.yaw_rad)
            places = [pose.to_local(*lane(station_m + speed * t)) for t in times]
            x, y = zip(*places, strict=True)
            plan = accepted(Trajectory(times, x, y), pose, now_ns)
        command, _ = tracker.track(state_of_body(body, now_ns, "vut"), plan.reference, now_ns)
        body = step_body(ObjectClass.CAR, body, command, STEP_S)
    assert np.abs(off).max() < 0.1


def test_without_a_plan_the_vut_decelerates_at_2_straight_on() -> None:
    reference = fallback_of(Pose2(5.0, 1.0, 0.0), 10.0, 0, STEP_S, "sha256:x")
    at = sample(reference, 2_000_000_000)
    assert (at.x_m, at.y_m, at.speed_mps) == pytest.approx((5.0 + 16.0, 1.0, 6.0), abs=1e-6)
    assert sample(reference, 9_000_000_000).speed_mps == 0.0
    assert sample(reference, 9_000_000_000).x_m == pytest.approx(30.0, abs=1e-3)


numbers = st.floats(allow_nan=True, allow_infinity=True)
columns = st.lists(numbers, max_size=6)


@given(columns, columns, columns)
def test_whatever_a_driver_answers_is_a_finite_reference_or_a_reason(
    t: list[float], x: list[float], y: list[float]
) -> None:
    plan = planned(Trajectory(tuple(t), tuple(x), tuple(y)), Pose2(0.0, 0.0, 0.0))
    if isinstance(plan, str):
        assert plan
    else:
        assert np.isfinite(plan.reference.columns).all()
        assert (np.diff(plan.reference.columns[0]) > 0.0).all()
        assert plan.reference.points[-1].speed_mps == 0.0
