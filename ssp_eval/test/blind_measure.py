"""Precision and recall of the rules on texts that were written and labelled apart from them.

``python ssp_eval/test/blind_measure.py`` prints both by half, slot and style; ``--misses`` names
what is missed in the open half. The half that is held out is measured, never read.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.extract import extract

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


def tallies(rows: Iterable[dict[str, Any]]) -> Iterator[tuple[dict[str, Any], str, Any, Tally]]:
    """Each slot of each text with what the rules give for it."""
    for row in rows:
        slots = extract(row["text"])
        for name in SLOT_NAMES:
            slot = getattr(slots, name)
            given = None if slot is None else _plain(slot.value)
            right = {value for label in row["labels"] for value in _defended(label[name])}
            hit = given is not None and given in right
            must = None not in right
            yield row, name, given, Tally(given is not None, hit, must, must and hit)


def total(found: Iterable[tuple[dict[str, Any], str, Any, Tally]]) -> Tally:
    """The sum over slots."""
    result = Tally()
    for _, _, _, tally in found:
        result = result.plus(tally)
    return result


def _plain(value: Any) -> Any:
    return tuple(sorted(value)) if isinstance(value, list | tuple | set | frozenset) else value


def _defended(label: dict[str, Any] | None) -> set[Any]:
    return {None} if label is None else {_plain(v) for v in (label["value"], *label["also"])}


def main() -> None:
    """Print the table."""
    for name, half in (("blind.jsonl", HELD_OUT), ("blind.jsonl", OPEN), ("single.jsonl", OPEN)):
        found = list(tallies(load(name, half)))
        groups = {"all": found}
        for slot in SLOT_NAMES:
            groups[slot] = [one for one in found if one[1] == slot]
        for one in found:
            style = f"{one[0]['style']}, {'plain' if one[0]['plain'] else 'hard'}"
            groups.setdefault(style, []).append(one)
        print(f"{name}, {half}: {len(found) // len(SLOT_NAMES)} texts")
        for group, members in groups.items():
            both = total(members)
            print(f"  {group:14s} {both.precision:.3f} / {both.recall:.3f}  of {both.wanted}")
        if "--misses" in sys.argv and half == OPEN:
            for row, slot, given, one in found:
                if one.given > one.right or one.wanted > one.found:
                    labels = [label[slot] for label in row["labels"]]
                    print(f"{row['id']} {slot}: {given}, labelled {labels}\n    {row['text']!r}")


if __name__ == "__main__":
    main()
