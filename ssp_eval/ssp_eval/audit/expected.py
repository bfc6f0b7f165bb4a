"""What a K* says of its event: q(k), and whether a person reviewed it.

Synthetic's states are held against it. It is evidence for one recording alone: the source clip that
the K* was taken from (METHOD 4.3).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ssp_eval.recordings.properties import CONFLICT, MOTION, ORDER, ROLES, TOPOLOGY, Property
from ssp_scenario_manager.event_spec.fields import owner
from ssp_scenario_manager.event_spec.load import seals
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Count, CountField, Event, WordField

_REVIEWED = ("accepted", "edited")
PHASES_FIELD = "phases"
# Of which clip all that was reviewed is.
_SOURCE = "source.sha256"
# The fields of T that a road can be measured in; the others are disclosed as K* has them.
ROAD_FIELDS = (
    "lanes_same_direction",
    "lanes_opposite",
    "segment",
    "vut_lane",
    "road_type",
    "left_boundary",
    "right_boundary",
)


def expected_properties(event: Event) -> dict[str, Property]:
    """q(k) as the K* has them; an unresolved one isn't determined."""
    return {
        TOPOLOGY: _topology(event),
        ROLES: _roles(event),
        MOTION: _known({"motion": (event.interaction.dominant_motion,)}),
        CONFLICT: _known({"paths": (event.interaction.relation,)}),
        ORDER: _known({"order": (" before ".join(event.interaction.passing_order),)}),
    }


def _known(words: Mapping[str, tuple[str, ...]]) -> Property:
    return Property(words, "from the K*")


def varying_parts(event: Event) -> frozenset[str]:
    """Parts of the topology that may differ between domains (METHOD 4.2)."""
    return frozenset(event.topology.varying_fields)


def outside_ranges(event: Event, found: Property) -> list[str]:
    """Parts of a measured topology that vary, but not inside the K*'s range, for people."""
    wrong = []
    for part in varying_parts(event) & set(found.words or {}):
        field = getattr(event.topology, part)
        words = (found.words or {})[part]
        if field.varies is not None and not any(_admits(field, word) for word in words):
            ranges = field.varies
            text = (
                f"{ranges.min} to {ranges.max}" if isinstance(ranges, Count) else ", ".join(ranges)
            )
            wrong.append(f"{part} {' or '.join(words)}, K* has {text}")
    return sorted(wrong)


def _admits(field: WordField[str] | CountField, word: str) -> bool:
    return field.admits(int(word)) if isinstance(field, CountField) else field.admits(word)


def _topology(event: Event) -> Property:
    road = event.topology
    words = {
        name: (str(field.value),)
        for name in ROAD_FIELDS
        if (field := getattr(road, name)).value != UNRESOLVED
    }
    open_fields = [n for n in road.identity_fields if getattr(road, n).value == UNRESOLVED]
    if open_fields:
        return Property(None, f"topology.{open_fields[0]} is unresolved in the K*")
    return _known({**words, "adjacency": (_adjacency(event),)})


def _adjacency(event: Event) -> str:
    initiator = event.participants.get(event.interaction.initiator)
    place = None if initiator is None else initiator.region.place
    if place == "vut_lane":
        return "same lane"
    if place in ("left_lane", "right_lane", "oncoming_lane"):
        return "adjacent lanes"
    return "beside the lanes"


def _roles(event: Event) -> Property:
    words: dict[str, tuple[str, ...]] = {}
    for who, participant in event.participants.items():
        words[who] = (f"{participant.role}, {participant.class_}",)
        if participant.role == "OT":
            words[f"{who} starts in"] = (participant.region.place,)
    words["initiator"] = (event.interaction.initiator,)
    words["affected"] = (event.interaction.affected,)
    return _known(words)


def seen_field(who: str) -> str:
    """What the review of an OT's visibility stands under."""
    return f"seen {who}"


# What a person must have reviewed for each field of KPR, for the phases, and for what is seen.
def reviewed_paths(event: Event) -> dict[str, tuple[str, ...]]:
    """Paths of the K* that each q(k), and the phases, rest on."""
    participants = [
        f"participants.{who}.{name}"
        for who, participant in event.participants.items()
        for name in ("role", "class", *(("region.place",) if participant.role == "OT" else ()))
    ]
    return {
        TOPOLOGY: tuple(f"topology.{name}" for name in event.topology.identity_fields),
        ROLES: (*participants, "interaction.initiator", "interaction.affected"),
        MOTION: ("interaction.dominant_motion",),
        CONFLICT: ("interaction.relation",),
        ORDER: ("interaction.passing_order",),
        **{
            seen_field(who): tuple(
                f"motion.{who}.{phase}.position" for phase in ("trigger", "conflict")
            )
            for who, participant in event.participants.items()
            if participant.role == "OT"
        },
        PHASES_FIELD: (
            "events.clip.start",
            "events.clip.end",
            *(f"events.{phase}.start" for phase in ("trigger", "conflict", "resolution")),
        ),
    }


@dataclass(frozen=True)
class Review:
    """What persons decided of a K*.

    Args:
        evidence: per field of KPR, and for the phases: where it can be seen, for people.
        gaps: per field, what isn't reviewed and why; empty where everything is.
    """

    evidence: Mapping[str, str]
    gaps: Mapping[str, tuple[str, ...]]


def review_of(event: Event) -> Review:
    """Whether every q(k) and the phases were reviewed, with evidence, and not changed since."""
    sealed = seals(event)
    evidence: dict[str, str] = {}
    gaps: dict[str, tuple[str, ...]] = {}
    source = owner(_SOURCE, event.uncertainty)
    seal = None if source is None else event.uncertainty[source].seal
    moved = (
        ()
        if seal in (None, sealed.get(source or ""))
        else (f"{_SOURCE} was changed after its review",)
    )
    for field, paths in reviewed_paths(event).items():
        missing, sources = list(moved), []
        for path in paths:
            entry = owner(path, event.uncertainty)
            if entry is None:
                missing.append(f"{path} has no entry in part U")
                continue
            doubt = event.uncertainty[entry]
            if doubt.review not in _REVIEWED:
                missing.append(f"{path} is {doubt.review}")
            elif doubt.seal is None:
                missing.append(f"{path} is {doubt.review} without a seal")
            elif doubt.seal != sealed.get(entry):
                missing.append(f"{path} was changed after its review")
            elif not doubt.source.strip():
                missing.append(f"{path} names no evidence")
            else:
                sources.append(doubt.source)
        evidence[field] = "; ".join(dict.fromkeys(sources))
        gaps[field] = tuple(missing)
    return Review(evidence, gaps)
