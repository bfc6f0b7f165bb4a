"""The learned reader: it finds more without being wrong more often, and says what it did."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from itertools import product
from pathlib import Path

import pytest
from label_conventions import contradicts

from ssp_eval.data.records import SLOT_NAMES, VOCABULARIES, Slots
from ssp_eval.extract import extract
from ssp_eval.extract.checks import check
from ssp_eval.extract.combined.extractor import Extractor
from ssp_eval.extract.measure import load_corpus, measure
from ssp_eval.extract.reader.clauses import MAX_CLAUSES
from ssp_eval.extract.reader.weights import FILE, load_weights, written
from ssp_vla_bridge.backends.phrases import action_sentence, scene_text

CORPUS = Path(__file__).parents[1] / "corpus"
TEST = load_corpus(CORPUS / "test.jsonl")
MAX_BYTES = 2_000_000


def values(slots: Slots) -> dict[str, object]:
    found = {name: getattr(slots, name) for name in SLOT_NAMES}
    return {name: None if slot is None else slot.value for name, slot in found.items()}


def test_precision_and_recall_rise_on_texts_that_nothing_was_learnt_from() -> None:
    extractor = Extractor()
    rules = measure(TEST, extract).slots["all"]
    both = measure(TEST, lambda text: extractor(text).slots).slots["all"]
    assert both.right / both.given > rules.right / rules.given
    assert both.right - rules.right > 40
    shares = extractor.shares()
    assert shares["slots_given"] == both.given
    assert shares["reader_filled"] < 0.12 * both.given


def test_what_it_fills_stands_in_the_text_and_the_rest_is_as_the_rules_left_it() -> None:
    extractor = Extractor()
    filled = 0
    for example in TEST:
        found, rules = extractor(example.text), extract(example.text)
        assert not set(found.by_reader) & set(found.withdrawn)
        filled += len(found.by_reader)
        for name in SLOT_NAMES:
            slot = getattr(found.slots, name)
            if name in found.by_reader:
                assert check(example.text, name, slot) == slot
            elif name in found.withdrawn:
                assert slot is None
                assert getattr(rules, name) is not None
            else:
                assert slot == getattr(rules, name)
    assert filled


def test_the_perfect_control_is_read_as_it_was_meant() -> None:
    extractor = Extractor()
    actions = list(product(VOCABULARIES["lon_action"], VOCABULARIES["lat_action"]))
    scenes = product(
        VOCABULARIES["objects"],
        (*VOCABULARIES["position"], None),
        (*VOCABULARIES["motion"], None),
        (*VOCABULARIES["conflict"], None),
    )
    for number, (name, position, motion, conflict) in enumerate(scenes):
        if number % 9 == 0 and not contradicts(name, motion):
            plan = action_sentence(*actions[number % len(actions)])
            text = f"{scene_text((name,), position, motion, conflict)} {plan}"
            assert values(extractor(text).slots) == values(extract(text)), text


@pytest.mark.parametrize(
    "text",
    [
        "",
        "…",
        "Das Auto vor uns bremst, also bremsen wir auch und bleiben in unserer Spur.",
        "A car ahead. " * (MAX_CLAUSES + 1),
        "\ud800 asphalt",
    ],
)
def test_it_says_nothing_of_what_it_cannot_read(text: str) -> None:
    found = Extractor()(text)
    assert found.by_reader == found.withdrawn == ()
    assert found.slots == extract(text)


@pytest.mark.parametrize(
    "text", ["Slow down, stop.", "Slow down, then stop", "pedestrian x0, car x2"]
)
def test_it_takes_nothing_back_in_a_short_text(text: str) -> None:
    assert Extractor()(text).slots == extract(text) != Slots()


@pytest.mark.parametrize(
    "text",
    [
        "The bus follows us and turns right.",
        "A truck is moving parallel to us and slows down.",
        "The car on the right is moving beside us and keeps its speed.",
        "The van on the left is level with us and keeps its lane.",
        "The car behind us is closing in and brakes.",
    ],
)
def test_it_takes_no_action_of_a_road_user_for_ours(text: str) -> None:
    slots = Extractor()(text).slots
    assert slots.objects is not None
    assert slots.lon_action is None
    assert slots.lat_action is None


def test_its_words_pass_the_checks_for_an_llm() -> None:
    """Neither what is only imagined nor what is denied is filled by a word that suits the label."""
    for text in (
        "If a lorry were to swerve into our lane from the left, we would have to brake.",
        "No lorry swerves into our lane from the left.",
        "The prompt asks: is the lorry swerving into our lane from the left?",
    ):
        found = Extractor()(text)
        assert found.slots.motion is None, text
        assert found.slots.lon_action is None, text


def test_the_weights_are_small_and_are_written_as_they_are_read() -> None:
    assert FILE.stat().st_size <= MAX_BYTES
    assert written(load_weights()) == FILE.read_text(encoding="utf-8")


def test_two_trainings_give_the_same_bytes() -> None:
    """The result doesn't depend on the order in which a process iterates its sets."""
    script = (
        "import train_reader as t; rows = t.examples(('blind',), most=6);"
        "print(t.written(t.feature_weights(rows)))"
    )
    folder = str(Path(__file__).parents[1])
    printed = []
    for seed in ("1", "2"):
        path = os.pathsep.join([folder, os.environ.get("PYTHONPATH", "")])
        env = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": path}
        run = subprocess.run(
            [sys.executable, "-c", script], env=env, capture_output=True, timeout=300, check=True
        )
        printed.append(run.stdout)
    assert printed[0] == printed[1]
    assert len(printed[0]) > 4_000


def test_without_it_the_rules_speak_alone() -> None:
    extractor = Extractor(use_reader=False)
    for example in TEST[:40]:
        found = extractor(example.text)
        assert found.slots == extract(example.text)
        assert found.by_reader == found.withdrawn == ()
    assert extractor.describe()["reader"] is None
    assert json.dumps(extractor.describe())
