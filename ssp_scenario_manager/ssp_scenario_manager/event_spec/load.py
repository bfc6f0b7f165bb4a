"""K* files read and written, the version of a K*, and the seals of part U."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

import yaml

from ssp_core.errors import InputError
from ssp_core.files.reading import parse_model, read_mapping
from ssp_core.files.writing import write_text
from ssp_core.hashing import sha256_json
from ssp_scenario_manager.event_spec.fields import (
    ROAD_FIELD,
    get,
    granules,
    has,
    join,
    leaves,
    matches,
    owner,
    split,
)
from ssp_scenario_manager.event_spec.model import IDENTITY_BY_DEFAULT, Doubt, Event
from ssp_scenario_manager.maps.site import find_shipped

# A K* has some hundred lines; what is much larger is none, and would keep a YAML parser busy.
MAX_EVENT_BYTES = 256 << 10
# Lists that are sets: their order says nothing.
_SETS = (
    ("interaction", "longitudinal_responses"),
    ("interaction", "lateral_responses"),
)


def read_event_file(name_or_path: str) -> tuple[dict[str, Any], Path]:
    """Read the mapping in a K* file, unchecked; return it and the file.

    Raises:
        InputError: there is no such event, or the file is too large or no mapping.
    """
    path = find_shipped(name_or_path, "event")
    try:
        size = path.stat().st_size
    except (OSError, ValueError):
        size = 0  # read_mapping says what is wrong
    if size > MAX_EVENT_BYTES:
        raise InputError(
            f"is larger than {MAX_EVENT_BYTES >> 10} KiB", file=path, remedy="name a K* file"
        )
    return read_mapping(path), path


def load_event(name_or_path: str) -> tuple[Event, str]:
    """Load a K* by the name of a shipped one or by file; return it and its version.

    Only the form is checked here; `spec.checks.check_event` holds all checks (METHOD 1).

    Raises:
        InputError: there is no such event or the file is not valid; every failure with its field.
    """
    value, path = read_event_file(name_or_path)
    event = parse_model(Event, value, path)
    return event, event_version(event)


def canonical(event: Event) -> dict[str, Any]:
    """Return the one mapping of all equal events: defaults filled in, sets in order."""
    value: dict[str, Any] = _plain(event.model_dump(mode="json", by_alias=True))
    for part, name in _SETS:
        value[part][name] = sorted(value[part][name])
    for field in value["topology"].values():
        for name in ("value", "varies"):
            if isinstance(field[name], list):
                field[name] = sorted(field[name])
    for participant in value["participants"].values():
        if participant["intent"] is None:
            del participant["intent"]
    return value


def event_version(event: Event) -> str:
    """Return the content hash of a K* over its canonical form (METHOD 1)."""
    return sha256_json(canonical(event))


def _plain(value: Any) -> Any:
    """Replace negative zeros, which are equal to 0 and would be written otherwise."""
    if isinstance(value, dict):
        # Most values are texts, which need no call.
        return {
            key: _plain(item) if isinstance(item, (dict, list, float)) else item
            for key, item in value.items()
        }
    if isinstance(value, list):
        return [_plain(item) for item in value]
    return value + 0.0 if isinstance(value, float) else value


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
    """Write a K* file."""
    write_text(path, event_text(event))


def event_text(event: Event, marks: Mapping[str, str] | None = None) -> str:
    """Return the event in YAML, which reads back equal; comments of an older text are gone.

    Args:
        event: to be written.
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
    yield from _wrapped([f"{_key(k)}: {flow(v)}" for k, v in _stated_items(value)], pad + "  ")


def _wrapped(items: list[str], pad: str) -> Iterator[str]:
    """Yield a flow mapping over as few lines as fit."""
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


def _stated_items(value: dict[str, Any]) -> list[tuple[str, Any]]:
    spoken = [(k, v) for k, v in value.items() if v is not None or k not in _SILENT_NULLS]
    if "identity" not in value:
        return spoken
    spoken.sort(key=lambda item: ("value", "identity", "varies", "why").index(item[0]))
    return [(k, v) for k, v in spoken if (k, v) != ("identity", False)]


def flow(value: Any) -> str:
    """Return a value as it stands in one line of the file."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)}: {flow(v)}" for k, v in _stated_items(value)) + "}"
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
    """Return a string plain where YAML reads it as one, else quoted."""
    plain = _PLAIN.match(text) and text.lower() not in _RESERVED
    if plain and not re.search(r":(\s|\Z)|\s\Z", text):
        return text
    quoted: str = yaml.safe_dump(text, default_style='"', width=float("inf"), allow_unicode=True)
    return quoted.strip()


# What part U doesn't speak about: the form's own name, and itself.
_APART = ("schema", "uncertainty")

# Fields that decide what happens on a road with people on it, or how it is judged: a person must
# have decided each of them, and none of them may stay unresolved.
SAFETY_CRITICAL = (
    *(f"topology.{name}" for name in IDENTITY_BY_DEFAULT),
    "participants.*.role",
    "participants.*.class",
    "participants.*.intent",
    "participants.*.region.place",
    "participants.*.region.along",
    "motion.*.trigger",
    "motion.*.conflict",
    "interaction.*",
    "events.clip.*",
    "events.*.start",
    "constraints.speeds.*.*",
    "constraints.trigger.*",
    "constraints.manoeuvre.*",
    "constraints.thresholds.*",
    "constraints.site.*",
    "constraints.safety.*",
)


def body(event: Event) -> dict[str, Any]:
    """Return the canonical mapping of what part U must cover: all but the schema and U itself."""
    value = canonical(event)
    return {key: item for key, item in value.items() if key not in _APART}


def safety_critical_fields(event: Event, value: Mapping[str, Any] | None = None) -> list[str]:
    """List the paths of the fields that a person has to decide, in the file's order.

    The identity fields of T are among them: they decide which recordings are admitted (METHOD 4.2).

    Args:
        event: a K*.
        value: the event's body, where it is at hand.
    """
    identity = {f"topology.{name}" for name in event.topology.identity_fields}
    return [
        path
        for path in granules(body(event) if value is None else value)
        if path in identity or any(matches(path, pattern) for pattern in SAFETY_CRITICAL)
    ]


def uncovered(event: Event, value: Mapping[str, Any] | None = None) -> list[str]:
    """Return the paths of the fields that part U doesn't cover, or not wholly; args as above.

    A field is what a person judges as one (`granules`).
    """
    value = body(event) if value is None else value
    return [
        path
        for path in granules(value)
        if any(
            owner(leaf, event.uncertainty) is None
            for leaf, _ in leaves(get(value, path), split(path))
        )
    ]


def seals(event: Event, value: Mapping[str, Any] | None = None) -> dict[str, str]:
    """Compute the seal of every entry; entries that name no field are left out."""
    value = body(event) if value is None else value
    entries = event.uncertainty
    below = _below(entries)
    there = (path for path in entries if has(value, path))
    return {path: _seal(value, path, entries, below.get(path, ())) for path in there}


def seal_event(event: Event, paths: Iterable[str] | None = None) -> Event:
    """Return the event with the seals of reviewed entries set to what they must be.

    The caller asserts that a person has seen these fields as they are now.

    Args:
        event: a K*.
        paths: entries to seal; None: all. An unreviewed entry loses its seal.

    Raises:
        LookupError: a path has no entry or names no field.
    """
    entries = dict(event.uncertainty)
    value, below = body(event), _below(entries)
    for path in entries if paths is None else paths:
        reviewed = entries[path].review != "unreviewed"
        seal = _seal(value, path, entries, below.get(path, ())) if reviewed else None
        entries[path] = entries[path].model_copy(update={"seal": seal})
    return event.model_copy(update={"uncertainty": entries})


def _below(entries: Mapping[str, Doubt]) -> dict[str, list[str]]:
    """Return the entries below an entry, with none between, by their holder."""
    entries_by_holder: dict[str, list[str]] = {}
    for path in entries:
        holder = owner(join(split(path)[:-1]), entries)
        if holder is not None:
            entries_by_holder.setdefault(holder, []).append(path)
    return entries_by_holder


def _seal(
    value: Mapping[str, Any], path: str, entries: Mapping[str, Doubt], below: Iterable[str]
) -> str:
    entry, own = entries[path], get(value, path)
    if isinstance(own, dict | list):
        own = _without(own, path, frozenset(below))
    return sha256_json([path, own, entry.confidence, entry.provenance, entry.source, entry.review])


def _without(value: Any, path: str, others: frozenset[str]) -> Any:
    """Return the value without what has an entry of its own. Lists keep a null in its place."""
    if not others:
        return value
    if isinstance(value, dict):
        members = ((key, f"{path}.{key}", item) for key, item in value.items())
        return {key: _without(item, at, others) for key, at, item in members if at not in others}
    if isinstance(value, list):
        numbered = ((f"{path}[{i}]", item) for i, item in enumerate(value))
        return [None if at in others else _without(item, at, others) for at, item in numbered]
    return value
