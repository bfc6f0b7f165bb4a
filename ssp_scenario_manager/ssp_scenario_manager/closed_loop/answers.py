"""The answers of a run with measured latency, kept beside it: with them it is driven again."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

from pydantic import TypeAdapter, ValidationError

from ssp_core.errors import InputError
from ssp_core.files import write_text
from ssp_core.world.driver import RecordedAnswer
from ssp_scenario_manager.run.in_process import Record

ANSWERS_FILE = "answers.json"
ANSWERS_SCHEMA: Literal["ssp.driven_answers/1"] = "ssp.driven_answers/1"


@dataclass(frozen=True, slots=True)
class KeptAnswers:
    """The answers of a driven run, in the order of its questions.

    Args:
        event: in the run.
        free: in its event-free twin.
    """

    event: tuple[RecordedAnswer, ...]
    free: tuple[RecordedAnswer, ...]
    schema: Literal["ssp.driven_answers/1"] = ANSWERS_SCHEMA


_FORM: TypeAdapter[KeptAnswers] = TypeAdapter(KeptAnswers)


def answers_of(record: Record) -> tuple[RecordedAnswer, ...]:
    """Return the answers of a run whose latency was measured."""
    drives = [report.drive for report in record.reports if report.drive is not None]
    return tuple(
        RecordedAnswer(drive.asked.sha256, drive.given)
        for drive in drives
        if drive.asked is not None and drive.given is not None
    )


def save_answers(folder: Path, kept: KeptAnswers) -> None:
    """Write the file of a run's folder; numbers that aren't finite stand in it as such."""
    write_text(folder / ANSWERS_FILE, json.dumps(asdict(kept)) + "\n")


def load_answers(folder: Path) -> KeptAnswers:
    """Read the file of a run's folder.

    Raises:
        InputError: it isn't there, or isn't what was written.
    """
    path = folder / ANSWERS_FILE
    remedy = "give --drive, and the model is asked again"
    try:
        value: Any = json.loads(path.read_text())
    except FileNotFoundError:
        raise InputError("isn't there", file=path, remedy=remedy) from None
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"can't be read: {error}", file=path, remedy=remedy) from None
    try:
        return _FORM.validate_python(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"]))
        raise InputError(first["msg"], file=path, field=field, remedy=remedy) from None
