"""Closed loops of tracker and plant: accuracy, standstill, recovery."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pytest

from ssp_core.geometry import FloatArray, Polyline
from ssp_core.motion.manoeuvre import drive_along, lane_change
from ssp_core.motion.reference import Reference, ReferencePoint, sample
from ssp_core.motion.state import ObjectState
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.bodies.dynamics import LIMITS, BodyState, Command, step_body
from ssp_ot_controller.control.tracker import Tracker, lateral_gains, tracking_error
from tests.support.states import make_reference, state_of_body

DT = 0.02
DT_NS = 20_000_000
STRAIGHT = Polyline([(0.0, 0.0), (300.0, 0.0)])
CAR, CYCLIST, WALKER = ObjectClass.CAR, ObjectClass.CYCLIST, ObjectClass.PEDESTRIAN


@dataclass(frozen=True)
class Run:
    """Errors and states of one closed loop, one row per step."""

    longitudinal_m: FloatArray
    lateral_m: FloatArray
    yaw_rad: FloatArray
    speed_mps: FloatArray
    end: BodyState


def closed_loop(
    cls: ObjectClass, body: BodyState, ref: Reference, extra_s: float = 2.0, lag_scale: float = 1.0
) -> Run:
    tracker = Tracker(cls, dt_s=DT)
    rows = []
    for k in range(round((ref.points[-1].t_s + extra_s) / DT)):
        now_ns = k * DT_NS
        command, e = tracker.track(state_of_body(body, now_ns, object_class=cls), ref, now_ns)
        rows.append((e.longitudinal_m, e.lateral_m, e.yaw_rad, body.speed_mps))
        body = step_body(cls, body, command, DT, lag_scale=lag_scale)
    columns = np.array(rows).T
    return Run(columns[0], columns[1], columns[2], columns[3], body)


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


@pytest.mark.parametrize("speed_mps", [11.0, 12.5, 14.0])
@pytest.mark.parametrize("shift_m", [3.5, -3.5])
def test_lane_change_is_tracked(speed_mps: float, shift_m: float) -> None:
    ref = make_reference(lane_change(STRAIGHT, 10.0, speed_mps, shift_m, 2.5, speed_mps, 2.0))
    run = closed_loop(CAR, BodyState(10.0, 0.0, 0.0, speed_mps), ref)
    assert rms(run.lateral_m[:150]) <= 0.005
    assert rms(run.longitudinal_m) <= 0.02
    assert np.abs(run.lateral_m).max() <= 0.02
    assert np.abs(run.yaw_rad).max() <= 0.02


def test_lane_change_with_a_slow_actuator_stays_within_the_target() -> None:
    ref = make_reference(lane_change(STRAIGHT, 10.0, 14.0, 3.5, 2.5, 11.0, 2.0))
    run = closed_loop(CAR, BodyState(10.0, 0.0, 0.0, 14.0), ref, lag_scale=2.0)
    assert 0.005 < rms(run.lateral_m[:150]) <= 0.05
    assert rms(run.longitudinal_m) <= 0.10


@pytest.mark.parametrize(
    ("cls", "cruise_mps", "accel_mps2"), [(CAR, 13.9, 2.0), (CYCLIST, 5.0, 1.0), (WALKER, 1.4, 1.5)]
)
def test_start_from_standstill_and_stop_are_tracked(
    cls: ObjectClass, cruise_mps: float, accel_mps2: float
) -> None:
    length = 250.0 if cls is CAR else 20.0
    path = Polyline([(0.0, 0.0), (length, 0.0)])
    ref = make_reference(drive_along(path, 0.0, 0.0, cruise_mps, accel_mps2, accel_mps2))
    run = closed_loop(cls, BodyState(0.0, 0.0, 0.0), ref)
    assert rms(run.longitudinal_m) <= 0.02
    assert run.end.x_m == pytest.approx(length, abs=0.05)
    assert run.end.speed_mps == 0.0


def test_an_arc_is_tracked() -> None:
    a = np.linspace(0.0, math.pi / 2.0, 80)
    arc = Polyline(np.stack((30.0 * np.sin(a), 30.0 - 30.0 * np.cos(a)), axis=1))
    run = closed_loop(
        CAR, BodyState(0.0, 0.0, 0.0), make_reference(drive_along(arc, 0, 0, 8, 2, 2))
    )
    assert rms(run.lateral_m) <= 0.05
    assert rms(run.longitudinal_m) <= 0.10


@pytest.mark.parametrize("cls", [CAR, CYCLIST, WALKER])
def test_at_the_end_it_stands_still_and_does_not_oscillate(cls: ObjectClass) -> None:
    path = Polyline([(0.0, 0.0), (15.0, 0.0)])
    ref = make_reference(drive_along(path, 0.0, 0.0, 1.2, 1.0, 1.0))
    run = closed_loop(cls, BodyState(0.3, 0.1, 0.05), ref, extra_s=5.0)
    standing = run.speed_mps[-round(4.0 / DT) :]
    assert (standing == 0.0).all()
    assert (np.diff(run.longitudinal_m[-round(4.0 / DT) :]) == 0.0).all()


def test_a_car_beside_its_reference_comes_back_without_swinging() -> None:
    ref = make_reference(drive_along(STRAIGHT, 0.0, 10.0, 10.0, 2.0, 2.0))
    run = closed_loop(CAR, BodyState(-1.0, 0.5, 0.0, 10.0), ref)
    assert np.abs(run.lateral_m[200:]).max() < 0.02
    assert run.lateral_m.min() > -0.1
    assert np.abs(run.longitudinal_m[300:]).max() < 0.05


def test_a_dummy_looking_elsewhere_turns_and_catches_up() -> None:
    path = Polyline([(0.0, 0.0), (0.0, 8.0)])
    run = closed_loop(
        WALKER, BodyState(0.0, 0.0, 0.0), make_reference(drive_along(path, 0, 0, 1.4, 1.5, 1.5))
    )
    assert np.abs(run.lateral_m).max() < 0.1
    assert (run.end.x_m, run.end.y_m) == pytest.approx((0.0, 8.0), abs=0.05)


def test_before_its_time_a_standing_reference_is_held() -> None:
    ref = make_reference(drive_along(STRAIGHT, 0.0, 0.0, 10.0, 2.0, 2.0), execute_at_ns=10**9)
    command, _ = Tracker(CAR).track(state_of_body(BodyState(0.0, 0.0, 0.0), 0), ref, 0)
    assert command.acceleration_mps2 < 0.0


def braked(command: Callable[[ObjectState, int], Command], body: BodyState) -> BodyState:
    for k in range(round(6.0 / DT)):
        now_ns = 10**9 + k * DT_NS
        body = step_body(CAR, body, command(state_of_body(body, now_ns), now_ns), DT)
    return body


def test_braking_on_the_reference_stays_on_its_path() -> None:
    ref = make_reference(lane_change(STRAIGHT, 10.0, 12.0, 3.5, 2.5, 12.0, 2.0))
    p = sample(ref, 10**9)
    body = BodyState(
        p.x_m, p.y_m, p.yaw_rad, p.speed_mps, 0.0, p.curvature_1pm, p.speed_mps * p.curvature_1pm
    )
    tracker = Tracker(CAR)
    end = braked(lambda state, now_ns: tracker.brake(state, ref, now_ns, 4.0), body)
    assert end.speed_mps == 0.0
    station = np.array([q.x_m for q in ref.points])
    beside = float(np.interp(end.x_m, station, [q.y_m for q in ref.points]))
    assert end.y_m == pytest.approx(beside, abs=0.15)


def test_error_signs() -> None:
    point = ReferencePoint(0.0, 0.0, 0.0, math.pi / 2, 1.0, 0.0, 0.0)
    e = tracking_error(state_of_body(BodyState(-0.5, 2.0, math.pi / 2 + 0.1), 0), point)
    assert (e.longitudinal_m, e.lateral_m) == pytest.approx((2.0, 0.5))
    assert e.yaw_rad == pytest.approx(0.1)


@pytest.mark.parametrize("cls", [CAR, ObjectClass.TRUCK, ObjectClass.BUS, CYCLIST])
def test_the_gains_are_stable_at_every_speed(cls: ObjectClass) -> None:
    lag = LIMITS[cls].curvature_lag_s
    share = -math.expm1(-DT / lag)
    for v, k in zip(*lateral_gains(lag, DT), strict=True):
        s = v * DT
        a = np.array([[1.0, s, 0.5 * s * s], [0.0, 1.0, s], [0.0, 0.0, 1.0 - share]])
        loop = a - np.array([[0.0], [0.0], [share]]) @ k[None, :]
        assert np.abs(np.linalg.eigvals(loop)).max() < 0.999


def test_tracking_is_a_function_of_its_arguments() -> None:
    ref = make_reference(drive_along(STRAIGHT, 0.0, 0.0, 10.0, 2.0, 2.0))
    tracker = Tracker(CAR)
    state = state_of_body(BodyState(1.0, 0.2, 0.01, 3.0), 2 * 10**9)
    first = tracker.track(state, ref, 2 * 10**9)
    tracker.track(state_of_body(BodyState(5.0, -1.0, 0.3, 9.0), 10**9), ref, 10**9)
    assert tracker.track(state, ref, 2 * 10**9) == first
