"""The adapter of our own bridges: rows (x_m, y_m) in the ego frame at a fixed step."""

from __future__ import annotations

import math

from ssp_vla_bridge.core.adapters.types import Adapted, AdapterInfo
from ssp_vla_bridge.core.request import Request
from ssp_vla_bridge.core.response import NativeArray, Response
from ssp_vla_bridge.core.trajectory import TOLERANCE_S, Trajectory, check_trajectory

ARRAY_NAME = "trajectory"
FRAME = "ego_xy"
_NAME = "waypoints"


def adapt_waypoints(
    response: Response, request: Request | None = None, mode: str = FRAME
) -> Adapted:
    """Reads the array ``trajectory``: frame ``ego_xy``, unit m, shape (n, 2), constant step.

    A first row one step after t = 0 gets the frame's origin before it, marked (METHOD 5.4). A
    wrong frame, unit, shape or number of arrays is a trajectory that can't be read: ``shape``.
    """
    arrays = [array for array in response.arrays if array.name == ARRAY_NAME]
    if response.error_code:
        return _without(response, "missing", f"error {response.error_code} instead of an answer")
    if not arrays:
        return _without(response, "missing", f"no array is named {ARRAY_NAME}")
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
    times = tuple(array.first_time_s + row * array.step_s for row in range(rows))
    xs, ys = array.data[0::2], array.data[1::2]
    origin_added = array.step_s > 0 and abs(array.first_time_s - array.step_s) <= TOLERANCE_S
    if origin_added:
        times, xs, ys = (0.0, *times), (0.0, *xs), (0.0, *ys)
    trajectory = Trajectory(times, xs, ys)
    invalid = check_trajectory(trajectory)
    info = AdapterInfo(_NAME, FRAME, origin_added)
    return Adapted(response.text, None if invalid else trajectory, invalid, info)


def _without(response: Response, reason: str, note: str) -> Adapted:
    info = AdapterInfo(_NAME, FRAME, notes=(note,))
    return Adapted(response.text, None, (reason,), info)
