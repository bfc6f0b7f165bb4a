"""Harness failures of a row's drives, each repeated at most twice over all calls (METHOD 8.7).

A model's failures are kept beside its answers, so that an interrupted and resumed campaign asks the
model no more often than an uninterrupted one.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter, ValidationError

from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.files.reading import read_json
from ssp_core.files.writing import write_text
from ssp_scenario_manager.closed_loop.answers import row_file
from ssp_scenario_manager.closed_loop.outcomes.outcome import Outcome

MOST_TRIES = 3
_REMEDY = "name a new folder with --out"
_SCHEMA: Literal["ssp.driven_tries/1"] = "ssp.driven_tries/1"


@dataclass(frozen=True, slots=True)
class Failure:
    """The time and the reason of a harness failure."""

    at_s: float
    why: str


@dataclass(slots=True)
class Tries:
    """The harness failures in the drives of one row.

    Args:
        event: in the event, in their order.
        free: in its event-free twin.
    """

    event: list[Failure] = field(default_factory=list)
    free: list[Failure] = field(default_factory=list)
    schema: Literal["ssp.driven_tries/1"] = _SCHEMA

    def of(self, *, event: bool) -> list[Failure]:
        """Return those in the event, or in its event-free twin."""
        return self.event if event else self.free

    def lost(self, *, event: bool) -> Failure | None:
        """Return the last failure where no more is tried; None: it is."""
        failures = self.of(event=event)
        return failures[-1] if len(failures) >= MOST_TRIES else None

    def fail(self, outcome: Outcome, path: Path | None, *, event: bool) -> None:
        """Keep one more failure.

        Args:
            outcome: of the drive.
            path: of the file; None: the drive is the same again each time, and none is kept.
            event: False: of the event-free twin.
        """
        self.of(event=event).append(Failure(outcome.at_s, outcome.why))
        if path is not None:
            make_folder(path.parent)
            write_text(path, json.dumps(asdict(self)) + "\n")


_FORM: TypeAdapter[Tries] = TypeAdapter(Tries)


def tries_file(campaign: Path, row: int) -> Path:
    """Return the file of the failed drives of a campaign's row.

    Args:
        campaign: its folder.
        row: of ``runs.csv``, from 1.
    """
    return row_file(campaign, row).with_suffix(".failed.json")


def load_tries(path: Path) -> Tries:
    """Read the failed drives of a row; none where nothing failed.

    Raises:
        InputError: the file isn't what was written.
    """
    if not path.exists():
        return Tries()
    value = read_json(path, _REMEDY)
    try:
        return _FORM.validate_python(value)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        field = ".".join(map(str, first["loc"]))
        raise InputError(first["msg"], file=path, field=field, remedy=_REMEDY) from None
