"""``ssp.observation/1``: what a named person saw in a recording (METHOD 4.3).

Every answer is null where the person couldn't tell, and then it isn't verified. An answer names the
frames in which it can be seen: indices, from 0, of the recording's frames in the order of their
stamps, or [first, last]. Times are clip times, s. Left and right are the VUT's.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from itertools import pairwise
from typing import Annotated, Any, Generic, Literal, Self, TypeVar

from pydantic import AwareDatetime, ConfigDict, Field, model_validator

from ssp_core.hashing import sha256_json
from ssp_core.run_file.values import Finite, ObjectId, Strict
from ssp_core.vocabulary import MotionWord, ObjectWord
from ssp_eval.data.audit import CONFLICT, EVENT_PHASES, MOTION, ORDER, ROLES, TOPOLOGY, Property
from ssp_eval.data.provenance import Words
from ssp_scenario_manager.event_spec.model import BoundaryWord, RoadTypeWord, SegmentWord
from ssp_scenario_manager.extract.questions import GATE_REASONS

SCHEMA: Literal["ssp.observation/1"] = "ssp.observation/1"

PlaceWord = Literal[
    "vut_lane",
    "left_lane",
    "right_lane",
    "oncoming_lane",
    "left_kerb",
    "right_kerb",
    "left_road",
    "right_road",
    "2_lanes_left",
    "2_lanes_right",
    "3_lanes_left",
    "3_lanes_right",
]
LaneWord = Literal["rightmost", "middle", "leftmost", "oncoming", "off the road"]
RelationWord = Literal["merge", "crossing", "following", "oncoming", "none"]
# Parts of the topology that an observation may leave out.
MAY_LACK = ("road_type", "left_boundary", "right_boundary")
# The five reasons for which the source gate refuses a clip (METHOD 1).
REASONS = tuple(GATE_REASONS)

FrameIndex = Annotated[int, Field(ge=0, le=10**9, strict=True)]
Frames = list[FrameIndex | tuple[FrameIndex, FrameIndex]]


YesNo = Annotated[bool, Field(strict=True)] | None
Lanes = Annotated[int, Field(ge=0, le=16, strict=True)] | None
Share = Annotated[float, Field(ge=0, le=1, strict=True)]
ClipTime = Finite | None
Value = TypeVar("Value")


class FrameAnswers(Strict):
    """Answers that rest on the same frames; ``note`` is for people."""

    frames: Frames = []
    note: Words | None = None

    @model_validator(mode="after")
    def _has_evidence(self) -> Self:
        for item in self.frames:
            if isinstance(item, tuple) and item[0] > item[1]:
                raise ValueError(f"the span {item[0]} to {item[1]} ends before it begins")
        if not self.frames and any(value is not None for _, value in leaves(self.answers())):
            raise ValueError("is answered without evidence: name the frames that show it")
        return self

    def answers(self) -> dict[str, Any]:
        """Return the statements, without their evidence."""
        return self.model_dump(by_alias=True, exclude={"frames", "note"})

    @property
    def evidence(self) -> str:
        """The frames, for people: ``frames 3, 10–20``."""
        parts = [str(f) if isinstance(f, int) else f"{f[0]}–{f[1]}" for f in self.frames]
        return f"frames {', '.join(parts)}" if parts else "no frames"


class Topology(FrameAnswers):
    """The road as the VUT drives on it. With one lane in its direction ``vut_lane`` may be any.

    Road type and boundaries may be left out: as a rule they may vary between domains.
    """

    segment: SegmentWord | None
    lanes_same_direction: Lanes
    lanes_opposite: Lanes
    vut_lane: LaneWord | None
    road_type: RoadTypeWord | None = None
    left_boundary: BoundaryWord | None = None
    right_boundary: BoundaryWord | None = None


class Participant(Strict):
    """A participant, and an OT's place at the clip's start, seen from the VUT's lane."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    role: Literal["VUT", "OT"]
    class_: ObjectWord | None = Field(alias="class")
    starts_in: PlaceWord | None = Field(None, description="of an OT")


class Roles(FrameAnswers):
    """The participants, the initiator of the event, and the one affected."""

    participants: Annotated[dict[ObjectId, Participant], Field(min_length=2, max_length=16)]
    initiator: ObjectId | None
    affected: ObjectId | None

    def answers(self) -> dict[str, Any]:
        answers = super().answers()
        for one in answers["participants"].values():
            del one["role"]
        return answers

    @property
    def vut(self) -> str:
        return next(who for who, one in self.participants.items() if one.role == "VUT")

    @property
    def targets(self) -> tuple[str, ...]:
        return tuple(who for who, one in self.participants.items() if one.role == "OT")


class Statement(FrameAnswers, Generic[Value]):
    """One answer."""

    value: Value | None


class PhaseStart(FrameAnswers):
    """The start of a phase."""

    t_s: ClipTime


class Phases(Strict):
    """Starts of the phases; start and end where the observer cropped the recording."""

    start_s: ClipTime = None
    end_s: ClipTime = None
    trigger: PhaseStart
    conflict: PhaseStart
    resolution: PhaseStart


YesOrNo = Statement[Annotated[bool, Field(strict=True)]]


class Gate(Strict):
    """The five reasons of the source gate; true: the clip has it."""

    deformation: YesOrNo
    identity: YesOrNo
    discontinuity: YesOrNo
    road: YesOrNo
    no_conflict: YesOrNo


class Visible(Statement[Share | Literal["throughout", "never"]]):
    """The share of the time from trigger to resolution in which something can be seen."""

    @property
    def share(self) -> float | None:
        if isinstance(self.value, str):
            return 1.0 if self.value == "throughout" else 0.0
        return self.value


class Visibility(Strict):
    """The visibility of the OTs, and of the region where they are in conflict."""

    participants: dict[ObjectId, Visible]
    conflict_region: Visible


class Log(Strict):
    """The observer's declaration of what a recording without our log can't show."""

    safety_abort: YesNo
    identity_switch: YesNo
    site_changes: list[Words] | None = Field(description="empty: nothing")


NO_LOG = Log(safety_abort=None, identity_switch=None, site_changes=None)


class Answers(Strict):
    """All that is asked."""

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    topology: Topology
    roles: Roles
    dominant_motion: Statement[MotionWord] = Field(
        description="of the critical OT, held longest from trigger to resolution"
    )
    conflict_type: Statement[RelationWord] = Field(
        description="how the path of the initiator meets the corridor of who is affected"
    )
    passing_order: Statement[tuple[ObjectId, ObjectId]] = Field(
        description="who arrives first at the conflict zone, and who second"
    )
    phases: Phases
    identity_stable: YesOrNo
    source_gate: Gate
    visibility: Visibility
    log: Log = NO_LOG

    def evidence_groups(self) -> Iterator[tuple[str, FrameAnswers]]:
        """Yield every group of answers that has evidence, by its path."""
        for name in ("topology", "roles", "dominant_motion", "conflict_type", "passing_order"):
            yield name, getattr(self, name)
        for phase in EVENT_PHASES:
            yield f"phases.{phase}", getattr(self.phases, phase)
        yield "identity_stable", self.identity_stable
        for reason in REASONS:
            yield f"source_gate.{reason}", getattr(self.source_gate, reason)
        for who, one in self.visibility.participants.items():
            yield f"visibility.participants.{who}", one
        yield "visibility.conflict_region", self.visibility.conflict_region

    def unanswered(self) -> tuple[str, ...]:
        """Return the paths of unanswered fields, without the declarations of the log."""
        paths = []
        for path, one in self.evidence_groups():
            for key, value in leaves(one.answers()):
                if value is None and not _is_idle(path, key, self):
                    paths.append(f"{path}.{key}")
        return tuple(paths)

    def contradictions(self) -> Iterator[tuple[str, str]]:
        """Yield the paths of contradicting answers, and why they contradict."""
        roles = self.roles
        participants = roles.participants
        vuts = [who for who, one in participants.items() if one.role == "VUT"]
        if len(vuts) != 1:
            yield "roles.participants", f"one of them is the VUT, not {len(vuts)}"
            return
        for name in ("initiator", "affected"):
            who = getattr(roles, name)
            if who is not None and who not in participants:
                yield f"roles.{name}", f"{who} is no participant: {', '.join(participants)}"
        if roles.initiator is not None and roles.initiator == roles.affected:
            yield "roles.affected", f"{roles.affected} is the initiator, too"
        if participants[roles.vut].starts_in is not None:
            yield f"roles.participants.{roles.vut}.starts_in", "is asked of OTs alone"
        order = self.passing_order.value
        if order is not None and (order[0] == order[1] or not set(order) <= set(participants)):
            yield "passing_order.value", f"must name two of {', '.join(participants)}"
        if set(self.visibility.participants) != set(roles.targets):
            yield "visibility.participants", f"must name {', '.join(roles.targets)}"
        yield from self._times()

    def _times(self) -> Iterator[tuple[str, str]]:
        starts = {f"{phase}.t_s": t_s for phase, t_s in self.phase_starts().items()}
        times_s = {"start_s": self.phases.start_s, **starts, "end_s": self.phases.end_s}
        sequence = [(name, t_s) for name, t_s in times_s.items() if t_s is not None]
        for before, (name, t_s) in pairwise(sequence):
            if t_s <= before[1]:
                yield f"phases.{name}", f"{t_s:g} s is not after {before[0]} at {before[1]:g} s"

    def phase_starts(self) -> dict[str, float]:
        """Clip times of the phases that were found."""
        return {
            phase: start.t_s
            for phase in EVENT_PHASES
            if (start := getattr(self.phases, phase)).t_s is not None
        }

    def rejections(self) -> tuple[str, ...]:
        """Return the reasons of the source gate that the observer found."""
        return tuple(r for r in REASONS if getattr(self.source_gate, r).value is True)

    def unverified_reasons(self) -> tuple[str, ...]:
        """Return the reasons of the source gate that couldn't be decided."""
        return tuple(r for r in REASONS if getattr(self.source_gate, r).value is None)

    def properties_by(self, by: str) -> dict[str, Property]:
        """Return q(d, k) in the words that are measured elsewhere (METHOD 4.2)."""
        order = self.passing_order
        return {
            TOPOLOGY: _property(self.topology, self._topology_words(), by),
            ROLES: _property(self.roles, self._role_words(), by),
            MOTION: _property(self.dominant_motion, {"motion": self.dominant_motion.value}, by),
            CONFLICT: _property(self.conflict_type, {"paths": self.conflict_type.value}, by),
            ORDER: _property(
                order, {"order": None if order.value is None else " before ".join(order.value)}, by
            ),
        }

    def _topology_words(self) -> dict[str, str | tuple[str, ...] | None]:
        road = self.topology
        lane: str | tuple[str, ...] | None = road.vut_lane
        if road.lanes_same_direction == 1 and lane in (None, "rightmost", "middle", "leftmost"):
            lane = ("rightmost", "leftmost")
        counts = {
            name: None if (count := getattr(road, name)) is None else str(count)
            for name in ("lanes_same_direction", "lanes_opposite")
        }
        return {
            **counts,
            "segment": road.segment,
            "vut_lane": lane,
            "adjacency": self._adjacency(),
            **{part: word for part in MAY_LACK if (word := getattr(road, part)) is not None},
        }

    def _adjacency(self) -> str | None:
        """Describe how the lane that the critical OT comes from lies to the VUT's."""
        roles = self.roles
        target = roles.initiator if roles.initiator != roles.vut else roles.affected
        if target is None or (place := roles.participants[target].starts_in) is None:
            return None
        if place == "vut_lane":
            return "same lane"
        if place in ("left_lane", "right_lane", "oncoming_lane"):
            return "adjacent lanes"
        return "beside the lanes" if place.endswith(("kerb", "road")) else "lanes apart"

    def _role_words(self) -> dict[str, str | tuple[str, ...] | None]:
        words: dict[str, str | tuple[str, ...] | None] = {}
        for who, one in self.roles.participants.items():
            words[who] = None if one.class_ is None else f"{one.role}, {one.class_}"
            if one.role == "OT":
                words[f"{who} starts in"] = one.starts_in
        words["initiator"] = self.roles.initiator
        words["affected"] = self.roles.affected
        return words


class Observation(Answers):
    """A person's file about one recording.

    ``bag_sha256`` binds it to the recording's content, and ``seal`` to its own: it is the hash of
    all the rest. ``scenario`` and ``event_version`` say what the recording was looked at for.
    """

    schema_: Literal["ssp.observation/1"] = Field(SCHEMA, alias="schema")
    recording: Words
    bag_sha256: Annotated[str, Field(pattern=r"^sha256:[0-9a-f]{64}$")]
    scenario: Words | None = None
    event_version: Words | None = None
    who: Words
    role: Words | None = Field(None, description="of the person")
    when: AwareDatetime
    remark: Words | None = None
    seal: str | None = Field(None, description="hash of all the rest; null: a draft")

    @property
    def content_sha256(self) -> str:
        """Compute the seal that the observation must have."""
        value = self.model_dump(mode="json", by_alias=True)
        del value["seal"]
        return sha256_json(value)

    def properties(self) -> dict[str, Property]:
        """Return q(d, k), as this person saw them."""
        return self.properties_by(self.who)


def leaves(value: Mapping[str, Any], before: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and value of everything in nested mappings."""
    for key, item in value.items():
        if isinstance(item, dict):
            yield from leaves(item, f"{before}{key}.")
        else:
            yield f"{before}{key}", item


def _is_idle(path: str, key: str, answers: Answers) -> bool:
    """Return True for a question without need: the VUT's start, its lane where there is one."""
    if path == "topology":
        only = key == "vut_lane" and answers.topology.lanes_same_direction == 1
        return only or key in MAY_LACK
    return path == "roles" and key == f"participants.{answers.roles.vut}.starts_in"


def _property(
    answers: FrameAnswers, words: Mapping[str, str | tuple[str, ...] | None], by: str
) -> Property:
    missing = [part for part, word in words.items() if word is None]
    if missing:
        return Property(None, f"not observed by {by}: {', '.join(missing)}")
    plain = {
        part: (word,) if isinstance(word, str) else word
        for part, word in words.items()
        if word is not None
    }
    return Property(plain, f"observed by {by}, {answers.evidence}")
