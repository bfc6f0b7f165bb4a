"""The slots that the learned reader fills, and the answers of the rules that it takes back."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cache, cached_property
from pathlib import Path

import numpy as np

from ssp_core.hashing import sha256_bytes, sha256_json
from ssp_eval.data.records import SLOT_NAMES, Slot, Slots
from ssp_eval.extract.checks import check
from ssp_eval.extract.engine import Reading
from ssp_eval.extract.llm.judge import TextUnderReview
from ssp_eval.extract.llm.reply import Proposal
from ssp_eval.extract.reader.candidates import Candidate, of_classes, of_labels
from ssp_eval.extract.reader.clauses import ClauseSpan, View, view
from ssp_eval.extract.reader.weights import (
    CLASS,
    COLUMNS,
    FILE,
    Weights,
    load_weights,
    share_of_class,
    shares_of_labels,
)
from ssp_eval.extract.scope import Scope

_MOST_WORDS = 8  # of a quote
_PRICE = 5.0  # hundredths that a further word of a quote must add
_MOST_QUOTES = 4  # that are tried for a label
FILL_FROM = 0.8  # the certainty from which a slot that the rules left empty is filled
KEEP_FROM = 0.7  # and from which an answer of the rules stays
FEW_CLAUSES = 3  # of a text in which nothing is taken back: it says too little against the rules
_FILES = ("clauses.py", "candidates.py", "weights.py", "reader.py", FILE.name)


@dataclass(frozen=True)
class Judgement:
    """The reader's judgement of the rules' slots.

    Args:
        slots: of rules and reader together.
        filled: names of the slots that the reader filled.
        withdrawn: names of the slots whose answer of the rules it took back.
    """

    slots: Slots
    filled: tuple[str, ...] = ()
    withdrawn: tuple[str, ...] = ()


def complete(text: str, reading: Reading) -> Judgement:
    """Fill slots that the rules left empty, and take back answers that aren't sure enough.

    Args:
        text: a model's text.
        reading: what the rules made of it.
    """
    weights = load_weights()
    clause_view = view(reading)
    if not clause_view.clauses:
        return Judgement(reading.slots)
    support = Support(text, reading, clause_view, weights)
    changed: dict[str, Slot | None] = {}
    for name, candidates in all_candidates(weights, clause_view, reading.slots).items():
        slot = getattr(reading.slots, name)
        certain = {one.value: weights.certainty(name, one) for one in candidates}
        if slot is not None and certain.get(slot.value, 1.0) >= KEEP_FROM:
            continue
        best = max(candidates, key=lambda one: certain[one.value], default=None)
        sure = best is not None and certain[best.value] >= FILL_FROM
        if best is None or not sure or (name == "motion" and _is_over(best, reading.slots)):
            replacement = None
        else:
            replacement = support.slot(name, best)
        is_replaced = name == "lon_action" and slot is not None and replacement is not None
        if is_replaced and support.is_later(replacement) and not support.is_later(slot):
            continue  # I brake, then keep my speed
        if replacement is not None or (slot is not None and len(clause_view.clauses) > FEW_CLAUSES):
            changed[name] = replacement
    filled = tuple(name for name, slot in changed.items() if slot is not None)
    withdrawn = tuple(name for name, slot in changed.items() if slot is None)
    return Judgement(replace(reading.slots, **changed), filled, withdrawn)


def _is_over(motion: Candidate, slots: Slots) -> bool:
    """Tell whether a movement has ended: a finished crossing is no motion."""
    over = slots.conflict is not None and slots.conflict.value == "resolved"
    return over and str(motion.value).startswith(("crossing", "cutting"))


def all_candidates(
    weights: Weights, clause_view: View, slots: Slots
) -> Mapping[str, list[Candidate]]:
    """Return the candidates of each slot, with what speaks for them."""
    sums = np.array([weights.sums(features) for features in clause_view.features])
    candidates = {}
    for name in SLOT_NAMES:
        if name == CLASS:
            shares = {
                one: share_of_class(weights.sums(features)[-1])
                for one, features in clause_view.classes.items()
            }
            candidates[name] = of_classes(shares, slots, len(clause_view.clauses))
        else:
            shares_of = shares_of_labels(sums[:, weights.columns(name)])
            candidates[name] = of_labels(name, shares_of, slots)
    return candidates


@dataclass(frozen=True)
class Support:
    """The words of a text that may support a value, held to the checks for an LLM's quotes."""

    text: str
    reading: Reading
    seen: View
    weights: Weights

    @cached_property
    def _bench(self) -> TextUnderReview:
        return TextUnderReview(self.text)

    def slot(self, name: str, candidate: Candidate) -> Slot | None:
        """Return the slot with its evidence, or None where no words pass."""
        if name == CLASS:
            places = [self._place(name, one, [self.mention(one)]) for one in candidate.value]
        else:
            quotes = self.quotes(name, str(candidate.value), candidate.clause)
            places = [self._place(name, str(candidate.value), quotes)]
        spans = tuple(sorted(place for place in places if place is not None))
        if len(spans) < len(places):
            return None
        return check(self.text, name, Slot(candidate.value, spans))

    def is_later(self, slot: Slot | None) -> bool:
        """Tell whether an action's evidence is a later step of a plan."""
        return slot is not None and any(
            flags & Scope.LATER and start <= self.reading.tokens.span(hit.first, hit.stop)[0] < end
            for hit, flags in zip(self.reading.hits, self.reading.flags, strict=True)
            for start, end in slot.evidence
        )

    def _place(self, name: str, label: str, quotes: Iterable[str]) -> tuple[int, int] | None:
        """Find the place of the first quote that supports a label."""
        for quote in quotes:
            place = self._bench.weigh(Proposal(name, label, quote))
            if not isinstance(place, str):
                return place
        return None

    def mention(self, name: str) -> str:
        """Return the first words that name a class of road users."""
        hit = next(one for one in self.reading.hits if (one.kind, one.value) == ("user", name))
        return self._words(hit.first, hit.stop)

    def quotes(self, name: str, label: str, clause: int) -> Iterator[str]:
        """Pieces of a clause, those whose words speak most for a label first."""
        first, stop, _ = self.seen.clauses[clause]
        worth = self._worth(self.seen.clauses[clause], COLUMNS.index(f"{name}:{label}"))
        pieces = [
            (sum(worth[a:b]) - _PRICE * (b - a), first + a, first + b)
            for a in range(stop - first)
            for b in range(a + 1, min(a + _MOST_WORDS, stop - first) + 1)
        ]
        for _, a, b in sorted(pieces, key=lambda one: (-one[0], one[1:]))[:_MOST_QUOTES]:
            yield self._words(a, b)
        yield self._words(first, stop)

    def _words(self, first: int, stop: int) -> str:
        start, end = self.reading.tokens.span(first, stop)
        return self.text[start:end]

    def _worth(self, clause: ClauseSpan, column: int) -> list[float]:
        """Compute what each word of a clause, alone and with its neighbours, adds for a column."""
        words = self.reading.tokens.words[clause.first : clause.stop]
        worth = [0.0] * len(words)
        for at, word in enumerate(words):
            for name, length in ((f"w:{word}", 1), (f"b:{' '.join(words[at : at + 2])}", 2)):
                row = self.weights.rows.get(name)
                for one in range(at, at + length) if row is not None else ():
                    worth[one] += float(self.weights.table[row, column]) / length
        for hit in self.reading.hits:
            row = self.weights.rows.get(f"h:{hit.kind}:{hit.value}")
            if row is not None and clause.first <= hit.first and hit.stop <= clause.stop:
                for one in range(hit.first, hit.stop):
                    part = float(self.weights.table[row, column]) / (hit.stop - hit.first)
                    worth[one - clause.first] += part
        return worth


@cache
def reader_hash() -> str:
    """Hash of the weights and of what reads them, ``sha256:<hex>``."""
    folder = Path(__file__).parent
    return sha256_json({name: sha256_bytes((folder / name).read_bytes()) for name in _FILES})
