"""Semantics (METHOD 6.3) and critical interaction accuracy (METHOD 6.4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from operator import attrgetter, itemgetter

from ssp_eval.labels.model import Label
from ssp_eval.score.ratio import ratio
from ssp_eval.score.validity import Value

SLOTS = ("objects", "position", "motion", "conflict")
DYNAMIC_SLOTS = ("motion", "conflict")
INTERACTION_SLOTS = ("objects", "position", "motion")
_truths = attrgetter(*SLOTS)
_interaction: Callable[[Mapping[str, SlotScore]], tuple[SlotScore, SlotScore, SlotScore]] = (
    itemgetter(*INTERACTION_SLOTS)
)

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


@dataclass(frozen=True)
class SlotScore:
    """One slot at one label.

    Args:
        evaluable: e of METHOD 6.3.
        given: z, the record gives a value with evidence.
        h: 0..1, 0 where nothing is given, None where the slot isn't evaluable.
        s: as h, with credit for adjacent classes.
        answer: the value that the record gives with evidence.
        truth: the label's value.
    """

    evaluable: bool
    given: bool
    h: float | None
    s: float | None
    answer: Value | None
    truth: Value | None


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


@lru_cache(maxsize=1 << 14)
def score_slot(
    answer: Value | None, truth: Value | None, masked: bool, soft_credit: float
) -> SlotScore:
    """One slot (METHOD 6.3). Vocabularies are closed, so that few different ones ever come up.

    Args:
        answer: what the record gives with evidence, None where z = 0.
        truth: the label's value, None for null.
        masked: the slot isn't evaluable here, whatever the label says.
        soft_credit: s of adjacent classes.
    """
    given = answer is not None
    if truth is None or masked:
        return SlotScore(False, given, None, None, answer, truth)
    if answer is None:
        return SlotScore(True, False, 0.0, 0.0, None, truth)
    soft = soft_score(answer, truth, soft_credit)
    return SlotScore(True, True, hard_score(answer, truth), soft, answer, truth)


def score_slots(
    label: Label, answers: Sequence[Value | None], dynamics_masked: bool, soft_credit: float
) -> dict[str, SlotScore]:
    """The four slots of METHOD 6.3 at one label, by name.

    Args:
        label: what is true.
        answers: of the matched output in the order of SLOTS, None where z = 0; more are ignored.
        dynamics_masked: motion and conflict aren't evaluable here (the earliest label).
        soft_credit: s of adjacent classes.
    """
    return {
        name: score_slot(answer, truth, dynamics_masked and name in DYNAMIC_SLOTS, soft_credit)
        for name, answer, truth in zip(SLOTS, answers, _truths(label), strict=False)
    }


@dataclass(frozen=True)
class SemanticRatios:
    """The four ratios of METHOD 6.3 and their common denominator Σe."""

    coverage: float | None
    accuracy_conditional: float | None
    accuracy_effective: float | None
    accuracy_soft: float | None
    evaluable: int


def semantic_ratios(scores: Sequence[SlotScore]) -> SemanticRatios:
    """SemCov, SemAcc_cond, SemAcc_eff and SemAcc_soft over all slots of all labels (6.3)."""
    given = [score for score in scores if score.evaluable and score.given]
    hard = [score.h for score in given if score.h is not None]
    soft = [score.s for score in given if score.s is not None]
    e = sum([score.evaluable for score in scores])
    ez, ezh, ezs = len(given), math.fsum(hard), math.fsum(soft)
    return SemanticRatios(ratio(ez, e), ratio(ezh, ez), ratio(ezh, e), ratio(ezs, e), e)


def interaction_evaluable(slots: Mapping[str, SlotScore]) -> bool:
    """E of METHOD 6.4: objects, position and motion are all evaluable."""
    objects, position, motion = _interaction(slots)
    return objects.evaluable and position.evaluable and motion.evaluable


def interaction_correct(slots: Mapping[str, SlotScore]) -> bool:
    """C of METHOD 6.4: objects, position and motion are all given and exactly right."""
    objects, position, motion = _interaction(slots)
    return objects.h == position.h == motion.h == 1.0
