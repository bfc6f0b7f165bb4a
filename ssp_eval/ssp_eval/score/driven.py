"""What the trajectories of many records do (METHOD 5.4 and 6.6), as codes of columns.

ssp_eval.score.motion decides the same for one trajectory; the tests hold the two to each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ssp_core.vocabulary import LAT_ACTIONS, LON_ACTIONS
from ssp_eval.score.columns import NOTHING, Flags, Numbers, RecordColumns, Whole
from ssp_eval.score.motion import Motion, sample_places, step_of
from ssp_eval.score.thresholds import Thresholds

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
