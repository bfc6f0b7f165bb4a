"""Precision and recall on texts that were written and labelled apart from the rules.

``python ssp_eval/test/blind_measure.py`` prints both by half, slot and style, for the rules and
with the reader too; ``--misses`` names what the rules miss in the open half. The half that is
held out is measured, never read.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ssp_eval.data.records import SLOT_NAMES, Slots
from ssp_eval.extract import extract
from ssp_eval.extract.combined.extractor import Extractor

CORPUS = Path(__file__).parent / "corpus"
HELD_OUT, OPEN = "held out", "open"


class Tally(NamedTuple):
    """Slots by how they were answered.

    An answer is right where one of the labellers gave it, or holds that it can be defended. A slot
    is wanted where all of them filled it.
    """

    given: int = 0
    right: int = 0
    wanted: int = 0
    found: int = 0

    @classmethod
    def of(cls, value: Any, right: Iterable[Any]) -> Tally:
        """The tally of one slot.

        Args:
            value: given for it, None for none.
            right: the values that can be defended, None among them where it may stay empty.
        """
        hit, must = value is not None and value in right, None not in right
        return cls(value is not None, hit, must, must and hit)

    def plus(self, other: Tally) -> Tally:
        return Tally(*(a + b for a, b in zip(self, other, strict=True)))

    @property
    def precision(self) -> float:
        return self.right / max(self.given, 1)

    @property
    def recall(self) -> float:
        return self.found / max(self.wanted, 1)


def load(name: str, half: str) -> list[dict[str, Any]]:
    """The texts of one half of a corpus file."""
    lines = (CORPUS / name).read_text(encoding="utf-8").splitlines()
    return [row for row in map(json.loads, lines) if row["half"] == half]


def tallies(
    rows: Iterable[dict[str, Any]], slots_of: Callable[[str], Slots] = extract
) -> Iterator[tuple[dict[str, Any], str, Any, Tally]]:
    """Each slot of each text with what is given for it."""
    for row in rows:
        slots = slots_of(row["text"])
        for name in SLOT_NAMES:
            slot = getattr(slots, name)
            given = None if slot is None else _plain(slot.value)
            right = {value for label in row["labels"] for value in _defended(label[name])}
            yield row, name, given, Tally.of(given, right)


def total(found: Iterable[tuple[dict[str, Any], str, Any, Tally]]) -> Tally:
    """The sum over slots."""
    return summed(tally for _, _, _, tally in found)


def summed(some: Iterable[Tally]) -> Tally:
    """The sum of tallies."""
    result = Tally()
    for one in some:
        result = result.plus(one)
    return result


def _plain(value: Any) -> Any:
    return tuple(sorted(value)) if isinstance(value, list | tuple | set | frozenset) else value


def _defended(label: dict[str, Any] | None) -> set[Any]:
    return {None} if label is None else {_plain(v) for v in (label["value"], *label["also"])}


def main() -> None:
    """Print the table."""
    extractor = Extractor()
    for name, half in (("blind.jsonl", HELD_OUT), ("blind.jsonl", OPEN), ("single.jsonl", OPEN)):
        rows = load(name, half)
        found = list(tallies(rows))
        with_reader = tallies(rows, lambda text: extractor(text).slots)
        groups: dict[str, list[tuple[Tally, Tally]]] = {}
        for (row, slot, _, alone), (_, _, _, both) in zip(found, with_reader, strict=True):
            style = f"{row['style']}, {'plain' if row['plain'] else 'hard'}"
            for group in ("all", slot, style):
                groups.setdefault(group, []).append((alone, both))
        print(f"{name}, {half}: {len(rows)} texts; rules, rules and reader")
        for group, members in groups.items():
            alone, both = (summed(column) for column in zip(*members, strict=True))
            print(
                f"  {group:14s} {alone.precision:.3f} / {alone.recall:.3f}   "
                f"{both.precision:.3f} / {both.recall:.3f}  of {both.wanted}"
            )
        if "--misses" in sys.argv and half == OPEN:
            for row, slot, given, one in found:
                if one.given > one.right or one.wanted > one.found:
                    labels = [label[slot] for label in row["labels"]]
                    print(f"{row['id']} {slot}: {given}, labelled {labels}\n    {row['text']!r}")


if __name__ == "__main__":
    main()
