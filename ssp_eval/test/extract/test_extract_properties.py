"""Properties that hold for every text: spans, legality, speed, dependence on the text alone."""

from __future__ import annotations

import random
import re
import sys
import time
from collections.abc import Callable
from types import FrameType

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_eval.data.records import (
    SLOT_NAMES,
    VOCABULARIES,
    BehaviourRecord,
    Slot,
    Slots,
    parse_records,
    record_to_json,
)
from ssp_eval.extract import extract
from ssp_eval.extract.checks import check
from ssp_eval.extract.lexicon import FILES, FOLDER, lexicon
from ssp_eval.extract.tokens import tokenise

# Every word of the lexicon, and what else texts hold.
WORDS = sorted(set(re.findall(r"[a-z']+", "".join((FOLDER / f).read_text("utf-8") for f in FILES))))
PIECES = [
    *WORDS,
    ".",
    ",",
    "?",
    "\n",
    ":",
    ";",
    '"',
    "(",
    "[",
    "left",
    "right",
    "not",
    "if",
    "the",
    "a",
    "frame 2",
    "lane",
    "İ",
    "ﬁ",
    "—",
    "don't",
    "3.5",
]

sentences = st.lists(st.sampled_from(PIECES), max_size=40).map(" ".join)
# What models wrap their words in: markdown, JSON, tags, brackets and other scripts.
WRAPPED = [
    "{}",
    "**{}**: {}",
    "# {}\n{}",
    "- {}\n- {}",
    "| {} | {} |\n|---|---|",
    "({})",
    "[{}, {}]",
    '{{"action": "{}", "risk": "{}"}}',
    "<think>{}</think>{}",
    "```json\n{}\n```",
    "~~{}~~ {}",
    "1. {}\n2. {}",
    "“{}” — {}",
    "\ufeff{}\r\n{}",
    "İ{}ß{}ﬁ",
    "{}\u2028{}\x00",
    "((({}",
    "{}]]",
]
formatted = st.builds(
    lambda form, one, other: form.format(one, other), st.sampled_from(WRAPPED), sentences, sentences
)
texts = st.one_of(
    st.text(max_size=200), sentences, formatted, st.lists(formatted, max_size=4).map("\n".join)
)


def _present_slots(slots: Slots) -> dict[str, Slot]:
    found = {name: getattr(slots, name) for name in SLOT_NAMES}
    return {name: slot for name, slot in found.items() if slot is not None}


@settings(max_examples=100, deadline=None)
@given(texts)
def test_every_slot_is_legal_and_supported_by_the_text(text: str) -> None:
    for name, slot in _present_slots(extract(text)).items():
        values = slot.value if isinstance(slot.value, tuple) else (slot.value,)
        assert isinstance(slot.value, tuple) == (name == "objects")
        assert set(values) <= set(VOCABULARIES[name])
        assert slot.evidence
        assert all(0 <= start < end <= len(text) for start, end in slot.evidence)
        assert all(text[start:end].strip() for start, end in slot.evidence)


@settings(max_examples=60, deadline=None)
@given(texts)
def test_slots_survive_a_record(text: str) -> None:
    slots = extract(text)
    record = BehaviourRecord(0.0, text, slots)
    assert parse_records(record_to_json(record), "memory")[0].slots == slots


@settings(max_examples=100, deadline=None)
@given(st.text(max_size=200))
def test_tokens_lie_in_the_text_in_order(text: str) -> None:
    tokens = tokenise(text)
    edges = [edge for pair in zip(tokens.starts, tokens.ends, strict=True) for edge in pair]
    assert edges == sorted(edges)
    assert all(0 <= start < end for start, end in zip(tokens.starts, tokens.ends, strict=True))
    assert not edges or edges[-1] <= len(text)


@settings(max_examples=50, deadline=None)
@given(st.text(alphabet=" \t\r\n", max_size=20))
def test_blank_text_gives_nothing(text: str) -> None:
    assert extract(text) == Slots()


@settings(max_examples=50, deadline=None)
@given(st.text(alphabet="éßЖ漢İ“”—•\u00a0", max_size=30))
def test_offsets_hold_behind_other_scripts(prefix: str) -> None:
    text = f"{prefix}\n\nI slow down and stay in my lane."
    slots = extract(text)
    assert slots.lon_action is not None
    assert slots.lat_action is not None
    assert [text[a:b] for a, b in slots.lon_action.evidence] == ["slow down"]
    assert [text[a:b] for a, b in slots.lat_action.evidence] == ["stay in my lane"]


@pytest.mark.parametrize(
    ("text", "evidence"),
    [
        (
            "A Van is Ahead on the RIGHT; it is cutting in from the right.",
            {
                "objects": ["Van"],
                "position": ["Ahead on the RIGHT"],
                "motion": ["cutting in from the right"],
            },
        ),
        (
            "The lead vehicle is no longer a risk. Slow down and stop.",
            {
                "objects": ["vehicle"],
                "position": ["lead vehicle"],
                "conflict": ["no longer a risk"],
                "lon_action": ["Slow down and stop"],
            },
        ),
        (
            "Change to the left‑lane; don’t brake. The cyclist could swerve.",
            {
                "objects": ["cyclist"],
                "conflict": ["could swerve"],
                "lat_action": ["Change to the left‑lane"],
            },
        ),
        (
            "A pedestrian poses no risk. Maintain speed and lane.",
            {
                "objects": ["pedestrian"],
                "conflict": ["poses no risk"],
                "lon_action": ["Maintain speed and lane"],
                "lat_action": ["Maintain speed and lane"],
            },
        ),
    ],
)
def test_evidence_is_the_words_that_say_it(text: str, evidence: dict[str, list[str]]) -> None:
    given_slots = _present_slots(extract(text))
    quoted = {name: [text[a:b] for a, b in slot.evidence] for name, slot in given_slots.items()}
    assert quoted == evidence


def test_the_same_text_gives_the_same_slots_whatever_came_before() -> None:
    text = "It is crossing from the left, so I stop."
    before = extract(text)
    extract("A pedestrian is ahead on the right. Final plan: accelerate.")
    assert extract(text) == before


def test_case_and_line_ends_dont_matter() -> None:
    text = "A pedestrian is ahead on the left.\nI slow down."
    assert extract(text.upper()) == extract(text)
    crlf = extract(text.replace("\n", "\r\n"))
    assert crlf.lon_action is not None
    assert crlf.lon_action.value == "decelerate"


@pytest.mark.parametrize("unit", ["[", "a", "(", "{", "<", "-", "'", '"', ".", "\n", "é", "{[("])
def test_a_megabyte_of_one_thing_says_nothing(unit: str) -> None:
    assert extract(unit * (1_000_000 // len(unit))) == Slots()


GROWING = [
    "if ",
    "[",
    "\n",
    "brake ",
    "7 ",
    "a car and ",
    "no car or ",
    '{"a":',
    "- ",
    "?\n",
    "it ",
    "a car ahead, ",
    "<think>",
    "<a",
    "frame 1 ",
    '"if" ',
    "was ",
    "nobody ",
    "left ",
    "brake and ",
    "it is ahead. ",
    "keep my ",
    "braking is not ",
    "critical: ",
    "the car on the left of ",
]


@pytest.mark.parametrize("unit", GROWING)
def test_work_grows_in_proportion_to_the_text(unit: str) -> None:
    """Lines of Python run for four times the text: counted, so that no busy machine disturbs."""

    def lines(count: int) -> int:
        counted = 0

        def trace(frame: FrameType, event: str, _: object) -> Callable[..., object]:
            nonlocal counted
            counted += event == "line"
            return trace

        text = unit * count
        before = sys.gettrace()
        sys.settrace(trace)
        try:
            extract(text)
        finally:
            sys.settrace(before)
        return counted

    extract(unit * 400)  # what is loaded on first use belongs to no text
    assert lines(1600) < 4.4 * lines(400) + 2000


def test_two_thousand_texts_of_a_hundred_words_take_seconds() -> None:
    rng = random.Random(7)
    sentences = [
        "The scene shows a two-lane urban road in daylight with dry asphalt and light traffic.",
        "A white van is ahead on the right and is drifting into our lane from the right.",
        "There is a risk of collision with the van if nothing changes in the next seconds.",
        "The ego vehicle should slow down gently and stay in its lane to keep a safe gap.",
        "Trees and buildings line the street, and the sky is slightly overcast at this hour.",
        "A pedestrian is waiting on the left sidewalk and does not affect our path.",
    ]
    batch = [" ".join(rng.sample(sentences, 6)) for _ in range(200)]
    assert 80 <= len(batch[0].split()) <= 110
    started = time.process_time()
    for text in batch:
        extract(text)
    assert time.process_time() - started < 2.0  # twenty times slower than measured


@pytest.mark.parametrize(
    ("name", "slot", "kept"),
    [
        ("lon_action", Slot("stop", ((2, 6),)), True),
        ("lon_action", Slot("halt", ((2, 6),)), False),
        ("lon_action", Slot("left", ((2, 6),)), False),
        ("lon_action", Slot("stop", ()), False),
        ("lon_action", Slot("stop", ((2, 5),)), False),
        ("lon_action", Slot("stop", ((3, 6),)), False),
        ("lon_action", Slot("stop", ((6, 2),)), False),
        ("lon_action", Slot("stop", ((2, 60),)), False),
        ("lon_action", Slot("stop", ((1, 2),)), False),
        ("objects", Slot("car", ((2, 6),)), False),
        ("objects", Slot(("car",), ((2, 6),)), True),
        ("lon_action", Slot(("stop",), ((2, 6),)), False),
    ],
)
def test_what_fails_a_check_is_dropped(name: str, slot: Slot, kept: bool) -> None:
    assert (check("I stop.", name, slot) is not None) == kept


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("slowing gently down", "verb", "slow"),
        ("slow down", "verb", "slow"),
        ("pedestrian crossings", "skip", ""),
        ("wheelchair users", "user", "pedestrian"),
        ("on our left", "place", "left"),
        ("from the right", "from", "right"),
        ("no other road users", "nobody", ""),
        ("on a collision course", "conflict", "active"),
    ],
)
def test_the_longest_phrase_at_a_word_is_found(text: str, kind: str, value: str) -> None:
    words = text.split()
    entry, stop = lexicon().longest(words, 0)
    assert entry is not None
    assert (entry.kind, entry.value, stop) == (kind, value, len(words))


def test_every_cue_of_scope_is_one_that_the_rules_know() -> None:
    flags = {
        "denied",
        "imagined",
        "possible",
        "future",
        "past",
        "planned",
        "intended",
        "rejected",
        "quoted",
        "later",
        "",
    }
    reaches = {"forward", "back", "clause", "sentence", "condition", "none"}
    for name, cue in lexicon().cues.items():
        assert cue["flag"] in flags, name
        assert cue["reach"] in reaches, name
        assert cue["words"].strip(), name
