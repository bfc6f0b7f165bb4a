"""Strict reading of JSON values: every refusal names the file, the line and the field."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from ssp_core.errors import InputError

# Python refuses to convert longer digit strings to int; as a float they are infinite.
_MAX_INT_DIGITS = 4000


class Location(NamedTuple):
    """Where a value stands: file, line (from 1, if lines matter) and path of the field."""

    file: str | Path
    line: int | None = None
    field: str = ""

    def at(self, key: str | int) -> Location:
        """The place of an item of a list or of a value of a mapping."""
        if isinstance(key, int):
            return Location(self.file, self.line, f"{self.field}[{key}]")
        return Location(self.file, self.line, f"{self.field}.{key}" if self.field else key)

    def error(self, problem: str, value: object = None, remedy: str | None = None) -> InputError:
        """The refusal of a value that stands here; only scalar values are shown."""
        return InputError(
            problem,
            file=self.file,
            line=self.line,
            field=self.field or None,
            value=value if _is_short_scalar(value) else None,
            remedy=remedy,
        )


def _is_short_scalar(value: object) -> bool:
    """Whether repr of the value is safe: no deep nesting, no endless digits."""
    if isinstance(value, int):
        return abs(value) < 10**30
    return isinstance(value, str | float)


def _kind(value: object) -> str:
    """What a JSON value is, in the words of JSON."""
    if value is None:
        return "null"
    if isinstance(value, bool):
        return "a boolean"
    if isinstance(value, int | float):
        return "a number"
    if isinstance(value, str):
        return "a string"
    if isinstance(value, list):
        return "a list"
    return "an object" if isinstance(value, dict) else f"a {type(value).__name__}"


def _int(digits: str) -> int | float:
    return int(digits) if len(digits) <= _MAX_INT_DIGITS else float(digits)


def parse_json(text: str, place: Location) -> Any:
    """The value of a JSON text; NaN and Infinity tokens are let through for the fields to judge.

    Args:
        place: of the text; without a line, a syntax error names its own.

    Raises:
        InputError: no JSON, nested too deeply, or an object has a key twice.
        json.JSONDecodeError: never; it is turned into InputError.
    """

    def unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in pairs:
            if key in found:
                raise place.error(f"key {_short(key)} stands twice")
            found[key] = value
        return found

    try:
        return json.loads(text, object_pairs_hook=unique, parse_int=_int)
    except json.JSONDecodeError as error:
        line = place.line if place.line is not None else error.lineno
        raise place._replace(line=line).error(
            f"is not valid JSON: {error.msg} (column {error.colno})"
        ) from error
    except RecursionError as error:
        raise place.error("is not acceptable JSON: nested too deeply") from error


def _short(key: object) -> str:
    shown = repr(key)
    return shown if len(shown) <= 60 else shown[:57] + "..."


def mapping(
    value: object, place: Location, required: Sequence[str], optional: Sequence[str] = ()
) -> dict[str, Any]:
    """An object with all required keys and no unknown ones."""
    if not isinstance(value, dict):
        raise place.error(f"must be an object, not {_kind(value)}", value)
    for key in value:
        if key not in required and key not in optional:
            known = ", ".join([*required, *optional])
            raise place.at(_plain(key)).error("is not a known key", remedy=f"known are {known}")
    for key in required:
        if key not in value:
            raise place.at(key).error("is missing")
    return value


def _plain(key: object) -> str:
    """A key as it may stand in a field path: control characters escaped, not endless."""
    text = str(key).encode("unicode_escape", "replace").decode("ascii")
    return text if len(text) <= 60 else text[:57] + "..."


def items(value: object, place: Location) -> list[Any]:
    """A list."""
    if not isinstance(value, list):
        raise place.error(f"must be a list, not {_kind(value)}", value)
    return value


def string(value: object, place: Location) -> str:
    """A string, which may be empty."""
    if not isinstance(value, str):
        raise place.error(f"must be a string, not {_kind(value)}", value)
    return value


def integer(value: object, place: Location) -> int:
    """A whole number written without fraction or exponent."""
    if not isinstance(value, int) or isinstance(value, bool):
        raise place.error(f"must be a whole number, not {_kind(value)}", value)
    return value


def finite(value: object, place: Location) -> float:
    """A finite number as a float."""
    if not isinstance(value, int | float) or isinstance(value, bool):
        raise place.error(f"must be a number, not {_kind(value)}", value)
    # A whole number that is too large for a float is infinite.
    result = math.inf if abs(value) > sys.float_info.max else float(value)
    if not math.isfinite(result):
        raise place.error("must be a finite number", result)
    return result


def choice(value: object, place: Location, vocabulary: Sequence[str]) -> str:
    """One word of a closed vocabulary."""
    if not isinstance(value, str):
        raise place.error(f"must be a string, not {_kind(value)}", value)
    if value not in vocabulary:
        raise place.error(
            "is outside the vocabulary", value, remedy=f"known are {', '.join(vocabulary)}"
        )
    return value


def choices(value: object, place: Location, vocabulary: Sequence[str]) -> tuple[str, ...]:
    """A list of words of a closed vocabulary, in the order given; repeated words count once."""
    words = [choice(item, place.at(i), vocabulary) for i, item in enumerate(items(value, place))]
    return tuple(dict.fromkeys(words))
