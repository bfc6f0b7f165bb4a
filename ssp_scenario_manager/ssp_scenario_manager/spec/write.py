"""A K* as text that people read and edit: one layout, whatever wrote the file before."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from ssp_core.files import write_text
from ssp_scenario_manager.spec.fields import ROAD_FIELD
from ssp_scenario_manager.spec.model import Event

_WIDTH = 100
_PARTS = {
    "topology": "T: the road, seen in the VUT's direction of travel.",
    "participants": "A: who takes part, and where they are when the clip begins.",
    "motion": "M: who moves how, phase by phase; position and motion as seen from the VUT.",
    "interaction": "I: who conflicts with whom, in which order, and what is a right answer.",
    "events": "E: when the phases start in the source clip, and where that can be seen.",
    "constraints": "C: what a realisation has to keep to; every number has a unit.",
    "uncertainty": "U: how each field is known, and the seal of its review.",
}
# Mappings of these keys stand in one line, or as few as they need.
_INLINE = (
    frozenset({"min", "max", "unit"}),
    frozenset({"min", "max"}),
    frozenset({"quantity", "object", "below"}),
    frozenset({"place", "along", "gap"}),
    ROAD_FIELD,
)
# What means the same when it is left out, and is then not written: less to read.
_SILENT_NULLS = frozenset(
    {"position", "motion", "occluder", "frames", "span_s", "intent", "varies", "why"}
)
_PLAIN = re.compile(r"(?:[A-Za-z_][\w /'()–:.*+^-]*|1/m)\Z", re.ASCII)
_RESERVED = frozenset({"null", "true", "false", "yes", "no", "on", "off", "y", "n"})


def write_event(path: str | Path, event: Event) -> None:
    """Writes a K* file."""
    write_text(path, event_text(event))


def event_text(event: Event, marks: Mapping[str, str] | None = None) -> str:
    """The event in YAML. Reading it gives the same event; comments of an older text are gone.

    Args:
        event: to write.
        marks: comments to put above fields, by path.
    """
    value = event.model_dump(mode="json", by_alias=True)
    if not value["constraints"]["weights"]:
        del value["constraints"]["weights"]
    lines = []
    for key, item in value.items():
        if key in _PARTS:
            lines += ["", f"# {_PARTS[key]}"]
        lines += _block((key,), item, marks or {})
    return "\n".join(lines) + "\n"


def _block(at: tuple[str, ...], value: Any, marks: Mapping[str, str]) -> Iterator[str]:
    key, pad = at[-1], "  " * (len(at) - 1)
    if at[0] != "uncertainty" and (mark := marks.get(".".join(at))):
        yield f"{pad}# {mark}"
    if isinstance(value, dict) and value and not _is_inline(value):
        yield f"{pad}{_key(key)}:"
        for name, item in value.items():
            if item is not None or name not in _SILENT_NULLS:
                yield from _block((*at, name), item, marks)
        return
    line = f"{pad}{_key(key)}: {flow(value)}"
    if len(line) <= _WIDTH or not isinstance(value, dict):
        yield line
        return
    yield f"{pad}{_key(key)}:"
    yield from _wrapped([f"{_key(k)}: {flow(v)}" for k, v in _spoken(value)], pad + "  ")


def _wrapped(items: list[str], pad: str) -> Iterator[str]:
    """A flow mapping over as few lines as fit."""
    line = pad + "{"
    for i, item in enumerate(items):
        text = item + ("}" if i == len(items) - 1 else ",")
        if line.strip() not in ("", "{") and len(line) + 1 + len(text) > _WIDTH:
            yield line
            line = pad + " " + text
        else:
            line += text if line.endswith(("{", " ")) else " " + text
    yield line


def _is_inline(value: dict[str, Any]) -> bool:
    keys = frozenset(value)
    return keys in _INLINE or "heading" in keys or "confidence" in keys


def _spoken(value: dict[str, Any]) -> list[tuple[str, Any]]:
    spoken = [(k, v) for k, v in value.items() if v is not None or k not in _SILENT_NULLS]
    if "identity" not in value:
        return spoken
    spoken.sort(key=lambda item: ("value", "identity", "varies", "why").index(item[0]))
    return [(k, v) for k, v in spoken if (k, v) != ("identity", False)]


def flow(value: Any) -> str:
    """A value as it stands in one line of the file."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)}: {flow(v)}" for k, v in _spoken(value)) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(flow, value)) + "]"
    if isinstance(value, float) and value.is_integer() and abs(value) < 1e15:
        return str(int(value))
    if isinstance(value, str):
        return _word(value)
    return json.dumps(value)


def _key(text: str) -> str:
    return text if re.fullmatch(r"[A-Za-z_][\w.\[\]]*", text) else json.dumps(text)


@lru_cache(maxsize=1024)  # a review writes the same event again after each decision
def _word(text: str) -> str:
    """A string as it stands where YAML takes it for one, else quoted."""
    plain = _PLAIN.match(text) and text.lower() not in _RESERVED
    if plain and not re.search(r":(\s|\Z)|\s\Z", text):
        return text
    quoted: str = yaml.safe_dump(text, default_style='"', width=float("inf"), allow_unicode=True)
    return quoted.strip()
