"""The answers of reviewers, and the key that stays with the person who asked them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, StrictInt

from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.run_file.values import Strict
from ssp_eval.data.labels import Text
from ssp_eval.data.records import SLOT_NAMES, VOCABULARIES
from ssp_eval.extract.measure import NOBODY

ANSWERS_SCHEMA = "ssp.review_answers/1"
REVIEWERS = (1, 2)
NONE = "none"  # the text says nothing about the slot
UNSURE = "unsure"
BETWEEN = "+"  # classes of objects
_COMMENT = "comment"

Answers = Mapping[str, Mapping[str, str]]


def _answers(answers: Mapping[str, str]) -> dict[str, str]:
    """Return the answers to all questions about a text, without the comment."""
    for name in answers:
        if name not in (*SLOT_NAMES, _COMMENT):
            raise ValueError(f"{name}: is not a known key; known: {', '.join(SLOT_NAMES)}")
    for name in SLOT_NAMES:
        if name not in answers:
            raise ValueError(f"{name}: is missing")
    return {name: _answer(name, answers[name]) for name in SLOT_NAMES}


def _answer(slot: str, value: str) -> str:
    """Return a label, classes joined in the vocabulary's order, or one of the words above."""
    parts = value.split(BETWEEN) if slot == "objects" else [value]
    alone = {NONE, UNSURE, *([NOBODY] if slot == "objects" else [])}
    allowed = (*VOCABULARIES[slot], *sorted(alone))
    if not set(parts) <= set(allowed):
        raise ValueError(
            f"{slot}: {value!r} is outside the vocabulary; known: {', '.join(allowed)}, where "
            f"{NONE} is what the text says nothing about, and {UNSURE} where you are"
        )
    if len(parts) > 1 and alone.intersection(parts):
        raise ValueError(f"{slot}: {', '.join(sorted(alone))} stand by themselves")
    return BETWEEN.join(name for name in allowed if name in parts)


_Answered = Annotated[dict[str, Text], AfterValidator(_answers)]


class KeyItem(Strict):
    """One text of the review: the id that reviewers see, and the text's own id and hash.

    It also has the extractor's findings, by slot, as an answer.
    """

    review_id: Text
    source_id: Text | StrictInt
    text_sha256: Text
    extracted: _Answered


class Key(Strict):
    """The data that reviewers must not see.

    ``subset`` is the hash of the texts under their new ids, which forms and answers carry;
    ``source_sha256`` that of the file of texts, ``extractor`` that of the extractor, ``seed`` the
    one of the choice.
    """

    schema_: Literal["ssp.review_key/1"] = Field("ssp.review_key/1", alias="schema")
    subset: Text
    source_sha256: Text
    extractor: Text
    seed: int
    items: tuple[KeyItem, ...]


def load_key(path: Path) -> Key:
    """Return the key of a review; raise InputError where something in it is wrong."""
    return load_model(Key, path)


class _Form(Strict):
    """The export of the form."""

    schema_: Literal["ssp.review_answers/1"] = Field(alias="schema")
    subset: Text
    reviewer: Literal[1, 2]
    answers: dict[str, _Answered]


def load_answers(path: Path, key: Key) -> Answers:
    """Return the answers of one reviewer, by review id and slot.

    Raises:
        InputError: it can't be read, is of another review, misses a text, or an answer is wrong.
    """
    form = load_model(_Form, path)
    if form.subset != key.subset:
        raise InputError(
            "is of another review than the key",
            file=path,
            field="subset",
            value=form.subset,
            remedy="give the form and the key of one review",
        )
    review_ids = [item.review_id for item in key.items]
    for review_id in form.answers:
        if review_id not in review_ids:
            problem = "is no text of this review"
            raise InputError(
                problem, file=path, field="answers", value=review_id, remedy="remove the entry"
            )
    if missing := [review_id for review_id in review_ids if review_id not in form.answers]:
        more = f" and {len(missing) - 1} others" if len(missing) > 1 else ""
        raise InputError(
            f"has no answers for {missing[0]}{more}",
            file=path,
            remedy="answer all texts of the form",
        )
    return {review_id: form.answers[review_id] for review_id in review_ids}
