"""Semantics (METHOD 6.3) and critical interaction accuracy (METHOD 6.4)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from ssp_eval.labels.model import Label
from ssp_eval.records import BehaviourRecord, Slot
from ssp_eval.score.ratio import ratio
from ssp_eval.score.validity import slot_given

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

Value = str | tuple[str, ...]


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


def score_slots(
    label: Label, record: BehaviourRecord | None, dynamics_masked: bool, soft_credit: float
) -> dict[str, SlotScore]:
    """The four slots of METHOD 6.3 at one label, by name.

    Args:
        label: what is true.
        record: the matched output, None for a missing one.
        dynamics_masked: motion and conflict aren't evaluable here (the earliest label).
        soft_credit: s of adjacent classes.
    """
    scores = {}
    for name in SLOTS:
        truth: Value | None = getattr(label, name)
        slot: Slot | None = getattr(record.slots, name) if record is not None else None
        given = record is not None and slot_given(slot, record.text)
        answer = slot.value if given and slot is not None else None
        evaluable = truth is not None and not (dynamics_masked and name in DYNAMIC_SLOTS)
        h = s = None
        if evaluable and truth is not None:
            h = hard_score(answer, truth) if answer is not None else 0.0
            s = soft_score(answer, truth, soft_credit) if answer is not None else 0.0
        scores[name] = SlotScore(evaluable, given, h, s, answer, truth)
    return scores


@dataclass(frozen=True)
class SemanticRatios:
    """The four ratios of METHOD 6.3 and their common denominator Σe."""

    coverage: float | None
    accuracy_conditional: float | None
    accuracy_effective: float | None
    accuracy_soft: float | None
    evaluable: int


def semantic_ratios(scores: Iterable[SlotScore]) -> SemanticRatios:
    """SemCov, SemAcc_cond, SemAcc_eff and SemAcc_soft over all slots of all labels (6.3)."""
    evaluable = [score for score in scores if score.evaluable]
    given = [score for score in evaluable if score.given]
    hard = [score.h for score in given if score.h is not None]
    soft = [score.s for score in given if score.s is not None]
    return SemanticRatios(
        coverage=ratio((1.0 for _ in given), len(evaluable)),
        accuracy_conditional=ratio(hard, len(given)),
        accuracy_effective=ratio(hard, len(evaluable)),
        accuracy_soft=ratio(soft, len(evaluable)),
        evaluable=len(evaluable),
    )


def interaction_evaluable(slots: Mapping[str, SlotScore]) -> bool:
    """E of METHOD 6.4: objects, position and motion are all evaluable."""
    return all(slots[name].evaluable for name in INTERACTION_SLOTS)


def interaction_correct(slots: Mapping[str, SlotScore]) -> bool:
    """C of METHOD 6.4: objects, position and motion are all given and exactly right."""
    return all(slots[name].given and slots[name].h == 1.0 for name in INTERACTION_SLOTS)
