"""From ``ssp.event/1`` to ``ssp.event/2``: part T as values with identity fields, and the intent.

What said one thing and means it still keeps its review. What the old form left open (a range of
lanes, ``any``) is no value of the source; it is written as ``unresolved`` and waits for a person.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.hashing import sha256_json
from ssp_scenario_manager.spec.extract import standards
from ssp_scenario_manager.spec.load import OLD_SCHEMA
from ssp_scenario_manager.spec.model import (
    SCHEMA,
    UNRESOLVED,
    Event,
)
from ssp_scenario_manager.spec.seal import seal_event

_INTENT_SOURCE = "the older form of this file had no intent"


@dataclass(frozen=True)
class Migrated:
    """A file in the new form.

    Args:
        event: in the new form.
        decisions: what a person must still decide, by path: why.
    """

    event: Event
    decisions: Mapping[str, str]


def migrate(value: Mapping[str, Any]) -> Migrated:
    """The event of an ``ssp.event/1`` mapping in today's form.

    Raises:
        ValueError: it is of another form, or its part T or A can't be read.
        pydantic.ValidationError: what wasn't changed can't be read.
    """
    road, people = value.get("topology"), value.get("participants")
    if value.get("schema") != OLD_SCHEMA:
        raise ValueError(f"schema is {value.get('schema')!r}, not {OLD_SCHEMA}")
    if not isinstance(road, Mapping) or not isinstance(people, Mapping):
        raise ValueError("topology and participants must be mappings")
    decisions: dict[str, str] = {}
    fields, kept = {}, set()
    for name, old in road.items():
        fields[name], why = _field(name, old)
        if why is None:
            kept.add(f"topology.{name}")
        else:
            decisions[f"topology.{name}"] = why
    entries = dict(value.get("uncertainty") or {})
    known = {}
    for path, entry in entries.items():
        known[path] = dict(entry)
        if path != "topology" and not path.startswith("topology."):
            continue
        name = path.removeprefix("topology.")
        if path not in kept or entry.get("seal") != _old_seal(path, road.get(name), entry):
            known[path] |= {"review": "unreviewed", "seal": None}
            kept.discard(path)
    participants = {}
    for who, participant in people.items():
        participants[who] = dict(participant)
        if participant.get("role") != "VUT":
            continue
        path = f"participants.{who}.intent"
        participants[who]["intent"] = UNRESOLVED
        decisions[path] = "the older form didn't say what the VUT is about to do"
        known[path] = {
            "confidence": 0.0,
            "provenance": "person",
            "source": _INTENT_SOURCE,
            "review": "unreviewed",
        }
    event = Event.model_validate(
        {
            **value,
            "schema": SCHEMA,
            "topology": fields,
            "participants": participants,
            "uncertainty": known,
        }
    )
    return Migrated(seal_event(event, sorted(kept & set(known))), decisions)


def _field(name: str, old: Any) -> tuple[dict[str, Any], str | None]:
    """A field of T in the new form, and why a person must decide it; None: it means the same."""
    if name in standards.ROAD_RANGES:
        if isinstance(old, Mapping):
            return {"value": UNRESOLVED, "varies": old}, None
        return {"value": UNRESOLVED, "varies": standards.ROAD_RANGES[name]}, (
            "the older form stated no range; this is the usual one"
        )
    if name in standards.ROAD_WORDS:
        if isinstance(old, str):
            old = UNRESOLVED if old == "any" else old
        return {"value": old, **standards.road_words(name, old)}, None
    if isinstance(old, Mapping):
        low, high = old.get("min"), old.get("max")
        if low == high:
            return {"value": low, "identity": True}, None
        return {"value": UNRESOLVED, "identity": True}, (
            f"how many the source shows; the older form allowed {low} to {high}"
        )
    if old in ("any", UNRESOLVED):
        return {"value": UNRESOLVED, "identity": True}, "what the source shows"
    return {"value": old, "identity": True}, None


def _old_seal(path: str, own: Any, entry: Mapping[str, Any]) -> str:
    """The seal of an entry as the older form made it."""
    if isinstance(own, Mapping) and "unit" in own:
        ends = {key: None if own.get(key) is None else float(own[key]) for key in ("min", "max")}
        own = {**ends, "unit": own["unit"]}
    if isinstance(own, list):
        own = sorted(own)
    names = ("confidence", "provenance", "source", "review")
    known = [entry.get(name) for name in names]
    known[0] = float(known[0]) if isinstance(known[0], int | float) else known[0]
    return sha256_json([path, own, *known])
