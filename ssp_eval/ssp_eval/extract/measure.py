"""The quality of an extractor on texts with known slots: precision, recall, confusion, spans.

A corpus has one JSON object per line::

    {"id": "a001", "style": "coc", "text": "Yield to the cyclist …",
     "slots": {"objects": {"value": ["cyclist"], "evidence": [[13, 20]]}, …, "lat_action": null}}

Unlike in behaviour records every span must lie in the text: a label with a span elsewhere is a
mistake of the file.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, NamedTuple, Self, get_args

from pydantic import model_validator

from ssp_core.errors import InputError
from ssp_core.files.reading import read_text
from ssp_core.proportion import wilson_interval
from ssp_core.run_file.values import Strict
from ssp_core.vocabulary import OBJECTS
from ssp_eval.data.labels import Name, Text
from ssp_eval.data.records import SLOT_NAMES, Slot, Slots, SlotsLine, parse_line, slots_of

StyleWord = Literal["coc", "staged", "verbose", "terse", "structured"]
EMPTY = "–"
NOBODY = "nobody"


class _Line(Strict):
    id: Name
    style: StyleWord
    text: Text
    slots: SlotsLine

    @model_validator(mode="after")
    def _is_supported(self) -> Self:
        slot: Any
        for name, slot in self.slots.items():
            if slot is None:
                continue
            if slot["value"] is None or not slot["evidence"]:
                raise ValueError(f"slots.{name}.evidence: must support a value by a span or more")
            if name == "objects" and len(set(slot["value"])) < len(slot["value"]):
                raise ValueError("slots.objects.value: names a class twice")
            for number, (start, end) in enumerate(slot["evidence"]):
                inside = 0 <= start < end <= len(self.text)
                if not inside or not self.text[start:end].strip():
                    raise ValueError(
                        f"slots.{name}.evidence[{number}]: [{start}, {end}] lies outside a text of "
                        f"{len(self.text)} characters, or covers blanks alone"
                    )
        return self


@dataclass(frozen=True)
class Example:
    """A text with what it says, and the words that say it."""

    key: str
    style: StyleWord
    text: str
    slots: Slots


def load_corpus(path: str | Path) -> tuple[Example, ...]:
    """Return the examples of a corpus file; raise InputError as parse_corpus."""
    return parse_corpus(read_text(path), path)


def parse_corpus(text: str, file: str | Path) -> tuple[Example, ...]:
    """Return the examples of a text of JSON lines; blank lines are passed over.

    Raises:
        InputError: the first thing that is wrong, with line and field, or there is no example.
    """
    examples: list[Example] = []
    lines: dict[str, int] = {}
    for number, content in enumerate(text.removeprefix("\ufeff").split("\n"), start=1):
        if not content.strip():
            continue
        line = parse_line(_Line, content, file, number)
        if (first := lines.setdefault(line.id, number)) != number:
            problem = f"stands in line {first} too"
            raise InputError(
                problem,
                file=file,
                line=number,
                field="id",
                value=line.id,
                remedy="give each text its own id",
            )
        examples.append(Example(line.id, line.style, line.text, slots_of(line.slots)))
    if not examples:
        raise InputError(
            "holds no text", file=file, remedy="give a file with texts, one JSON object a line"
        )
    return tuple(examples)


class Estimate(NamedTuple):
    """A figure with its 95 % interval; both None where it has no sense."""

    value: float | None
    interval: tuple[float, float] | None


def share(part: int, whole: int) -> Estimate:
    """So many of so many, with Wilson's score interval."""
    if whole == 0:
        return Estimate(None, None)
    return Estimate(part / whole, wilson_interval(part / whole, whole))


@dataclass(frozen=True)
class Score:
    """Answers against labels: how many there are of either, and how many answers are right."""

    given: int
    wanted: int
    right: int

    @property
    def precision(self) -> Estimate:
        return share(self.right, self.given)

    @property
    def recall(self) -> Estimate:
        return share(self.right, self.wanted)

    @property
    def f1(self) -> float | None:
        """Harmonic mean of both; None where there was neither answer nor label."""
        both = self.given + self.wanted
        return 2 * self.right / both if both else None

    def to_json(self) -> dict[str, Any]:
        precision, recall = self.precision, self.recall
        return {
            **vars(self),
            "f1": self.f1,
            "precision": precision.value,
            "recall": recall.value,
            "precision_95": precision.interval,
            "recall_95": recall.interval,
        }


class Row(NamedTuple):
    """A slot of a text, as it was labelled and as it came out."""

    key: str
    style: str
    slot: str
    wanted: Slot | None
    given: Slot | None

    @property
    def shown(self) -> tuple[str, str]:
        """Return the wanted and the given value."""
        return shown(self.wanted), shown(self.given)

    def span(self) -> str | None:
        """Return where the evidence of a right answer lies beside the label's."""
        if self.wanted is None or self.given is None or len(set(self.shown)) > 1:
            return None
        labelled, evidence = self.wanted.evidence, self.given.evidence
        if all(any(a <= s and e <= b for a, b in labelled) for s, e in evidence):
            return "inside"
        overlaps = any(a < e and s < b for a, b in labelled for s, e in evidence)
        return "overlapping" if overlaps else "elsewhere"


@dataclass(frozen=True)
class Measure:
    """An extractor on a corpus."""

    rows: tuple[Row, ...]

    @property
    def texts(self) -> int:
        return len(self.rows) // len(SLOT_NAMES)

    @property
    def slots(self) -> dict[str, Score]:
        """Score by slot; ``all`` is over all of them."""
        return _scores(self.rows)

    @property
    def classes(self) -> dict[str, Score]:
        """Score the objects, each counted by itself."""
        sets = [
            (set(row.given.value) if row.given else set(), row.wanted.value if row.wanted else ())
            for row in self.rows
            if row.slot == "objects"
        ]
        return {
            name: _score([(name in answer, name in label, True) for answer, label in sets])
            for name in OBJECTS
        }

    @property
    def styles(self) -> dict[str, dict[str, Score]]:
        """Score by style that the corpus has, each by slot and ``all``."""
        by_style = {s: [row for row in self.rows if row.style == s] for s in get_args(StyleWord)}
        return {style: _scores(rows) for style, rows in by_style.items() if rows}

    @property
    def confusion(self) -> dict[str, Counter[tuple[str, str]]]:
        """Count by slot the pairs (wanted, given); EMPTY is none."""
        return {
            name: Counter(row.shown for row in self.rows if row.slot == name) for name in SLOT_NAMES
        }

    @property
    def spans(self) -> dict[str, dict[str, int]]:
        """Count by slot where the evidence of right answers lies beside the label's.

        ``inside``: every span lies within a labelled one. ``overlapping``: at least one overlaps
        one. ``elsewhere``: none does.
        """
        counts = Counter((row.slot, row.span()) for row in self.rows)
        places = ("inside", "overlapping", "elsewhere")
        return {name: {place: counts[name, place] for place in places} for name in SLOT_NAMES}

    @property
    def misses(self) -> list[Row]:
        """List the rows whose result isn't the label, in the order of the corpus."""
        return [row for row in self.rows if len(set(row.shown)) > 1]

    def to_json(self) -> dict[str, Any]:
        """All figures for programs."""
        return {
            "schema": "ssp.extraction_measure/1",
            "texts": self.texts,
            "slots": _json(self.slots),
            "object_classes": _json(self.classes),
            "styles": {style: _json(scores) for style, scores in self.styles.items()},
            "confusion": {
                name: [
                    {"wanted": label, "given": answer, "count": count}
                    for (label, answer), count in sorted(counts.items())
                ]
                for name, counts in self.confusion.items()
            },
            "spans": self.spans,
            "misses": [
                {"key": row.key, "slot": row.slot, "wanted": row.shown[0], "given": row.shown[1]}
                for row in self.misses
            ],
        }


def measure(examples: Iterable[Example], extract: Callable[[str], Slots]) -> Measure:
    """Extract from each text, which is all that the extractor sees, and compare."""
    rows = [
        Row(example.key, example.style, name, getattr(example.slots, name), slot)
        for example in examples
        for name, slot in vars(extract(example.text)).items()
    ]
    return Measure(tuple(rows))


def shown(slot: Slot | None) -> str:
    """Return a slot's value as one word or several; objects in the vocabulary's order."""
    if slot is None:
        return EMPTY
    if isinstance(slot.value, str):
        return slot.value
    return "+".join(name for name in OBJECTS if name in slot.value) or NOBODY


def _scores(rows: Iterable[Row]) -> dict[str, Score]:
    answers: dict[str, list[tuple[bool, bool, bool]]] = {name: [] for name in (*SLOT_NAMES, "all")}
    for row in rows:
        one = (row.given is not None, row.wanted is not None, row.shown[0] == row.shown[1])
        answers[row.slot].append(one)
        answers["all"].append(one)
    return {name: _score(ones) for name, ones in answers.items()}


def _score(answers: list[tuple[bool, bool, bool]]) -> Score:
    """Score answers by whether each was given, was wanted, and is the same."""
    return Score(
        sum(has_answer for has_answer, _, _ in answers),
        sum(has_label for _, has_label, _ in answers),
        sum(has_answer and has_label and same for has_answer, has_label, same in answers),
    )


def _json(scores: dict[str, Score]) -> dict[str, Any]:
    return {name: score.to_json() for name, score in scores.items()}
