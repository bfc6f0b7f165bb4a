"""The control that copies its history as its future: the last movement, mirrored forward.

The plan at τ is the history's position at −τ with x mirrored: x(τ) = −x(−τ), y(τ) = y(−τ), linear
between samples. On a straight line or a circle at constant speed that is the motion going on; a VUT
that has been braking speeds up again as it slowed down. A model that does no better than this
has said nothing that its history didn't say.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from ssp_vla_bridge.backends.phrases import action_sentence
from ssp_vla_bridge.backends.plan import (
    SIDEWAYS_M,
    STOPPED_MPS,
    TREND_MPS2,
    point_times,
    waypoints,
)
from ssp_vla_bridge.core.backend import check_options
from ssp_vla_bridge.core.request import EgoSample, Request
from ssp_vla_bridge.core.response import Answer
from ssp_vla_bridge.core.trajectory import Trajectory, interpolate

_STEP_S = 0.5  # of the actions of METHOD 6.6


class CopyHistory:
    """Frames are never looked at; the text tells the plan's own action and nothing else."""

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


def make(options: Mapping[str, Any]) -> CopyHistory:
    """Raises InputError: it has no options."""
    check_options("copy_history", options, {})
    return CopyHistory()
