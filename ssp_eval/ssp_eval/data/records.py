"""Behaviour records (METHOD 5.3, 5.6): what a line of a file holds, and the object made of it."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Annotated, Any, Generic, Literal, NotRequired, TypeVar

from pydantic import RootModel, Strict, ValidationError, with_config
from typing_extensions import TypedDict

from ssp_core.errors import InputError
from ssp_core.files.reading import Model, parse_model, read_text
from ssp_core.files.strict_json import parse_json_line
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
from ssp_eval.data.labels import CLOSED, ClipTime, Flag, Text, once
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
_Evidence = tuple[tuple[_Place, _Place], ...]
_Coordinates = tuple[Annotated[float, Strict()] | None, ...]


Words = TypeVar("Words")


# Typed mappings rather than models, since a campaign has hundreds of thousands of them.
@with_config(CLOSED)
class _SlotValue(TypedDict, Generic[Words]):
    value: Words | None
    evidence: _Evidence


@with_config(CLOSED)
class SlotsLine(TypedDict):
    """The slots of a text as a line of a file has them."""

    objects: _SlotValue[tuple[ObjectWord, ...]] | None
    position: _SlotValue[PositionWord] | None
    motion: _SlotValue[MotionWord] | None
    conflict: _SlotValue[ConflictWord] | None
    lon_action: _SlotValue[LonWord] | None
    lat_action: _SlotValue[LatWord] | None


@with_config(CLOSED)
class _Trajectory(TypedDict):
    t_s: _Coordinates
    x_m: _Coordinates
    y_m: _Coordinates


@with_config(CLOSED)
class _Adapter(TypedDict):
    name: Text
    mode: Text
    origin_added: Flag
    notes: list[Text]


@with_config(CLOSED)
class _Content(TypedDict):
    schema: Literal["ssp.record/1"]
    t_s: ClipTime
    text: Text
    slots: SlotsLine
    trajectory: _Trajectory | None
    invalid: tuple[Literal[INVALID_REASONS], ...]  # type: ignore[valid-type]  # words of a tuple
    adapter: NotRequired[_Adapter | None]


class _Line(RootModel[_Content]):
    """``ssp.record/1``."""

    def record(self) -> BehaviourRecord:
        content = self.root
        path, adapter = content["trajectory"], content.get("adapter")
        return BehaviourRecord(
            content["t_s"],
            content["text"],
            slots_of(content["slots"]),
            None
            if path is None
            else Trajectory(_with_nan(path["t_s"]), _with_nan(path["x_m"]), _with_nan(path["y_m"])),
            once(content["invalid"]),
            None if adapter is None else {**adapter},
        )

    def colons(self) -> int:
        """Return the number of colons of a line in which no key stands twice."""
        content = self.root
        slots, adapter = content["slots"], content.get("adapter")
        answer_count = len(slots) - list(slots.values()).count(None)
        path = 0 if content["trajectory"] is None else len(_Trajectory.__annotations__)
        count = len(content) + len(slots) + 2 * answer_count + path + content["text"].count(":")
        if adapter is not None:
            texts = (adapter["name"], adapter["mode"], *adapter["notes"])
            count += len(adapter) + sum([text.count(":") for text in texts])
        return count


def _with_nan(numbers: _Coordinates) -> tuple[float, ...]:
    """Replace null by NaN: the trajectory is invalid, the file is not."""
    if None not in numbers:
        return numbers  # type: ignore[return-value]  # none of them is None
    return tuple([math.nan if number is None else number for number in numbers])


def slots_of(line: SlotsLine) -> Slots:
    """Return the slots; None where a line has null, or null for the value."""
    return Slots(**{name: _slot(entry) for name, entry in line.items()})


def _slot(entry: Any) -> Slot | None:
    if entry is None or entry["value"] is None:
        return None
    value = entry["value"]
    return Slot(once(value) if isinstance(value, tuple) else value, entry["evidence"])


def load_records(path: str | Path) -> tuple[BehaviourRecord, ...]:
    """Return the records of a JSON Lines file.

    Raises:
        InputError: see parse_records; or the file can't be read.
    """
    return parse_records(read_text(path, MOST_BYTES), path)


def parse_records(text: str, file: str | Path) -> tuple[BehaviourRecord, ...]:
    """Return the records of a JSON Lines text; none for an empty one (a model that stayed silent).

    Raises:
        InputError: the first thing that is wrong with the file, with line and field.
    """
    records: list[BehaviourRecord] = []
    for number, line in enumerate(text.removeprefix("\ufeff").split("\n"), start=1):
        if not line.strip(" \t\r"):
            continue
        record = parse_line(_Line, line, file, number, _Line.colons).record()
        if records and record.t_s <= records[-1].t_s:
            raise InputError(
                "must rise strictly from record to record",
                file=file,
                line=number,
                field="t_s",
                value=record.t_s,
                remedy=f"the record before has {records[-1].t_s!r}",
            )
        records.append(record)
    return tuple(records)


def parse_line(
    model: type[Model],
    line: str,
    file: str | Path,
    number: int,
    colons_of: Callable[[Model], int] | None = None,
) -> Model:
    """Return a line of a JSON Lines file as its model.

    Args:
        model: of the line.
        line: without its end.
        file: that an error names.
        number: of the line, from 1.
        colons_of: returns the number of colons that a line has, one after each key and those in
            its texts; spares most lines a second reading, which finds a key that stands twice.

    Raises:
        InputError: something is wrong, with line and field.
    """
    instance = None
    with suppress(ValidationError):
        instance = model.model_validate_json(line)
    if instance is not None and colons_of is not None:
        # Without a backslash, the quicker search, no colon of a text is written as \u003a.
        is_plain = "\\" not in line or "\\u003" not in line
        if is_plain and line.count(":") == colons_of(instance):
            return instance
    value = parse_json_line(line, file, number)
    if instance is not None:
        return instance
    # A half of a surrogate pair, which is no text of UTF-8, becomes ?.
    whole = json.dumps(value, ensure_ascii=False).encode("utf-8", "replace")
    try:
        return parse_model(model, json.loads(whole), file)
    except InputError as told:  # in the words of all files that are read
        first, *_ = told.parts or (told,)
        raise first.in_file(file).in_line(number) from told


def record_to_json(record: BehaviourRecord) -> str:
    """Return the record as one line of JSON (METHOD 5.3) without line end, for parse_records.

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
