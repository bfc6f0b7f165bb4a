"""Behaviour records as plain JSON values, checked many at a time (METHOD 5.3, 5.6).

ssp_eval.records says which content is right, and names what is wrong with a file. Here the same
rules are questions to whole columns of values, which a file that is right answers several times
as fast. The answer is yes or doubt, never no: a file in doubt is left to ssp_eval.records.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import accumulate, chain, islice
from operator import itemgetter, lt
from typing import Any, Final

from pydantic_core import from_json

from ssp_core.vocabulary import CONFLICTS, LAT_ACTIONS, LON_ACTIONS, MOTIONS, OBJECTS, POSITIONS
from ssp_vla_bridge.trajectory import INVALID_REASONS

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

_trajectory, _adapter = itemgetter(*TRAJECTORY_KEYS), itemgetter(*ADAPTER_KEYS)
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
    lists = list(chain.from_iterable(map(_trajectory, paths)))
    _types_are(lists, list)
    kinds = _types(chain.from_iterable(lists))
    _sure(kinds.issubset((float, int, type(None))))
    if int in kinds:
        numbers = [n for n in chain.from_iterable(lists) if type(n) is int]
        _sure(min(numbers) >= -_LARGE and max(numbers) <= _LARGE)


def _check_adapters(adapters: Sequence[Object]) -> None:
    _objects(adapters, len(ADAPTER_KEYS))
    for adapter in adapters:
        name, mode, origin_added, notes = _adapter(adapter)
        _types_are((name, mode), str)
        _types_are((origin_added,), bool)
        _types_are((notes,), list)
        _types_are(notes, str)
