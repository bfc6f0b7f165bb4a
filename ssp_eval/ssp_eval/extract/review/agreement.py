"""The agreement of two reviewers, and of the extractor with them where they agree."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ssp_core.vocabulary import OBJECTS
from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.extract.measure import Estimate, Score, share
from ssp_eval.extract.review.answers import BETWEEN, NONE, UNSURE, Answers, KeyItem

Z_95 = 1.959963984540054  # quantile of the normal distribution for two-sided 95 %


@dataclass(frozen=True)
class SlotReview:
    """One slot over all texts.

    Args:
        judged: texts of which both reviewers were sure.
        unsure: the others.
        agreement: share of the judged on which they agree.
        kappa: with each combination of classes as an answer of its own for objects.
        overlap: of objects, mean share of the named classes that both named; None for others.
        score: the extractor against what both agree on.
    """

    judged: int
    unsure: int
    agreement: Estimate
    kappa: Estimate
    overlap: float | None
    score: Score


@dataclass(frozen=True)
class Disagreement:
    """An answer to settle."""

    review_id: str
    slot: str
    first: str
    second: str


@dataclass(frozen=True)
class Error:
    """A slot that the extractor has otherwise than both reviewers.

    Args:
        kind: ``false_positive`` where it gave an answer that isn't theirs, ``false_negative``
            where it gave none and they did, ``wrong`` where both gave one and they differ (it
            counts against precision and recall alike).
    """

    review_id: str
    source_id: str | int
    slot: str
    kind: str
    agreed: str
    extracted: str


@dataclass(frozen=True)
class Review:
    """All that comes out of a review."""

    texts: int
    slots: Mapping[str, SlotReview]
    disagreements: tuple[Disagreement, ...]
    errors: tuple[Error, ...]

    def to_json(self) -> dict[str, Any]:
        """All figures for programs."""
        return {
            "schema": "ssp.extraction_review/1",
            "texts": self.texts,
            "slots": {
                name: {
                    "judged": slot.judged,
                    "unsure": slot.unsure,
                    "agreement": slot.agreement.value,
                    "agreement_95": slot.agreement.interval,
                    "kappa": slot.kappa.value,
                    "kappa_95": slot.kappa.interval,
                    "object_overlap": slot.overlap,
                    "extractor": slot.score.to_json(),
                }
                for name, slot in self.slots.items()
            },
            "disagreements": [vars(one) for one in self.disagreements],
            "errors": [vars(one) for one in self.errors],
        }


def compare(items: Sequence[KeyItem], first: Answers, second: Answers) -> Review:
    """Return the review of two people's answers to each item of the key."""
    slots = {}
    disagreements: list[Disagreement] = []
    errors: list[Error] = []
    for name in SLOT_NAMES:
        pairs = [(first[item.review_id][name], second[item.review_id][name]) for item in items]
        sure = [pair for pair in pairs if UNSURE not in pair]
        agreed = []
        for item, (one, other) in zip(items, pairs, strict=True):
            if one != other or one == UNSURE:
                disagreements.append(Disagreement(item.review_id, name, one, other))
                continue
            extracted = item.extracted[name]
            agreed.append((extracted, one))
            if extracted != one:
                missed = "false_negative" if extracted == NONE else "wrong"
                kind = "false_positive" if one == NONE else missed
                errors.append(Error(item.review_id, item.source_id, name, kind, one, extracted))
        slots[name] = SlotReview(
            judged=len(sure),
            unsure=len(pairs) - len(sure),
            agreement=share(sum(one == other for one, other in sure), len(sure)),
            kappa=cohens_kappa(sure),
            overlap=_overlap(sure) if name == "objects" else None,
            score=Score(
                given=sum(extracted != NONE for extracted, _ in agreed),
                wanted=sum(label != NONE for _, label in agreed),
                right=sum(extracted == label != NONE for extracted, label in agreed),
            ),
        )
    disagreements.sort(key=lambda one: one.review_id)
    errors.sort(key=lambda one: one.review_id)
    return Review(len(items), slots, tuple(disagreements), tuple(errors))


def cohens_kappa(pairs: Sequence[tuple[str, str]]) -> Estimate:
    """Cohen's kappa: agreement of two people beyond what their habits alone would give.

    kappa = (p_o - p_e) / (1 - p_e), where p_o is the share of equal answers and p_e the one that
    their margins give by chance. It has no sense where both gave one and the same answer
    throughout. Its 95 % interval comes from the large-sample standard error of Fleiss, Cohen and
    Everitt.

    Args:
        pairs: both answers to each question.
    """
    count = len(pairs)
    joint = {pair: number / count for pair, number in Counter(pairs).items()}
    rows = {k: n / count for k, n in Counter(pair[0] for pair in pairs).items()}
    columns = {k: n / count for k, n in Counter(pair[1] for pair in pairs).items()}
    chance = sum(part * columns.get(label, 0.0) for label, part in rows.items())
    if count == 0 or chance > 1.0 - 1e-12:
        return Estimate(None, None)
    equal = sum(part for (one, other), part in joint.items() if one == other)
    kappa = (equal - chance) / (1 - chance)
    spread = -((kappa - chance * (1 - kappa)) ** 2)
    for (one, other), part in joint.items():
        margins = columns.get(one, 0.0) + rows.get(other, 0.0)
        own = 1.0 if one == other else 0.0
        spread += part * (own - margins * (1 - kappa)) ** 2
    error = math.sqrt(max(spread, 0.0) / count) / (1 - chance)
    return Estimate(kappa, (max(kappa - Z_95 * error, -1.0), min(kappa + Z_95 * error, 1.0)))


def _overlap(pairs: Sequence[tuple[str, str]]) -> float | None:
    """Mean of shared classes over named ones; without classes, whether both say the same."""
    shares = []
    for one, other in pairs:
        first, second = (set(text.split(BETWEEN)) & set(OBJECTS) for text in (one, other))
        union = first | second
        shares.append(len(first & second) / len(union) if union else float(one == other))
    return sum(shares) / len(shares) if shares else None
