"""Precision and recall on texts that were written and labelled apart from the rules.

``python ssp_eval/test/blind_measure.py [--before CHECKOUT]`` prints both by half, slot and style:
of the rules, with the reader on what it hasn't learnt from, of another checkout's engine, and of
each labeller as the other one judges; ``--misses`` names what the rules miss in the open half. The
half that is held out is measured, never read.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from argparse import ArgumentParser
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ssp_eval.data.records import SLOT_NAMES, Slots
from ssp_eval.extract import extract
from ssp_eval.extract.combined.extractor import Extractor

CORPUS = Path(__file__).parent / "corpus"
HELD_OUT, OPEN = "held out", "open"
PARTS = (
    ("blind.jsonl", HELD_OUT),
    ("unseen.jsonl", HELD_OUT),
    ("blind.jsonl", OPEN),
    ("unseen.jsonl", OPEN),
    ("single.jsonl", OPEN),
)
PERMUTATIONS = 10_000
# Run by the other checkout's code: texts by line in, values of the slots by line out.
OTHER_ENGINE = """
import json, sys
from ssp_eval.extract import extract
for line in sys.stdin:
    slots = extract(json.loads(line))
    values = {n: getattr(getattr(slots, n), "value", None) for n in json.loads(sys.argv[1])}
    print(json.dumps(values, default=sorted))
"""
Found = tuple[dict[str, Any], str, Any, "Tally"]


class Tally(NamedTuple):
    """Slots by how they were answered.

    An answer is right where one of the labellers gave it, or holds that it can be defended. A slot
    is wanted where all of them filled it.
    """

    answer_count: int = 0
    right: int = 0
    required_count: int = 0
    hit_count: int = 0

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
        return self.right / max(self.answer_count, 1)

    @property
    def recall(self) -> float:
        return self.hit_count / max(self.required_count, 1)


def load(name: str, half: str) -> list[dict[str, Any]]:
    """The texts of one half of a corpus file."""
    lines = (CORPUS / name).read_text(encoding="utf-8").splitlines()
    return [row for row in map(json.loads, lines) if row["half"] == half]


def tallies(
    rows: Iterable[dict[str, Any]], slots_of: Callable[[str], Slots] = extract
) -> Iterator[Found]:
    """Each slot of each text with what is given for it."""
    for row in rows:
        slots = slots_of(row["text"])
        values = {name: getattr(getattr(slots, name), "value", None) for name in SLOT_NAMES}
        yield from row_tallies(row, values, row["labels"])


def row_tallies(
    row: dict[str, Any], values: Mapping[str, Any], labels: Sequence[dict[str, Any]]
) -> Iterator[Found]:
    """Each slot of one text, held against some labels of it."""
    for name in SLOT_NAMES:
        given = _plain(values[name])
        right = {value for label in labels for value in _defended(label[name])}
        yield row, name, given, Tally.of(given, right)


def of_labellers(rows: Iterable[dict[str, Any]]) -> Iterator[Found]:
    """Each slot as one labeller filled it and the other one judges it, and the other way round."""
    for row in rows:
        for one, other in (row["labels"], row["labels"][::-1]):
            values = {name: label and label["value"] for name, label in one.items()}
            yield from row_tallies(row, values, [other])


def of_other_engine(rows: Sequence[dict[str, Any]], checkout: Path) -> Iterator[Found]:
    """Each slot as the code of another checkout fills it."""
    folders = sorted({str(one.parent) for one in checkout.glob("ssp_*/ssp_*") if one.is_dir()})
    run = subprocess.run(
        [sys.executable, "-c", OTHER_ENGINE, json.dumps(SLOT_NAMES)],
        input="".join(json.dumps(row["text"]) + "\n" for row in rows),
        env={**os.environ, "PYTHONPATH": os.pathsep.join(folders)},
        capture_output=True,
        text=True,
        check=True,
    )
    for row, line in zip(rows, run.stdout.splitlines(), strict=True):
        yield from row_tallies(row, json.loads(line), row["labels"])


def p_of_difference(some: Sequence[Found], others: Sequence[Found]) -> tuple[float, float]:
    """Two-sided p of a difference in precision and in recall, by permutations paired by text."""
    by_text = [_by_text(some), _by_text(others)]
    both = np.array([[one[key] for key in by_text[0]] for one in by_text], dtype=float)
    drawn = np.random.default_rng(0).integers(0, 2, (PERMUTATIONS, both.shape[1]))
    swapped = [np.where(drawn[..., None], both[1 - i], both[i]).sum(axis=1) for i in (0, 1)]

    def differences(one: NDArray[np.float64], other: NDArray[np.float64]) -> NDArray[np.float64]:
        # precision: right of given; recall: found of wanted
        return one[..., [1, 3]] / one[..., [0, 2]] - other[..., [1, 3]] / other[..., [0, 2]]

    seen = abs(differences(both[0].sum(axis=0), both[1].sum(axis=0)))
    extreme = abs(differences(swapped[0], swapped[1])) >= seen - 1e-12
    precision, recall = (1 + extreme.sum(axis=0)) / (1 + PERMUTATIONS)
    return float(precision), float(recall)


def _by_text(found: Iterable[Found]) -> dict[str, Tally]:
    sums: dict[str, Tally] = {}
    for row, _, _, one in found:
        sums[row["id"]] = sums.get(row["id"], Tally()).plus(one)
    return sums


def total(found: Iterable[Found]) -> Tally:
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
    """Print the tables."""
    parser = ArgumentParser(description=__doc__)
    parser.add_argument("--before", type=Path, metavar="CHECKOUT", help="whose engine is measured")
    parser.add_argument("--misses", action="store_true", help="name them, of the open half")
    asked = parser.parse_args()
    extractor = Extractor()
    for name, half in PARTS:
        rows = load(name, half)
        measured = {"rules": list(tallies(rows))}
        if half == HELD_OUT:  # the reader has learnt from the others: train_reader.py crosses them
            measured["rules and reader"] = list(tallies(rows, lambda text: extractor(text).slots))
        if asked.before is not None:
            measured["before"] = list(of_other_engine(rows, asked.before))
        if all(len(row["labels"]) == 2 for row in rows):
            measured["labeller by labeller"] = list(of_labellers(rows))
        print(f"{name}, {half}: {len(rows)} texts, precision / recall: {', '.join(measured)}")
        for group, members in _groups(measured).items():
            columns = [f"{one.precision:.3f} / {one.recall:.3f}" for one in members]
            print(f"  {group:14s} {'   '.join(columns)}   of {members[0].required_count}")
        tried = [("rules", "before"), ("rules and reader", "rules"), ("rules and reader", "before")]
        for one, other in (pair for pair in tried if measured.keys() >= set(pair)):
            precision, recall = p_of_difference(measured[one], measured[other])
            print(f"  {one} against {other}: p {precision:.4f} / {recall:.4f}")
        if asked.misses and half == OPEN:
            _print_misses(measured["rules"])


def _groups(measured: Mapping[str, Sequence[Found]]) -> dict[str, list[Tally]]:
    """The tally of each way of measuring, by all, slot and style."""
    groups: dict[str, list[Tally]] = {}
    for at, found in enumerate(measured.values()):
        for row, slot, _, one in found:
            style = f"{row['style']}, {'plain' if row['plain'] else 'hard'}"
            for group in ("all", slot, style):
                sums = groups.setdefault(group, [Tally()] * len(measured))
                sums[at] = sums[at].plus(one)
    return groups


def _print_misses(found: Iterable[Found]) -> None:
    for row, slot, given, one in found:
        if one.answer_count > one.right or one.required_count > one.hit_count:
            labels = [label[slot] for label in row["labels"]]
            print(f"{row['id']} {slot}: {given}, labelled {labels}\n    {row['text']!r}")


if __name__ == "__main__":
    main()
