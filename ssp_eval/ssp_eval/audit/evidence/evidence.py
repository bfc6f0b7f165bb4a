"""Expected properties of K*, and the sources that say what a recording shows (METHOD 4.3)."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from ssp_eval.audit.evidence.measure import COMES_OPPOSITE, Measurements, Phases, comes_part
from ssp_eval.audit.evidence.recording import Recording
from ssp_eval.data.audit import (
    CONFLICT,
    FIELDS,
    MOTION,
    ORDER,
    ROLES,
    TOPOLOGY,
    Property,
    differences,
)
from ssp_eval.observations.agreement import Agreement
from ssp_eval.recordings.event import TURNS, Crop, EventRules, phase_starts
from ssp_eval.recordings.sight import Moment
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
    """Return q(k) as the K* has them; an unresolved one isn't determined."""
    return {
        TOPOLOGY: _topology(event),
        ROLES: _roles(event),
        MOTION: _event_property({"motion": (event.interaction.dominant_motion,)}),
        CONFLICT: _event_property({"paths": (event.interaction.relation,)}),
        ORDER: _event_property({"order": (" before ".join(event.interaction.passing_order),)}),
    }


def _event_property(words: Mapping[str, tuple[str, ...]]) -> Property:
    return Property(words, "from the K*")


def varying_parts(event: Event) -> frozenset[str]:
    """Return the parts of the topology that may differ between domains (METHOD 4.2)."""
    return frozenset(event.topology.varying_fields)


def outside_ranges(event: Event, topology: Property) -> list[str]:
    """Return parts of a measured topology that vary, but not inside the K*'s range, for people."""
    wrong = []
    for part in varying_parts(event) & set(topology.words or {}):
        field = getattr(event.topology, part)
        words = (topology.words or {})[part]
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
    return _event_property({**words, "adjacency": (_adjacency(event),)})


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
        if participant.intent in TURNS:
            words[who] = (f"{words[who][0]}, {participant.intent}",)
        if participant.role == "OT":
            words[f"{who} starts in"] = (participant.region.place,)
    if event.participants[event.vut_id].intent in TURNS:
        words[comes_part(event.interaction.initiator)] = (COMES_OPPOSITE,)
    words["initiator"] = (event.interaction.initiator,)
    words["affected"] = (event.interaction.affected,)
    return _event_property(words)


def visibility_field(who: str) -> str:
    """Name the field of the review of an OT's visibility."""
    return f"seen {who}"


# What a person must have reviewed for each field of KPR, for the phases, and for what is seen.
def reviewed_paths(event: Event) -> dict[str, tuple[str, ...]]:
    """Return the paths of the K* that each q(k), and the phases, rest on."""
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
            visibility_field(who): tuple(
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
    """The decisions of persons about a K*.

    Args:
        evidence: per field of KPR, and for the phases: where it can be seen, for people.
        gaps: per field, what isn't reviewed and why; empty where everything is.
    """

    evidence: Mapping[str, str]
    gaps: Mapping[str, tuple[str, ...]]


def review_of(event: Event) -> Review:
    """Tell whether q(k) and phases were reviewed, with evidence, and are unchanged since."""
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


Source = Literal["states", "reviewed", "observed", "unverified"]

# A person who picks frames at 10 Hz can be two frames off.
OBSERVED_TOLERANCE_S = 0.25


@dataclass(frozen=True)
class Evidence:
    """The statements of one source about a recording.

    Args:
        source: states, reviewed or observed.
        origin: for people: which states, which K*, who looked.
        properties: q(d, k) of the fields that it says something about. One whose words are None was
            looked for and isn't there, which is no silence.
        starts: clip times of the phases that it locates, s; None: it doesn't speak of phases.
    """

    source: Source
    origin: str
    properties: Mapping[str, Property]
    starts: Mapping[str, float] | None


@dataclass(frozen=True)
class Value:
    """One q(d, k) with where it comes from."""

    property: Property
    source: Source
    origin: str


UNVERIFIED = Value(
    Property(None, "neither measured nor observed, and not the K*'s source clip"), "unverified", ""
)


def combined(evidence: Sequence[Evidence]) -> dict[str, Value]:
    """Return q(d, k) per field: of several sources the first that has one, part by part.

    Args:
        evidence: in the order in which it counts.
    """
    values_by_field: dict[str, Value] = {}
    for name in FIELDS:
        values = [(one, one.properties[name]) for one in evidence if name in one.properties]
        if not values:
            values_by_field[name] = UNVERIFIED
            continue
        first, value = values[0]
        words = dict(value.words or {})
        how, origin, source = value.how, first.origin, first.source
        for other, more in values[1:]:
            added = {part: w for part, w in (more.words or {}).items() if part not in words}
            if value.words is not None and added:
                words |= added
                how += f"; {', '.join(p.replace('_', ' ') for p in added)}: {other.origin}"
                source = other.source
        values_by_field[name] = Value(
            Property(words if value.words is not None else None, how), source, origin
        )
    return values_by_field


@dataclass(frozen=True)
class Difference:
    """An observation that differs from what counts before it.

    Args:
        text: who says what, for people.
        refuses: it is of something that both can know and that must hold.
    """

    text: str
    refuses: bool


# Where they begin is a prediction from states (METHOD 1): nobody sees it.
PREDICTED = ("conflict", "resolution")


def observed_differences(
    evidence: Sequence[Evidence], varying: Collection[str] = (), first: int = 1
) -> list[Difference]:
    """List where an observation differs from a source that ranks above it (METHOD 4.3).

    A part that one source is silent about, such as the lane that somebody starts in where no road
    is bound to the states, isn't contradicted by another one; who takes part always is. What may
    vary between domains, and a predicted instant that states give, refuse nothing.

    Args:
        evidence: in the order in which it counts.
        varying: parts of the topology that may differ between domains.
        first: place of the first one that is held against those before it.
    """
    contradictions = []
    for index, other in enumerate(evidence[first:], start=first):
        before = combined(evidence[:index])
        for name, observed in other.properties.items():
            counts = before[name]
            if counts.source == "unverified" or observed.words is None:
                continue
            reference = counts.property
            told_by_both = observed.without(
                [
                    p
                    for p in observed.words
                    if _may_lack(name, p) and p not in (reference.words or {})
                ]
            )
            parts = reference.without([p for p in reference.words or {} if p not in observed.words])
            differing = differences(told_by_both, parts)
            if differing is None:
                text = f"{name.replace('_', ' ')}: {other.origin} says {observed.text}"
                contradictions.append(Difference(f"{text}; {counts.origin}: {reference.how}", True))
                continue
            may_vary = set(varying) & set(differing) if name == TOPOLOGY else set()
            for refuses, of in (
                (True, {p: pair for p, pair in differing.items() if p not in may_vary}),
                (False, {p: pair for p, pair in differing.items() if p in may_vary}),
            ):
                if of:
                    deviation = "; ".join(f"{p} {a}, not {b}" for p, (a, b) in of.items())
                    text = f"{name.replace('_', ' ')}: {other.origin} says {deviation}"
                    why = reference.how if refuses else "it may vary between domains"
                    contradictions.append(Difference(f"{text}; {counts.origin}: {why}", refuses))
        contradictions += _phase_differences(evidence[:index], other)
    return contradictions


def _phase_differences(before: Sequence[Evidence], other: Evidence) -> list[Difference]:
    """List the phases that an observation locates elsewhere than a source that ranks above it."""
    first = next((one for one in before if one.starts is not None), None)
    if first is None or first.starts is None:
        return []
    contradictions = []
    for phase, t_s in (other.starts or {}).items():
        known_s = first.starts.get(phase)
        if known_s is not None and abs(t_s - known_s) <= OBSERVED_TOLERANCE_S:
            continue
        where = "is nowhere" if known_s is None else f"is at {known_s:.2f} s"
        text = f"the {phase}: {other.origin} says {t_s:.2f} s; by {first.origin} it {where}"
        predicted = known_s is not None and first.source == "states" and phase in PREDICTED
        contradictions.append(
            Difference(f"{text}, a prediction" if predicted else text, not predicted)
        )
    return contradictions


def _may_lack(field: str, part: str) -> bool:
    """Return True for a part that comes from the road, which a source with states needn't have."""
    return field == TOPOLOGY or part.endswith(" starts in")


def observed(agreement: Agreement) -> Evidence:
    """Return the evidence of one person, or of several persons who agree."""
    properties = {k: q for k, q in agreement.properties().items() if q.words is not None}
    starts = agreement.answers.phase_starts()
    return Evidence("observed", f"observed by {agreement.by}", properties, starts or None)


def observed_apart(agreement: Agreement) -> list[Evidence]:
    """Return the evidence of each of several persons on what doesn't count of them all."""
    together = observed(agreement)
    evidence = []
    for one in agreement.observations:
        properties = {
            name: value
            for name, value in one.properties().items()
            if value.words is not None and name not in together.properties
        }
        starts = {
            phase: t_s
            for phase, t_s in one.phase_starts().items()
            if phase not in (together.starts or {})
        }
        evidence.append(Evidence("observed", f"observed by {one.who}", properties, starts))
    return evidence


def is_source_clip(recording: Recording, event: Event | None) -> bool:
    """Return True for the clip that the K* was taken from: its hash is the K*'s source hash."""
    imported = recording.provenance.imported
    return (
        event is not None
        and imported is not None
        and event.source.sha256 is not None
        and imported.source_sha256 == event.source.sha256
        and imported.domain == "synthetic"
    )


def reviewed(event: Event) -> Evidence:
    """Return the evidence of persons' decisions about the source clip."""
    review, event_properties = review_of(event), expected_properties(event)
    properties = {
        name: Property(
            event_properties[name].words, f"reviewed in the K*; evidence: {review.evidence[name]}"
        )
        for name in FIELDS
        if not review.gaps[name] and event_properties[name].words is not None
    }
    starts = None if review.gaps[PHASES_FIELD] else phase_starts(event)
    return Evidence("reviewed", f"reviewed in K* {event.name}", properties, starts)


@dataclass(frozen=True)
class Subject:
    """A recording, and what is known of it before anything of it is judged.

    Args:
        whole: as it was read, with the states in and near the clip.
        recording: within its clip.
        event: the K* of the audit; None: there is none at hand.
        version: of that K*.
        is_source: it is the K*'s source clip.
        rules: of its event.
        said: what each source says of it, in the order in which they count.
        values: q(d, k) per field, with its source.
        crop: the clip that all of this is of; None: the recording never began.
        measured: None without states.
        phases: None: none were located.
        moments: the states at each frame of the clip.
    """

    whole: Recording
    recording: Recording
    event: Event | None
    version: str | None
    is_source: bool
    rules: EventRules
    evidence_sources: tuple[Evidence, ...]
    values: Mapping[str, Value]
    crop: Crop | None
    measured: Measurements | None
    phases: Phases | None
    moments: Sequence[Moment]

    @property
    def agreement(self) -> Agreement | None:
        """Agreement of the observers; None without observers."""
        return self.whole.agreement

    @property
    def observed_differences(self) -> list[Difference]:
        """List where an observation differs from a source that ranks above it."""
        varying = frozenset[str]() if self.event is None else varying_parts(self.event)
        above = [one for one in self.evidence_sources if one.source != "observed"]
        apart = () if self.agreement is None else observed_apart(self.agreement)
        return [
            *observed_differences(self.evidence_sources, varying),
            *(d for one in apart for d in observed_differences([*above, one], varying, len(above))),
        ]

    @property
    def located(self) -> Evidence | None:
        """Source of the phases' starts; None without one."""
        return next((one for one in self.evidence_sources if one.starts is not None), None)
