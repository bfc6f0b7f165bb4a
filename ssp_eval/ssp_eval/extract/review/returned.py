"""Reading what reviewers return: the form's CSV or JSON, or the filled spreadsheet."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping
from pathlib import Path

from ssp_core.errors import InputError
from ssp_core.files import read_text
from ssp_eval.data import json_fields
from ssp_eval.data.json_fields import Location
from ssp_eval.data.records import SLOT_NAMES
from ssp_eval.extract.review.model import ANSWERS_SCHEMA, REVIEWERS, Key, answer

COLUMNS = ("review_id", "text", *SLOT_NAMES, "comment")
_OPTIONAL = ("text", "comment")
Answers = Mapping[str, Mapping[str, str]]


def load_answers(path: Path, key: Key) -> Answers:
    """The answers of one reviewer, by review id and slot.

    Args:
        path: CSV with a header (separated by comma, semicolon or tab), or JSON of the form.
        key: of the review.

    Raises:
        InputError: it can't be read, is of another review, misses a text, or an answer is wrong.
    """
    text = read_text(path).removeprefix("\ufeff")
    found = _from_json(text, path, key) if text.lstrip().startswith("{") else _from_csv(text, path)
    known = [item.review_id for item in key.items]
    for review_id, place in found.items():
        if review_id not in known:
            raise place[0].error("is no text of this review", review_id)
    missing = [review_id for review_id in known if review_id not in found]
    if missing:
        more = f" and {len(missing) - 1} others" if len(missing) > 1 else ""
        raise Location(path).error(f"has no answers for {missing[0]}{more}")
    return {review_id: found[review_id][1] for review_id in known}


def _from_json(text: str, path: Path, key: Key) -> dict[str, tuple[Location, dict[str, str]]]:
    top = Location(path)
    value = json_fields.mapping(
        json_fields.parse_json(text, top), top, ("schema", "subset", "reviewer", "answers")
    )
    json_fields.choice(value["schema"], top.at("schema"), (ANSWERS_SCHEMA,))
    if json_fields.string(value["subset"], top.at("subset")) != key.subset:
        raise top.at("subset").error("is of another review than the key", value["subset"])
    reviewer = json_fields.integer(value["reviewer"], top.at("reviewer"))
    if reviewer not in REVIEWERS:
        raise top.at("reviewer").error("is no reviewer", reviewer)
    here = top.at("answers")
    if not isinstance(value["answers"], dict):
        raise here.error("must be an object")
    found = {}
    for review_id, given in value["answers"].items():
        place = here.at(review_id)
        slots = json_fields.mapping(given, place, SLOT_NAMES, ("comment",))
        found[review_id] = place, _answers(slots, place)
    return found


def _from_csv(text: str, path: Path) -> dict[str, tuple[Location, dict[str, str]]]:
    head = text.split("\n", 1)[0]
    delimiter = max(",;\t", key=head.count)
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=delimiter, strict=True)
    found: dict[str, tuple[Location, dict[str, str]]] = {}
    names: list[str] | None = None
    line = 1
    while True:
        line = reader.line_num + 1  # where the next row begins, whatever lines its text has
        place = Location(path, line)
        try:
            row = next(reader, None)
        except csv.Error as error:
            raise place.error(f"is no CSV: {error}") from error
        if row is None:
            break
        if names is None:
            names = _header(row, place)
        elif any(cell.strip() for cell in row):
            review_id, slots = _row(names, row, place)
            if review_id in found:
                first = found[review_id][0].line
                raise place.at("review_id").error(f"stands in line {first} too", review_id)
            found[review_id] = place.at("review_id"), slots
    if names is None:
        raise InputError("is empty", file=path)
    return found


def _header(row: list[str], place: Location) -> list[str]:
    names = [cell.strip().lower() for cell in row]
    for name in names:
        if name not in COLUMNS:
            known = ", ".join(COLUMNS)
            raise place.error("has an unknown column", name, remedy=f"known are {known}")
    for name in COLUMNS:
        count = names.count(name)
        if count > 1 or (count == 0 and name not in _OPTIONAL):
            raise place.error(f"has the column {name} {'twice' if count else 'nowhere'}")
    return names


def _row(names: list[str], row: list[str], place: Location) -> tuple[str, dict[str, str]]:
    if len(row) != len(names):
        raise place.error(f"has {len(row)} cells where the header has {len(names)}")
    cells = dict(zip(names, row, strict=True))
    return cells["review_id"].strip(), _answers(cells, place)


def _answers(cells: Mapping[str, object], place: Location) -> dict[str, str]:
    return {name: answer(name, cells[name], place.at(name)) for name in SLOT_NAMES}
