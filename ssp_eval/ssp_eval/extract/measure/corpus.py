"""Corpus files: texts with the slots and spans that people gave them, read strictly.

One JSON object per line::

    {"id": "a001", "style": "coc", "text": "Yield to the cyclist …",
     "slots": {"objects": {"value": ["cyclist"], "evidence": [[13, 20]]}, …, "lat_action": null}}

Unlike in behaviour records every span must lie in the text: a label with a span elsewhere is a
mistake of the file.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from ssp_core.files import read_text
from ssp_eval.data import json_fields
from ssp_eval.data.json_fields import Location
from ssp_eval.data.records import SLOT_NAMES, VOCABULARIES, Slot, Slots

STYLES = ("coc", "staged", "verbose", "terse", "structured")


@dataclass(frozen=True)
class Example:
    """A text with its labels.

    Args:
        key: of the text, unlike all others in the file.
        style: one of STYLES.
        text: that a model could have written.
        slots: what it says, with the words that say it.
    """

    key: str
    style: str
    text: str
    slots: Slots


def load_corpus(path: str | Path) -> tuple[Example, ...]:
    """The examples of a corpus file.

    Raises:
        InputError: it can't be read, holds no example, or something in it is wrong.
    """
    return parse_corpus(read_text(path), path)


def parse_corpus(text: str, file: str | Path) -> tuple[Example, ...]:
    """The examples of a text of JSON lines; blank lines are passed over.

    Args:
        text: of the file.
        file: name for messages.

    Raises:
        InputError: the first thing that is wrong, with line and field.
    """
    examples: list[Example] = []
    lines: dict[str, int] = {}
    for number, content in enumerate(text.removeprefix("\ufeff").split("\n"), start=1):
        if not content.strip():
            continue
        place = Location(file, number)
        example = _example(json_fields.parse_json(content, place), place)
        if example.key in lines:
            raise place.at("id").error(f"stands in line {lines[example.key]} too", example.key)
        lines[example.key] = number
        examples.append(example)
    if not examples:
        raise Location(file).error("holds no text")
    return tuple(examples)


def _example(value: object, place: Location) -> Example:
    found = json_fields.mapping(value, place, ("id", "style", "text", "slots"))
    key = json_fields.string(found["id"], place.at("id"))
    if not key:
        raise place.at("id").error("must not be empty")
    text = json_fields.string(found["text"], place.at("text"))
    here = place.at("slots")
    given = json_fields.mapping(found["slots"], here, SLOT_NAMES)
    slots = {name: _slot(name, given[name], text, here.at(name)) for name in SLOT_NAMES}
    return Example(
        key, json_fields.choice(found["style"], place.at("style"), STYLES), text, Slots(**slots)
    )


def _slot(name: str, value: object, text: str, place: Location) -> Slot | None:
    if value is None:
        return None
    found = json_fields.mapping(value, place, ("value", "evidence"))
    here = place.at("value")
    answer: str | tuple[str, ...]
    if name == "objects":
        words = json_fields.items(found["value"], here)
        answer = json_fields.choices(words, here, VOCABULARIES[name])
        if len(answer) < len(words):
            raise here.error("names a class twice")
    else:
        answer = json_fields.choice(found["value"], here, VOCABULARIES[name])
    here = place.at("evidence")
    spans = json_fields.items(found["evidence"], here)
    if not spans:
        raise here.error("must hold at least one span")
    return Slot(answer, tuple(_span(one, text, here.at(i)) for i, one in enumerate(spans)))


def _span(value: object, text: str, place: Location) -> tuple[int, int]:
    bounds = json_fields.items(value, place)
    if len(bounds) != 2:
        raise place.error(f"must hold a start and an end, not {len(bounds)} items")
    start, end = (json_fields.integer(bound, place.at(i)) for i, bound in enumerate(bounds))
    if not 0 <= start < end <= len(text):
        raise place.error(f"[{start}, {end}] is no span of a text of {len(text)} characters")
    if not text[start:end].strip():
        raise place.error("covers nothing but blanks")
    return start, end
