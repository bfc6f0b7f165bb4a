"""What reviewers answer, and the key that stays with whoever asked them.

Reviewers return the form's CSV or JSON, or the filled spreadsheet.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, ConfigDict, Field, RootModel, Strict

from ssp_core.errors import InputError
from ssp_core.files import load_model, parse_mapping, parse_model, read_text
from ssp_core.run_file.values import Strict as Closed
from ssp_core.vocabulary import OBJECTS
from ssp_eval.data.labels import Text
from ssp_eval.data.records import SLOT_NAMES, VOCABULARIES
from ssp_eval.extract.measure import NOBODY

ANSWERS_SCHEMA = "ssp.review_answers/1"
REVIEWERS = (1, 2)
NONE = "none"  # the text says nothing about the slot
UNSURE = "unsure"
BETWEEN = "+"  # classes of objects
_OPTIONAL = ("text", "comment")
COLUMNS = ("review_id", "text", *SLOT_NAMES, "comment")


def answer(slot: str, value: str) -> str:
    """An answer in its one form: a label, classes joined in order, or one of the words above.

    Args:
        slot: that it is for.
        value: as somebody wrote it; case and blanks around don't matter.

    Raises:
        ValueError: it is none.
    """
    written = value.strip().lower()
    for mark in ",;|/ \t" if slot == "objects" else "":
        written = written.replace(mark, BETWEEN)
    parts = {part for part in written.split(BETWEEN) if part}
    alone = {NONE, UNSURE, *([NOBODY] if slot == "objects" else [])}
    allowed = (*VOCABULARIES[slot], *sorted(alone))
    if not parts or not parts <= set(allowed):
        raise ValueError(
            f"{slot}: {value!r} is outside the vocabulary; known are {', '.join(allowed)}, where "
            f"{NONE} is what the text says nothing about, and {UNSURE} where you are"
        )
    if len(parts) > 1 and (slot != "objects" or parts & alone):
        raise ValueError(f"{slot}: {', '.join(sorted(alone))} stand by themselves")
    return BETWEEN.join(name for name in OBJECTS if name in parts) or parts.pop()


def _answers(given: Mapping[str, str]) -> dict[str, str]:
    """The answers to all questions about a text, without the comment."""
    for name in given:
        if name not in COLUMNS:
            raise ValueError(f"{name}: is not a known key; known are {', '.join(SLOT_NAMES)}")
    for name in SLOT_NAMES:
        if name not in given:
            raise ValueError(f"{name}: is missing")
    return {name: answer(name, given[name]) for name in SLOT_NAMES}


_Answered = Annotated[dict[str, Text], AfterValidator(_answers)]
Answers = Mapping[str, Mapping[str, str]]


@dataclass(frozen=True)
class KeyItem:
    """One text of the review.

    Args:
        review_id: that reviewers see.
        source_id: that the text had before.
        text_sha256: of the text.
        extracted: what the extractor found, by slot, as an answer.
    """

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")
    review_id: Text
    source_id: Text | Annotated[int, Strict()]
    text_sha256: Text
    extracted: _Answered


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

    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")
    subset: Text
    source_sha256: Text
    extractor: Text
    seed: int
    items: tuple[KeyItem, ...]
    schema: Literal["ssp.review_key/1"] = "ssp.review_key/1"

    def to_json(self) -> dict[str, Any]:
        """As it is written."""
        return asdict(self)


def load_key(path: Path) -> Key:
    """The key of a review; raises InputError where something in it is wrong."""
    return load_model(RootModel[Key], path).root


class _Form(Closed):
    """What the form exports as JSON."""

    schema_: Literal["ssp.review_answers/1"] = Field(alias="schema")
    subset: Text
    reviewer: Literal[1, 2]
    answers: dict[str, _Answered]


def load_answers(path: Path, key: Key) -> Answers:
    """The answers of one reviewer, by review id and slot.

    Args:
        path: CSV with a header (separated by comma, semicolon or tab), or JSON of the form.
        key: of the review.

    Raises:
        InputError: it can't be read, is of another review, misses a text, or an answer is wrong.
    """
    text = read_text(path).removeprefix("\ufeff")
    known = [item.review_id for item in key.items]
    if text.lstrip().startswith("{"):
        form = parse_model(_Form, parse_mapping(text.encode(), path), path)
        if form.subset != key.subset:
            raise InputError(
                "is of another review than the key", file=path, field="subset", value=form.subset
            )
        found = form.answers
    else:
        found = _sheet(text, path, known)
    _refuse_stranger(found, known, path)
    missing = [review_id for review_id in known if review_id not in found]
    if missing:
        more = f" and {len(missing) - 1} others" if len(missing) > 1 else ""
        raise InputError(f"has no answers for {missing[0]}{more}", file=path)
    return {review_id: found[review_id] for review_id in known}


def _refuse_stranger(
    given: Mapping[str, Any], known: list[str], path: Path, line: int | None = None
) -> None:
    for review_id in given:
        if review_id not in known:
            problem = "is no text of this review"
            raise InputError(problem, file=path, line=line, field="review_id", value=review_id)


def _sheet(text: str, path: Path, known: list[str]) -> dict[str, dict[str, str]]:
    rows = _rows(text, path)
    names = [cell.strip().lower() for cell in next(rows, (1, [""]))[1]]
    odd = [name for name in names if name not in COLUMNS or names.count(name) > 1]
    odd += [name for name in COLUMNS if name not in (*names, *_OPTIONAL)]
    if odd:
        remedy = f"give each of {', '.join(COLUMNS)} once; {' and '.join(_OPTIONAL)} may be missing"
        problem = "has a column that isn't known, is missing or stands twice"
        raise InputError(problem, file=path, line=1, value=odd[0], remedy=remedy)
    found: dict[str, dict[str, str]] = {}
    lines: dict[str, int] = {}
    for line, row in rows:
        if len(row) != len(names):
            problem = f"has {len(row)} cells where the header has {len(names)}"
            raise InputError(problem, file=path, line=line)
        cells = dict(zip(names, row, strict=True))
        review_id = cells["review_id"].strip()
        _refuse_stranger({review_id: cells}, known, path, line)
        if (first := lines.setdefault(review_id, line)) != line:
            problem = f"stands in line {first} too"
            raise InputError(problem, file=path, line=line, field="review_id", value=review_id)
        try:
            found[review_id] = _answers(cells)
        except ValueError as error:
            raise InputError(str(error), file=path, line=line) from error
    return found


def _rows(text: str, path: Path) -> Iterator[tuple[int, list[str]]]:
    """The rows that aren't blank, each with the line in which it begins."""
    head = text.split("\n", 1)[0]
    stream = io.StringIO(text, newline="")
    reader = csv.reader(stream, delimiter=max(",;\t", key=head.count), strict=True)
    line = 1
    try:
        for row in reader:
            if any(cell.strip() for cell in row):
                yield line, row
            line = reader.line_num + 1
    except csv.Error as error:
        raise InputError(f"is no CSV: {error}", file=path, line=line) from error
