"""The answers of a model's run, kept beside it: with them it is driven again.

A campaign keeps those of each row, so that a run that failed is seen again as it was.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import FailFast, TypeAdapter, ValidationError

from ssp_core.errors import InputError
from ssp_core.files.reading import read_json
from ssp_core.files.writing import write_text
from ssp_core.hashing import sha256_json
from ssp_core.run_file.driven import Driven
from ssp_core.world.driver import LatencyParts, RecordedAnswer
from ssp_core.world.driver_answers import MOST_ANSWER_BYTES
from ssp_scenario_manager.run.in_process import Record

ANSWERS_FILE = "answers.json"
ANSWERS_FOLDER = "answers"  # of a campaign, by row
ANSWERS_SCHEMA: Literal["ssp.driven_answers/2"] = "ssp.driven_answers/2"

_NO_TIME = LatencyParts(0)


@dataclass(frozen=True, slots=True)
class Question:
    """The run whose driver was asked; under another one its answers aren't repeated.

    Args:
        driver: its name.
        options: hash of its options.
        latency: L, as a run file has it.
        start: hash of the start.
        repeat: of the start under this driver, from 0.
    """

    driver: str
    options: str
    latency: str
    start: str
    repeat: int = 0

    @classmethod
    def of(cls, driven: Driven) -> Question:
        """Return what a run file says of it."""
        options = sha256_json(driven.options)
        return cls(driven.driver, options, str(driven.latency), driven.start, driven.repeat)


@dataclass(frozen=True, slots=True)
class KeptAnswers:
    """The answers of a driven run, in the order of its questions.

    Args:
        asked: whose answers they are.
        event: in the run.
        free: in its event-free twin.
    """

    asked: Question
    event: Annotated[tuple[RecordedAnswer, ...], FailFast()]
    free: Annotated[tuple[RecordedAnswer, ...], FailFast()]
    schema: Literal["ssp.driven_answers/2"] = ANSWERS_SCHEMA


_FORM: TypeAdapter[KeptAnswers] = TypeAdapter(KeptAnswers)


def answers_of(driven: Driven, record: Record) -> tuple[RecordedAnswer, ...]:
    """Return the answers of a run; without the time that they took where L is fixed.

    Args:
        driven: the driver.
        record: of the run.
    """
    drives = [report.drive for report in record.reports if report.drive is not None]
    return tuple(
        RecordedAnswer(
            drive.question.sha256,
            drive.answer if driven.latency.measured else replace(drive.answer, latency=_NO_TIME),
        )
        for drive in drives
        if drive.question is not None and drive.answer is not None
    )


def row_file(campaign: Path, row: int) -> Path:
    """Return the file of the answers of a campaign's row.

    Args:
        campaign: its folder.
        row: of ``runs.csv``, from 1.
    """
    return campaign / ANSWERS_FOLDER / f"{row:06d}.json"


def save_answers(path: Path, answers: KeptAnswers) -> None:
    """Write a file of answers; numbers that aren't finite stand in it as such."""
    write_text(path, json.dumps(asdict(answers)) + "\n")


def load_answers(path: Path, remedy: str, driven: Driven | None = None) -> KeptAnswers:
    """Read a file of answers.

    Args:
        path: of the file.
        remedy: what a person does without it.
        driven: repeats them; None: they are only read.

    Raises:
        InputError: it isn't there, isn't what was written, or is of another driver, options,
            latency or start.
    """
    if not path.exists():
        raise InputError("isn't there", file=path, remedy=remedy)
    value = read_json(path, remedy, MOST_ANSWER_BYTES)
    try:
        answers = _FORM.validate_python(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"]))
        raise InputError(first["msg"], file=path, field=field, remedy=remedy) from None
    question = {} if driven is None else asdict(Question.of(driven))
    for name, theirs in asdict(answers.asked).items():
        if question.get(name, theirs) != theirs:
            raise InputError(
                f"the answers are of another run: this one has {question[name]}",
                file=path,
                field=f"asked.{name}",
                value=theirs,
                remedy=remedy,
            )
    return answers


def repeated(
    answers: KeptAnswers | None, *, event: bool = True
) -> tuple[RecordedAnswer, ...] | None:
    """Return the answers that a driver repeats in a run, or in its event-free twin."""
    if answers is None:
        return None
    return answers.event if event else answers.free
