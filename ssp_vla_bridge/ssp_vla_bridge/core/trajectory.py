"""A model's planned trajectory in the frame of METHOD 5.4: what it holds, and when it is valid."""

from __future__ import annotations

import math
from bisect import bisect_left
from dataclasses import dataclass
from itertools import pairwise

# The interval that a trajectory must cover is [0, SUPPORT_END_S] (METHOD 5.4); inclusive
# comparisons of times carry TOLERANCE_S (METHOD 6.11).
SUPPORT_END_S = 1.0
TOLERANCE_S = 1e-9

# The reasons that ``invalid`` of a behaviour record may give (METHOD 5.3).
INVALID_REASONS = ("missing", "shape", "non_finite", "timestamps", "coverage")


@dataclass(frozen=True)
class Trajectory:
    """Planned positions of the VUT's reference point, as a model gave them.

    It holds whatever came out of a model, so it may be invalid (unequal lengths, NaN, no points);
    check_trajectory tells.

    Args:
        t_s: times after the record's time, s; t = 0 is the record's time.
        x_m: forward, m, ego frame at the record's time.
        y_m: to the left, m, ego frame at the record's time.
    """

    t_s: tuple[float, ...]
    x_m: tuple[float, ...]
    y_m: tuple[float, ...]


def check_trajectory(
    trajectory: Trajectory,
    support_end_s: float = SUPPORT_END_S,
    tolerance_s: float = TOLERANCE_S,
) -> tuple[str, ...]:
    """The reasons why a trajectory is invalid, none for a valid one (METHOD 5.4).

    Valid means: at least two points, equal lengths, all finite, times rising strictly, support
    covering [0, support_end_s]. A later check is made only where an earlier failure leaves it a
    meaning: the support of times that don't rise is no interval.

    Args:
        trajectory: positions in the ego frame, m, over times, s.
        support_end_s: end of the interval that must be covered, s.
        tolerance_s: by how much the support may fall short of either end, s.

    Returns:
        Some of ``shape``, ``non_finite``, ``timestamps``, ``coverage``, in this order.
    """
    times, xs, ys = trajectory.t_s, trajectory.x_m, trajectory.y_m
    reasons = []
    if len(times) < 2 or len(xs) != len(times) or len(ys) != len(times):
        reasons.append("shape")
    if not all(math.isfinite(value) for values in (times, xs, ys) for value in values):
        reasons.append("non_finite")
    if not times or not all(math.isfinite(time) for time in times):
        return tuple(reasons)
    if not all(before < after for before, after in pairwise(times)):
        reasons.append("timestamps")
    elif times[0] > tolerance_s or times[-1] < support_end_s - tolerance_s:
        reasons.append("coverage")
    return tuple(reasons)


def interpolate(
    trajectory: Trajectory, t_s: float, tolerance_s: float = TOLERANCE_S
) -> tuple[float, float]:
    """Position (x_m, y_m) at a time, linear between samples, never outside them (METHOD 5.4).

    Args:
        trajectory: a valid one (check_trajectory returned nothing).
        t_s: time after the record's time, s.
        tolerance_s: a time outside the support by no more than this takes the end sample.

    Raises:
        ValueError: the time lies outside the trajectory's native support.
    """
    times, xs, ys = trajectory.t_s, trajectory.x_m, trajectory.y_m
    if not times[0] - tolerance_s <= t_s <= times[-1] + tolerance_s:
        raise ValueError(f"{t_s} s is outside the support [{times[0]}, {times[-1]}] s")
    right = min(bisect_left(times, t_s), len(times) - 1)
    if right == 0 or times[right] <= t_s:
        return xs[right], ys[right]
    left = right - 1
    weight = (t_s - times[left]) / (times[right] - times[left])
    return (
        xs[left] + (xs[right] - xs[left]) * weight,
        ys[left] + (ys[right] - ys[left]) * weight,
    )
