"""Part U: which entry covers a field, and the seal that notices a change after a review.

A seal is the hash of what was reviewed: the field's path, its value without what has an entry of
its own, and the entry's confidence, provenance, source and review state. A field or an entry that
is changed by hand afterwards no longer fits it, and `ssp spec check` says so (METHOD 1).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ssp_core.hashing import sha256_json
from ssp_scenario_manager.spec.fields import get, granules, has, join, leaves, matches, owner, split
from ssp_scenario_manager.spec.load import canonical
from ssp_scenario_manager.spec.model import IDENTITY_BY_DEFAULT, Doubt, Event

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
    """The canonical mapping of what part U must cover: all but the schema and U itself."""
    value = canonical(event)
    return {key: item for key, item in value.items() if key not in _APART}


def safety_critical_fields(event: Event, value: Mapping[str, Any] | None = None) -> list[str]:
    """Paths of the fields that a person has to decide, in the file's order.

    The identity fields of T are among them: they decide which recordings are admitted (METHOD 4.2).

    Args:
        event: the event.
        value: its body, where it is at hand.
    """
    identity = {f"topology.{name}" for name in event.topology.identity_fields}
    return [
        path
        for path in granules(body(event) if value is None else value)
        if path in identity or any(matches(path, pattern) for pattern in SAFETY_CRITICAL)
    ]


def uncovered(event: Event, value: Mapping[str, Any] | None = None) -> list[str]:
    """Paths of the fields that no entry of part U, or not all of them, speaks about; args as above.

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
    """What the seal of every entry must be; entries that name no field are left out."""
    value = body(event) if value is None else value
    entries = event.uncertainty
    below = _below(entries)
    there = (path for path in entries if has(value, path))
    return {path: _seal(value, path, entries, below.get(path, ())) for path in there}


def seal_event(event: Event, paths: Iterable[str] | None = None) -> Event:
    """The event with the seals of reviewed entries set to what they must be.

    Whoever calls this says that a person has seen these fields as they are now.

    Args:
        event: with its entries' review states as decided.
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
    """Entries below an entry, with none between, by their holder."""
    found: dict[str, list[str]] = {}
    for path in entries:
        holder = owner(join(split(path)[:-1]), entries)
        if holder is not None:
            found.setdefault(holder, []).append(path)
    return found


def _seal(
    value: Mapping[str, Any], path: str, entries: Mapping[str, Doubt], below: Iterable[str]
) -> str:
    entry, own = entries[path], get(value, path)
    if isinstance(own, dict | list):
        own = _without(own, path, frozenset(below))
    return sha256_json([path, own, entry.confidence, entry.provenance, entry.source, entry.review])


def _without(value: Any, path: str, others: frozenset[str]) -> Any:
    """The value without what has an entry of its own. Lists keep a null in its place."""
    if not others:
        return value
    if isinstance(value, dict):
        named = ((key, f"{path}.{key}", item) for key, item in value.items())
        return {key: _without(item, at, others) for key, at, item in named if at not in others}
    if isinstance(value, list):
        numbered = ((f"{path}[{i}]", item) for i, item in enumerate(value))
        return [None if at in others else _without(item, at, others) for at, item in numbered]
    return value
