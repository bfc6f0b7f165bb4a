"""JSON from outside: no key twice in an object, and errors of one kind."""

from __future__ import annotations

import json
from collections import Counter
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError

# Python 3.11 ends at some 900 levels, and later versions read far more than what is read can be
# walked through.
MOST_LEVELS = 500


class KeyTwiceError(ValueError):
    """A JSON object has a key twice, of which a reader would take either."""

    def __init__(self, key: str) -> None:
        self.key = key
        super().__init__(f"key {key!r} stands twice")


def parse_strict(text: str | bytes) -> Any:
    """Return the value of a JSON text.

    Unlike ``json.loads`` it takes no NaN or infinity and no key twice in an object, and nesting
    that is too deep is an error like any other.

    Args:
        text: as it came; bytes must be UTF-8.

    Raises:
        ValueError: it is no JSON; says what and, where that is known, at which character.
    """
    try:
        plain = text.decode("utf-8") if isinstance(text, bytes) else text
    except UnicodeDecodeError as error:
        raise ValueError(f"it is not UTF-8 (byte {error.start})") from None
    try:
        return _loads(plain, parse_constant=_no_number)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def parse_lenient(text: str | bytes) -> Any:
    """Return the value of a JSON text; NaN and infinity are read as such.

    Raises:
        ValueError: it is no JSON, or an object of it has a key twice (KeyTwiceError).
        RecursionError: it is nested too deeply.
    """
    return _loads(text)


def _loads(text: str | bytes, **options: Any) -> Any:
    value = json.loads(text, object_pairs_hook=_once, **options)
    _check_levels(value)
    return value


def _check_levels(value: Any) -> None:
    level, count = [value], 0
    while level := [one for one in level if isinstance(one, dict | list)]:
        count += 1
        if count > MOST_LEVELS:
            raise RecursionError(f"it has more than {MOST_LEVELS} levels")
        level = [
            inner for one in level for inner in (one.values() if isinstance(one, dict) else one)
        ]


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        raise KeyTwiceError(next(key for key, count in counts.items() if count > 1))
    return mapping


def parse_json_line(line: str | bytes, file: str | Path, number: int) -> Any:
    """Return the value of a line of a JSON Lines file; NaN and infinity are read as such.

    Raises:
        InputError: it is no JSON, or an object of it has a key twice; with line and key.
    """
    try:
        return parse_lenient(line)
    except KeyTwiceError as error:
        raise InputError(
            "stands twice in an object",
            file=file,
            line=number,
            field=error.key,
            remedy="keep one of the two",
        ) from error
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"is not valid JSON: {error}",
            file=file,
            line=number,
            remedy="write one JSON value a line",
        ) from error


def _no_number(word: str) -> Any:
    raise ValueError(f"{word} is no number")
