"""What reviewers answer, and the key that stays with whoever asked them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from ssp_core.files import read_text
from ssp_core.vocabulary import OBJECTS
from ssp_eval.data import json_fields
from ssp_eval.data.json_fields import Location
from ssp_eval.data.records import SLOT_NAMES, VOCABULARIES

KEY_SCHEMA = "ssp.review_key/1"
ANSWERS_SCHEMA = "ssp.review_answers/1"
REVIEWERS = (1, 2)
NONE = "none"  # the text says nothing about the slot
NOBODY = "nobody"  # the text says that no road user is there
UNSURE = "unsure"
BETWEEN = "+"  # classes of objects


@dataclass(frozen=True)
class KeyItem:
    """One text of the review.

    Args:
        review_id: that reviewers see.
        source_id: that the text had before.
        text_sha256: of the text.
        extracted: what the extractor found, by slot, as an answer.
    """

    review_id: str
    source_id: str | int
    text_sha256: str
    extracted: Mapping[str, str]


@dataclass(frozen=True)
class Key:
    """What reviewers must not see.

    Args:
        subset: hash of the texts under their new ids; forms and answers carry it.
        source_sha256: of the file of texts.
        extractor: hash of the extractor.
        seed: of the choice.
        items: in the order of their ids.
    """

    subset: str
    source_sha256: str
    extractor: str
    seed: int
    items: tuple[KeyItem, ...]

    def to_json(self) -> dict[str, object]:
        """As it is written."""
        items = [{**vars(item), "extracted": dict(item.extracted)} for item in self.items]
        return {"schema": KEY_SCHEMA, **vars(self), "items": items}


def load_key(path: Path) -> Key:
    """The key of a review.

    Raises:
        InputError: it can't be read, or something in it is wrong.
    """
    top = Location(path)
    value = json_fields.parse_json(read_text(path), top)
    found = json_fields.mapping(
        value, top, ("schema", "subset", "source_sha256", "extractor", "seed", "items")
    )
    json_fields.choice(found["schema"], top.at("schema"), (KEY_SCHEMA,))
    here = top.at("items")
    items = [
        _item(one, here.at(i)) for i, one in enumerate(json_fields.items(found["items"], here))
    ]
    if len({item.review_id for item in items}) < len(items):
        raise here.error("holds an id twice")
    return Key(
        json_fields.string(found["subset"], top.at("subset")),
        json_fields.string(found["source_sha256"], top.at("source_sha256")),
        json_fields.string(found["extractor"], top.at("extractor")),
        json_fields.integer(found["seed"], top.at("seed")),
        tuple(items),
    )


def _item(value: object, place: Location) -> KeyItem:
    keys = ("review_id", "source_id", "text_sha256", "extracted")
    found = json_fields.mapping(value, place, keys)
    source = found["source_id"]
    if isinstance(source, bool) or not isinstance(source, str | int):
        raise place.at("source_id").error("must be a string or a whole number", source)
    here = place.at("extracted")
    extracted = json_fields.mapping(found["extracted"], here, SLOT_NAMES)
    return KeyItem(
        json_fields.string(found["review_id"], place.at("review_id")),
        source,
        json_fields.string(found["text_sha256"], place.at("text_sha256")),
        {name: answer(name, extracted[name], here.at(name)) for name in SLOT_NAMES},
    )


def answer(slot: str, value: object, place: Location) -> str:
    """An answer in its one form: a label, classes joined in order, or one of the words above.

    Args:
        slot: that it is for.
        value: as somebody wrote it; case and blanks around don't matter.
        place: of the value.

    Raises:
        InputError: it is none.
    """
    written = json_fields.string(value, place).strip().lower()
    if not written:
        raise place.error(
            "is empty", remedy=f"write {NONE} where the text says nothing, {UNSURE} where you are"
        )
    allowed = (*VOCABULARIES[slot], *((NOBODY,) if slot == "objects" else ()), NONE, UNSURE)
    if slot != "objects":
        return json_fields.choice(written, place, allowed)
    for mark in ",;|/ \t":
        written = written.replace(mark, BETWEEN)
    parts = [json_fields.choice(part, place, allowed) for part in written.split(BETWEEN) if part]
    if not parts:
        raise place.error("names no class of objects", value)
    if len(set(parts)) > 1 and not set(parts) <= set(OBJECTS):
        raise place.error(f"{NOBODY}, {NONE} and {UNSURE} stand by themselves", value)
    return BETWEEN.join(name for name in OBJECTS if name in parts) or parts[0]
