"""What the means of METHOD 6.2 to 6.9 are taken of, label by label, as arrays.

A bootstrap over records, a sensitivity analysis or a diagram by phase recomputes metrics from
these without judging any output again; ssp_eval.score.batch makes them for many cells at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ssp_eval.score.cell import CellScore
from ssp_eval.score.semantics import SLOTS

Flags = NDArray[np.bool_]
Numbers = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class RecordTerms:
    """The terms of a cell, one row per label in time order; a missing output is 0 everywhere.

    Args:
        matched: (N,) the label has a record (6.1).
        output_valid: (N,) v_txt v_trj (6.2).
        evaluable: (N, 4) e of each slot, in the order of SLOTS (6.3).
        given: (N, 4) e z.
        hard: (N, 4) e z h, 0..1.
        soft: (N, 4) e z s, 0..1.
        interaction_evaluable: (N,) E (6.4).
        interaction_correct: (N,) E C (6.4).
        action_correct: (N,) the term of ActAcc_eff (6.5).
        feasible: (N,) v_trj F, the term of STFR (6.7).
        trajectory_correct: (N,) v_trj F R_lon R_lat, the term of TQSR (6.7).
        consistent: (N,) the term of ATC_eff (6.8).
        candidate: (N,) the record is a candidate for the risk response (6.9).
        defensive: (N,) a valid trajectory slows down where that is right, candidate or not (6.9).
        record_t_s: (N,) clip time of the record, s; NaN without one.
        risk_onset_s: t_r (6.9), clip time, s.
    """

    matched: Flags
    output_valid: Flags
    evaluable: Flags
    given: Flags
    hard: Numbers
    soft: Numbers
    interaction_evaluable: Flags
    interaction_correct: Flags
    action_correct: Flags
    feasible: Flags
    trajectory_correct: Flags
    consistent: Flags
    candidate: Flags
    defensive: Flags
    record_t_s: Numbers
    risk_onset_s: float

    def __len__(self) -> int:
        """N, the number of labels."""
        return len(self.matched)


def record_terms(score: CellScore) -> RecordTerms:
    """The terms of a scored cell."""
    items = score.details.judgements
    slots = [[item.slots[name] for name in SLOTS] for item in items]

    def flags(values: list[bool]) -> Flags:
        return np.array(values, dtype=np.bool_)

    return RecordTerms(
        matched=flags([item.record is not None for item in items]),
        output_valid=flags([item.text_valid and item.trajectory_valid for item in items]),
        evaluable=np.array([[slot.evaluable for slot in row] for row in slots], dtype=np.bool_),
        given=np.array(
            [[slot.evaluable and slot.given for slot in row] for row in slots], dtype=np.bool_
        ),
        hard=np.array([[slot.h or 0.0 for slot in row] for row in slots]),
        soft=np.array([[slot.s or 0.0 for slot in row] for row in slots]),
        interaction_evaluable=flags([item.interaction_evaluable for item in items]),
        interaction_correct=flags(
            [item.interaction_evaluable and item.interaction_correct for item in items]
        ),
        action_correct=flags([item.action_correct for item in items]),
        feasible=flags([item.feasible_valid for item in items]),
        trajectory_correct=flags([item.trajectory_correct for item in items]),
        consistent=flags([item.consistent for item in items]),
        candidate=flags([item.candidate for item in items]),
        defensive=flags([item.defensive for item in items]),
        record_t_s=np.array(
            [np.nan if item.record_t_s is None else item.record_t_s for item in items]
        ),
        risk_onset_s=score.details.risk_onset_s,
    )
