"""Dotted field paths such as ``events.trigger.evidence[0].frames``: reading, walking, matching."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from typing import Any

Part = str | int

_PART = re.compile(r"([^.\[\]]+)|\[(\d{1,6})\]")
ROAD_FIELD = frozenset({"value", "identity", "varies", "why"})
# Mappings that a person judges as one: a field of the road, a quantity, a count, one participant
# in one phase.
_WHOLE = (
    ROAD_FIELD,
    frozenset({"min", "max", "unit"}),
    frozenset({"min", "max"}),
    frozenset({"position", "motion", "heading", "speed_trend", "longitudinal", "lateral"}),
)


@lru_cache(maxsize=1 << 13)
def split(path: str) -> tuple[Part, ...]:
    """Parts of a path; list indices are ints. A path that isn't one gives ()."""
    parts: list[Part] = []
    at = 0
    while at < len(path):
        if path[at] == "." and 0 < at < len(path) - 1:
            at += 1
        found = _PART.match(path, at)
        if found is None:
            return ()
        name, index = found.groups()
        parts.append(name if name is not None else int(index))
        at = found.end()
    return tuple(parts)


def join(parts: tuple[Part, ...]) -> str:
    """The path of its parts."""
    text = ""
    for part in parts:
        text += f"[{part}]" if isinstance(part, int) else (f".{part}" if text else part)
    return text


def get(value: Any, path: str) -> Any:
    """The value at a path.

    Raises:
        LookupError: there is nothing.
    """
    parts = split(path)
    if not parts:
        raise LookupError(path)
    for part in parts:
        try:
            value = value[part]
        except (TypeError, LookupError) as error:
            raise LookupError(path) from error
    return value


def has(value: Any, path: str) -> bool:
    """Whether a mapping has something at a path, null included."""
    try:
        get(value, path)
    except LookupError:
        return False
    return True


def leaves(value: Any, at: tuple[Part, ...] = ()) -> Iterator[tuple[str, Any]]:
    """Every (path, value) that isn't made of others; an empty list or mapping is one too."""
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from leaves(item, (*at, key))
    elif isinstance(value, list) and value:
        for index, item in enumerate(value):
            yield from leaves(item, (*at, index))
    else:
        yield join(at), value


def granules(value: Any, at: tuple[Part, ...] = ()) -> Iterator[str]:
    """Paths of the smallest things that a person judges: a word, a quantity, a list, a cell."""
    if isinstance(value, dict) and value and frozenset(value) not in _WHOLE:
        for key, item in value.items():
            yield from granules(item, (*at, key))
    else:
        yield join(at)


def owner(path: str, entries: Mapping[str, Any]) -> str | None:
    """The entry of a path: its own or its nearest ancestor's; None without one."""
    while path:
        if path in entries:
            return path
        path = path[: max(path.rfind("."), path.rfind("["), 0)]
    return None


def within(path: str, ancestor: str) -> bool:
    """Whether a path is the ancestor or lies below it."""
    return path == ancestor or path.startswith((ancestor + ".", ancestor + "["))


@lru_cache(maxsize=1 << 14)
def matches(path: str, pattern: str) -> bool:
    """Whether a path is of a pattern's shape; ``*`` stands for one name each."""
    names, wanted = path.split("."), pattern.split(".")
    pairs = zip(names, wanted, strict=False)
    return len(names) == len(wanted) and all(want in ("*", name) for name, want in pairs)
