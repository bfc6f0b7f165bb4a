"""The rules on texts whose writers knew neither rules nor corpora, and the form of that corpus."""

from __future__ import annotations

from collections import Counter

import pytest
from blind_measure import HELD_OUT, OPEN, load, of_labellers, p_of_difference, tallies, total

from ssp_eval.data.records import SLOT_NAMES, Slots
from ssp_eval.extract import extract

# A little under what was measured (docs/text-extraction.md), so that a loss is seen.
FLOORS = {
    ("blind.jsonl", HELD_OUT): (0.875, 0.62),
    ("blind.jsonl", OPEN): (0.925, 0.735),
    ("unseen.jsonl", HELD_OUT): (0.905, 0.735),
    ("unseen.jsonl", OPEN): (0.93, 0.79),
    ("single.jsonl", OPEN): (0.96, 0.835),
    ("fresh.jsonl", OPEN): (0.925, 0.755),
}


@pytest.mark.parametrize("part", FLOORS, ids=" ".join)
def test_precision_and_recall_do_not_fall(part: tuple[str, str]) -> None:
    both = total(tallies(load(*part)))
    precision, recall = FLOORS[part]
    assert both.precision >= precision, both
    assert both.recall >= recall, both


def test_texts_are_known_once_and_labels_quote_them() -> None:
    rows = [row for part in FLOORS for row in load(*part)]
    assert max(Counter(row["id"] for row in rows).values()) == 1
    assert max(Counter(row["text"] for row in rows).values()) == 1
    for row in rows:
        for label in row["labels"]:
            assert set(label) == set(SLOT_NAMES)
            assert all(one["quote"] in row["text"] for one in label.values() if one is not None)


def test_a_paired_test_sees_a_difference_and_none_between_equals() -> None:
    rows = load("blind.jsonl", OPEN)[:40]
    rules = list(tallies(rows))
    deaf = list(tallies(rows, lambda text: extract(text) if len(text) % 2 else Slots()))
    assert p_of_difference(rules, rules) == (1.0, 1.0)
    assert p_of_difference(rules, deaf)[1] < 0.01
    assert p_of_difference(deaf, rules)[1] < 0.01


def test_labellers_who_judge_each_other_are_as_precise_as_they_find() -> None:
    one = dict.fromkeys(SLOT_NAMES) | {"motion": {"value": "oncoming", "also": []}}
    other = {**one, "motion": {"value": "receding", "also": ["oncoming"]}}
    both = total(of_labellers([{"id": "a", "text": "", "labels": [one, other]}]))
    assert (both.answer_count, both.right, both.required_count, both.hit_count) == (2, 1, 2, 1)
