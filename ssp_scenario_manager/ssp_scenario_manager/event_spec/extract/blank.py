"""K* that begin without a video: blank from their kind, or from a file of an older form."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files import parse_model
from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.event_spec.extract import candidate
from ssp_scenario_manager.event_spec.fields import granules, within
from ssp_scenario_manager.event_spec.load import OLD_SCHEMA, body, load_event
from ssp_scenario_manager.event_spec.model import (
    IDENTITY_BY_DEFAULT,
    SCHEMA,
    UNRESOLVED,
    Doubt,
    Event,
)
from ssp_scenario_manager.maps.site import LIBRARY
from ssp_scenario_manager.scenarios.kinds import KINDS

_ROAD = {
    "road_type": "urban, rural, motorway or proving_ground",
    "segment": "straight, curve or junction",
    "lanes_same_direction": "how many lanes lead the VUT's way, its own included",
    "lanes_opposite": "how many lanes come towards it; 0 on a one-way road",
    "vut_lane": "rightmost, leftmost or middle, of the lanes that lead its way",
    "left_boundary": "kerb, sidewalk, shoulder or verge",
    "right_boundary": "kerb, sidewalk, shoulder or verge",
}
_STARTS = {
    "trigger": "the manoeuvre becomes visible: {min: 3.2, max: 3.2, unit: s}",
    "conflict": "without a reaction they would now meet",
    "resolution": "from here on, for good, they would no longer meet",
}


@dataclass(frozen=True)
class Blank:
    """An event without its decisions.

    Args:
        marks: comments above the fields to decide, by path.
    """

    event: Event
    marks: Mapping[str, str]


def blank_event(kind: str, name: str) -> Blank:
    """A K* of a kind, with all that the kind settles and nothing that a source clip must show.

    Part A, M, I and C are those of the shipped event of this kind, as defaults to confirm.

    Raises:
        InputError: nobody knows this kind, or no shipped event is of it.
    """
    shipped = sorted((LIBRARY / "events").glob("*.event.yaml"))
    examples = {load_event(str(path))[0].interaction.type: str(path) for path in shipped}
    if kind not in KINDS or kind not in examples:
        raise InputError(
            "is no kind of interaction that there is an example of",
            field="KIND",
            value=kind,
            remedy=f"one of {', '.join(sorted(set(KINDS) & set(examples)))}",
        )
    example, _ = load_event(examples[kind])
    value: dict[str, Any] = example.model_dump(mode="json", by_alias=True)
    marks = {"name": "decide: your own name, and a sentence about what happens"}
    value["name"] = name
    unknown: dict[str, Any] = dict.fromkeys(("generator", "original", "rate"), UNRESOLVED)
    value["source"] = unknown | {"sha256": None}
    marks["source.generator"] = "decide: what made the clip, its version, and its hash"
    for field, road in value["topology"].items():
        road["value"] = UNRESOLVED
        if field == "permitted_manoeuvres":
            road["value"] = sorted(example.topology.permitted_manoeuvres.needed)
        if field in IDENTITY_BY_DEFAULT:
            road |= {"identity": True, "varies": None, "why": None}
        if field in _ROAD:
            marks[f"topology.{field}"] = f"decide: {_ROAD[field]}"
    _open_events(value["events"], marks)
    source = f"default of `ssp spec new`, as in the shipped {example.name}"
    value["uncertainty"] = {}
    event = Event.model_validate(value)
    doubt = Doubt(confidence=0.5, provenance="standard", source=source, review="unreviewed")
    entries = dict.fromkeys(granules(body(event)), doubt)
    return Blank(event.model_copy(update={"uncertainty": entries}), marks)


def _open_events(events: dict[str, Any], marks: dict[str, str]) -> None:
    events["clip"]["end"] = UNRESOLVED
    marks["events.clip.end"] = "decide: the crop's length: {min: 9, max: 9, unit: s}"
    for phase in PHASES:
        events[phase]["evidence"] = [{"frames": None, "span_s": None}]
        marks[f"events.{phase}.evidence"] = (
            "decide: where it can be seen, up to the next phase: [{span_s: [3.2, 3.4]}]"
        )
        if phase in _STARTS:
            events[phase]["start"] = UNRESOLVED
            marks[f"events.{phase}.start"] = f"decide: {_STARTS[phase]}"


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
