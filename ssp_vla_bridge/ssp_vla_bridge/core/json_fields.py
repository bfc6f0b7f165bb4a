"""Strict reading of decoded JSON: what is missing, unknown or of the wrong type is named."""

from __future__ import annotations

import math
from typing import Any


class Malformed(ValueError):
    """A value that isn't what its place asks for.

    Args:
        field: path of the field, such as ``arrays[0].shape``.
        problem: what is wrong, as one clause.
        value: the offending value.
    """

    def __init__(self, field: str, problem: str, value: object = None) -> None:
        super().__init__(problem)
        self.field, self.problem, self.value = field, problem, value


def exact_object(value: Any, place: str, keys: set[str]) -> dict[str, Any]:
    """An object that has exactly these keys."""
    if not isinstance(value, dict):
        raise Malformed(place, "must be an object", value)
    for key in sorted(keys ^ set(value)):
        raise Malformed(f"{place}.{key}", "is missing" if key in keys else "is no known key")
    return value


def listed(value: Any, place: str) -> list[Any]:
    """A list."""
    if not isinstance(value, list):
        raise Malformed(place, "must be a list", value)
    return value


def mapping(value: Any, place: str) -> dict[str, Any]:
    """An object with any keys."""
    if not isinstance(value, dict):
        raise Malformed(place, "must be an object", value)
    return value


def string(fields: dict[str, Any], key: str, place: str = "response") -> str:
    """The text under a key."""
    value = fields[key]
    if not isinstance(value, str):
        raise Malformed(f"{place}.{key}", "must be a string", value)
    return value


def integer(value: Any, place: str) -> int:
    """A whole number."""
    if not isinstance(value, int) or isinstance(value, bool):
        raise Malformed(place, "must be an integer", value)
    return value


def number(value: Any, place: str) -> float:
    """A number; ``nan``, ``inf`` and ``-inf`` stand for those that JSON doesn't have."""
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:
            raise Malformed(place, "is too large a number", value) from None
    if value in ("nan", "inf", "-inf"):
        return float(value)
    raise Malformed(place, "must be a number", value)


def number_to_json(value: float) -> float | str:
    """The inverse of number."""
    return float(value) if math.isfinite(value) else str(float(value))
