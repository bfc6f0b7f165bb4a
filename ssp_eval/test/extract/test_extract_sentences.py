"""Sentences with known slots, each of which the rules read as ``extract_sentences.yaml`` says."""

from __future__ import annotations

from pathlib import Path

import yaml

from ssp_eval.data.records import Slot
from ssp_eval.extract import extract
from tests.support.rows import check_rows

SHORT = {
    "o": "objects",
    "p": "position",
    "m": "motion",
    "c": "conflict",
    "lon": "lon_action",
    "lat": "lat_action",
}
FILE = Path(__file__).with_name("extract_sentences.yaml")
GROUPS = yaml.load(FILE.read_text(encoding="utf-8"), yaml.CSafeLoader)
CASES = [
    (text, told, group["slots"].split())
    for group in GROUPS.values()
    for text, told in group["sentences"]
]


def value(slot: Slot | None) -> str:
    """A slot's value as the file writes it; empty where there is none."""
    if slot is None:
        return ""
    return slot.value if isinstance(slot.value, str) else ",".join(sorted(slot.value)) or "-"


def test_the_rules_read_each_sentence() -> None:
    check_rows(check_sentence, CASES)


def check_sentence(text: str, told: str, slots: list[str]) -> None:
    wanted = dict.fromkeys(slots, "")
    for part in told.split():
        slot, _, label = part.partition("=")
        wanted[slot] = "" if label.endswith("?") else label.rpartition("!")[2]
    found = extract(text)
    assert {slot: value(getattr(found, SHORT[slot])) for slot in slots} == wanted


def test_few_slots_are_read_wrongly_and_no_sentence_stands_twice() -> None:
    labels = [part for _, told, _ in CASES for part in told.split()]
    wrong, missing = (sum(mark in label for label in labels) for mark in "!?")
    assert wrong <= 0.025 * (len(labels) - missing)
    assert missing <= 0.17 * len(labels)
    pairs = [(text, tuple(slots)) for text, _, slots in CASES]
    assert len(set(pairs)) == len(pairs) >= 600
