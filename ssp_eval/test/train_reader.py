"""Learns the weights of the reader (ssp_eval/extract/reader) from the open texts of the corpus.

Usage: python ssp_eval/test/train_reader.py [--write], in a shell of `eval "$(./ssp env)"`.
It prints what rules and reader give together on texts that their weights were not learnt from: five
parts, each read with the weights of the four others. ``--write`` writes the file. The texts of
test.jsonl, replies.jsonl and unseen.jsonl and the held-out half of blind.jsonl are never learnt
from.
"""

from __future__ import annotations

import hashlib
import json
import sys
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from blind_measure import Tally
from numpy.typing import NDArray
from scipy.optimize import minimize  # type: ignore[import-untyped]  # has no types
from scipy.sparse import csr_matrix  # type: ignore[import-untyped]  # has no types

from ssp_eval.data.records import SLOT_NAMES, VOCABULARIES
from ssp_eval.extract.engine import Reading, read
from ssp_eval.extract.reader import weights as files
from ssp_eval.extract.reader.candidates import LABELS, Candidate
from ssp_eval.extract.reader.clauses import View, view
from ssp_eval.extract.reader.reader import (
    FEW_CLAUSES,
    FILL_FROM,
    KEEP_FROM,
    Support,
    all_candidates,
)
from ssp_eval.extract.reader.weights import (
    CLASS,
    Weights,
    written,
)
from ssp_vla_bridge.backends.phrases import action_sentence, scene_text

FOLDER = Path(__file__).parent / "corpus"
PARTS = 5
LEAST_TEXTS = 5  # clauses that a feature must be in
STRENGTH = 0.3  # of the weights against the pull to zero
LEAST_WEIGHT = 6  # hundredths; smaller weights are left out
PERFECT = "the perfect control"  # its sentences, whose labels the rules return one for one
EVERY = 11  # of the perfect control's texts that is learnt from
# Rules were made on all files but fresh.jsonl and wide.jsonl, where they are as good as on any new
# text; those of wide.jsonl say more than most, so that they count less for how much is said.
WORTH = {
    "development": 1.0,
    "single": 1.0,
    "blind": 2.0,
    "fresh": 3.0,
    "wide": 0.3,
    PERFECT: 1.0,
}
Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Label:
    """A labeller's decision about a slot: its value, the words that say so, defensible values."""

    value: Any
    spans: list[tuple[int, int]]
    defended: frozenset[Any]


@dataclass(frozen=True)
class Example:
    """A text with its labels and what rules and reader see in it."""

    key: str
    file: str
    style: str
    text: str
    labels: dict[str, list[Label]]
    reading: Reading
    view: View

    @property
    def part(self) -> int:
        return hashlib.sha256(self.key.encode()).digest()[0] % PARTS

    def right(self, name: str) -> frozenset[Any]:
        return frozenset().union(*(one.defended for one in self.labels[name]))


def examples(files: Sequence[str] = tuple(WORTH), most: int | None = None) -> list[Example]:
    """The texts that may be learnt from.

    Args:
        files: of these alone.
        most: lines of a file that are read; None: all.
    """
    found = perfect() if PERFECT in files else []
    for name in (name for name in files if name != PERFECT):
        for line in (FOLDER / f"{name}.jsonl").read_text(encoding="utf-8").splitlines()[:most]:
            row = json.loads(line)
            if row.get("half", "open") != "open":
                continue
            answers = row.get("labels") or [row["slots"]]
            labels = {
                slot: [_label(row["text"], one.get(slot)) for one in answers] for slot in SLOT_NAMES
            }
            reading = read(row["text"])
            style = row["style"] + {True: ", plain", False: ", hard", None: ""}[row.get("plain")]
            found.append(
                Example(row["id"], name, style, row["text"], labels, reading, view(reading))
            )
    return found


def perfect() -> list[Example]:
    """Some texts of the perfect control, labelled by the rules, which return all of its labels."""
    actions = list(product(VOCABULARIES["lon_action"], VOCABULARIES["lat_action"]))
    scenes = product(
        VOCABULARIES["objects"],
        (*VOCABULARIES["position"], None),
        (*VOCABULARIES["motion"], None),
        (*VOCABULARIES["conflict"], None),
    )
    found = []
    for number, (name, position, motion, conflict) in enumerate(scenes):
        people_cut = name == "pedestrian" and (motion or "").startswith("cutting")
        over = conflict == "resolved" and (motion or "").startswith(("crossing", "cutting"))
        if number % EVERY or people_cut or over:
            continue
        plan = action_sentence(*actions[number % len(actions)])
        text = f"{scene_text((name,), position, motion, conflict)} {plan}"
        reading = read(text)
        labels = {}
        for slot in SLOT_NAMES:
            said = getattr(reading.slots, slot)
            labels[slot] = [
                _label(
                    text, None if said is None else {"value": said.value, "evidence": said.evidence}
                )
            ]
        found.append(Example(f"p{number}", PERFECT, PERFECT, text, labels, reading, view(reading)))
    return found


def _label(text: str, given: dict[str, Any] | None) -> Label:
    if given is None:
        return Label(None, [], frozenset({None}))
    spans = [(a, b) for a, b in given.get("evidence", ())]
    if "quote" in given and (at := text.find(given["quote"])) >= 0:
        spans = [(at, at + len(given["quote"]))]
    defended = frozenset(_value(one) for one in (given["value"], *given.get("also", ())))
    return Label(_value(given["value"]), spans, defended)


def _value(value: Any) -> Any:
    return tuple(sorted(value)) if isinstance(value, list) else value


def clause_labels(example: Example, label: Label) -> list[Any]:
    """The label of each clause: that of the slot where the words that say so lie, else None."""
    found: list[Any] = [None] * len(example.view.clauses)
    for start, end in label.spans:
        shared = []
        for clause in example.view.clauses:
            first, stop = example.reading.tokens.span(clause.first, clause.stop)
            shared.append((min(end, stop) - max(start, first), stop - first))
        for at, (common, length) in enumerate(shared):
            if common > 0 and common >= 0.4 * min(end - start, length):
                found[at] = label.value
        if shared and max(shared)[0] > 0:
            found[shared.index(max(shared))] = label.value
    return found


# --- weights of features


def learn(x: csr_matrix, y: NDArray[np.int64], labels: int, worth: Floats, pull: float) -> Floats:
    """Multinomial logistic regression by L-BFGS; rows of weights, the last the constant."""
    rows, width = x.shape
    wanted = np.zeros((rows, labels))
    wanted[np.arange(rows), y] = 1.0
    turned = x.T.tocsr()

    def loss(flat: Floats) -> tuple[float, Floats]:
        w = flat.reshape(width + 1, labels)
        sums = x @ w[:-1] + w[-1]
        sums -= sums.max(axis=1, keepdims=True)
        powers = np.exp(sums)
        total = powers.sum(axis=1, keepdims=True)
        value = -(worth * ((sums - np.log(total)) * wanted).sum(axis=1)).sum()
        rest = (powers / total - wanted) * worth[:, None]
        slope = np.vstack([turned @ rest + pull * w[:-1], rest.sum(axis=0)])
        return value + 0.5 * pull * (w[:-1] ** 2).sum(), slope.ravel()

    start = np.zeros((width + 1) * labels)
    options = {"maxiter": 60, "maxcor": 6}
    found: Floats = minimize(loss, start, jac=True, method="L-BFGS-B", options=options).x
    return found.reshape(width + 1, labels)


def matrix(sets: Sequence[set[str]], rows: dict[str, int]) -> csr_matrix:
    """Sets of features as rows of ones."""
    columns = [sorted(rows[one] for one in known if one in rows) for known in sets]
    ends = np.cumsum([0, *map(len, columns)])
    flat = np.concatenate([np.array(one, dtype=np.int64) for one in columns])
    return csr_matrix((np.ones(len(flat)), flat, ends), shape=(len(sets), len(rows)))


def feature_weights(chosen: Sequence[Example]) -> Weights:
    """The weights of all features, learnt from some examples; nothing is joined yet."""
    sets = [known for one in chosen for known in one.view.features]
    counted = Counter(name for known in sets for name in known)
    class_sets, member, class_worth = [], [], []
    for example in chosen:
        for name, known in example.view.classes.items():
            for label in example.labels[CLASS]:
                class_sets.append(known)
                member.append(int(name in (label.value or ())))
                class_worth.append(1.0 / len(example.labels[CLASS]))
    counted.update(name for known in class_sets for name in known if name.startswith("a:"))
    names = sorted(name for name, times in counted.items() if times >= LEAST_TEXTS)
    rows = {name: row for row, name in enumerate(names)}
    x = matrix(sets, rows)
    blocks = []
    for slot, labels in LABELS.items():
        index = {None: 0, **{label: at for at, label in enumerate(labels, start=1)}}
        at, y, worth = [], [], []
        offset = 0
        for example in chosen:
            for label in example.labels[slot]:
                for number, value in enumerate(clause_labels(example, label)):
                    at.append(offset + number)
                    y.append(index[value])
                    worth.append(1.0 / len(example.labels[slot]))
            offset += len(example.view.features)
        blocks.append(learn(x[at], np.array(y), len(index), np.array(worth), 1.0 / STRENGTH))
    pair = learn(
        matrix(class_sets, rows), np.array(member), 2, np.array(class_worth), 2.0 / STRENGTH
    )
    blocks.append(pair[:, 1:] - pair[:, :1])
    table = np.rint(np.hstack(blocks) * 100).astype(np.int32)
    bias = table[-1]
    table = np.where(abs(table[:-1]) < LEAST_WEIGHT, 0, table[:-1])
    used = np.flatnonzero(table.any(axis=1))
    return Weights({names[row]: at for at, row in enumerate(used)}, table[used], bias, {})


# --- candidates over the text


def joining(
    name: str, chosen: Sequence[tuple[Example, Mapping[str, list[Candidate]]]]
) -> list[float]:
    """The weights by which a slot's candidates are joined; the first is the constant."""
    ones = [(example, one) for example, found in chosen for one in found.get(name, ())]
    x = np.array([one.features for _, one in ones])
    y = np.array([int(one.value in example.right(name)) for example, one in ones])
    worth = np.array([WORTH[example.file] for example, _ in ones])
    mean, spread = x.mean(axis=0), x.std(axis=0) + 1e-6
    pair = learn(csr_matrix((x - mean) / spread), y, 2, worth, 10.0)
    w = pair[:, 1] - pair[:, 0]
    scaled = w[:-1] / spread
    return [round(float(one), 5) for one in (w[-1] - (scaled * mean).sum(), *scaled)]


# --- measure


@dataclass(frozen=True)
class Choice:
    """The candidates for a slot's value.

    Args:
        rules: the value of the rules, and how likely it is right.
        best: the likeliest value, and how likely it is right; None where no words support it.
        is_short: the text has so few clauses that nothing is taken back.
    """

    rules: tuple[Any, float]
    best: tuple[Any, float]
    is_short: bool

    def value(self) -> Any:
        if self.rules[0] is not None and self.rules[1] >= KEEP_FROM:
            return self.rules[0]
        if self.best[0] is not None and self.best[1] >= FILL_FROM:
            return self.best[0]
        return self.rules[0] if self.is_short else None


def choice(example: Example, name: str, found: list[Candidate], weights: Weights) -> Choice:
    """The choice of a slot by the weights of the other parts."""
    certain = {one.value: weights.certainty(name, one) for one in found}
    slot = getattr(example.reading.slots, name)
    value = None if slot is None else slot.value
    rules = (value, certain.get(value, 1.0))
    is_short = len(example.view.clauses) <= FEW_CLAUSES
    best = max(found, key=lambda one: certain[one.value], default=None)
    if best is None:
        return Choice(rules, (None, 0.0), is_short)
    if best.value != value:
        support = Support(example.text, example.reading, example.view, weights)
        if support.slot(name, best) is None:
            return Choice(rules, (None, certain[best.value]), is_short)
    return Choice(rules, (best.value, certain[best.value]), is_short)


def cross_weights(chosen: Sequence[Example]) -> list[Weights]:
    """Return, for each part, the weights of features that were learnt from the other parts."""
    found = []
    for part in range(PARTS):
        found.append(feature_weights([one for one in chosen if one.part != part]))
        print(f"part {part + 1} of {PARTS}", file=sys.stderr)
    return found


def main() -> None:
    """Learn, measure and, if asked, write."""
    chosen = examples()
    crossed = cross_weights(chosen)
    found = {
        one.key: all_candidates(crossed[one.part], one.view, one.reading.slots)
        for one in chosen
        if one.view.clauses
    }
    chosen = [one for one in chosen if one.view.clauses]
    choices: dict[str, dict[str, Choice]] = defaultdict(dict)
    for name in SLOT_NAMES:
        for part in range(PARTS):
            others = [(one, found[one.key]) for one in chosen if one.part != part]
            joined = replace(crossed[part], joining={name: joining(name, others)})
            for one in (one for one in chosen if one.part == part):
                choices[name][one.key] = choice(one, name, found[one.key][name], joined)
    for file in WORTH:
        groups: dict[str, list[Tally]] = defaultdict(lambda: [Tally(), Tally()])
        for example in (one for one in chosen if one.file == file):
            for name in SLOT_NAMES:
                one = choices[name][example.key]
                for group in ("all", name, example.style):
                    groups[group] = [
                        tally.plus(Tally.of(value, example.right(name)))
                        for tally, value in zip(
                            groups[group], (one.rules[0], one.value()), strict=True
                        )
                    ]
        print(f"{file}, rules and then rules with reader, precision / recall")
        for group, (rules, both) in groups.items():
            print(
                f"  {group:14s} {rules.precision:.3f} / {rules.recall:.3f}   "
                f"{both.precision:.3f} / {both.recall:.3f}"
            )
    if "--write" in sys.argv:
        weights = feature_weights(chosen)
        joined_all = {
            name: joining(name, [(one, found[one.key]) for one in chosen]) for name in SLOT_NAMES
        }
        weights = replace(weights, joining=joined_all)
        files.FILE.write_text(written(weights), encoding="utf-8")
        size = files.FILE.stat().st_size
        print(f"{files.FILE.name}: {len(weights.rows)} features, {size} bytes")


if __name__ == "__main__":
    main()
