"""The plain form for models without one of their own: a text, and points in our own frame."""

from __future__ import annotations

import math
from collections.abc import Mapping

from ssp_vla_bridge.core.prompts.shared import (
    UNKNOWN_PAST,
    actions_sentence,
    critical_sentence,
    demand_sentence,
    frames_sentence,
    objects_sentence,
    paragraphs,
    placeholders,
)
from ssp_vla_bridge.core.prompts.types import Prompt, Stage
from ssp_vla_bridge.core.request import Request

_TOLERANCE = 1e-9


def _answer(request: Request, _: Mapping[str, str]) -> Prompt:
    task = request.task
    count = math.floor(task.trajectory_horizon_s / task.trajectory_step_s + _TOLERANCE)
    text = paragraphs(
        frames_sentence(request),
        task.instruction,
        objects_sentence(task),
        critical_sentence(task),
        actions_sentence(task),
        "Positions are [x, y] in metres, seen from your vehicle: x is forward, y is to the left, "
        "and your vehicle is at [0, 0] now.",
        _past(request),
        f"{demand_sentence(task)} That is {count} points, the first one "
        f"{task.trajectory_step_s:g} s from now.",
        "Write the text first, in plain English, and end with one line in the form",
        f"Trajectory: [{placeholders('[x{i}, y{i}]', count)}]",
    )
    return Prompt(text)


def _past(request: Request) -> str:
    if not request.ego_known:
        return UNKNOWN_PAST
    rows = ", ".join(
        f"[{s.t_s:.1f}, {s.x_m + 0.0:.2f}, {s.y_m + 0.0:.2f}, {s.speed_mps + 0.0:.2f}]"
        for s in request.history
    )
    return (
        "Your vehicle's past as [time in s, x, y, speed in m/s], oldest first, with 0 as the time "
        f"now: {rows}."
    )


WAYPOINTS = (Stage("motion", _answer),)
