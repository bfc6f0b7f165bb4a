"""Log L as a whole: the parts merged, each entry once, with where it stands."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from heapq import merge
from typing import Any

from ssp_scenario_manager.event_spec.log import Record, parse_log, record_line

SCHEMA = "ssp.package-log/1"


@dataclass(frozen=True, slots=True)
class Entry:
    """One entry of a part.

    Args:
        order: (time, number of the part, place in the part): where it goes in the whole.
        line: the entry as it is written.
        nth: how often the same line stood in this part before.
        origin: of the part, and which entry of it this is, from 1.
    """

    order: tuple[datetime, int, int]
    line: str
    nth: int
    origin: dict[str, Any]


def merged_log(parts: Iterable[tuple[str, str]]) -> str:
    """The whole log as JSON Lines, in order of time; within a part, in the part's own order.

    A part's order wins over its clock: an entry that claims to be earlier than the one before it
    goes right after that one. An entry that stands in several parts (a compiled folder's log is
    copied into each run's) is given once, with all its origins.

    Args:
        parts: path and text of each part.

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
    seen: Counter[str] = Counter()
    latest: datetime | None = None
    for place, record in enumerate(parse_log(text, path)):
        when = _time(record)
        latest = when if latest is None else max(latest, when)
        line = record_line(record)
        origin = {"path": path, "entry": place + 1}
        yield Entry((latest, number, place), line, seen[line], origin)
        seen[line] += 1


def _time(record: Record) -> datetime:
    return datetime.fromisoformat(record.when)
