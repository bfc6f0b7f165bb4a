"""Behaviour records (METHOD 5.3): what adapter and extractor leave for scoring.

One JSON object per line. Which wrong content is an error of the file, and which is an output of a
model that scores as missing or invalid (METHOD 5.6):

====================  =====================================  =====================================
where                 refused as input (InputError)          a model's output, never an error
====================  =====================================  =====================================
the line              no JSON object, a key twice, unknown   blank lines are skipped (they count
                      or missing keys, unknown schema        as lines); a BOM at the start of the
                                                             file and CRLF line ends are accepted
``t_s``               no finite number, not rising strictly
``slots``             one of the six slots missing, a slot   slot null, or its ``value`` null: the
                      without exactly value and evidence,    slot is missing; an empty list of
                      a value outside its vocabulary         objects is an answer
``evidence``          no list of pairs of whole numbers      a span outside the text, empty or
                                                             reversed: it supports nothing
``trajectory``        neither null nor an object of exactly  null, NaN, Infinity or a number too
                      the lists t_s, x_m, y_m; an item that  large for a double among the items,
                      is a string, boolean, list or object   empty or unequal lists, times that
                                                             don't rise, too short a support:
                                                             invalid trajectory
``invalid``           a word that METHOD 5.3 doesn't list    any listed word (it decides nothing)
``adapter``           present, neither null nor an object
                      of name, mode, origin_added, notes
====================  =====================================  =====================================

The line is drawn between the shape of the file, which our own adapter or extractor writes, and
the numbers and spans in it, which a model chose.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ssp_core.files import read_text
from ssp_eval import record_lines, strict
from ssp_eval.record_lines import ADAPTER_KEYS, KEYS, SCHEMA, SLOT_KEYS, TRAJECTORY_KEYS, Lines
from ssp_eval.strict import Place
from ssp_vla_bridge.trajectory import INVALID_REASONS, Trajectory

# An answer may have a mebibyte of text, and a cell any number of label times.
MOST_BYTES = 1 << 28

_JSON_SPACE = " \t\r\n"


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


VOCABULARIES = record_lines.VOCABULARIES
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


def load_records(path: str | Path) -> tuple[BehaviourRecord, ...]:
    """The records of a JSON Lines file.

    Raises:
        InputError: see parse_records; or the file can't be read.
    """
    return parse_records(read_text(path, MOST_BYTES), path)


def parse_records(text: str, file: str | Path) -> tuple[BehaviourRecord, ...]:
    """The records of a JSON Lines text; none for an empty one (a model that stayed silent).

    Args:
        text: one JSON object per line.
        file: name for error messages.

    Raises:
        InputError: the first thing that is wrong with the file, with line and field.
    """
    lines = record_lines.read_lines([text])
    return _parse_strictly(text, file) if lines is None else _records_of(lines)


def _parse_strictly(text: str, file: str | Path) -> tuple[BehaviourRecord, ...]:
    """See parse_records: value by value, so that what is wrong has its place."""
    records: list[BehaviourRecord] = []
    for line, content in enumerate(text.removeprefix("\ufeff").split("\n"), start=1):
        if not content.strip(_JSON_SPACE):
            continue
        place = Place(file, line)
        record = _record(strict.parse_json(content, place), place)
        if records and record.t_s <= records[-1].t_s:
            raise place.at("t_s").error(
                "must rise strictly from record to record",
                record.t_s,
                remedy=f"the record before has {records[-1].t_s!r}",
            )
        records.append(record)
    return tuple(records)


def _record(value: object, place: Place) -> BehaviourRecord:
    found = strict.mapping(value, place, KEYS, ("adapter",))
    strict.choice(found["schema"], place.at("schema"), (SCHEMA,))
    return BehaviourRecord(
        t_s=strict.finite(found["t_s"], place.at("t_s")),
        text=strict.string(found["text"], place.at("text")),
        slots=_slots(found["slots"], place.at("slots")),
        trajectory=_trajectory(found["trajectory"], place.at("trajectory")),
        invalid=strict.choices(found["invalid"], place.at("invalid"), INVALID_REASONS),
        adapter=_adapter(found.get("adapter"), place.at("adapter")),
    )


def _slots(value: object, place: Place) -> Slots:
    found = strict.mapping(value, place, SLOT_NAMES)
    return Slots(**{name: _slot(name, found[name], place.at(name)) for name in SLOT_NAMES})


def _slot(name: str, value: object, place: Place) -> Slot | None:
    if value is None:
        return None
    found = strict.mapping(value, place, SLOT_KEYS)
    spans = strict.items(found["evidence"], place.at("evidence"))
    evidence = tuple(_span(span, place.at("evidence").at(i)) for i, span in enumerate(spans))
    if found["value"] is None:
        return None
    read = strict.choices if name == "objects" else strict.choice
    return Slot(read(found["value"], place.at("value"), VOCABULARIES[name]), evidence)


def _span(value: object, place: Place) -> tuple[int, int]:
    bounds = strict.items(value, place)
    if len(bounds) != 2:
        raise place.error(f"must hold a start and an end, not {len(bounds)} items")
    start, end = (strict.integer(bound, place.at(i)) for i, bound in enumerate(bounds))
    return start, end


def _trajectory(value: object, place: Place) -> Trajectory | None:
    if value is None:
        return None
    found = strict.mapping(value, place, TRAJECTORY_KEYS)
    t_s, x_m, y_m = (_coordinates(found[key], place.at(key)) for key in TRAJECTORY_KEYS)
    return Trajectory(t_s, x_m, y_m)


def _coordinates(value: object, place: Place) -> tuple[float, ...]:
    """Numbers with NaN where the file has null: the trajectory is invalid, the file is not."""
    return tuple(
        math.nan if item is None else strict.number(item, place.at(i))
        for i, item in enumerate(strict.items(value, place))
    )


def _adapter(value: object, place: Place) -> dict[str, Any] | None:
    if value is None:
        return None
    found = strict.mapping(value, place, ADAPTER_KEYS)
    notes = strict.items(found["notes"], place.at("notes"))
    return {
        "name": strict.string(found["name"], place.at("name")),
        "mode": strict.string(found["mode"], place.at("mode")),
        "origin_added": strict.boolean(found["origin_added"], place.at("origin_added")),
        "notes": [strict.string(n, place.at("notes").at(i)) for i, n in enumerate(notes)],
    }


def _records_of(lines: Lines) -> tuple[BehaviourRecord, ...]:
    """Records whose content is known to be right."""
    columns = (
        lines.t_s,
        lines.texts,
        [Slots(*slots) for slots in zip(*_slot_columns(lines), strict=True)],
        [path and Trajectory(*_coordinate_tuples(path)) for path in lines.trajectories],
        [tuple(dict.fromkeys(words)) for words in lines.invalid],
        [adapter and dict(adapter) for adapter in lines.adapters],
    )
    return tuple([BehaviourRecord(*row) for row in zip(*columns, strict=True)])


def _slot_columns(lines: Lines) -> list[list[Slot | None]]:
    return [[_known_slot(slot) for slot in column] for column in lines.slots]


def _known_slot(found: Mapping[str, Any] | None) -> Slot | None:
    if found is None or found["value"] is None:
        return None
    value = found["value"]
    evidence = tuple([(start, end) for start, end in found["evidence"]])
    return Slot(value if isinstance(value, str) else tuple(dict.fromkeys(value)), evidence)


def _coordinate_tuples(path: Mapping[str, Any]) -> list[tuple[float, ...]]:
    return [
        tuple([math.nan if item is None else float(item) for item in path[key]])
        for key in TRAJECTORY_KEYS
    ]


def record_to_json(record: BehaviourRecord) -> str:
    """The record as one line of JSON (METHOD 5.3) without line end, which parse_records reads.

    Numbers that are not finite are written as null, so that the line is standard JSON; they come
    back as NaN and the trajectory is as invalid as before.
    """
    value = {
        "schema": SCHEMA,
        "t_s": record.t_s,
        "text": record.text,
        "slots": {name: _slot_json(getattr(record.slots, name)) for name in SLOT_NAMES},
        "trajectory": _trajectory_json(record.trajectory),
        "invalid": list(record.invalid),
    }
    if record.adapter is not None:
        value["adapter"] = record.adapter
    return json.dumps(value, allow_nan=False)


def _slot_json(slot: Slot | None) -> dict[str, Any] | None:
    if slot is None:
        return None
    value = slot.value if isinstance(slot.value, str) else list(slot.value)
    return {"value": value, "evidence": [list(span) for span in slot.evidence]}


def _trajectory_json(trajectory: Trajectory | None) -> dict[str, Any] | None:
    if trajectory is None:
        return None
    return {key: _numbers_json(getattr(trajectory, key)) for key in TRAJECTORY_KEYS}


def _numbers_json(values: Sequence[float]) -> list[float | None]:
    return [value if math.isfinite(value) else None for value in values]
