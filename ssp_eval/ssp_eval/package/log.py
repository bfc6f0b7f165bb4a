"""Log L as a whole, each entry once, and entering a change on site into it."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from heapq import merge
from pathlib import Path
from typing import Any

from ssp_core.bag.reading.reader import BagReader
from ssp_core.errors import InputError
from ssp_core.files.folders import check_folder
from ssp_core.files.reading import parse_mapping, parse_model
from ssp_core.files.writing import write_text
from ssp_core.run_file.model import RunSpec, load_run
from ssp_eval.data.provenance import RUN_ATTACHMENT
from ssp_scenario_manager.compile.changes import (
    check_changeable,
    explained,
    parse_value,
    same_value,
    value_at,
    with_value,
)
from ssp_scenario_manager.compile.task import RUN_FILE, TASK_FILE, TASK_FOLDER, Task, load_task
from ssp_scenario_manager.event_spec.log import (
    LOG_FILE,
    Record,
    append_record,
    parse_log,
    read_log,
    record_line,
)

SCHEMA = "ssp.package-log/1"


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry of a part.

    Args:
        order: (time, number of the part, place in the part): where it goes in the whole.
        nth: how often the same line stood in this part before.
        origin: of the part, and which entry of it this is, from 1.
    """

    order: tuple[datetime, int, int]
    line: str
    nth: int
    origin: dict[str, Any]


def merged_log(parts: Iterable[tuple[str, str]]) -> str:
    """Return the whole log as JSON Lines, in order of time; within a part, in the part's own order.

    A part's order wins over its clock: an entry that claims to be earlier than the one before it
    goes right after that one. An entry that stands in several parts (a compiled folder's log is
    copied into each run's) is given once, with all its origins.

    Raises:
        InputError: a part is no log.
    """
    parts = sorted(parts)
    origins: dict[tuple[str, int], list[dict[str, Any]]] = {}
    entries = [list(_entries(number, path, text)) for number, (path, text) in enumerate(parts)]
    for entry in merge(*entries, key=lambda e: e.order):
        origins.setdefault((entry.line, entry.nth), []).append(entry.origin)
    return "".join(
        json.dumps(
            {"schema": SCHEMA, "origins": places, "record": json.loads(line)},
            ensure_ascii=False,
            sort_keys=True,
        )
        + "\n"
        for (line, _), places in origins.items()
    )


def _entries(number: int, path: str, text: str) -> Iterator[Entry]:
    counts: Counter[str] = Counter()
    latest: datetime | None = None
    for place, record in enumerate(parse_log(text, path)):
        when = _time(record)
        latest = when if latest is None else max(latest, when)
        line = record_line(record)
        origin = {"path": path, "entry": place + 1}
        yield Entry((latest, number, place), line, counts[line], origin)
        counts[line] += 1


def _time(record: Record) -> datetime:
    return datetime.fromisoformat(record.when)


BAG_FOLDER = "bag"
LATER = "after the run"


@dataclass(frozen=True, slots=True)
class Change:
    """A change that a person states.

    Args:
        field: path in run.yaml, ``limits.speed_mps``.
        old: the compiled value, or the one that was logged last; YAML or JSON.
        when: ISO 8601, UTC.
    """

    field: str
    old: str
    new: str
    who: str
    reason: str
    when: str


@dataclass(frozen=True, slots=True)
class LogEntries:
    """The entries that were made.

    Args:
        run_has: value in run.yaml, or in the run that was recorded.
    """

    record: Record
    log: Path
    applied: bool
    later: bool
    run_has: Any


@dataclass(frozen=True, slots=True)
class _Place:
    """The place of a change's entry: the compiled folder, and its recording, if any."""

    folder: Path
    bag: Path | None

    @property
    def log(self) -> Path:
        return self.folder / LOG_FILE


def log_change(folder: Path, change: Change, apply: bool = False) -> LogEntries:
    """Check a change against what was compiled and logged so far, and append it to the log.

    Args:
        folder: a compiled folder; or the folder of a run, or its ``task`` folder.
        change: field, old and new value, and by whom, when and why it was changed.
        apply: write the new value into the run file too; a folder that was run refuses it.

    Raises:
        InputError: the folder is none of these, the field or a value is wrong, the old value is
            not the one that stands, or a recording shows another new value. Nothing is written.
    """
    place = _place(folder)
    task = load_task(place.folder)
    check_changeable(change.field)
    before = explained(task.run, read_log(place.log), place.log)
    old = parse_value(before, change.field, change.old, place.folder / TASK_FILE)
    new = parse_value(before, change.field, change.new, place.folder / TASK_FILE)
    _check_old(before, change.field, old, place)
    if same_value(old, new):
        raise InputError(
            "changes nothing: old and new are equal",
            field=change.field,
            value=new,
            remedy="give another value as new",
        )
    if place.bag is not None and apply:
        raise InputError(
            "has been run; a change can be entered now, but not made",
            file=place.bag,
            remedy="leave --apply out",
        )
    run = _recorded_run(place.bag) if place.bag is not None else load_run(place.folder / RUN_FILE)
    has = value_at(run, change.field, place.folder / RUN_FILE)
    _check_new(has, old, new, change.field, place)
    if apply and not same_value(has, new):
        _apply(place.folder / RUN_FILE, run, change.field, new)
        has = new
        applied = True
    else:
        applied = False
    record = _record(task, change, old, new, place)
    append_record(place.log, record)
    return LogEntries(record, place.log, applied, place.bag is not None, has)


def _place(folder: Path) -> _Place:
    inner = folder / TASK_FOLDER
    if (inner / TASK_FILE).is_file():
        bag = folder / BAG_FOLDER
        return _Place(inner, bag if bag.is_dir() else None)
    if (folder / TASK_FILE).is_file():
        bag = folder.parent / BAG_FOLDER
        run = folder.resolve().name == TASK_FOLDER and bag.is_dir()
        return _Place(folder, bag if run else None)
    remedy = "give a folder of `ssp compile`, or one of `ssp run`"
    check_folder(folder, remedy)
    raise InputError(f"holds no {TASK_FILE}", file=folder, remedy=remedy)


def _check_old(before: RunSpec, field: str, old: Any, place: _Place) -> None:
    stands = value_at(before, field)
    if not same_value(stands, old):
        raise InputError(
            f"was {stands!r} by {TASK_FILE} and {LOG_FILE}",
            file=place.folder,
            field=field,
            value=old,
            remedy="give that as --old, or log the change that is missing first",
        )


def _check_new(has: Any, old: Any, new: Any, field: str, place: _Place) -> None:
    if place.bag is not None:
        if not same_value(has, new):
            raise InputError(
                f"was {has!r} in the run that was recorded",
                file=place.bag,
                field=field,
                value=new,
                remedy="log what was executed",
            )
    elif not same_value(has, new) and not same_value(has, old):
        raise InputError(
            f"is {has!r}, which is neither the old value nor the new one",
            file=place.folder / RUN_FILE,
            field=field,
            remedy=f"set it in {RUN_FILE} to what it is to be, then log that",
        )


def _recorded_run(bag: Path) -> RunSpec:
    with BagReader(bag) as reader:
        data = reader.attachment(RUN_ATTACHMENT)
    name = f"{bag}:{RUN_ATTACHMENT}"
    if data is None:
        raise InputError("is missing", file=name, remedy="name the folder of a run")
    return parse_model(RunSpec, parse_mapping(data, name), name)


def _apply(file: Path, run: RunSpec, field: str, new: Any) -> None:
    changed = with_value(run, field, new, file)
    write_text(file, changed.model_dump_json(by_alias=True, indent=1) + "\n")


def _record(task: Task, change: Change, old: Any, new: Any, place: _Place) -> Record:
    details = {"file": RUN_FILE, "place": task.place.name}
    if place.bag is not None:
        details["entered"] = LATER
    value = {
        "kind": "site_change",
        "when": change.when,
        "who": change.who,
        "subject": f"task {task.event.name} at {task.place.name}",
        "version": task.version,
        "field": change.field,
        "old": old,
        "new": new,
        "reason": change.reason,
        "details": details,
    }
    return parse_model(Record, value, "the entry")
