"""What answers in slots are worth (METHOD 6.3, 6.4): h and s by the codes of answer and truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from ssp_core.vocabulary import OBJECTS
from ssp_eval.data.records import VOCABULARIES
from ssp_eval.score.columns import NOTHING, Columns, Flags, Numbers, Whole
from ssp_eval.score.thresholds import Thresholds

Value = str | tuple[str, ...]
SLOTS = ("objects", "position", "motion", "conflict")
DYNAMIC_SLOTS = ("motion", "conflict")
INTERACTION_SLOTS = ("objects", "position", "motion")
# Classes that a careful reader may take for each other (METHOD 6.3); the order doesn't matter.
ADJACENT = frozenset(
    frozenset(pair)
    for pair in (
        ("front", "front_left"),
        ("front", "front_right"),
        ("left", "front_left"),
        ("right", "front_right"),
        ("potential", "active"),
        ("no_conflict", "resolved"),
    )
)


def object_f1(answer: Iterable[str], truth: Iterable[str]) -> float:
    """Set F1 = 2|Ô∩O| / (|Ô|+|O|), and 1 when both are empty (METHOD 6.3)."""
    given, true = set(answer), set(truth)
    if not given and not true:
        return 1.0
    return 2 * len(given & true) / (len(given) + len(true))


def hard_score(answer: Value, truth: Value) -> float:
    """h of METHOD 6.3: set F1 for a set of objects, exact match for a word."""
    if isinstance(answer, str) or isinstance(truth, str):
        return float(answer == truth)
    return object_f1(answer, truth)


def soft_score(answer: Value, truth: Value, credit: float) -> float:
    """s of METHOD 6.3: as h, but ``credit`` for adjacent classes."""
    if isinstance(answer, str) and isinstance(truth, str) and {answer, truth} in ADJACENT:
        return credit
    return hard_score(answer, truth)


_DYNAMIC = [SLOTS.index(name) for name in DYNAMIC_SLOTS]
_INTERACTION = [SLOTS.index(name) for name in INTERACTION_SLOTS]


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
        answer: (L, 6) codes of the matched records.
        earliest: (C,) the row of each cell's earliest label.
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
