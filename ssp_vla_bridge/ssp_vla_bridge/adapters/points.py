"""LLaViDA, Alpamayo and the plain interface ``waypoints``: lists of points."""

from __future__ import annotations

import ast
import math
import re
from collections.abc import Sequence
from dataclasses import replace

from ssp_vla_bridge.adapters.adapted import (
    AdaptedResponse,
    AdapterInfo,
    motion_is_cut,
    without_trajectory,
)
from ssp_vla_bridge.adapters.answer import FROM_ORIGIN, Choice, Form, choose_answer
from ssp_vla_bridge.adapters.stated import POINTS, POINTS_RIGHT_FIRST
from ssp_vla_bridge.messages import TASK, NativeArray, Request, Response
from ssp_vla_bridge.native_history import LLAVIDA_POINTS, STEP_S, llavida_history, waypoints_history
from ssp_vla_bridge.trajectory import TOLERANCE_S, Trajectory, check_trajectory

# METHOD 5.4b, Origin: how far from the vehicle a plan may begin.
_NOTED_M = 0.5
_LEAST_M = 3.0
_WAYS = 1.5
_UNKNOWN_SPEED_MPS = 25.0
_FIRST_TIME = "first_time_s says when the first point is meant"


def adapt_points(
    response: Response,
    info: AdapterInfo,
    xs_m: Sequence[float],
    ys_m: Sequence[float],
    times_s: Sequence[float],
    request: Request | None,
    declared_step_s: float,
) -> AdaptedResponse:
    """Return the trajectory of points, with the origin before a start one step late.

    Args:
        response: whose text is kept.
        info: the adapter's name, mode and notes; further ones are added.
        xs_m: forward, m.
        ys_m: to the left, m.
        times_s: of the points after the record's time, s, finite.
        request: whose history gives the present speed, by which the first point is judged.
        declared_step_s: the step of a plan of one point, whose times don't give it.
    """
    times, xs, ys = tuple(times_s), tuple(xs_m), tuple(ys_m)
    step_s = times[1] - times[0] if len(times) > 1 else declared_step_s
    if not times:
        step_s = 0.0
    problem, note = _start(times, xs, ys, step_s, present_speed_mps(request))
    if problem or note:
        info = replace(info, notes=(*info.notes, problem or note))
    if problem:
        return AdaptedResponse(response.text, None, ("shape",), info)
    origin_added = step_s > 0 and abs(times[0] - step_s) <= TOLERANCE_S
    if origin_added:
        times, xs, ys = (0.0, *times), (0.0, *xs), (0.0, *ys)
    trajectory = Trajectory(times, xs, ys)
    invalid = check_trajectory(trajectory)
    info = replace(info, origin_added=origin_added)
    return AdaptedResponse(response.text, None if invalid else trajectory, invalid, info)


def present_speed_mps(request: Request | None) -> float | None:
    """Return the VUT's speed at the request's time by its history, None where that isn't known."""
    samples = request.history if request is not None and request.ego_known else ()
    if not samples:
        return None
    speed_mps = abs(samples[-1].speed_mps)
    if len(samples) > 1:
        before, last = samples[-2:]
        step_s = last.t_s - before.t_s
        way_m = math.hypot(last.x_m - before.x_m, last.y_m - before.y_m)
        speed_mps = max(speed_mps, way_m / step_s if step_s > 0 else 0.0)
    return speed_mps if math.isfinite(speed_mps) else None


def _start(
    times_s: Sequence[float],
    xs_m: Sequence[float],
    ys_m: Sequence[float],
    step_s: float,
    speed_mps: float | None,
) -> tuple[str, str]:
    """Say why a plan doesn't begin at the vehicle, and what is to be noted of its beginning."""
    if not times_s or not xs_m or not ys_m:
        return "", ""
    away_m, first_s = math.hypot(xs_m[0], ys_m[0]), times_s[0]
    if not (math.isfinite(away_m) and math.isfinite(first_s) and step_s > 0):
        return "", ""
    speed = _UNKNOWN_SPEED_MPS if speed_mps is None else speed_mps
    if abs(first_s) <= TOLERANCE_S:
        if away_m > max(_LEAST_M, speed * step_s):
            return f"at t = 0 the plan is {away_m:.1f} m away from the vehicle; {_FIRST_TIME}", ""
        near = away_m <= _NOTED_M
        return "", "" if near else f"at t = 0 the plan is {away_m:.1f} m away from the vehicle"
    most_m = _LEAST_M + _WAYS * speed * max(0.0, first_s)
    if away_m > most_m:
        where = f"{away_m:.1f} m away from the vehicle at {first_s:g} s, limit {most_m:.1f} m"
        return f"the plan's first point is {where}; {_FIRST_TIME}", ""
    return "", ""


def _raster(count: int, first_time_s: float, step_s: float) -> tuple[float, ...]:
    return tuple(first_time_s + k * step_s for k in range(count))


def _times_of(choice: Choice, step_s: float) -> tuple[float, ...]:
    """Return times of a list's rows: as stated, from the origin, or from one step after t = 0."""
    if choice.times_s == FROM_ORIGIN:
        return _raster(len(choice.rows), 0.0, step_s)
    return choice.times_s or _raster(len(choice.rows), step_s, step_s)


LLAVIDA_FRAME = "lateral_forward"

_LLAVIDA_FORM = Form(
    LLAVIDA_POINTS,
    POINTS_RIGHT_FIRST,
    frozenset({"m", "meter", "meters", "metre", "metres"}),
    label="trajectory",
    usual=frozenset({"round brackets", "a nested list"}),
)


def adapt_llavida(
    response: Response, request: Request | None = None, mode: str = LLAVIDA_FRAME
) -> AdaptedResponse:
    """Read the list behind the label ``… trajectory:``, points at 0.5, 1.0, … s.

    A native x is lateral, negative to the left, and a native y is forward: (X, Y) = (y, −x). The
    origin is added. LLaViDA's own parser pads a short list with its last point and makes six
    points (0, 0) of one that it can't read; here a short list stays short, and one that can't be
    read is no trajectory. A line of meta-actions stays in the text.

    Args:
        response: as it came.
        request: that it answers, by which the echo of its history is known; None: not at hand.
        mode: the frame, as the result names it.
    """
    info = AdapterInfo("llavida", mode)
    if response.error_code:
        return without_trajectory(response, info, "missing")
    history = None if request is None else llavida_history(request).rows
    choice = choose_answer(response.text, _LLAVIDA_FORM, history, motion_is_cut(response))
    info = replace(info, notes=choice.notes)
    if choice.reason:
        return AdaptedResponse(response.text, None, (choice.reason,), info)
    lateral, forward = zip(*choice.rows, strict=True)
    # 0.0 − x instead of −x, which would make a negative zero of straight ahead.
    ys = [0.0 - x for x in lateral]
    return adapt_points(response, info, forward, ys, _times_of(choice, STEP_S), request, STEP_S)


WAYPOINTS_ARRAY = "trajectory"
WAYPOINTS_FRAME = "ego_xy"
_SHORTEST_STEP_S = 0.01  # as in request.request_problems
_WAYPOINTS_INFO = AdapterInfo("waypoints", WAYPOINTS_FRAME)
_WAYPOINTS_FORM = Form(
    rows=0,  # by the task
    meaning=POINTS,
    units=frozenset({"m", "meter", "meters", "metre", "metres"}),
    label="trajectory",
    usual=frozenset({"square brackets", "a nested list"}),
)


def adapt_waypoints(
    response: Response,
    request: Request | None = None,
    mode: str = WAYPOINTS_FRAME,  # noqa: ARG001  # as every reader has it
) -> AdaptedResponse:
    """Read the array ``trajectory``: frame ``ego_xy``, unit m, shape (n, 2), constant step.

    A first row one step after t = 0 gets the frame's origin before it, marked (METHOD 5.4). A
    wrong frame, unit, shape or number of arrays is a trajectory that can't be read: ``shape``.

    Without such an array, the text is read: ``Trajectory: [[x, y], …]`` in the same frame and unit,
    at the task's step, the first point one step after t = 0.

    Args:
        response: as it came.
        request: that it answers, whose task declares the step; None: that of TASK.
        mode: ignored; every reader has it.
    """
    arrays = [array for array in response.arrays if array.name == WAYPOINTS_ARRAY]
    if response.error_code:
        return _without(response, "missing", "")
    if not arrays:
        return _read_text(response, request)
    if len(arrays) > 1:
        return _without(response, "shape", f"{len(arrays)} arrays are named {WAYPOINTS_ARRAY}")
    return _read_waypoints(response, arrays[0], request)


def _read_waypoints(
    response: Response, array: NativeArray, request: Request | None
) -> AdaptedResponse:
    if array.frame != WAYPOINTS_FRAME or array.unit != "m":
        return _without(response, "shape", f"frame {array.frame!r} in {array.unit!r} is not read")
    rows = array.shape[0] if len(array.shape) == 2 else -1
    if rows < 1 or array.shape[1:] != (2,) or len(array.data) != 2 * rows:
        return _without(
            response, "shape", f"{len(array.data)} values of shape {array.shape} are no (n, 2)"
        )
    if not (math.isfinite(array.step_s) and math.isfinite(array.first_time_s)):
        return _without(response, "timestamps", "step or first time isn't finite")
    xs, ys = array.data[0::2], array.data[1::2]
    times_s = _raster(rows, array.first_time_s, array.step_s)
    return adapt_points(response, _WAYPOINTS_INFO, xs, ys, times_s, request, array.step_s)


def _read_text(response: Response, request: Request | None) -> AdaptedResponse:
    """Return the list behind ``Trajectory:``, whose step and first time the task declares."""
    task = TASK if request is None else request.task
    history = () if request is None else waypoints_history(request).rows
    step_s = task.trajectory_step_s
    horizon_s = task.trajectory_horizon_s
    if not (math.isfinite(horizon_s) and _SHORTEST_STEP_S <= step_s <= horizon_s):
        return _without(response, "timestamps", "the task's trajectory step is no time")
    rows = math.floor(horizon_s / step_s + TOLERANCE_S)
    form = replace(_WAYPOINTS_FORM, rows=rows, step_s=step_s)
    choice = choose_answer(response.text, form, history, motion_is_cut(response))
    if choice.reason:
        note = f"no array is named {WAYPOINTS_ARRAY}"
        return replace(
            _without(response, choice.reason, note),
            info=replace(_WAYPOINTS_INFO, notes=(note, *choice.notes)),
        )
    info = replace(_WAYPOINTS_INFO, notes=("the trajectory was read from the text", *choice.notes))
    xs, ys = zip(*choice.rows, strict=True)
    return adapt_points(response, info, xs, ys, _times_of(choice, step_s), request, step_s)


def _without(response: Response, reason: str, note: str) -> AdaptedResponse:
    return without_trajectory(response, _WAYPOINTS_INFO, reason, note)


ALPAMAYO_ARRAY = "pred_xyz"
ALPAMAYO_FRAMES = ("ego_xyz", "ego_xy")
ALPAMAYO_MODE = "set0_sample0"

_MOST_AXES = 5  # batch, sets, samples, times, coordinates

# The print of a numpy array (or list) of strings. The repetitions are possessive: nothing is tried
# twice.
_LITERAL = r"""(?:'(?:[^'\\\n]++|\\.)*+'|"(?:[^"\\\n]++|\\.)*+")"""
_PRINTED = re.compile(rf"\s*\[[\[\s]*+({_LITERAL})(?:[\s,\[\]]++|{_LITERAL})*+")


def adapt_alpamayo(
    response: Response, request: Request | None = None, mode: str = ALPAMAYO_MODE
) -> AdaptedResponse:
    """Read set 0, sample 0 of ``pred_xyz``: shape [B, sets, samples, n, 3], or fewer leading axes.

    x is forward, y to the left, m, in the ego frame at the record's time; z is not used. B must be
    1. Step and first time are the array's own (0.1 s each for Alpamayo), so that the origin is
    added before a start one step late. A path that folds back is passed on as it is, and a text
    that is empty stays empty.
    """
    text, notes = unwrapped(response.text)
    info = AdapterInfo("alpamayo", mode, notes=notes)
    response = replace(response, text=text)
    arrays = [array for array in response.arrays if array.name == ALPAMAYO_ARRAY]
    if response.error_code or not arrays:
        return without_trajectory(response, info, "missing", f"no array is named {ALPAMAYO_ARRAY}")
    if len(arrays) > 1:
        note = f"{len(arrays)} arrays are named {ALPAMAYO_ARRAY}"
        return without_trajectory(response, info, "shape", note)
    return _read_alpamayo(response, info, arrays[0], request)


def _read_alpamayo(
    response: Response, info: AdapterInfo, array: NativeArray, request: Request | None
) -> AdaptedResponse:
    if array.frame not in ALPAMAYO_FRAMES or array.unit != "m":
        note = f"frame {array.frame!r} in {array.unit!r} is not read"
        return without_trajectory(response, info, "shape", note)
    shape = array.shape
    width = shape[-1] if shape else 0
    value_count = math.prod(shape) if all(size >= 0 for size in shape) else -1
    if not 2 <= len(shape) <= _MOST_AXES or width not in (2, 3) or len(array.data) != value_count:
        note = f"{len(array.data)} values of shape {shape} are no [B, sets, samples, n, 3]"
        return without_trajectory(response, info, "shape", note)
    if len(shape) == _MOST_AXES and shape[0] > 1:
        note = f"the array is a batch of {shape[0]}"
        return without_trajectory(response, info, "shape", note)
    if not array.data:
        return without_trajectory(response, info, "shape", "the array holds no points")
    if not (math.isfinite(array.step_s) and math.isfinite(array.first_time_s)):
        return without_trajectory(response, info, "timestamps", "step or first time isn't finite")
    # Row-major, so set 0, sample 0 of every batch of one comes first.
    points = shape[-2] * width
    trajectory_count = len(array.data) // points
    if trajectory_count > 1:
        info = replace(
            info, notes=(*info.notes, f"the first of {trajectory_count} trajectories was taken")
        )
    xs, ys = array.data[0:points:width], array.data[1:points:width]
    times_s = _raster(len(xs), array.first_time_s, array.step_s)
    return adapt_points(response, info, xs, ys, times_s, request, array.step_s)


def unwrapped(text: str) -> tuple[str, tuple[str, ...]]:
    """Return the first string of a text that prints an array of strings, and a note on that."""
    match = _PRINTED.fullmatch(text)
    if match is None or not text.rstrip().endswith("]"):
        return text, ()
    try:
        inner = ast.literal_eval(match[1])
    except (SyntaxError, ValueError):
        return text, ()
    return inner, ("the text was the print of an array, whose first string was taken",)
