"""JSON from strangers: by the standard's rules, and a ValueError for everything else."""

from __future__ import annotations

import json
from typing import Any


def parse_strict(text: str | bytes) -> Any:
    """The value of a JSON text.

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
        return json.loads(plain, object_pairs_hook=_once, parse_constant=_no_number)
    except RecursionError:
        raise ValueError("it is nested too deeply") from None


def _once(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    mapping = dict(pairs)
    if len(mapping) < len(pairs):
        raise ValueError("a key stands twice")
    return mapping


def _no_number(word: str) -> Any:
    raise ValueError(f"{word} is no number")
