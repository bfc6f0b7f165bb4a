"""Semantics, allowed actions and candidates (METHOD 6.3 to 6.9) for all labels of many cells.

ssp_eval.score.judge decides the same label by label and keeps the reasons; the tests hold the two
to each other. Words are the codes of ssp_eval.score.columns.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from ssp_core.vocabulary import CONFLICTS, LON_ACTIONS, OBJECTS
from ssp_eval.records import VOCABULARIES
from ssp_eval.score.columns import NOTHING, Columns, Flags, Numbers, Whole
from ssp_eval.score.risk import DEFENSIVE_ACTIONS, RISKY_CONFLICTS
from ssp_eval.score.semantics import (
    DYNAMIC_SLOTS,
    INTERACTION_SLOTS,
    SLOTS,
    hard_score,
    soft_score,
)
from ssp_eval.score.thresholds import Thresholds
from ssp_eval.score.validity import Value

_DYNAMIC = [SLOTS.index(name) for name in DYNAMIC_SLOTS]
_INTERACTION = [SLOTS.index(name) for name in INTERACTION_SLOTS]
# By code; NOTHING, which is -1, picks the last item.
_RISKY = np.array([word in RISKY_CONFLICTS for word in (*CONFLICTS, None)])
_DEFENSIVE = np.array([word in DEFENSIVE_ACTIONS for word in (*LON_ACTIONS, None)])


@dataclass(frozen=True, eq=False)
class Semantics:
    """The slots of METHOD 6.3, one row per label, and the interaction of METHOD 6.4.

    Args:
        evaluable: (L, 4) e.
        given: (L, 4) e z.
        hard: (L, 4) e z h.
        soft: (L, 4) e z s.
        interaction_evaluable: (L,) E.
        interaction_correct: (L,) E C.
    """

    evaluable: Flags
    given: Flags
    hard: Numbers
    soft: Numbers
    interaction_evaluable: Flags
    interaction_correct: Flags


def _values(slot: str) -> list[Value]:
    """Every value that a slot can have, in the order of its codes."""
    if slot != "objects":
        return list(VOCABULARIES[slot])
    return [
        tuple(word for bit, word in enumerate(OBJECTS) if mask >> bit & 1)
        for mask in range(1 << len(OBJECTS))
    ]


def score_tables(soft_credit: float) -> tuple[tuple[Numbers, Numbers], ...]:
    """h and s of METHOD 6.3 per slot of SLOTS, by the codes of answer and truth.

    A last row of zeros stands for a missing answer, which NOTHING points at.
    """
    tables = []
    for slot in SLOTS:
        values = _values(slot)
        hard = np.zeros((len(values) + 1, len(values)))
        soft = np.zeros_like(hard)
        for (i, answer), (j, truth) in product(enumerate(values), enumerate(values)):
            hard[i, j] = hard_score(answer, truth)
            soft[i, j] = soft_score(answer, truth, soft_credit)
        tables.append((hard, soft))
    return tuple(tables)


_score_tables = lru_cache(maxsize=8)(score_tables)


def semantics(
    columns: Columns, answer: Whole, earliest: Whole, thresholds: Thresholds
) -> Semantics:
    """METHOD 6.3 and 6.4.

    Args:
        columns: the cells.
        answer: (L, 6) codes of the matched records.
        earliest: (C,) the row of each cell's earliest label.
        thresholds: the credit for adjacent classes.
    """
    truth = columns.labels.truth
    evaluable = truth != NOTHING
    masked = earliest[~columns.first_frame_dynamics]
    evaluable[masked[:, None], _DYNAMIC] = False
    given = evaluable & (answer[:, : len(SLOTS)] != NOTHING)
    hard, soft = np.zeros(truth.shape), np.zeros(truth.shape)
    for slot, (hard_table, soft_table) in enumerate(_score_tables(thresholds.soft_credit)):
        index = (answer[:, slot], truth[:, slot])
        hard[:, slot] = np.where(evaluable[:, slot], hard_table[index], 0.0)
        soft[:, slot] = np.where(evaluable[:, slot], soft_table[index], 0.0)
    interaction = np.logical_and.reduce([evaluable[:, slot] for slot in _INTERACTION])
    correct = np.logical_and.reduce([hard[:, slot] == 1.0 for slot in _INTERACTION])
    return Semantics(evaluable, given, hard, soft, interaction, interaction & correct)


def allowed(action: Whole, bits: Whole) -> Flags:
    """Whether an action's code is in the set whose bits a label allows; NOTHING never is."""
    result: Flags = (action != NOTHING) & ((bits >> np.maximum(action, 0)) & 1 == 1)
    return result


def risky(conflict: Whole) -> Flags:
    """Whether a label's conflict admits a candidate of METHOD 6.9."""
    result: Flags = _RISKY[conflict]
    return result


def slows_down(lon: Whole) -> Flags:
    """Whether an inferred action is one of those that METHOD 6.9 calls defensive."""
    result: Flags = _DEFENSIVE[lon]
    return result
