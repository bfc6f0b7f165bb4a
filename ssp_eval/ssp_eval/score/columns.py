"""Labels and records of many cells as columns of numbers, for ssp_eval.score.batch.

Nothing here depends on a threshold: columns are made once and scored as often as one likes, say
under other thresholds. Words become their places in the closed vocabularies (METHOD 5.1), a set of
objects the bits of its classes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Whole = NDArray[np.int64]
Flags = NDArray[np.bool_]
Numbers = NDArray[np.float64]

# The code of a null label and of an answer that is missing.
NOTHING = -1


@dataclass(frozen=True, eq=False)
class LabelColumns:
    """All labels of all cells, cell after cell (METHOD 5.2).

    Args:
        t_s: (L,) clip time, s.
        truth: (L, 4) per slot of METHOD 6.3 the code of its value, NOTHING for null.
        lon_allowed: (L,) bits of the allowed longitudinal actions.
        lat_allowed: (L,) bits of the allowed lateral actions.
    """

    t_s: Numbers
    truth: Whole
    lon_allowed: Whole
    lat_allowed: Whole


@dataclass(frozen=True, eq=False)
class RecordColumns:
    """All records of all cells, cell after cell (METHOD 5.3).

    Args:
        t_s: (R,) clip time, s.
        text_valid: (R,) v_txt.
        answer: (R, 6) per slot the code of its value where z = 1, else NOTHING.
        grid: (R,) which of grids the trajectory's times are.
        grids: the different sequences of times of trajectories; the first one is empty and that
            of records without a trajectory.
        x_m, y_m: all coordinates, record after record.
        x_start, y_start: (R + 1,) where a record's coordinates begin.
    """

    t_s: Numbers
    text_valid: Flags
    answer: Whole
    grid: Whole
    grids: tuple[tuple[float, ...], ...]
    x_m: Numbers
    y_m: Numbers
    x_start: Whole
    y_start: Whole


@dataclass(frozen=True, eq=False)
class Columns:
    """Many cells (METHOD 6).

    Args:
        label_start: (C + 1,) where a cell's labels begin.
        record_start: (C + 1,) where a cell's records begin.
        risk_onset_s: (C,) t_r, clip time, s.
        first_frame_dynamics: (C,) motion and conflict count at the earliest label too.
        labels, records: see there.
    """

    label_start: Whole
    record_start: Whole
    risk_onset_s: Numbers
    first_frame_dynamics: Flags
    labels: LabelColumns
    records: RecordColumns
