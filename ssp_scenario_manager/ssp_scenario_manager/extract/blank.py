"""K* that begin without a video, blank from their kind."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from ssp_core.errors import InputError
from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.event_spec.fields import get, granules, has
from ssp_scenario_manager.event_spec.load import body, load_event, seals
from ssp_scenario_manager.event_spec.model import (
    IDENTITY_BY_DEFAULT,
    UNRESOLVED,
    Doubt,
    Event,
)
from ssp_scenario_manager.maps.site import LIBRARY
from ssp_scenario_manager.scenarios.events.kinds import KINDS

# Followed by the name of the shipped event.
_DEFAULT = "default of `ssp spec new`, as in the shipped "
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
    """Return a K* of a kind, with all that the kind settles and nothing that a clip must show.

    Part A, M, I and C are those of the shipped event of this kind, as defaults to confirm.

    Raises:
        InputError: this kind is unknown, or no shipped event is of it.
    """
    example = next((one for one in _shipped(kind) if one.interaction.type == kind), None)
    if kind not in KINDS or example is None:
        there = {one.interaction.type for one in _shipped(kind)}
        raise InputError(
            "is no kind of interaction that there is an example of",
            field="KIND",
            value=kind,
            remedy=f"one of {', '.join(sorted(set(KINDS) & there))}",
        )
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
    source = f"{_DEFAULT}{example.name}"
    value["uncertainty"] = {}
    event = Event.model_validate(value)
    doubt = Doubt(confidence=0.5, provenance="standard", source=source, review="unreviewed")
    entries = dict.fromkeys(granules(body(event)), doubt)
    return Blank(event.model_copy(update={"uncertainty": entries}), marks)


def _shipped(first: str) -> Iterator[Event]:
    """Yield the shipped events, of which each is read when it is asked for.

    Args:
        first: the event of this name comes before the others.
    """
    files = sorted((LIBRARY / "events").glob("*.event.yaml"))
    for path in sorted(files, key=lambda path: path.name != f"{first}.event.yaml"):
        yield load_event(str(path))[0]


@dataclass(frozen=True)
class ByHand:
    """A field of a K* that isn't as `ssp spec new` wrote it, though its source says so."""

    field: str
    old: Any
    new: Any


def changed_by_hand(event: Event) -> list[ByHand]:
    """Return the fields that were changed in the file and still name the template as their source.

    What a person reviewed as it is now is left out.
    """
    value = body(event)
    sealed, templates = seals(event, value), dict[str, dict[str, Any]]()
    changes = []
    for path, entry in event.uncertainty.items():
        name = entry.source.removeprefix(_DEFAULT)
        is_reviewed = entry.review != "unreviewed" and entry.seal == sealed.get(path)
        if name == entry.source or is_reviewed or not has(value, path):
            continue
        if name not in templates:
            kind = load_event(name)[0].interaction.type
            templates[name] = body(blank_event(kind, event.name).event)
        old = get(templates[name], path) if has(templates[name], path) else None
        if get(value, path) != old:
            changes.append(ByHand(path, old, get(value, path)))
    return changes


def with_author(event: Event, fields: Iterable[ByHand], who: str) -> Event:
    """Return the event with a person as the source of these fields, which are unreviewed."""
    doubt = Doubt(
        confidence=1.0, provenance="person", source=f"{who}, in an editor", review="unreviewed"
    )
    entries = dict.fromkeys((field.field for field in fields), doubt)
    return event.model_copy(update={"uncertainty": {**event.uncertainty, **entries}})


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
