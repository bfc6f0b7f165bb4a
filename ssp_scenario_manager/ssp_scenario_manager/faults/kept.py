"""The files of a fault cell's folder that are read when it is judged, held against their forms."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeVar

from pydantic import ConfigDict, Field, model_validator

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model, read_json_mapping
from ssp_core.run_file.values import Finite, Strict
from ssp_core.run_file.verdict import RESULT_FILE
from ssp_scenario_manager.run.faults import FAULTS_FILE, WITNESS_FILE

CELL_FILE = "cell.json"
# Of the witness, which has 50 states a second of each object.
_MOST_BYTES = 1 << 26
_REMEDY = "remove the folder of this cell, and it is run again"
_Index = Annotated[int, Field(ge=0, lt=1000)]


class _Part(Strict):
    """No value is made to fit."""

    model_config = ConfigDict(strict=True)


class CellFile(_Part):
    """``ssp.fault_cell/1``: the run that a cell was, and what it left running."""

    schema_: Literal["ssp.fault_cell/1"] = Field("ssp.fault_cell/1", alias="schema")
    key: str
    leftovers: list[str] = []


class ResultFile(_Part):
    """The part of ``result.json`` that a fault is judged by."""

    model_config = ConfigDict(extra="ignore")

    verdict: str
    reasons: list[str]
    bag: Annotated[str, Field(pattern=r"^[^/]+$", max_length=255)]
    wall_s: Finite = 0.0


class FaultChange(_Part):
    """The begin or end of a fault that the runner injected."""

    index: _Index
    kind: str = ""
    target: str = ""
    active: bool
    session_s: Finite
    wall_s: Finite


class ReceivedEvent(_Part):
    """An event that the runner heard."""

    kind: str
    name: str
    detail: str
    session_s: Finite
    wall_s: Finite


class NotesFile(_Part):
    """``ssp.faults_injected/1``, empty where the file isn't there."""

    schema_: Literal["ssp.faults_injected/1"] = Field("ssp.faults_injected/1", alias="schema")
    injected: list[FaultChange] = []
    heard: list[ReceivedEvent] = []


class Rows(_Part):
    """True states of an object, a value for each time."""

    x_m: list[Finite]
    y_m: list[Finite]
    yaw_rad: list[Finite]
    speed_mps: list[Finite]


class WitnessFile(_Part):
    """True states as the runner heard them, empty where the file isn't there."""

    t_s: list[Finite] = []
    wall_s: list[Finite] = []
    objects: dict[str, Rows] = {}

    @model_validator(mode="after")
    def _of_one_length(self) -> Self:
        for name, rows in self.objects.items():
            for key in Rows.model_fields:
                if len(getattr(rows, key)) != len(self.t_s):
                    raise ValueError(f"{key} of {name} must have as many values as t_s")
        return self


_File = TypeVar("_File", bound=_Part)


def _load(form: type[_File], file: Path) -> _File:
    try:
        return parse_model(form, read_json_mapping(file, _MOST_BYTES), file)
    except InputError as error:
        if error.parts:
            raise
        raise InputError(
            error.problem, file=file, field=error.field, value=error.value, remedy=_REMEDY
        ) from error


def load_cell(folder: Path) -> CellFile | None:
    """Read a cell's file; None where there is none as it was written."""
    try:
        return _load(CellFile, folder / CELL_FILE)
    except InputError:
        return None


def load_result(folder: Path) -> ResultFile:
    """Read the result of a cell's run; raise InputError where it isn't one."""
    return _load(ResultFile, folder / RESULT_FILE)


def load_notes(folder: Path) -> NotesFile:
    """Read what the runner injected and heard; raise InputError where the file isn't that."""
    return _if_there(NotesFile, folder / FAULTS_FILE)


def load_witness(folder: Path) -> WitnessFile:
    """Read what the runner heard of the truth; raise InputError where the file isn't that."""
    return _if_there(WitnessFile, folder / WITNESS_FILE)


def _if_there(form: type[_File], file: Path) -> _File:
    values: dict[str, Any] = {}
    return _load(form, file) if file.exists() else form(**values)
