"""The answers of a driver that is a node of its own: one line each, written as soon as it is known.

The run in one process, by which such a session is judged, repeats them.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from ssp_core.errors import InputError, not_written
from ssp_core.files.reading import read_json, read_text
from ssp_core.files.strict_json import parse_json_line
from ssp_core.world.driver import RecordedAnswer

# Beside the run file of a session of several processes.
NODE_ANSWERS_FILE = "answers.jsonl"

# An answer has a megabyte of text at most, and a run some hundred questions.
MOST_ANSWER_BYTES = 1 << 28
_REMEDY = "put the file back, or drive the run again"
_ANSWER: TypeAdapter[RecordedAnswer] = TypeAdapter(RecordedAnswer)


def append_answer(path: Path, answer: RecordedAnswer) -> None:
    """Write one more answer behind those of a file.

    Raises:
        HostError: the disk doesn't take it.
    """
    try:
        with path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(asdict(answer)) + "\n")
    except OSError as error:
        raise not_written(path, error) from error


def given_answers(path: Path) -> tuple[RecordedAnswer, ...]:
    """Read the answers that a driver's node wrote, in the order of its questions.

    Raises:
        InputError: a line is none, but for a last one that was cut off.
    """
    try:
        # A last line without its end was cut off: the node ended while it wrote.
        *lines, _ = read_text(path, MOST_ANSWER_BYTES).split("\n")
    except InputError as error:
        if not path.exists():
            return ()
        raise InputError(error.problem, file=path, remedy=_REMEDY) from error
    return tuple(
        _answer(parse_json_line(line, path, k), path, k) for k, line in enumerate(lines, 1)
    )


def answers_in_event(path: Path) -> tuple[RecordedAnswer, ...]:
    """Read the answers in the event of a run that was driven before (``answers.json``).

    Raises:
        InputError: it isn't such a file.
    """
    value = read_json(path, _REMEDY, MOST_ANSWER_BYTES)
    answers = value.get("event") if isinstance(value, dict) else None
    if not isinstance(answers, list):
        raise InputError("has no answers", file=path, field="event", remedy=_REMEDY)
    return tuple(_answer(one, path, k) for k, one in enumerate(answers, 1))


def _answer(value: Any, path: Path, number: int) -> RecordedAnswer:
    try:
        return _ANSWER.validate_python(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join([str(number), *map(str, first["loc"])])
        raise InputError(first["msg"], file=path, field=field, remedy=_REMEDY) from None
