"""What adapters of points share: rows (x, y) at a fixed step become a trajectory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ssp_vla_bridge.core.adapters.types import Adapted, AdapterInfo
from ssp_vla_bridge.core.response import Response
from ssp_vla_bridge.core.trajectory import TOLERANCE_S, Trajectory, check_trajectory


def adapt_points(
    response: Response,
    info: AdapterInfo,
    xs_m: Sequence[float],
    ys_m: Sequence[float],
    step_s: float,
    first_time_s: float,
) -> Adapted:
    """The trajectory of points at a fixed step, with the origin before a start one step late.

    Args:
        response: that they come from.
        info: name, mode and notes.
        xs_m: forward, m.
        ys_m: to the left, m.
        step_s: between points, s, finite.
        first_time_s: of the first point after the record's time, s, finite.
    """
    times = tuple(first_time_s + k * step_s for k in range(len(xs_m)))
    xs, ys = tuple(xs_m), tuple(ys_m)
    origin_added = step_s > 0 and abs(first_time_s - step_s) <= TOLERANCE_S
    if origin_added:
        times, xs, ys = (0.0, *times), (0.0, *xs), (0.0, *ys)
    trajectory = Trajectory(times, xs, ys)
    invalid = check_trajectory(trajectory)
    info = replace(info, origin_added=origin_added)
    return Adapted(response.text, None if invalid else trajectory, invalid, info)
