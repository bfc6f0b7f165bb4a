"""The blind baseline: goes on as it went, and speaks of nothing but its own action."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ssp_vla_bridge.backends.phrases import action_sentence
from ssp_vla_bridge.backends.plan import (
    SIDEWAYS_M,
    STOPPED_MPS,
    TREND_MPS2,
    circle_point,
    point_times,
    waypoints,
)
from ssp_vla_bridge.core.backend import check_options
from ssp_vla_bridge.core.request import EgoSample, Request
from ssp_vla_bridge.core.response import Answer

TREND_S = 1.0  # span of history that the trend of the speed is taken from


class ConstantVelocity:
    """Speed and yaw rate of the last history sample, held; frames are never looked at.

    The text tells the action that the history shows (a VUT that has been braking says that it
    slows down), while the trajectory holds the speed, as the name says.
    """

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
    """Slope of the least-squares line through the speeds of the last TREND_S, m/s²; 0 if short."""
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


def make(options: Mapping[str, Any]) -> ConstantVelocity:
    """Raises InputError: it has no options."""
    check_options("constant_velocity", options, {})
    return ConstantVelocity()
