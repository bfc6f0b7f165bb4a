"""A model's planned trajectory between its samples, and the reasons of an invalid one."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Sequence

from ssp_core.motion.trajectory import SUPPORT_END_S, TOLERANCE_S, Trajectory, check_trajectory

__all__ = [
    "INVALID_REASONS",
    "SUPPORT_END_S",
    "TOLERANCE_S",
    "Trajectory",
    "between",
    "check_trajectory",
    "interpolate",
    "locate",
]

# The reasons that ``invalid`` of a behaviour record may give (METHOD 5.3).
INVALID_REASONS = ("missing", "shape", "non_finite", "timestamps", "coverage")


def interpolate(
    trajectory: Trajectory, t_s: float, tolerance_s: float = TOLERANCE_S
) -> tuple[float, float]:
    """Return the position (x_m, y_m) at a time, linear between samples only (METHOD 5.4).

    Args:
        trajectory: a valid one.
        t_s: time after the record's time, s.
        tolerance_s: a time outside the support by no more than this takes the end sample.

    Raises:
        ValueError: the time lies outside the trajectory's native support.
    """
    left, weight = locate(trajectory.t_s, t_s, tolerance_s)
    return (
        between(trajectory.x_m, left, weight),
        between(trajectory.y_m, left, weight),
    )


def locate(
    times_s: Sequence[float], t_s: float, tolerance_s: float = TOLERANCE_S
) -> tuple[int, float]:
    """Find the place of a time among the samples of a valid trajectory.

    Returns:
        Index of a sample, and the share of the way from it to the next; 0 at the sample itself.

    Raises:
        ValueError: see interpolate.
    """
    if not times_s[0] - tolerance_s <= t_s <= times_s[-1] + tolerance_s:
        raise ValueError(f"{t_s} s is outside the support [{times_s[0]}, {times_s[-1]}] s")
    right = min(bisect_left(times_s, t_s), len(times_s) - 1)
    if right == 0 or times_s[right] <= t_s:
        return right, 0.0
    left = right - 1
    return left, (t_s - times_s[left]) / (times_s[right] - times_s[left])


def between(values: Sequence[float], left: int, weight: float) -> float:
    """Return a coordinate at a place that locate gave; at a sample only that one is looked at."""
    if not weight:
        return values[left]
    # Halves keep the difference of two huge numbers finite, and halving costs no digit.
    half = values[left] / 2
    return 2 * (half + (values[left + 1] / 2 - half) * weight)
