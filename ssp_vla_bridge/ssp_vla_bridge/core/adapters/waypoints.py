"""The adapter ``waypoints``: rows (x_m, y_m) in the ego frame at a fixed step."""

from __future__ import annotations

import math
from dataclasses import replace

from ssp_vla_bridge.core.adapters.answer import Form, choose_answer
from ssp_vla_bridge.core.adapters.limit import motion_is_cut
from ssp_vla_bridge.core.adapters.points import adapt_points
from ssp_vla_bridge.core.adapters.types import Adapted, AdapterInfo, without_trajectory
from ssp_vla_bridge.core.native_history import waypoints_history
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import NativeArray, Response
from ssp_vla_bridge.core.task import TASK
from ssp_vla_bridge.core.trajectory import TOLERANCE_S

ARRAY_NAME = "trajectory"
FRAME = "ego_xy"
_SHORTEST_STEP_S = 0.01  # as in request.request_problems
_INFO = AdapterInfo("waypoints", FRAME)
_FORM = Form(
    rows=0,  # by the task
    names=(frozenset({"x", "forward"}), frozenset({"y", "left"})),
    units=frozenset({"m", "meter", "meters", "metre", "metres"}),
    label="trajectory",
    usual=frozenset({"square brackets", "a nested list"}),
)


def adapt_waypoints(
    response: Response, request: Request | None = None, mode: str = FRAME
) -> Adapted:
    """Reads the array ``trajectory``: frame ``ego_xy``, unit m, shape (n, 2), constant step.

    A first row one step after t = 0 gets the frame's origin before it, marked (METHOD 5.4). A
    wrong frame, unit, shape or number of arrays is a trajectory that can't be read: ``shape``.

    Without such an array, the text is read: ``Trajectory: [[x, y], …]`` in the same frame and unit,
    at the task's step, the first point one step after t = 0.

    Args:
        response: raw.
        request: that it answers, whose task declares the step; None: that of TASK.
        mode: there is one.
    """
    arrays = [array for array in response.arrays if array.name == ARRAY_NAME]
    if response.error_code:
        return _without(response, "missing", "")
    if not arrays:
        return _read_text(response, request)
    if len(arrays) > 1:
        return _without(response, "shape", f"{len(arrays)} arrays are named {ARRAY_NAME}")
    return _read(response, arrays[0])


def _read(response: Response, array: NativeArray) -> Adapted:
    if array.frame != FRAME or array.unit != "m":
        return _without(response, "shape", f"frame {array.frame!r} in {array.unit!r} is not read")
    rows = array.shape[0] if len(array.shape) == 2 else -1
    if rows < 1 or array.shape[1:] != (2,) or len(array.data) != 2 * rows:
        return _without(
            response, "shape", f"{len(array.data)} values of shape {array.shape} are no (n, 2)"
        )
    if not (math.isfinite(array.step_s) and math.isfinite(array.first_time_s)):
        return _without(response, "timestamps", "step or first time isn't finite")
    xs, ys = array.data[0::2], array.data[1::2]
    return adapt_points(response, _INFO, xs, ys, array.step_s, array.first_time_s)


def _read_text(response: Response, request: Request | None) -> Adapted:
    """The list behind ``Trajectory:``, whose step and first time the task declares."""
    task = TASK if request is None else request.task
    history = () if request is None else waypoints_history(request).rows
    step_s = task.trajectory_step_s
    horizon_s = task.trajectory_horizon_s
    if not (math.isfinite(horizon_s) and _SHORTEST_STEP_S <= step_s <= horizon_s):
        return _without(response, "timestamps", "the task's trajectory step is no time")
    form = replace(_FORM, rows=math.floor(horizon_s / step_s + TOLERANCE_S))
    choice = choose_answer(response.text, form, history, motion_is_cut(response))
    if choice.reason:
        note = f"no array is named {ARRAY_NAME}"
        return replace(
            _without(response, choice.reason, note),
            info=replace(_INFO, notes=(note, *choice.notes)),
        )
    info = replace(_INFO, notes=("the trajectory was read from the text", *choice.notes))
    xs, ys = zip(*choice.rows, strict=True)
    return adapt_points(response, info, xs, ys, step_s, step_s)


def _without(response: Response, reason: str, note: str) -> Adapted:
    return without_trajectory(response, _INFO, reason, note)
