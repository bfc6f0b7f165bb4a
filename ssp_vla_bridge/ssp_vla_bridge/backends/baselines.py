"""Blind baselines, which never look at a frame: silent, constant velocity, and copied history."""

from __future__ import annotations

from ssp_vla_bridge.backend import OptionFree
from ssp_vla_bridge.backends.phrases import (
    SIDEWAYS_M,
    STOPPED_MPS,
    TREND_MPS2,
    action_sentence,
    circle_point,
    point_times,
    waypoints,
)
from ssp_vla_bridge.messages import Answer, EgoSample, Request
from ssp_vla_bridge.trajectory import Trajectory, interpolate


class Silent(OptionFree):
    """Must score 0 in every metric that isn't null."""

    name = "silent"
    model_id = "ssp/silent/1"

    def answer(self, _request: Request) -> Answer:
        return Answer("")


TREND_S = 1.0  # span of history that the trend of the speed is taken from


class ConstantVelocity(OptionFree):
    """Speed and yaw rate of the last history sample, held; frames are never looked at.

    The text tells the action that the history shows (a VUT that has been braking says that it
    slows down), while the trajectory holds the speed, as the name says.
    """

    name = "constant_velocity"
    model_id = "ssp/constant_velocity/1"

    def answer(self, request: Request) -> Answer:
        decoding = {"trend_s": TREND_S}
        if not request.ego_known:
            return Answer("My own motion is not known to me, so I can't plan.", decoding=decoding)
        now = request.history[-1]
        curvature = now.yaw_rate_radps / now.speed_mps if abs(now.speed_mps) > 0.1 else 0.0
        points = [
            circle_point(now.speed_mps * time_s, curvature) for time_s in point_times(request.task)
        ]
        _, after_1s_m = circle_point(now.speed_mps, curvature)
        text = action_sentence(_lon_action(request.history), _lat_action(after_1s_m))
        return Answer(text, (waypoints(points, request.task),), decoding)


def speed_trend_mps2(history: tuple[EgoSample, ...]) -> float:
    """Return the slope of the line fitted to the last TREND_S of speeds, m/s²; 0 if short."""
    recent = [sample for sample in history if sample.t_s >= history[-1].t_s - TREND_S - 1e-9]
    mean_t = sum(sample.t_s for sample in recent) / len(recent)
    mean_v = sum(sample.speed_mps for sample in recent) / len(recent)
    spread = sum((sample.t_s - mean_t) ** 2 for sample in recent)
    if spread < 1e-6:
        return 0.0
    return sum((s.t_s - mean_t) * (s.speed_mps - mean_v) for s in recent) / spread


def _lon_action(history: tuple[EgoSample, ...]) -> str:
    if history[-1].speed_mps <= STOPPED_MPS:
        return "stop"
    trend = speed_trend_mps2(history)
    if trend <= -TREND_MPS2:
        return "decelerate"
    return "accelerate" if trend >= TREND_MPS2 else "maintain"


def _lat_action(left_m: float) -> str:
    if abs(left_m) < SIDEWAYS_M:
        return "straight"
    return "left" if left_m > 0 else "right"


_STEP_S = 0.5  # of the actions of METHOD 6.6


class CopyHistory(OptionFree):
    """A blind baseline: its plan repeats the vehicle's own past motion, mirrored into the future.

    Its text states the action of that plan and nothing else.
    """

    name = "copy_history"
    model_id = "ssp/copy_history/1"

    def answer(self, request: Request) -> Answer:
        times_s = point_times(request.task)
        end_s = max(times_s[-1], 2.0 * _STEP_S)
        if not request.ego_known:
            return Answer("My own motion is not known to me, so I can't repeat it.")
        past = _mirrored(request.history)
        if len(past.t_s) < 2 or past.t_s[0] > 0.0 or past.t_s[-1] < end_s - 1e-9:
            return Answer(f"I know less than the last {end_s:g} s of my motion to repeat.")
        points = [interpolate(past, time_s) for time_s in times_s]
        return Answer(_action_text(past), (waypoints(points, request.task),))


def _mirrored(history: tuple[EgoSample, ...]) -> Trajectory:
    samples = history[::-1]
    return Trajectory(
        tuple(-sample.t_s for sample in samples),
        tuple(-sample.x_m for sample in samples),
        tuple(sample.y_m for sample in samples),
    )


def _action_text(plan: Trajectory) -> str:
    (x0, y0), (x1, _), (x2, y2) = (interpolate(plan, k * _STEP_S) for k in range(3))
    v1, v2 = (x1 - x0) / _STEP_S, (x2 - x1) / _STEP_S
    change = (v2 - v1) / _STEP_S
    lon, lat = "maintain", "straight"
    if v2 <= STOPPED_MPS:
        lon = "stop"
    elif abs(change) >= TREND_MPS2:
        lon = "decelerate" if change < 0.0 else "accelerate"
    if abs(y2 - y0) >= SIDEWAYS_M:
        lat = "left" if y2 > y0 else "right"
    return action_sentence(lon, lat)
