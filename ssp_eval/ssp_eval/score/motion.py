"""The actions of a trajectory (METHOD 5.4, 6.6), and whether a vehicle can drive it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ssp_core.vocabulary import LAT_ACTIONS, LON_ACTIONS
from ssp_eval.score.columns import NOTHING, Flags, Numbers, RecordColumns, Whole
from ssp_eval.score.thresholds import DEFAULT, Thresholds
from ssp_vla_bridge.trajectory import Trajectory, check_trajectory, locate


@dataclass(frozen=True)
class Motion:
    """Trajectories at k = 0, 1, 2, and the differences that METHOD 6.6 takes from them.

    Args:
        forward_m: s_k, ego frame.
        left_m: l_k, ego frame.
    """

    forward_m: tuple[Numbers, Numbers, Numbers]
    left_m: tuple[Numbers, Numbers, Numbers]
    step_s: float

    @property
    def forward_steps_m(self) -> tuple[Numbers, Numbers]:
        """Δs_k for k = 1, 2."""
        s0, s1, s2 = self.forward_m
        return s1 - s0, s2 - s1

    @property
    def left_steps_m(self) -> tuple[Numbers, Numbers]:
        """Δl_k for k = 1, 2."""
        l0, l1, l2 = self.left_m
        return l1 - l0, l2 - l1

    @property
    def end_speed_mps(self) -> Numbers:
        """v_2, forward."""
        return (self.forward_m[2] - self.forward_m[1]) / self.step_s

    @property
    def accel_mps2(self) -> Numbers:
        """Compute a = (v_2 − v_1)/Δt, positive when speeding up."""
        # Both speeds of a huge step can be infinite and then have no difference; the steps have.
        before_m, after_m = self.forward_steps_m
        return (after_m - before_m) / self.step_s / self.step_s

    @property
    def shift_m(self) -> Numbers:
        """Δl = l_2 − l_0, positive to the left."""
        return self.left_m[2] - self.left_m[0]


def step_of(thresholds: Thresholds) -> float:
    """Return Δt of METHOD 6.6, half of the interval that a trajectory must cover, s."""
    return thresholds.support_end_s / 2


# Where a trajectory is read: index of a sample, and the share of the way to the next.
Places = tuple[tuple[int, float], ...]


@lru_cache(maxsize=1 << 12)
def sample_places(
    times_s: tuple[float, ...], support_end_s: float, tolerance_s: float
) -> Places | None:
    """Find the samples between which a trajectory is read (METHOD 6.6).

    A model gives all its trajectories over the same few times, so that this is seldom asked anew.

    Args:
        times_s: of the trajectory's points, s.
        support_end_s: end of the interval that must be covered, s.
        tolerance_s: by which times may miss the interval's ends, s.

    Returns:
        The place of each of the three times; None if no trajectory with these times is valid
        (METHOD 5.4).
    """
    if check_trajectory(Trajectory(times_s, times_s, times_s), support_end_s, tolerance_s):
        return None
    step_s = support_end_s / 2
    return tuple(locate(times_s, k * step_s, tolerance_s) for k in range(3))


_STOP, _DECELERATE, _MAINTAIN, _ACCELERATE = map(
    LON_ACTIONS.index, ("stop", "decelerate", "maintain", "accelerate")
)
_LEFT, _STRAIGHT, _RIGHT = map(LAT_ACTIONS.index, ("left", "straight", "right"))


@dataclass(frozen=True, eq=False)
class TrajectoryActions:
    """The actions of trajectories, one row per record (METHOD 6.6).

    Args:
        valid: (R,) v_trj.
        lon, lat: (R,) codes of the inferred actions, NOTHING where v_trj = 0.
        feasible: (R,) v_trj F.
    """

    valid: Flags
    lon: Whole
    lat: Whole
    feasible: Flags


@dataclass(frozen=True, eq=False)
class SampledTrajectories:
    """The trajectories that are valid, sampled.

    Args:
        rows: (V,) the records whose v_trj = 1.
    """

    rows: Whole
    motion: Motion


def measure(records: RecordColumns, thresholds: Thresholds) -> SampledTrajectories:
    """Sample all valid trajectories at start, middle and end (METHOD 5.4, 6.6).

    Times must cover the interval, and all coordinates be finite; a record's ``invalid`` decides
    nothing.
    """
    places = [
        sample_places(times, thresholds.support_end_s, thresholds.tolerance)
        for times in records.grids
    ]
    usable = np.array([sample is not None for sample in places], dtype=np.bool_)
    points = np.array([len(times) for times in records.grids])
    valid = usable[records.grid]
    for values, start in ((records.x_m, records.x_start), (records.y_m, records.y_start)):
        infinite = np.concatenate(([0], np.cumsum(~np.isfinite(values))))
        valid &= np.diff(start) == points[records.grid]
        valid &= infinite[start[1:]] == infinite[start[:-1]]

    rows = np.flatnonzero(valid)
    place = np.array([sample or ((0, 0.0),) * 3 for sample in places])[records.grid[rows]]
    left, share = place[:, :, 0].astype(np.int64), place[:, :, 1]
    # At a sample there is no other side: it could be missing, or too far away for a difference.
    right = left + (share > 0)

    def sampled(values: Numbers, start: Whole) -> tuple[Numbers, Numbers, Numbers]:
        # In halves, as between does: the difference of two huge numbers stays finite.
        before = values[start[rows, None] + left] / 2
        at = 2 * (before + (values[start[rows, None] + right] / 2 - before) * share)
        return at[:, 0], at[:, 1], at[:, 2]

    # Huge coordinates overflow into infinite speeds, which no limit admits.
    with np.errstate(over="ignore", invalid="ignore"):
        forward_m = sampled(records.x_m, records.x_start)
        left_m = sampled(records.y_m, records.y_start)
    return SampledTrajectories(rows, Motion(forward_m, left_m, step_of(thresholds)))


def driven(records: RecordColumns, thresholds: Thresholds) -> TrajectoryActions:
    """Compute which trajectories are valid (METHOD 5.4) and their actions (METHOD 6.6)."""
    count = len(records.t_s)
    lon, lat = np.full(count, NOTHING), np.full(count, NOTHING)
    valid, drivable = np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=np.bool_)
    trajectories = measure(records, thresholds)
    rows, motion = trajectories.rows, trajectories.motion
    with np.errstate(over="ignore", invalid="ignore"):
        valid[rows] = True
        lon[rows], lat[rows] = lon_action(motion, thresholds), lat_action(motion, thresholds)
        drivable[rows] = feasible(motion, thresholds)
    return TrajectoryActions(valid, lon, lat, drivable)


def lon_action(motion: Motion, thresholds: Thresholds = DEFAULT) -> Whole:
    """Return longitudinal action codes (METHOD 6.6): stop, decelerate, maintain, accelerate."""
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


def lat_action(motion: Motion, thresholds: Thresholds = DEFAULT) -> Whole:
    """Return lateral action codes (METHOD 6.6): left, straight, right."""
    return np.select(
        [
            thresholds.at_least(motion.shift_m, thresholds.lateral_shift_m),
            thresholds.at_most(motion.shift_m, -thresholds.lateral_shift_m),
        ],
        [_LEFT, _RIGHT],
        _STRAIGHT,
    )


def feasible(motion: Motion, thresholds: Thresholds = DEFAULT) -> Flags:
    """Return F of METHOD 6.6: no step backwards, too fast or too fast sideways, |a| bounded."""
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
