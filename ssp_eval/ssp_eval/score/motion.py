"""What a trajectory does (METHOD 5.4, 6.6): its actions, and whether a vehicle can drive it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Generic, TypeVar

import numpy as np

from ssp_core.vocabulary import LAT_ACTIONS, LON_ACTIONS
from ssp_eval.score.columns import NOTHING, Flags, Numbers, RecordColumns, Whole
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_vla_bridge.trajectory import Trajectory, between, check_trajectory, locate

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

# One trajectory, or an array with an item per trajectory.
T = TypeVar("T", float, "NDArray[np.float64]")


@dataclass(frozen=True)
class Motion(Generic[T]):
    """A trajectory at k = 0, 1, 2, and the differences that METHOD 6.6 takes from it.

    Args:
        forward_m: s_k, ego frame.
        left_m: l_k, ego frame.
        step_s: Δt.
    """

    forward_m: tuple[T, T, T]
    left_m: tuple[T, T, T]
    step_s: float

    @property
    def forward_steps_m(self) -> tuple[T, T]:
        """Δs_k for k = 1, 2."""
        s0, s1, s2 = self.forward_m
        return s1 - s0, s2 - s1

    @property
    def left_steps_m(self) -> tuple[T, T]:
        """Δl_k for k = 1, 2."""
        l0, l1, l2 = self.left_m
        return l1 - l0, l2 - l1

    @property
    def end_speed_mps(self) -> T:
        """v_2, forward."""
        return (self.forward_m[2] - self.forward_m[1]) / self.step_s

    @property
    def accel_mps2(self) -> T:
        """a = (v_2 − v_1)/Δt, positive when speeding up."""
        # Both speeds of a huge step can be infinite and then have no difference; the steps have.
        before_m, after_m = self.forward_steps_m
        return (after_m - before_m) / self.step_s / self.step_s

    @property
    def shift_m(self) -> T:
        """Δl = l_2 − l_0, positive to the left."""
        return self.left_m[2] - self.left_m[0]


def step_of(thresholds: Thresholds) -> float:
    """Δt of METHOD 6.6, half of the interval that a trajectory must cover, s."""
    return thresholds.support_end_s / 2


# Where a trajectory is read: index of a sample, and the share of the way to the next.
Places = tuple[tuple[int, float], ...]


@lru_cache(maxsize=1 << 12)
def sample_places(
    times_s: tuple[float, ...], support_end_s: float, tolerance_s: float
) -> Places | None:
    """Where among its samples a trajectory is read (METHOD 6.6).

    A model gives all its trajectories over the same few times, so that this is seldom asked anew.

    Args:
        times_s: times of the samples.
        support_end_s: end of the interval that must be covered, s.
        tolerance_s: see check_trajectory.

    Returns:
        The place of each of the three times; None if no trajectory with these times is valid
        (METHOD 5.4).
    """
    if check_trajectory(Trajectory(times_s, times_s, times_s), support_end_s, tolerance_s):
        return None
    step_s = support_end_s / 2
    return tuple(locate(times_s, k * step_s, tolerance_s) for k in range(3))


def measure(
    trajectory: Trajectory | None, thresholds: Thresholds = DEFAULT
) -> Motion[float] | None:
    """Samples a trajectory at the start, middle and end of the interval (METHOD 6.6).

    Args:
        trajectory: as a model gave it, ego frame, m; None without one.
        thresholds: the interval and the tolerance.

    Returns:
        None where v_trj = 0 (METHOD 5.3, 5.4); a record's ``invalid`` decides nothing.
    """
    if trajectory is None:
        return None
    xs, ys = trajectory.x_m, trajectory.y_m
    if not len(xs) == len(ys) == len(trajectory.t_s):
        return None
    places = sample_places(trajectory.t_s, thresholds.support_end_s, thresholds.tolerance)
    if places is None or not (all(map(math.isfinite, xs)) and all(map(math.isfinite, ys))):
        return None
    (i, u), (j, v), (k, w) = places
    return Motion(
        (between(xs, i, u), between(xs, j, v), between(xs, k, w)),
        (between(ys, i, u), between(ys, j, v), between(ys, k, w)),
        step_of(thresholds),
    )


def lon_action(motion: Motion[float], thresholds: Thresholds = DEFAULT) -> str:
    """The longitudinal action (METHOD 6.6): stop, decelerate, maintain or accelerate."""
    if thresholds.at_most(motion.end_speed_mps, thresholds.stop_speed_mps):
        return "stop"
    accel_mps2 = motion.accel_mps2
    if thresholds.at_most(accel_mps2, -thresholds.accel_mps2):
        return "decelerate"
    if thresholds.at_least(accel_mps2, thresholds.accel_mps2):
        return "accelerate"
    return "maintain"


def lat_action(motion: Motion[float], thresholds: Thresholds = DEFAULT) -> str:
    """The lateral action (METHOD 6.6): left, straight or right."""
    shift_m = motion.shift_m
    if thresholds.at_least(shift_m, thresholds.lateral_shift_m):
        return "left"
    if thresholds.at_most(shift_m, -thresholds.lateral_shift_m):
        return "right"
    return "straight"


def feasible(motion: Motion[float], thresholds: Thresholds = DEFAULT) -> bool:
    """F of METHOD 6.6: no step goes backwards, too fast or too fast sideways, |a| is bounded."""
    (s1, s2), (l1, l2) = motion.forward_steps_m, motion.left_steps_m
    furthest_m = max(math.hypot(s1, l1), math.hypot(s2, l2))
    widest_m = max(abs(l1), abs(l2))
    return (
        thresholds.at_least(min(s1, s2), -thresholds.max_backward_m)
        and thresholds.at_most(furthest_m / motion.step_s, thresholds.max_speed_mps)
        and thresholds.at_most(widest_m / motion.step_s, thresholds.max_lateral_speed_mps)
        and thresholds.at_most(abs(motion.accel_mps2), thresholds.max_accel_mps2)
    )


_STOP, _DECELERATE, _MAINTAIN, _ACCELERATE = map(
    LON_ACTIONS.index, ("stop", "decelerate", "maintain", "accelerate")
)
_LEFT, _STRAIGHT, _RIGHT = map(LAT_ACTIONS.index, ("left", "straight", "right"))


@dataclass(frozen=True, eq=False)
class Driven:
    """What trajectories do, one row per record (METHOD 6.6).

    Args:
        valid: (R,) v_trj.
        lon, lat: (R,) codes of the inferred actions, NOTHING where v_trj = 0.
        feasible: (R,) v_trj F.
    """

    valid: Flags
    lon: Whole
    lat: Whole
    feasible: Flags


def driven(records: RecordColumns, thresholds: Thresholds) -> Driven:
    """Which trajectories are valid (METHOD 5.4) and what they do (METHOD 6.6)."""
    places = [
        sample_places(times, thresholds.support_end_s, thresholds.tolerance)
        for times in records.grids
    ]
    usable = np.array([found is not None for found in places], dtype=np.bool_)
    points = np.array([len(times) for times in records.grids])
    valid = usable[records.grid]
    for values, start in ((records.x_m, records.x_start), (records.y_m, records.y_start)):
        infinite = np.concatenate(([0], np.cumsum(~np.isfinite(values))))
        valid &= np.diff(start) == points[records.grid]
        valid &= infinite[start[1:]] == infinite[start[:-1]]

    rows = np.flatnonzero(valid)
    place = np.array([found or ((0, 0.0),) * 3 for found in places])[records.grid[rows]]
    left, share = place[:, :, 0].astype(np.int64), place[:, :, 1]
    # At a sample there is no other side: it could be missing, or too far away for a difference.
    right = left + (share > 0)

    def sampled(values: Numbers, start: Whole) -> tuple[Numbers, Numbers, Numbers]:
        # In halves, as between does: the difference of two huge numbers stays finite.
        before = values[start[rows, None] + left] / 2
        at = 2 * (before + (values[start[rows, None] + right] / 2 - before) * share)
        return at[:, 0], at[:, 1], at[:, 2]

    lon, lat = np.full(len(valid), NOTHING), np.full(len(valid), NOTHING)
    feasible = np.zeros(len(valid), dtype=np.bool_)
    # Huge coordinates overflow into infinite speeds, which no limit admits.
    with np.errstate(over="ignore", invalid="ignore"):
        motion = Motion(
            sampled(records.x_m, records.x_start),
            sampled(records.y_m, records.y_start),
            step_of(thresholds),
        )
        lon[rows], lat[rows] = _lon(motion, thresholds), _lat(motion, thresholds)
        feasible[rows] = _feasible(motion, thresholds)
    return Driven(valid, lon, lat, feasible)


def _lon(motion: Motion[Numbers], thresholds: Thresholds) -> Whole:
    accel = motion.accel_mps2
    return np.select(
        [
            thresholds.at_most(motion.end_speed_mps, thresholds.stop_speed_mps),
            thresholds.at_most(accel, -thresholds.accel_mps2),
            thresholds.at_least(accel, thresholds.accel_mps2),
        ],
        [_STOP, _DECELERATE, _ACCELERATE],
        _MAINTAIN,
    )


def _lat(motion: Motion[Numbers], thresholds: Thresholds) -> Whole:
    return np.select(
        [
            thresholds.at_least(motion.shift_m, thresholds.lateral_shift_m),
            thresholds.at_most(motion.shift_m, -thresholds.lateral_shift_m),
        ],
        [_LEFT, _RIGHT],
        _STRAIGHT,
    )


def _feasible(motion: Motion[Numbers], thresholds: Thresholds) -> Flags:
    accel_mps2: Numbers = np.abs(motion.accel_mps2)
    result = thresholds.at_most(accel_mps2, thresholds.max_accel_mps2)
    for forward_m, left_m in zip(motion.forward_steps_m, motion.left_steps_m, strict=True):
        speed_mps: Numbers = np.hypot(forward_m, left_m) / motion.step_s
        lateral_mps: Numbers = np.abs(left_m) / motion.step_s
        result = (
            result
            & thresholds.at_least(forward_m, -thresholds.max_backward_m)
            & thresholds.at_most(speed_mps, thresholds.max_speed_mps)
            & thresholds.at_most(lateral_mps, thresholds.max_lateral_speed_mps)
        )
    return result
