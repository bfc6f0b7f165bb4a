"""Behaviour records (METHOD 5.3, 5.6): what a line of a file holds, and the object made of it."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, Strict, ValidationError

from ssp_core.errors import InputError
from ssp_core.files import Model, parse_model, read_text
from ssp_core.run_file.values import Strict as Closed
from ssp_core.vocabulary import (
    CONFLICTS,
    LAT_ACTIONS,
    LON_ACTIONS,
    MOTIONS,
    OBJECTS,
    POSITIONS,
    ConflictWord,
    LatWord,
    LonWord,
    MotionWord,
    ObjectWord,
    PositionWord,
)
from ssp_eval.data.labels import Flag, Number, Text, once
from ssp_vla_bridge.trajectory import INVALID_REASONS, Trajectory

SCHEMA: Literal["ssp.record/1"] = "ssp.record/1"
VOCABULARIES: dict[str, tuple[str, ...]] = {
    "objects": OBJECTS,
    "position": POSITIONS,
    "motion": MOTIONS,
    "conflict": CONFLICTS,
    "lon_action": LON_ACTIONS,
    "lat_action": LAT_ACTIONS,
}
# An answer may have a mebibyte of text, and a cell any number of label times.
MOST_BYTES = 1 << 28


@dataclass(frozen=True)
class Slot:
    """One answer of a model with its support.

    Args:
        value: a word of the slot's vocabulary; for objects, a tuple of distinct words.
        evidence: half-open character spans (start, end) of the record's text; a span may lie
            outside the text, then it supports nothing.
    """

    value: str | tuple[str, ...]
    evidence: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class Slots:
    """The six slots of METHOD 5.1; None where the text says nothing."""

    objects: Slot | None = None
    position: Slot | None = None
    motion: Slot | None = None
    conflict: Slot | None = None
    lon_action: Slot | None = None
    lat_action: Slot | None = None


SLOT_NAMES = tuple(item.name for item in fields(Slots))


@dataclass(frozen=True)
class BehaviourRecord:
    """One output of a model, ready for scoring (METHOD 5.3).

    Args:
        t_s: clip time of the newest frame that the model saw, s.
        text: the model's text, ``""`` if it gave none.
        slots: what the text says in the closed vocabularies.
        trajectory: as the model gave it, valid or not; None when missing or unreadable.
        invalid: why the trajectory is missing or invalid; informs and decides nothing.
        adapter: name, mode, origin_added and notes of the adapter, if it is known.
    """

    t_s: float
    text: str
    slots: Slots = field(default_factory=Slots)
    trajectory: Trajectory | None = None
    invalid: tuple[str, ...] = ()
    adapter: dict[str, Any] | None = None


_Place = Annotated[int, Strict()]


class _Said(Closed):
    evidence: tuple[tuple[_Place, _Place], ...]


class _Objects(_Said):
    value: tuple[ObjectWord, ...] | None


class _Position(_Said):
    value: PositionWord | None


class _Motion(_Said):
    value: MotionWord | None


class _Conflict(_Said):
    value: ConflictWord | None


class _LonAction(_Said):
    value: LonWord | None


class _LatAction(_Said):
    value: LatWord | None


class SlotsLine(Closed):
    """The slots of a text as a line of a file has them."""

    objects: _Objects | None
    position: _Position | None
    motion: _Motion | None
    conflict: _Conflict | None
    lon_action: _LonAction | None
    lat_action: _LatAction | None

    def made(self) -> Slots:
        """The slots; None where a line has null, or null for the value."""
        return Slots(**{name: _slot(said) for name, said in self})


_Coordinates = tuple[Annotated[float, Strict()] | None, ...]


class _TrajectoryLine(Closed):
    t_s: _Coordinates
    x_m: _Coordinates
    y_m: _Coordinates


class _AdapterLine(Closed):
    name: Text
    mode: Text
    origin_added: Flag
    notes: list[Text]


class _Line(Closed):
    """``ssp.record/1``."""

    schema_: Literal["ssp.record/1"] = Field(alias="schema")
    t_s: Number
    text: Text
    slots: SlotsLine
    trajectory: _TrajectoryLine | None
    invalid: tuple[Literal[INVALID_REASONS], ...]  # type: ignore[valid-type]  # words of a tuple
    adapter: _AdapterLine | None = None

    def record(self) -> BehaviourRecord:
        path = self.trajectory
        return BehaviourRecord(
            self.t_s,
            self.text,
            self.slots.made(),
            None if path is None else Trajectory(*map(_with_nan, (path.t_s, path.x_m, path.y_m))),
            once(self.invalid),
            None if self.adapter is None else self.adapter.model_dump(),
        )


def _with_nan(numbers: _Coordinates) -> tuple[float, ...]:
    """NaN where the file has null: the trajectory is invalid, the file is not."""
    return tuple([math.nan if number is None else number for number in numbers])


def _slot(said: Any) -> Slot | None:
    if said is None or said.value is None:
        return None
    return Slot(once(said.value) if isinstance(said, _Objects) else said.value, said.evidence)


def load_records(path: str | Path) -> tuple[BehaviourRecord, ...]:
    """The records of a JSON Lines file.

    Raises:
        InputError: see parse_records; or the file can't be read.
    """
    return parse_records(read_text(path, MOST_BYTES), path)


def parse_records(text: str, file: str | Path) -> tuple[BehaviourRecord, ...]:
    """The records of a JSON Lines text; none for an empty one (a model that stayed silent).

    Raises:
        InputError: the first thing that is wrong with the file, with line and field.
    """
    records: list[BehaviourRecord] = []
    for number, line in enumerate(text.removeprefix("\ufeff").split("\n"), start=1):
        if not line.strip(" \t\r"):
            continue
        record = parse_line(_Line, line, file, number).record()
        if records and record.t_s <= records[-1].t_s:
            raise InputError(
                "must rise strictly from record to record", file=file, line=number, field="t_s",
                value=record.t_s, remedy=f"the record before has {records[-1].t_s!r}",
            )  # fmt: skip
        records.append(record)
    return tuple(records)


def parse_line(model: type[Model], line: str, file: str | Path, number: int) -> Model:
    """A line of a JSON Lines file as its model; raises InputError with line and field."""
    try:
        return model.model_validate_json(line)
    except ValidationError as error:
        first = error.errors()[0]
        if first["type"] == "json_invalid":
            problem = f"is not valid JSON: {first['ctx']['error']}"
            raise InputError(problem, file=file, line=number) from error
    try:
        return parse_model(model, json.loads(line), file)
    except InputError as told:  # in the words of all files that are read
        raise InputError(
            told.problem, file=file, line=number, field=told.field, value=told.value
        ) from told


def record_to_json(record: BehaviourRecord) -> str:
    """The record as one line of JSON (METHOD 5.3) without line end, which parse_records reads.

    Numbers that are not finite are written as null, so that the line is standard JSON; they come
    back as NaN and the trajectory is as invalid as before.
    """
    path = record.trajectory
    value = {
        "schema": SCHEMA,
        "t_s": record.t_s,
        "text": record.text,
        "slots": {
            name: None if slot is None else {"value": slot.value, "evidence": slot.evidence}
            for name in SLOT_NAMES
            for slot in [getattr(record.slots, name)]
        },
        "trajectory": path
        and {"t_s": _finite(path.t_s), "x_m": _finite(path.x_m), "y_m": _finite(path.y_m)},
        "invalid": record.invalid,
    }
    if record.adapter is not None:
        value["adapter"] = record.adapter
    return json.dumps(value, allow_nan=False)


def _finite(values: Sequence[float]) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values]
