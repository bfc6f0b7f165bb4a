"""Behaviour records (METHOD 5.3, 5.6): as dataclasses, or many lines checked at a time."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from itertools import accumulate, chain, islice
from operator import itemgetter, lt
from pathlib import Path
from typing import Any, Final

from pydantic_core import from_json

from ssp_core.files import read_text
from ssp_core.vocabulary import CONFLICTS, LAT_ACTIONS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS
from ssp_eval.data import json_fields
from ssp_eval.data.json_fields import Location
from ssp_vla_bridge.trajectory import INVALID_REASONS, Trajectory

SCHEMA: Final = "ssp.record/1"
KEYS = ("schema", "t_s", "text", "slots", "trajectory", "invalid")
VOCABULARIES: dict[str, tuple[str, ...]] = {
    "objects": OBJECTS,
    "position": POSITIONS,
    "motion": MOTIONS,
    "conflict": CONFLICTS,
    "lon_action": LON_ACTIONS,
    "lat_action": LAT_ACTIONS,
}
SLOT_KEYS = ("value", "evidence")
TRAJECTORY_KEYS = ("t_s", "x_m", "y_m")
ADAPTER_KEYS = ("name", "mode", "origin_added", "notes")

Object = Mapping[str, Any]

_trajectory_fields, _adapter_fields = itemgetter(*TRAJECTORY_KEYS), itemgetter(*ADAPTER_KEYS)
_WORDS = tuple(map(frozenset, VOCABULARIES.values()))
_REASONS = frozenset(INVALID_REASONS)
_ROOM = re.compile(r'"[ \t\r]+:')
# Whole numbers up to it are floats; beyond, two may become one.
_LARGE = 1 << 53


@dataclass(frozen=True, eq=False)
class Lines:
    """The records of one or several files, an item per record in each of these but the first.

    Args:
        counts: how many records each file has.
        t_s: clip times, s.
        texts: as they are.
        slots: per slot in the order of VOCABULARIES, its object with value and evidence, or None.
        trajectories: objects with TRAJECTORY_KEYS whose numbers may be None, or None.
        invalid: lists of words.
        adapters: objects with ADAPTER_KEYS, or None.
    """

    counts: Sequence[int]
    t_s: Sequence[float]
    texts: Sequence[str]
    slots: Sequence[Sequence[Object | None]]
    trajectories: Sequence[Object | None]
    invalid: Sequence[Sequence[str]]
    adapters: Sequence[Object | None]


def read_lines(texts: Sequence[str]) -> Lines | None:
    """The records of JSON Lines texts, file after file; None if any may be wrong."""
    files = [text.removeprefix("\ufeff").split("\n") for text in texts]
    try:
        parsed = [[from_json(line) for line in file if line.strip(" \t\r")] for file in files]
        found, objects = _checked(list(chain.from_iterable(parsed)), list(map(len, parsed)))
    except (ValueError, KeyError, TypeError, OverflowError):
        return None
    return found if sum(map(len, objects)) == _written_keys("\n".join(texts)) else None


def _written_keys(text: str) -> int | None:
    """How many keys stand in a JSON text, doubled ones too; None where that isn't easily told.

    A parser keeps one of two equal keys. A quote inside a string has a backslash before it; of all
    others, those before a colon end a key, unless there is room between the two.
    """
    plain = text.replace('\\"', "") if "\\" in text else text
    room = " :" in plain or "\t" in plain or "\r" in plain
    return None if room and _ROOM.search(plain) else plain.count('":')


def _checked(records: Sequence[Object], counts: Sequence[int]) -> tuple[Lines, Iterable[Object]]:
    """Records, and every object in them.

    Raises:
        ValueError, KeyError, TypeError, OverflowError: something may be wrong.
    """
    _objects(records, len(KEYS), len(KEYS) + 1)
    columns = [[record[key] for record in records] for key in KEYS]
    schemas, times, texts, answers, paths, invalid = columns
    adapters = [record["adapter"] if len(record) > len(KEYS) else None for record in records]
    _sure({SCHEMA}.issuperset(schemas))
    _types_are(texts, str)
    _types_are(times, float, int)
    t_s = list(map(float, times))
    _sure(all(map(math.isfinite, t_s)))
    for end, count in zip(accumulate(counts), counts, strict=True):
        one = t_s[end - count : end]
        _sure(all(map(lt, one, islice(one, 1, None))))
    _objects(answers, len(VOCABULARIES))
    slots = [[answer[name] for answer in answers] for name in VOCABULARIES]
    given = _check_slots(slots)
    driven = [path for path in paths if path is not None]
    _check_trajectories(driven)
    _types_are(invalid, list)
    _sure(_REASONS.issuperset(chain.from_iterable(invalid)))
    known = [adapter for adapter in adapters if adapter is not None]
    _check_adapters(known)
    found = Lines(counts, t_s, texts, slots, paths, invalid, adapters)
    return found, chain(records, answers, given, driven, known)


def _sure(holds: bool) -> None:
    if not holds:
        raise ValueError


def _types(values: Iterable[object]) -> set[type]:
    return set(map(type, values))


def _types_are(values: Iterable[object], *allowed: type) -> None:
    _sure(_types(values).issubset(allowed))


def _objects(values: Sequence[Object], *sizes: int) -> None:
    _types_are(values, dict)
    _sure(set(map(len, values)).issubset(sizes))


def _check_slots(slots: Sequence[Sequence[Object | None]]) -> list[Object]:
    """All slots that are objects."""
    every: list[Object] = []
    for column, name, words in zip(slots, VOCABULARIES, _WORDS, strict=True):
        given = [slot for slot in column if slot is not None]
        _objects(given, len(SLOT_KEYS))
        values = [slot["value"] for slot in given if slot["value"] is not None]
        if name == "objects":
            _types_are(values, list)
            values = list(chain.from_iterable(values))
        _sure(words.issuperset(values))
        every += given
    evidence = [slot["evidence"] for slot in every]
    _types_are(evidence, list)
    spans = list(chain.from_iterable(evidence))
    _types_are(spans, list)
    _sure(set(map(len, spans)).issubset((2,)))
    _types_are(chain.from_iterable(spans), int)
    return every


def _check_trajectories(paths: Sequence[Object]) -> None:
    _objects(paths, len(TRAJECTORY_KEYS))
    lists = list(chain.from_iterable(map(_trajectory_fields, paths)))
    _types_are(lists, list)
    kinds = _types(chain.from_iterable(lists))
    _sure(kinds.issubset((float, int, type(None))))
    if int in kinds:
        numbers = [n for n in chain.from_iterable(lists) if type(n) is int]
        _sure(min(numbers) >= -_LARGE and max(numbers) <= _LARGE)


def _check_adapters(adapters: Sequence[Object]) -> None:
    _objects(adapters, len(ADAPTER_KEYS))
    for adapter in adapters:
        name, mode, origin_added, notes = _adapter_fields(adapter)
        _types_are((name, mode), str)
        _types_are((origin_added,), bool)
        _types_are((notes,), list)
        _types_are(notes, str)


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
    lines = read_lines([text])
    return _parse_strictly(text, file) if lines is None else _records_of(lines)


def _parse_strictly(text: str, file: str | Path) -> tuple[BehaviourRecord, ...]:
    """See parse_records: value by value, so that what is wrong has its place."""
    records: list[BehaviourRecord] = []
    for line, content in enumerate(text.removeprefix("\ufeff").split("\n"), start=1):
        if not content.strip(_JSON_SPACE):
            continue
        place = Location(file, line)
        record = _record(json_fields.parse_json(content, place), place)
        if records and record.t_s <= records[-1].t_s:
            raise place.at("t_s").error(
                "must rise strictly from record to record",
                record.t_s,
                remedy=f"the record before has {records[-1].t_s!r}",
            )
        records.append(record)
    return tuple(records)


def _record(value: object, place: Location) -> BehaviourRecord:
    found = json_fields.mapping(value, place, KEYS, ("adapter",))
    json_fields.choice(found["schema"], place.at("schema"), (SCHEMA,))
    return BehaviourRecord(
        t_s=json_fields.finite(found["t_s"], place.at("t_s")),
        text=json_fields.string(found["text"], place.at("text")),
        slots=_slots(found["slots"], place.at("slots")),
        trajectory=_trajectory(found["trajectory"], place.at("trajectory")),
        invalid=json_fields.choices(found["invalid"], place.at("invalid"), INVALID_REASONS),
        adapter=_adapter(found.get("adapter"), place.at("adapter")),
    )


def _slots(value: object, place: Location) -> Slots:
    found = json_fields.mapping(value, place, SLOT_NAMES)
    return Slots(**{name: _slot(name, found[name], place.at(name)) for name in SLOT_NAMES})


def _slot(name: str, value: object, place: Location) -> Slot | None:
    if value is None:
        return None
    found = json_fields.mapping(value, place, SLOT_KEYS)
    spans = json_fields.items(found["evidence"], place.at("evidence"))
    evidence = tuple(_span(span, place.at("evidence").at(i)) for i, span in enumerate(spans))
    if found["value"] is None:
        return None
    read = json_fields.choices if name == "objects" else json_fields.choice
    return Slot(read(found["value"], place.at("value"), VOCABULARIES[name]), evidence)


def _span(value: object, place: Location) -> tuple[int, int]:
    bounds = json_fields.items(value, place)
    if len(bounds) != 2:
        raise place.error(f"must hold a start and an end, not {len(bounds)} items")
    start, end = (json_fields.integer(bound, place.at(i)) for i, bound in enumerate(bounds))
    return start, end


def _trajectory(value: object, place: Location) -> Trajectory | None:
    if value is None:
        return None
    found = json_fields.mapping(value, place, TRAJECTORY_KEYS)
    t_s, x_m, y_m = (_coordinates(found[key], place.at(key)) for key in TRAJECTORY_KEYS)
    return Trajectory(t_s, x_m, y_m)


def _coordinates(value: object, place: Location) -> tuple[float, ...]:
    """Numbers with NaN where the file has null: the trajectory is invalid, the file is not."""
    return tuple(
        math.nan if item is None else json_fields.number(item, place.at(i))
        for i, item in enumerate(json_fields.items(value, place))
    )


def _adapter(value: object, place: Location) -> dict[str, Any] | None:
    if value is None:
        return None
    found = json_fields.mapping(value, place, ADAPTER_KEYS)
    notes = json_fields.items(found["notes"], place.at("notes"))
    return {
        "name": json_fields.string(found["name"], place.at("name")),
        "mode": json_fields.string(found["mode"], place.at("mode")),
        "origin_added": json_fields.boolean(found["origin_added"], place.at("origin_added")),
        "notes": [json_fields.string(n, place.at("notes").at(i)) for i, n in enumerate(notes)],
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
