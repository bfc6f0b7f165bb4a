"""Extracted slots against labelled ones; counts only, and shares worked out from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Any

from ssp_core.vocabulary import OBJECTS
from ssp_eval.data.records import SLOT_NAMES, Slot, Slots
from ssp_eval.extract.measure.corpus import STYLES, Example
from ssp_eval.extract.measure.intervals import Share

EMPTY = "–"
NOBODY = "nobody"


@dataclass
class Score:
    """Answers against labels.

    Args:
        given: answers of the extractor.
        wanted: labels.
        right: answers that are the label.
    """

    given: int = 0
    wanted: int = 0
    right: int = 0

    @property
    def precision(self) -> Share:
        return Share(self.right, self.given)

    @property
    def recall(self) -> Share:
        return Share(self.right, self.wanted)

    @property
    def f1(self) -> float | None:
        """Harmonic mean of both; None where there was neither answer nor label."""
        both = self.given + self.wanted
        return 2 * self.right / both if both else None

    def add(self, given: int, wanted: int, right: int) -> None:
        self.given += given
        self.wanted += wanted
        self.right += right

    def to_json(self) -> dict[str, Any]:
        shares = {"precision": self.precision, "recall": self.recall}
        return {
            "given": self.given,
            "wanted": self.wanted,
            "right": self.right,
            "f1": self.f1,
            **{name: share.value for name, share in shares.items()},
            **{f"{name}_95": share.interval for name, share in shares.items()},
        }


@dataclass
class Spans:
    """Where the evidence of right answers lies, one count per answer.

    Args:
        inside: every span lies within a labelled one.
        overlapping: at least one span overlaps a labelled one, but not all lie within.
        elsewhere: none does.
    """

    inside: int = 0
    overlapping: int = 0
    elsewhere: int = 0

    def add(self, given: Slot, wanted: Slot) -> None:
        """Counts one right answer."""
        labelled = wanted.evidence
        if all(any(a <= s and e <= b for a, b in labelled) for s, e in given.evidence):
            self.inside += 1
        elif any(a < e and s < b for a, b in labelled for s, e in given.evidence):
            self.overlapping += 1
        else:
            self.elsewhere += 1

    def to_json(self) -> dict[str, int]:
        return dict(vars(self))


@dataclass(frozen=True)
class Miss:
    """A slot that came out otherwise than labelled."""

    key: str
    slot: str
    wanted: str
    given: str


@dataclass
class Measure:
    """All counts over a corpus.

    Args:
        texts: number of them.
        slots: by slot; ``all`` is over all of them.
        classes: of objects, each counted by itself.
        styles: by style, each by slot and ``all``.
        confusion: by slot: (wanted, given) and how often; EMPTY is none.
        spans: by slot.
        misses: in the order of the corpus.
    """

    texts: int = 0
    slots: dict[str, Score] = field(default_factory=lambda: _scores())
    classes: dict[str, Score] = field(default_factory=lambda: {name: Score() for name in OBJECTS})
    styles: dict[str, dict[str, Score]] = field(default_factory=dict)
    confusion: dict[str, Counter[tuple[str, str]]] = field(
        default_factory=lambda: {name: Counter() for name in SLOT_NAMES}
    )
    spans: dict[str, Spans] = field(default_factory=lambda: {name: Spans() for name in SLOT_NAMES})
    misses: list[Miss] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        """All figures for programs."""
        styles = [style for style in STYLES if style in self.styles]
        return {
            "schema": "ssp.extraction_measure/1",
            "texts": self.texts,
            "slots": _json(self.slots),
            "object_classes": _json(self.classes),
            "styles": {style: _json(self.styles[style]) for style in styles},
            "confusion": {
                name: [
                    {"wanted": wanted, "given": given, "count": count}
                    for (wanted, given), count in sorted(counts.items())
                ]
                for name, counts in self.confusion.items()
            },
            "spans": {name: spans.to_json() for name, spans in self.spans.items()},
            "misses": [vars(miss) for miss in self.misses],
        }


def measure(examples: Iterable[Example], extract: Callable[[str], Slots]) -> Measure:
    """Extracts from each text, which is all that the extractor sees, and compares.

    Args:
        examples: labelled texts.
        extract: text to slots.
    """
    found = Measure()
    for example in examples:
        slots = extract(example.text)
        found.texts += 1
        style = found.styles.setdefault(example.style, _scores())
        for name in SLOT_NAMES:
            given, wanted = getattr(slots, name), getattr(example.slots, name)
            _compare(found, style, example.key, name, given, wanted)
    return found


def shown(slot: Slot | None) -> str:
    """A slot's value as one word or several; objects in the vocabulary's order."""
    if slot is None:
        return EMPTY
    if isinstance(slot.value, str):
        return slot.value
    return "+".join(name for name in OBJECTS if name in slot.value) or NOBODY


def _compare(
    found: Measure,
    style: dict[str, Score],
    key: str,
    name: str,
    given: Slot | None,
    wanted: Slot | None,
) -> None:
    is_right = given is not None and wanted is not None and shown(given) == shown(wanted)
    counts = (int(given is not None), int(wanted is not None), int(is_right))
    for scores in (found.slots, style):
        scores[name].add(*counts)
        scores["all"].add(*counts)
    if name == "objects":
        theirs = () if given is None else given.value
        ours = () if wanted is None else wanted.value
        for one in OBJECTS:
            both = one in theirs and one in ours
            found.classes[one].add(int(one in theirs), int(one in ours), int(both))
    found.confusion[name][shown(wanted), shown(given)] += 1
    if given is not None and wanted is not None and is_right:
        found.spans[name].add(given, wanted)
    elif shown(given) != shown(wanted):
        found.misses.append(Miss(key, name, shown(wanted), shown(given)))


def _scores() -> dict[str, Score]:
    return {name: Score() for name in (*SLOT_NAMES, "all")}


def _json(scores: dict[str, Score]) -> dict[str, Any]:
    return {name: score.to_json() for name, score in scores.items()}
