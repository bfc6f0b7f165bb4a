"""``ssp.event/2``: a K* file, its seven parts T, A, M, I, E, C and U (METHOD 1).

Every part is keyed by names rather than by position, so that ``motion.ot1.trigger.lateral`` names
one field for the file, the checks, the log and the uncertainty part alike. A quantity is an
interval with its unit; what is unknown is ``unresolved`` and never a made-up number.
"""

from __future__ import annotations

import math
from typing import Annotated, Generic, Literal, TypeVar

from pydantic import ConfigDict, Field

from ssp_core.run_file.values import ObjectId, Strict
from ssp_core.vocabulary import LatWord, LonWord, MotionWord, ObjectWord, PhaseWord, PositionWord
from ssp_scenario_manager.event_spec.fields import UNITS, Span

SCHEMA: Literal["ssp.event/2"] = "ssp.event/2"
UNRESOLVED: Literal["unresolved"] = "unresolved"
# Fields of T that are identity unless a review record says why not (METHOD 4.2).
IDENTITY_BY_DEFAULT = ("segment", "lanes_same_direction", "lanes_opposite", "vut_lane")

Unresolved = Literal["unresolved"]
RoadTypeWord = Literal["urban", "rural", "motorway", "proving_ground"]
SegmentWord = Literal["straight", "curve", "junction"]
LaneWord = Literal["rightmost", "leftmost", "middle"]
BoundaryWord = Literal["kerb", "sidewalk", "shoulder", "verge"]
IntentWord = Literal[
    "keep_lane", "turn_left", "turn_right", "lane_change_left", "lane_change_right", "stop"
]
ManoeuvreWord = Literal["keep_lane", "lane_change_left", "lane_change_right", "crossing", "stop"]
Share = Annotated[float, Field(ge=0, le=1, strict=True)]
# Numbers as such: neither `yes` nor "12" is one.
Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
FrameNumber = Annotated[int, Field(ge=0, le=10**9, strict=True)]


class Interval(Strict):
    """A closed interval with its unit; an open side is null, an exact value has min = max."""

    min: Number | None = None
    max: Number | None = None
    unit: str

    @property
    def si(self) -> Span:
        """The same in SI units; code that works with K* takes this.

        Raises:
            ValueError: its unit is unknown.
        """
        unit = UNITS.get(self.unit)
        if unit is None:
            raise ValueError(f"no unit is called {self.unit!r}; known: {', '.join(UNITS)}")
        return Span(
            -math.inf if self.min is None else self.min * unit.factor,
            math.inf if self.max is None else self.max * unit.factor,
        )


Quantity = Interval | Unresolved


Lanes = Annotated[int, Field(ge=0, le=16, strict=True)]


class Count(Strict):
    """A count, from min to max."""

    min: Lanes
    max: Lanes


class RoadField(Strict):
    """One field of T: what the source shows, and what another place may have instead.

    Either the field is identity, so that every domain must have the source's value, or it varies
    inside a stated range and is disclosed (METHOD 1, 4.2). C2 refuses a field that says neither or
    both, and an identity field without a value.
    """

    identity: Annotated[bool, Field(strict=True)] = False
    why: str | None = Field(None, description="why segment, lane counts or VUT's lane may vary")


Word = TypeVar("Word", bound=str)


class WordField(RoadField, Generic[Word]):
    """A field of T that is a word."""

    value: Word | Unresolved
    varies: Annotated[list[Word], Field(min_length=1)] | None = None

    @property
    def words(self) -> tuple[str, ...]:
        """Words that a place may have, the source's first; () where they are unknown."""
        own = () if self.value == UNRESOLVED else (str(self.value),)
        return own if self.varies is None else tuple(dict.fromkeys((*own, *self.varies)))

    def admits(self, word: str) -> bool:
        """Tell whether a place with this word agrees with K*."""
        return word == self.value if self.varies is None else word in self.varies


class CountField(RoadField):
    """A field of T that is a number of lanes."""

    value: Lanes | Unresolved
    varies: Count | None = None

    @property
    def range(self) -> Count | None:
        """Return the counts that a place may have; None where they are not known."""
        if self.varies is not None:
            return self.varies
        return None if self.value == UNRESOLVED else Count(min=self.value, max=self.value)

    def admits(self, count: int) -> bool:
        """Tell whether a place with so many agrees with K*."""
        allowed = self.range
        return allowed is not None and allowed.min <= count <= allowed.max


class QuantityField(RoadField):
    """A field of T that is measured, in m or 1/m."""

    value: Quantity
    varies: Interval | None = None

    @property
    def range(self) -> Interval | None:
        """Return the values that a place may have; None where they are not known."""
        if self.varies is not None:
            return self.varies
        return self.value if isinstance(self.value, Interval) else None

    def admits(self, quantity: float) -> bool:
        """Tell whether a place with this value, m or 1/m, agrees with K*."""
        return self.range is not None and self.range.si.holds(quantity)


class ManoeuvresField(RoadField):
    """The manoeuvres that the road permits.

    ``varies`` names those that a place may permit or not.
    """

    value: Annotated[list[ManoeuvreWord], Field(min_length=1)] | Unresolved
    varies: Annotated[list[ManoeuvreWord], Field(min_length=1)] | None = None

    @property
    def permitted(self) -> frozenset[str]:
        """Return the manoeuvres that the source's road permits; empty where they are not known."""
        return frozenset(() if self.value == UNRESOLVED else self.value)

    @property
    def needed(self) -> frozenset[str]:
        """Return the manoeuvres that every place must permit."""
        return self.permitted - frozenset(self.varies or ())

    def admits(self, manoeuvres: frozenset[str]) -> bool:
        """Tell whether a place that permits this agrees with K*."""
        return self.value != UNRESOLVED and self.permitted ^ manoeuvres <= frozenset(
            self.varies or ()
        )


class Topology(Strict):
    """T: the road that the source shows, seen in the VUT's direction of travel."""

    road_type: WordField[RoadTypeWord]
    segment: WordField[SegmentWord]
    lanes_same_direction: CountField
    lanes_opposite: CountField
    vut_lane: WordField[LaneWord]
    left_boundary: WordField[BoundaryWord]
    right_boundary: WordField[BoundaryWord]
    lane_width: QuantityField
    curvature: QuantityField = Field(description="absolute curvature of the reference line, 1/m")
    permitted_manoeuvres: ManoeuvresField

    @property
    def by_name(self) -> dict[str, RoadField]:
        """Every field by its name, in the file's order."""
        return {name: getattr(self, name) for name in type(self).model_fields}

    @property
    def identity_fields(self) -> tuple[str, ...]:
        """Names of the fields that must be equal in all domains (METHOD 4.2)."""
        return tuple(name for name, field in self.by_name.items() if field.identity)

    @property
    def varying_fields(self) -> tuple[str, ...]:
        """Names of the fields that may differ between domains, and are then disclosed."""
        return tuple(name for name, field in self.by_name.items() if not field.identity)


class Region(Strict):
    """A participant's region at the clip's begin, in words and intervals relative to the VUT."""

    place: Literal[
        "vut_lane",
        "left_lane",
        "right_lane",
        "right_kerb",
        "left_kerb",
        "oncoming_lane",
        "left_road",
        "right_road",
    ]
    along: Literal["at", "ahead", "beside", "behind"] = Field(
        description="at: the VUT's own entry; else relative to it"
    )
    gap: Quantity = Field(UNRESOLVED, description="bumper gap to the VUT along its path, m")


class Participant(Strict):
    """A: one participant."""

    role: Literal["VUT", "OT"]
    class_: ObjectWord = Field(alias="class")
    intent: IntentWord | Unresolved | None = Field(None, description="the VUT's; null for an OT")
    region: Region

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class MotionCell(Strict):
    """M: one participant in one phase. Position and motion are seen from the VUT (METHOD 5.1)."""

    position: PositionWord | Unresolved | None = Field(None, description="null for the VUT")
    motion: MotionWord | Unresolved | None = Field(None, description="null for the VUT")
    heading: Literal["same", "opposite", "leftwards", "rightwards", "unresolved"]
    speed_trend: Literal["standing", "constant", "increasing", "decreasing", "any", "unresolved"]
    longitudinal: Literal["none", "closing", "opening", "any", "unresolved"] = Field(
        description="change of the gap between VUT and participant; none for the VUT"
    )
    lateral: Literal["none", "left", "right", "unresolved"]


PhaseCells = dict[PhaseWord, MotionCell]


class Interaction(Strict):
    """I: who conflicts with whom, how, in which order, and what is a right answer."""

    type: ObjectId = Field(description="a module of ssp_scenario_manager.scenarios")
    initiator: ObjectId = Field(description="the OT whose manoeuvre is the event")
    affected: ObjectId = Field(description="the VUT")
    relation: Literal["merge", "crossing", "following"]
    zone: Literal["vut_lane", "corridor_crossing"]
    occluder: ObjectId | None = None
    dominant_motion: MotionWord
    passing_order: Annotated[list[ObjectId], Field(min_length=2, max_length=2)]
    longitudinal_responses: Annotated[list[LonWord], Field(min_length=1)]
    lateral_responses: Annotated[list[LatWord], Field(min_length=1)]


class Evidence(Strict):
    """The part of the source that shows a fact: frame numbers or a span of time."""

    frames: tuple[FrameNumber, FrameNumber] | None = None
    span_s: tuple[Number, Number] | None = None


class PhaseStart(Strict):
    """E: when a phase starts in the (cropped) source clip, and where that can be seen."""

    start: Quantity
    evidence: Annotated[list[Evidence], Field(min_length=1, max_length=64)]


class Clip(Strict):
    """The cropped source clip that φ (METHOD 4) is taken over."""

    start: Quantity
    end: Quantity


class Events(Strict):
    """E: the phases in order, on the clip's own clock."""

    clip: Clip
    approach: PhaseStart
    trigger: PhaseStart
    conflict: PhaseStart
    resolution: PhaseStart


class TriggerNeed(Strict):
    """The condition that fires the manoeuvre, as an interval that the compiler chooses from."""

    quantity: Literal["relative_distance", "time_to_arrival"]
    object: ObjectId = Field(description="relative_distance: to it; time_to_arrival: at its path")
    below: Quantity


class Thresholds(Strict):
    """The start of a conflict (METHOD 1); null: this event isn't judged by it."""

    ttc: Interval | None = Interval(min=2.5, max=2.5, unit="s")
    arrival_gap: Interval | None = Interval(min=1.5, max=1.5, unit="s")


class CameraNeed(Strict):
    """The images that the forward camera must deliver."""

    hfov: Interval
    width: Interval
    rate: Interval
    visible_fraction: Interval = Field(description="of the critical phases, share in [0, 1]")


class SiteNeed(Strict):
    """The features that a place must offer."""

    length: Interval
    lateral_clearance: Interval = Field(description="beyond the kerb, for VRUs and run-off")


class SafetyNeed(Strict):
    """Ω_safe: limits that a realisation must not pass."""

    speed: Interval
    acceleration: Interval
    separation: Interval
    duration: Interval


class Constraints(Strict):
    """C: every number of the event, with its unit."""

    speeds: Annotated[dict[ObjectId, dict[PhaseWord, Quantity]], Field(max_length=16)]
    trigger: TriggerNeed
    manoeuvre: dict[ObjectId, Quantity] = Field(
        max_length=16, description="named by the interaction's module"
    )
    time_gap: Quantity = Field(description="at the conflict point (METHOD 1)")
    thresholds: Thresholds = Thresholds()
    camera: CameraNeed
    site: SiteNeed
    safety: SafetyNeed
    weights: dict[
        Literal[
            "topology", "participant_roles", "dominant_motion", "conflict_type", "passing_order"
        ],
        Annotated[Number, Field(ge=0)],
    ] = Field(default_factory=dict, description="w_k of KPR; 1 where not given")


class Doubt(Strict):
    """U: what is known about one field, or about all below it that have no entry of their own."""

    confidence: Share
    provenance: Literal["frame", "model", "person", "derived", "standard"]
    source: str = Field(description="frames, model id, or what it was derived from")
    review: Literal["unreviewed", "accepted", "edited", "unresolved"]
    seal: str | None = Field(None, description="hash of the field as it was reviewed")


class Source(Strict):
    """The clip that the event was taken from."""

    generator: str
    original: str = Field(description="version or name of the original")
    sha256: str | None = Field(None, description="null: made anew wherever it is needed")
    rate: Quantity = Field(UNRESOLVED, description="frames a second, Hz")


class Event(Strict):
    """One K* or, before review, a candidate."""

    schema_: Literal["ssp.event/2"] = Field(alias="schema")
    name: ObjectId
    description: str
    source: Source
    topology: Topology
    participants: Annotated[dict[ObjectId, Participant], Field(min_length=2, max_length=16)]
    motion: Annotated[dict[ObjectId, PhaseCells], Field(max_length=16)]
    interaction: Interaction
    events: Events
    constraints: Constraints
    uncertainty: dict[str, Doubt] = Field(default_factory=dict)

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @property
    def vut_id(self) -> str:
        """Id of the one VUT; the first participant's where C1 would fail."""
        ids = [key for key, who in self.participants.items() if who.role == "VUT"]
        return ids[0] if ids else next(iter(self.participants))
