"""The adapter ``alpamayo``: the array ``pred_xyz``, and texts printed as an array."""

from __future__ import annotations

import ast
import math
import re
from dataclasses import replace

from ssp_vla_bridge.core.adapters.points import adapt_points
from ssp_vla_bridge.core.adapters.types import Adapted, AdapterInfo, without_trajectory
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import NativeArray, Response

ARRAY_NAME = "pred_xyz"
FRAMES = ("ego_xyz", "ego_xy")
MODE = "set0_sample0"

_MOST_AXES = 5  # batch, sets, samples, times, coordinates

# The print of a numpy array (or list) of strings. The repetitions are possessive: nothing is tried
# twice.
_LITERAL = r"""(?:'(?:[^'\\\n]++|\\.)*+'|"(?:[^"\\\n]++|\\.)*+")"""
_PRINTED = re.compile(rf"\s*\[[\[\s]*+({_LITERAL})(?:[\s,\[\]]++|{_LITERAL})*+")


def adapt_alpamayo(response: Response, request: Request | None = None, mode: str = MODE) -> Adapted:
    """Reads set 0, sample 0 of ``pred_xyz``: shape [B, sets, samples, n, 3], or fewer leading axes.

    x is forward, y to the left, m, in the ego frame at the record's time; z is not used. B must be
    1. Step and first time are the array's own (0.1 s each for Alpamayo), so that the origin is
    added before a start one step late. A path that folds back is passed on as it is, and a text
    that is empty stays empty.

    Args:
        response: raw.
        request: not used.
        mode: there is one.
    """
    text, notes = unwrapped(response.text)
    info = AdapterInfo("alpamayo", mode, notes=notes)
    response = replace(response, text=text)
    arrays = [array for array in response.arrays if array.name == ARRAY_NAME]
    if response.error_code or not arrays:
        return without_trajectory(response, info, "missing", f"no array is named {ARRAY_NAME}")
    if len(arrays) > 1:
        note = f"{len(arrays)} arrays are named {ARRAY_NAME}"
        return without_trajectory(response, info, "shape", note)
    return _read(response, info, arrays[0])


def _read(response: Response, info: AdapterInfo, array: NativeArray) -> Adapted:
    if array.frame not in FRAMES or array.unit != "m":
        note = f"frame {array.frame!r} in {array.unit!r} is not read"
        return without_trajectory(response, info, "shape", note)
    shape = array.shape
    width = shape[-1] if shape else 0
    wanted = math.prod(shape) if all(size >= 0 for size in shape) else -1
    if not 2 <= len(shape) <= _MOST_AXES or width not in (2, 3) or len(array.data) != wanted:
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
    given = len(array.data) // points
    if given > 1:
        info = replace(info, notes=(*info.notes, f"the first of {given} trajectories was taken"))
    xs, ys = array.data[0:points:width], array.data[1:points:width]
    return adapt_points(response, info, xs, ys, array.step_s, array.first_time_s)


def unwrapped(text: str) -> tuple[str, tuple[str, ...]]:
    """The first string of a text that is the print of an array of strings; notes say if it was.

    Args:
        text: any; one that is no such print is given back.
    """
    match = _PRINTED.fullmatch(text)
    if match is None or not text.rstrip().endswith("]"):
        return text, ()
    try:
        inner = ast.literal_eval(match[1])
    except (SyntaxError, ValueError):
        return text, ()
    return inner, ("the text was the print of an array, whose first string was taken",)
