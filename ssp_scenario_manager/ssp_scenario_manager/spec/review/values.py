"""A field's value as a person types it on one line."""

from __future__ import annotations

import json
import re
from typing import Any

import yaml

from ssp_scenario_manager.spec.checks.base import show
from ssp_scenario_manager.spec.fields import ROAD_FIELD
from ssp_scenario_manager.spec.model import UNRESOLVED
from ssp_scenario_manager.spec.write import flow

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_END = rf"(?:{_NUMBER}|…)?"
_RANGE = re.compile(rf"({_END})\s*(?:\.\.|–|\bto\b)\s*({_END})\s*([^\s\d]\S*|1(?:/m)?)?")
_ONE = re.compile(rf"({_NUMBER})\s*([^\s\d.]\S*|1(?:/m)?)?")
_WORDS = re.compile(r"[a-z][a-z0-9_]*(\s*,\s*[a-z][a-z0-9_]*)*")
_PAIRS = re.compile(r"(\w+)\s*=\s*(\w+)")


class Unreadable(Exception):
    """A line that is no value for its field; the message says what would be."""


def shown(value: Any) -> str:
    """A value as read_value takes it back: a cell as its words, a quantity as a range."""
    if isinstance(value, dict) and set(value) == ROAD_FIELD:
        return flow(value)
    if isinstance(value, dict) and "heading" in value:
        return " ".join(f"{key}={word}" for key, word in value.items() if word is not None)
    if isinstance(value, list):
        words = all(isinstance(item, str) for item in value)
        return ", ".join(value) if words and value else json.dumps(value)
    if isinstance(value, dict) and value.keys() >= {"min", "max"}:
        low, high = ("" if end is None else f"{end:g}" for end in (value["min"], value["max"]))
        ends = low if low == high else f"{low}..{high}"
        return f"{ends} {value.get('unit', '')}".strip()
    return show(value)


def read_value(text: str, old: Any, quantity: bool) -> Any:
    """The value in a line, in the shape of the one that it replaces.

    Quantities are ``2..3 s`` (``..3 s`` and ``2.. s`` are open, ``2 s`` is exact), counts ``2..3``,
    lists ``a, b``; of one participant in one phase, ``motion=stationary lateral=none`` changes
    these words and leaves the others. Of a field of the road a line is what the source shows;
    whether it is identity or varies is told in braces. Whatever is in braces or brackets is YAML.

    Args:
        text: as typed.
        old: the value that stands.
        quantity: whether the field is one; any other line stands for itself where a word stood.

    Raises:
        Unreadable: the line can't be read.
    """
    text = text.strip()
    if not text:
        raise Unreadable("type a value")
    if isinstance(old, dict) and set(old) == ROAD_FIELD:
        return _road_field(text, old)
    if text == UNRESOLVED:
        return UNRESOLVED
    if text == "null" and (old is None or isinstance(old, str) or quantity):
        return None
    if isinstance(old, str | None) and not quantity:
        return text
    if text[0] in "{[":
        return _yaml(text)
    if isinstance(old, dict) and "heading" in old:
        return _cell(text, old)
    if isinstance(old, list):
        if not _WORDS.fullmatch(text):
            raise Unreadable("type words with commas between them, such as: decelerate, stop")
        return [word.strip() for word in text.split(",")]
    found = _quantity(text)
    if found is not None:
        return found
    if isinstance(old, dict):
        shape = "2..3" if set(old) == {"min", "max"} else "2..3 s"
        raise Unreadable(f"type a range, such as {shape}, or {UNRESOLVED}")
    if quantity:
        raise Unreadable(f"type a range with its unit, such as 2..3 s, or {UNRESOLVED}")
    return text


def _road_field(text: str, old: dict[str, Any]) -> Any:
    """A whole field in braces; else what the source shows, and whether it varies is as it was."""
    if text[0] == "{":
        found = _yaml(text)
        nothing = {"identity": False, "varies": None, "why": None}
        is_field = isinstance(found, dict) and "value" in found
        return nothing | found if is_field else {**old, "value": found}
    inside, varies = old["value"], old["varies"]
    is_list = isinstance(inside, list)
    measured = any(isinstance(item, dict) and "unit" in item for item in (inside, varies))
    if text.isdecimal() and not measured:
        return {**old, "value": int(text)}
    value = read_value(text, inside if is_list else None, measured and not is_list)
    return {**old, "value": value}


def _quantity(text: str) -> Any:
    text = re.sub(r"^at least (\S+)", r"\1..", re.sub(r"^at most ", "..", text))
    one = _ONE.fullmatch(text)
    ends = (one.group(1), one.group(1)) if one else None
    unit = one.group(2) if one else None
    found = _RANGE.fullmatch(text)
    if found:
        low, high, unit = found.groups()
        ends = (low, high)
    if ends is None:
        return None
    if unit is None:
        if any(not re.fullmatch(r"\d+", end) for end in ends):
            raise Unreadable("type the unit as well, such as 2..3 m/s")
        return {"min": int(ends[0]), "max": int(ends[1])}
    low_high = [None if end in ("", "…") else float(end) for end in ends]
    return {"min": low_high[0], "max": low_high[1], "unit": unit}


def _cell(text: str, old: dict[str, Any]) -> dict[str, Any]:
    pairs = _PAIRS.findall(text)
    if not pairs or _PAIRS.sub("", text).replace(",", " ").strip():
        raise Unreadable("type words to change, such as: motion=stationary lateral=none")
    unknown = [key for key, _ in pairs if key not in old]
    if unknown:
        raise Unreadable(f"there is no {unknown[0]!r} here; known are {', '.join(old)}")
    return {**old, **{key: None if word == "null" else word for key, word in pairs}}


def _yaml(text: str) -> Any:
    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise Unreadable(f"this is no YAML: {str(error).partition(chr(10))[0]}") from error
    return value
