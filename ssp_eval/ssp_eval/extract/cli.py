"""``ssp extract``: slots with evidence for texts in a JSON Lines file."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator

import click

from ssp_core.errors import InputError
from ssp_eval import strict
from ssp_eval.extract.rules import extract as extract_slots
from ssp_eval.records import BehaviourRecord, record_to_json
from ssp_eval.strict import Place


@click.command()
@click.argument("file", metavar="FILE.jsonl")
def extract(file: str) -> None:
    """Extract slots with evidence from texts.

    FILE.jsonl has lines {"id": …, "text": …}; "-" reads standard input. For each, one line
    {"id": …, "slots": …} goes to standard output, slots as in behaviour records (METHOD 5.3).
    """
    try:
        with click.open_file(file, encoding="utf-8") as stream:
            _run(stream, file)
    except (FileNotFoundError, PermissionError, IsADirectoryError) as error:
        raise InputError(f"can't be read: {error.strerror}", file=file) from error


def _run(stream: Iterable[str], file: str) -> None:
    for key, text in _texts(stream, file):
        record = record_to_json(BehaviourRecord(0.0, text, extract_slots(text)))
        click.echo(json.dumps({"id": key, "slots": json.loads(record)["slots"]}))


def _texts(stream: Iterable[str], file: str) -> Iterator[tuple[str | int, str]]:
    """The ids and texts of a stream, one line at a time; blank lines are passed over."""
    number = 0
    try:
        for number, line in enumerate(stream, start=1):
            content = line.removeprefix("\ufeff") if number == 1 else line
            if content.strip():
                yield _text(content, Place(file, number))
    except UnicodeDecodeError as error:
        raise InputError("is not UTF-8", file=file, line=number + 1) from error


def _text(content: str, place: Place) -> tuple[str | int, str]:
    found = strict.mapping(strict.parse_json(content, place), place, ("id", "text"))
    key = found["id"]
    if isinstance(key, bool) or not isinstance(key, str | int):
        raise place.at("id").error("must be a string or a whole number", key)
    return key, strict.string(found["text"], place.at("text"))
