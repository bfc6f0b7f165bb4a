"""A planned trajectory in the frame of METHOD 5.4, and the rules by which it is valid."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import chain, islice
from operator import lt

# The interval that a trajectory must cover is [0, SUPPORT_END_S] (METHOD 5.4); inclusive
# comparisons of times carry TOLERANCE_S (METHOD 6.11).
SUPPORT_END_S = 1.0
TOLERANCE_S = 1e-9


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
    """List the reasons why a trajectory is invalid, none for a valid one (METHOD 5.4).

    Valid means: at least two points, equal lengths, all finite, times rising strictly, support
    covering [0, support_end_s]. A later check is made only where an earlier failure leaves it a
    meaning: the support of times that don't rise is no interval.

    Args:
        trajectory: of any lengths, finite or not.
        support_end_s: end of the interval that must be covered, s.
        tolerance_s: by how much the support may fall short of either end, s.

    Returns:
        Some of ``shape``, ``non_finite``, ``timestamps``, ``coverage``, in this order.
    """
    times, xs, ys = trajectory.t_s, trajectory.x_m, trajectory.y_m
    reasons = []
    if len(times) < 2 or len(xs) != len(times) or len(ys) != len(times):
        reasons.append("shape")
    if not all(map(math.isfinite, chain(times, xs, ys))):
        reasons.append("non_finite")
    if not times or not all(map(math.isfinite, times)):
        return tuple(reasons)
    if not all(map(lt, times, islice(times, 1, None))):
        reasons.append("timestamps")
    elif times[0] > tolerance_s or times[-1] < support_end_s - tolerance_s:
        reasons.append("coverage")
    return tuple(reasons)
