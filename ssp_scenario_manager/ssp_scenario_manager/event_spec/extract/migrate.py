"""From ``ssp.event/1`` to ``ssp.event/2``: part T as values with identity fields, and the intent.

Part T is reviewed anew, all else keeps its review. What the old form left open (a range of lanes,
``any``) is no value of the source; it is written as ``unresolved`` and waits for a person.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files import parse_model
from ssp_scenario_manager.event_spec.extract import candidate
from ssp_scenario_manager.event_spec.fields import within
from ssp_scenario_manager.event_spec.load import OLD_SCHEMA
from ssp_scenario_manager.event_spec.model import SCHEMA, UNRESOLVED, Event

_INTENT_SOURCE = "the older form of this file had no intent"


@dataclass(frozen=True)
class Migrated:
    """A file in the new form.

    Args:
        decisions: what a person must still decide, by path: why.
    """

    event: Event
    decisions: Mapping[str, str]


def migrate(value: Mapping[str, Any], path: Path) -> Migrated:
    """The event of an ``ssp.event/1`` file in today's form.

    Raises:
        InputError: it is of another form, or can't be read.
    """
    if value.get("schema") != OLD_SCHEMA:
        found, remedy = value.get("schema"), f"only {OLD_SCHEMA} is moved over"
        raise InputError("is not of the older form", file=path, field="schema", value=found,
                         remedy=remedy)  # fmt: skip
    road, people, entries = (
        _mapping(value, part, path) for part in ("topology", "participants", "uncertainty")
    )
    decisions: dict[str, str] = {}
    fields = {}
    for name, old in road.items():
        fields[name], why = _field(name, old)
        if why is not None:
            decisions[f"topology.{name}"] = why
    # The seals of part T were made of other values.
    open_again = {"review": "unreviewed", "seal": None}
    known = {
        field: {**entry, **open_again} if within(field, "topology") else entry
        for field, entry in entries.items()
    }
    participants = {}
    for who, participant in people.items():
        participants[who] = dict(participant)
        if participant.get("role") != "VUT":
            continue
        field = f"participants.{who}.intent"
        participants[who]["intent"] = UNRESOLVED
        decisions[field] = "the older form didn't say what the VUT is about to do"
        known[field] = {
            "confidence": 0.0,
            "provenance": "person",
            "source": _INTENT_SOURCE,
            "review": "unreviewed",
        }
    new = {
        "schema": SCHEMA,
        "topology": fields,
        "participants": participants,
        "uncertainty": known,
    }
    return Migrated(parse_model(Event, {**value, **new}, path), decisions)


def _mapping(value: Mapping[str, Any], part: str, path: Path) -> dict[str, Any]:
    """A part of the file; part U may be missing."""
    found = value.get(part, {} if part == "uncertainty" else None)
    inside = found.values() if isinstance(found, dict) and part != "topology" else ()
    if not isinstance(found, dict) or not all(isinstance(item, dict) for item in inside):
        raise InputError("can't be read", file=path, field=part, remedy="a mapping, as it was")
    return found


def _field(name: str, old: Any) -> tuple[dict[str, Any], str | None]:
    """A field of T in the new form, and why a person must decide it; None: it means the same."""
    if name in candidate.ROAD_RANGES:
        if isinstance(old, Mapping):
            return {"value": UNRESOLVED, "varies": old}, None
        return {"value": UNRESOLVED, "varies": candidate.ROAD_RANGES[name]}, (
            "the older form stated no range; this is the usual one"
        )
    if name in candidate.ROAD_WORDS:
        if isinstance(old, str):
            old = UNRESOLVED if old == "any" else old
        return {"value": old, **candidate.road_words(name, old)}, None
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
