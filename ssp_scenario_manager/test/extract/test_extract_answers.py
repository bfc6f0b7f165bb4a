"""Answers are held to their schema; what fits it becomes a candidate without made-up numbers."""

from __future__ import annotations

import json
import random
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_core.vocabulary import MOTIONS, OBJECTS
from ssp_scenario_manager.checks.check import check_event, contradictions, undecided
from ssp_scenario_manager.event_spec.fields import leaves
from ssp_scenario_manager.event_spec.load import body, event_text, event_version, uncovered
from ssp_scenario_manager.extract.answers import (
    BadAnswer,
    Scope,
    answer_schema,
    printable,
    read_answer,
)
from ssp_scenario_manager.extract.candidate import Origin, make_candidate
from ssp_scenario_manager.extract.clip import Clip, Shot
from ssp_scenario_manager.extract.interview import Interviewer, Store, kind_texts
from ssp_scenario_manager.extract.questions import QUESTIONS
from ssp_scenario_manager.scenarios.events.kinds import KINDS

SCOPE = Scope(5, ("ot1", "ot2"))


def draw(schema: Mapping[str, Any], dice: random.Random) -> Any:
    """Some value that fits a schema."""
    if "enum" in schema:
        return dice.choice(schema["enum"])
    if "const" in schema:
        return schema["const"]
    kind = schema["type"]
    if kind == "object":
        return {key: draw(part, dice) for key, part in schema["properties"].items()}
    if kind == "array":
        count = dice.randint(schema.get("minItems", 0), min(4, schema.get("maxItems", 3)))
        return [draw(schema["items"], dice) for _ in range(count)]
    if kind == "number":
        return round(dice.uniform(schema["minimum"], schema["maximum"]), 3)
    assert kind == "string"
    return dice.choice(
        ["a red car", "{braces} %s \u202e\x1b[31m", "x" * schema["maxLength"], "née"]
    )


class DrawingModel:
    """Answers anything that fits the schema."""

    model = "dice"

    def __init__(self, seed: int) -> None:
        self._dice = random.Random(seed)

    def ask(self, messages: Sequence[Mapping[str, Any]], answer: Mapping[str, Any]) -> bytes:
        schema = answer["response_format"]["json_schema"]["schema"]
        content = json.dumps(draw(schema, self._dice))
        message = {"role": "assistant", "content": content}
        return json.dumps({"choices": [{"message": message, "finish_reason": "stop"}]}).encode()


def clip(frames: int = 5) -> Clip:
    shots = tuple(Shot(12 * k, 0.5 * k, b"\xff\xd8%d" % k) for k in range(frames))
    return Clip(Path("clip.mp4"), "sha256:" + "0" * 64, 24.0, 0, 0.0, 0.5 * frames, shots)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**32))
def test_whatever_fits_the_schema_becomes_a_candidate(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    store = Store(tmp_path_factory.mktemp("x") / "clip.extraction")
    found = Interviewer(clip(), DrawingModel(seed), store).run()
    origin = Origin("clip", "g", "o")
    if not found.targets or found.interaction["type"].value == "none":
        with pytest.raises(InputError, match="conflict"):
            make_candidate(found, clip(), origin, "dice")
        return
    event = make_candidate(found, clip(), origin, "dice")
    assert uncovered(event) == []
    assert all(entry.review == "unreviewed" for entry in event.uncertainty.values())
    check_event(event)
    contradictions(event)
    assert "\x1b" not in event_text(event)
    # No number but the clip's own times and rate, counts of lanes, what stands, and the defaults.
    free = (
        "constraints.camera",
        "constraints.site",
        "constraints.safety",
        "constraints.thresholds",
        "events.",
        "source.rate",
        "topology.lanes",
        "topology.lane_width.varies",
        "topology.curvature.varies",
        "participants.vut.region.gap",
    )
    for path, value in leaves(body(event)):
        if isinstance(value, float) and not path.startswith(free):
            assert path.startswith("constraints.speeds")
            assert value == 0.0
            cell = event.motion[path.split(".")[2]][path.split(".")[3]]  # type: ignore[index]
            assert cell.speed_trend == "standing"
    assert {item.field for item in undecided(event)} >= {"interaction.type", "events.trigger.start"}


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 2**32))
def test_the_same_answers_give_the_same_candidate(
    tmp_path_factory: pytest.TempPathFactory, seed: int
) -> None:
    folder = tmp_path_factory.mktemp("x") / "clip.extraction"
    first = Interviewer(clip(), DrawingModel(seed), Store(folder)).run()
    again = Interviewer(clip(), DrawingModel(seed + 1), Store(folder)).run()
    assert first == again
    if first.targets and first.interaction["type"].value != "none":
        origin = Origin("clip", "g", "o")
        events = [make_candidate(found, clip(), origin, "dice") for found in (first, again)]
        assert event_version(events[0]) == event_version(events[1])


anything = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(st.sampled_from(["value", "items", "evidence", "road_type", "x"]), inner)
    ),
    max_leaves=8,
)


@settings(max_examples=150, deadline=None)
@given(st.sampled_from(sorted(QUESTIONS)), st.text(max_size=60) | anything.map(json.dumps))
def test_no_answer_breaks_the_reader(key: str, text: str) -> None:
    with suppress(BadAnswer):
        read_answer(QUESTIONS[key], SCOPE, text)


@settings(max_examples=60, deadline=None)
@given(st.sampled_from(sorted(QUESTIONS)), st.integers(0, 2**32))
def test_what_the_schema_allows_is_read(key: str, seed: int) -> None:
    schema = answer_schema(QUESTIONS[key], SCOPE)
    value = draw(schema, random.Random(seed))
    assert read_answer(QUESTIONS[key], SCOPE, json.dumps(value)) is not None


@settings(max_examples=100, deadline=None)
@given(st.sampled_from(sorted(QUESTIONS)), st.integers(0, 2**32), st.data())
def test_one_strange_value_is_found(key: str, seed: int, data: st.DataObject) -> None:
    """A value of the answer replaced by one of another kind: the reader names a field."""
    schema = answer_schema(QUESTIONS[key], SCOPE)
    value = draw(schema, random.Random(seed))
    spots = list(_spots(value))
    holder, name = data.draw(st.sampled_from(spots))
    old = holder[name]
    strange: Any = data.draw(
        st.sampled_from([None, True, "strange word", -1, 99, [], {}, 1e308, 0.5])
    )
    holder[name] = strange
    fits = isinstance(old, float) and strange in (0.5,) and strange is not True
    fits = fits or (name == "description" and isinstance(strange, str))
    fits = fits or (name == "items" and strange == [])
    if fits or strange == old:
        return
    with pytest.raises(BadAnswer) as caught:
        read_answer(QUESTIONS[key], SCOPE, json.dumps(value))
    assert str(name).strip("0123456789") in str(caught.value)


def _spots(value: Any) -> Any:
    keys = value.keys() if isinstance(value, dict) else range(len(value))
    for key in list(keys):
        yield value, key
        if isinstance(value[key], dict | list):
            yield from _spots(value[key])


def test_the_vocabularies_are_those_of_the_labels() -> None:
    schema = answer_schema(QUESTIONS["motion"], SCOPE)["properties"]["trigger"]["properties"]
    assert schema["motion"]["enum"] == [*MOTIONS, "unresolved"]
    listed = answer_schema(QUESTIONS["targets"], SCOPE)["properties"]["items"]["items"]
    assert listed["properties"]["class"]["enum"] == list(OBJECTS)


def test_every_kind_of_interaction_is_explained() -> None:
    texts = kind_texts()
    assert set(texts) == set(KINDS)
    assert all(len(text) > 20 for text in texts.values())


@pytest.mark.parametrize(
    ("text", "plain"),
    [("a\nb", "a b"), ("\x1b[2Jx", "[2Jx"), ("née", "née"), ("a\u202eb", "a b"), ("  ", "")],
)
def test_a_models_words_are_made_plain(text: str, plain: str) -> None:
    assert printable(text) == plain
