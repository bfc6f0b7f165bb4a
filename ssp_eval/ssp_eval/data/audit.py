"""``ssp.audit/2``: properties q(d, k), φ, KPR and EPD, as an audit's file holds them (METHOD 4)."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from ssp_core.errors import InputError
from ssp_core.files.reading import load_model
from ssp_core.run_file.values import Finite, NonNegative, Strict
from ssp_core.vocabulary import DOMAINS, DomainWord, PhaseWord
from ssp_eval.data.response import ResponseEntry

TOPOLOGY = "topology"
ROLES = "participant_roles"
MOTION = "dominant_motion"
CONFLICT = "conflict_type"
ORDER = "passing_order"
# The fields of KPR, all of them mandatory.
FIELDS = (TOPOLOGY, ROLES, MOTION, CONFLICT, ORDER)
EVENT_PHASES = ("trigger", "conflict", "resolution")


@dataclass(frozen=True)
class Property:
    """One q(d, k).

    Args:
        words: per part of the field, the words that hold of it; None: it could not be determined.
            A recording has one word for a part as a rule, a specification any number of them: each
            is as good as the other (2 to 4 lanes).
    """

    words: Mapping[str, tuple[str, ...]] | None
    how: str

    def without(self, parts: Collection[str]) -> Property:
        """Return the property without these parts, which may differ between domains."""
        if self.words is None or not parts:
            return self
        return Property({k: v for k, v in self.words.items() if k not in parts}, self.how)

    @property
    def text(self) -> str:
        """Describe the property for people, without its obvious parts: ``straight, 2 to 4 …``."""
        if self.words is None:
            return "not determined"
        return "; ".join(f"{part} {_either(words)}" for part, words in self.words.items())


def _either(words: tuple[str, ...]) -> str:
    if len(words) > 2 and all(word.isdigit() for word in words):
        return f"{words[0]} to {words[-1]}"
    return " or ".join(words)


def differences(candidate: Property, reference: Property) -> dict[str, tuple[str, str]] | None:
    """Return the parts in which two values of one field differ, as (candidate, reference).

    Two words for a part agree when they share one. An empty answer means that the fields are equal;
    None means that one of them isn't determined, so that the answer is unknown.
    """
    if candidate.words is None or reference.words is None:
        return None
    parts = {}
    for part in [*reference.words, *(p for p in candidate.words if p not in reference.words)]:
        ours = candidate.words.get(part, ())
        theirs = reference.words.get(part, ())
        if not set(ours) & set(theirs):
            parts[part] = (_either(ours) or "absent", _either(theirs) or "absent")
    return parts


def is_equal(candidate: Property, reference: Property) -> bool:
    """Return [q(d, k) = q(Syn, k)]; a property that isn't determined equals nothing."""
    return differences(candidate, reference) == {}


def phase_fraction(t_s: float, start_s: float, end_s: float) -> float:
    """Compute φ(d, e) = (t(d, e) − t(d, start)) / (t(d, end) − t(d, start)), METHOD 4.

    Args:
        t_s: time of the event, any clock.
        start_s: start of the clip on the same clock.
        end_s: its end, later than its start.

    Returns:
        A fraction in [0, 1] for a time inside the clip.

    Raises:
        ValueError: the clip has no length, or a time isn't finite.
    """
    if not all(map(math.isfinite, (t_s, start_s, end_s))) or end_s <= start_s:
        raise ValueError(f"a clip from {start_s} to {end_s} s has no fraction at {t_s} s")
    return (t_s - start_s) / (end_s - start_s)


def phase_difference(phi: Mapping[str, float], reference: Mapping[str, float]) -> float:
    """Return EPD(d) = (1/|E_s|) Σ_e |φ(d, e) − φ(Syn, e)|, METHOD 4.

    Args:
        phi: φ(d, e) per event.
        reference: φ(Syn, e) of the same events, at least one.

    Raises:
        ValueError: there are no events, or not the same ones.
    """
    if not reference or set(phi) != set(reference):
        raise ValueError(f"events {sorted(phi)} and {sorted(reference)} can't be compared")
    return math.fsum(abs(phi[e] - reference[e]) for e in reference) / len(reference)


def property_retention(
    properties: Mapping[str, Property],
    reference: Mapping[str, Property],
    weights: Mapping[str, float] | None = None,
) -> float:
    """Return KPR(d) = Σ_k w_k [q(d, k) = q(Syn, k)] / Σ_k w_k, METHOD 4.

    Args:
        properties: q(d, k) per field; a field that isn't there or isn't determined equals nothing.
        reference: q(Syn, k) of every field.
        weights: w_k ≥ 0 from part C of K*; 1 where not given.

    Raises:
        ValueError: the weights sum to 0, or one is negative or not finite.
    """
    weight_by_field = weights or {}
    w = {k: weight_by_field.get(k, 1.0) for k in FIELDS}
    total = math.fsum(w.values())
    if not math.isfinite(total) or total <= 0.0 or min(w.values()) < 0.0:
        raise ValueError(f"weights {w} can't be used")
    retained_weight = math.fsum(
        w[k] for k in FIELDS if k in properties and is_equal(properties[k], reference[k])
    )
    return retained_weight / total


SCHEMA: Literal["ssp.audit/2"] = "ssp.audit/2"
AUDIT_FILE = "audit.json"
PAGE_FILE = "audit.html"

Status = Literal["admitted", "refused", "unpaired"]
Evidence = Literal["states", "reviewed", "observed", "unverified"]
Share = Annotated[float, Field(ge=0, le=1)]
# Of computed values; no verdict hangs on it.
_ROUNDING = 1e-6


class FindingEntry(Strict):
    """A row of the table in reasons.py, with what was found."""

    code: str
    text: str
    detail: str


class ReasonEntry(FindingEntry):
    """A cause, and what follows from it."""

    consequences: list[FindingEntry] = []


class PropertyEntry(Strict):
    """q(d, k): words per part; several words mean any of them. Null: not determined."""

    source: Evidence
    said_by: str = Field("", description="which states, which K*, or who looked")
    words: dict[str, list[str]] | None
    how: str
    equal: bool | None = Field(description="to q(Syn, k); null for Syn, or where one is unknown")
    differences: dict[str, tuple[str, str]] = Field({}, description="part: (found, wanted)")

    def property(self, varying: Collection[str]) -> Property:
        """Return the value without the parts that may vary."""
        words = None if self.words is None else {k: tuple(v) for k, v in self.words.items()}
        return Property(words, self.how).without(varying)


class PhasesEntry(Strict):
    """Clip times in s, null where a phase can't be located; φ of METHOD 4 and its half width."""

    source: Evidence
    start_s: Finite | None
    end_s: Finite | None
    trigger_s: Finite | None
    conflict_s: Finite | None
    resolution_s: Finite | None
    phi: dict[str, Share] = {}
    phi_half_width: dict[str, Share] = Field({}, description="where K* gives an interval")


class CropEntry(Strict):
    """The clip that was compared (METHOD 4.1); clip times in s of the recording."""

    start_s: Finite
    end_s: Finite
    chosen_by: str
    short_before_s: NonNegative = Field(0.0, description="the recording begins so much too late")
    short_after_s: NonNegative = Field(0.0, description="the recording ends so much too early")


class AgreementEntry(Strict):
    """One answer of those who looked at a recording, and what counts of it (METHOD 4.3)."""

    field: str
    values: list[str]
    verdict: Literal["agree", "differ", "one alone", "contradict", "unknown"]
    result: str


class ObservationsEntry(Strict):
    """The persons' observations of a recording, in files beside its bag."""

    observers: Annotated[list[str], Field(min_length=1)]
    files: dict[str, str] = Field(description="SHA-256 of each file")
    tolerance_s: Finite = Field(description="of times")
    rows: list[AgreementEntry]


# Of the height of the critical object in the picture, px.
HARDLY_VISIBLE_PX = 12.0


class LabelSize(Strict):
    """The size of the critical object in the newest frame at a label's time."""

    t_s: Finite = Field(description="clip time of the label")
    phase: PhaseWord
    height_px: NonNegative | None = Field(
        description="of what the recorded picture shows of its box; 0: nothing, null: not known"
    )

    @property
    def hardly_visible(self) -> bool:
        """Tell whether the size is known to be under HARDLY_VISIBLE_PX."""
        return self.height_px is not None and self.height_px < HARDLY_VISIBLE_PX


class LabelCount(Strict):
    """Labels that lay beside the recording (METHOD 4.5).

    They decide nothing here, so that they may be reviewed afterwards; scoring counts them anew.
    """

    plan: Literal["phase", "clock"]
    per_phase: dict[PhaseWord, Annotated[int, Field(ge=0)]]
    outside_crop: Annotated[int, Field(ge=0)] = 0
    sizes: list[LabelSize] = Field([], description="one of each label, in their order")
    sizes_from: str = Field("", description="whose box was projected, or why none was")

    @property
    def hardly_visible_s(self) -> list[float]:
        """Clip times of the labels at which the critical object is hardly visible."""
        return [one.t_s for one in self.sizes if one.hardly_visible]


class SightEntry(Strict):
    """The share of the critical phases for which something is visible; null: it is not known."""

    fraction: Share | None
    needed: Share
    how: str


class CoverageEntry(Strict):
    """Camera coverage from trigger to resolution."""

    source: Literal["projection", "reviewed", "observed", "none"]
    participants: dict[str, SightEntry] = {}
    zone: SightEntry | None = None
    frames: int = Field(0, description="in that time")
    notes: list[str] = []


class PictureCheck(Strict):
    """One figure of pictures held against states, with the limits that it must keep."""

    name: str = Field(description="what is compared, or the id of an object that is looked for")
    figure: Finite | None = Field(description="null: not judged")
    unit: str = ""
    low: Finite | None = None
    high: Finite | None = None
    judged: Annotated[int, Field(ge=0)] = Field(0, description="pairs of frames it comes from")
    told: str = Field(description="what the figure says, or why there is none")

    @property
    def state(self) -> Literal["holds", "fails", "shown", "not judged"]:
        """Judge the figure by its limits; without limits it is only shown."""
        if self.figure is None:
            return "not judged"
        if self.low is None and self.high is None:
            return "shown"
        is_low = self.low is not None and self.figure < self.low
        is_high = self.high is not None and self.figure > self.high
        return "fails" if is_low or is_high else "holds"

    @property
    def limit(self) -> str:
        """The limits in words; empty where there is no figure."""
        if self.low is not None and self.high is not None:
            return f"{self.low:g} to {self.high:g}{self._unit}"
        if self.low is not None:
            return f"at least {self.low:g}{self._unit}"
        return "" if self.high is None else f"at most {self.high:g}{self._unit}"

    @property
    def _unit(self) -> str:
        return f" {self.unit}" if self.unit else ""


class PicturesEntry(Strict):
    """Checks of a recording's pictures against its states."""

    checks: list[PictureCheck] = []
    note: str = Field("", description="why nothing could be compared; empty where something was")

    @property
    def failing(self) -> list[PictureCheck]:
        """The checks whose figure lies outside its limits."""
        return [check for check in self.checks if check.state == "fails"]


class ChangeEntry(Strict):
    """A difference between what was compiled and what ran."""

    field: str
    old: Any
    new: Any
    logged: bool
    later: bool = Field(False, description="logged after the run, beside the recording")
    who: str | None = None
    when: str | None = None
    reason: str | None = None


class RecordingEntry(Strict):
    """One recording and its verdict.

    ``facts`` are measured quantities with their unit in the name, null where they don't exist;
    ``contradictions`` are between what was recorded during the run and what the states say.
    What lies outside the MCAP file and was read all the same is bound by its hash: verdict.json of
    a session and observation files by their bytes.
    """

    domain: DomainWord
    domain_said_by: str = Field(description="a named person with date and place, or our session")
    name: str
    bag: str
    bag_sha256: str
    origin: str
    stand_in: bool
    evidence: Evidence = Field(description="the weakest source of any property")
    measured_from: str
    scenario: str | None
    event_version: str | None
    task_version: str | None
    verdict: str | None = Field(None, description="of the run; null for an imported video")
    verdict_reasons: list[str] = []
    verdict_sha256: str | None = Field(None, description="of the bag's verdict.json")
    declaration_sha256: str | None = Field(None, description="of the bag's declaration.json")
    labels: LabelCount | None = Field(None, description="null: none beside the bag")
    observations: ObservationsEntry | None = None
    log_said_by: str
    status: Status
    reasons: list[ReasonEntry]
    properties: dict[str, PropertyEntry]
    varying: dict[str, tuple[str, str]] = Field(
        {}, description="topology that may vary: (here, in Synthetic)"
    )
    crop: CropEntry | None = Field(description="null: the recording never began")
    phases: PhasesEntry
    kpr: Share | None
    epd: Finite | None
    coverage: CoverageEntry
    pictures: PicturesEntry | None = Field(None, description="null in audits of earlier builds")
    safety_events: list[str] = []
    identities: list[str] = []
    changes: list[ChangeEntry] = []
    contradictions: list[str] = []
    disclosures: dict[str, str] = {}
    facts: dict[str, Finite | None] = {}


class Audit(Strict):
    """A scenario's three recordings, Synthetic first."""

    schema_: Literal["ssp.audit/2"] = Field(SCHEMA, alias="schema")
    software: str
    scenario: str
    event_version: str | None
    weights: dict[str, float]
    thresholds: dict[str, float | None]
    labels: str | None = Field(
        None, description="labels per phase, and whether domains compare by them (METHOD 4.5)"
    )
    recordings: Annotated[list[RecordingEntry], Field(min_length=3, max_length=3)]
    response: ResponseEntry | None = Field(
        None, description="did the VUT respond alike; null in audits of earlier builds"
    )

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    def contradiction(self) -> str | None:
        """Say why a status doesn't follow from the entries' own values; None: each does.

        An evidence package measures its recordings again instead.
        """
        if [entry.domain for entry in self.recordings] != list(DOMAINS):
            return f"its recordings must be of {', '.join(DOMAINS)}, in this order"
        refused = [
            entry.domain for entry in self.recordings if entry.status == "refused" or entry.reasons
        ]
        for entry in self.recordings:
            against = None
            if (entry.status == "refused") != bool(entry.reasons):
                against = " without a reason" if not entry.reasons else " with reasons against it"
            elif entry.status != "refused" and (entry.status == "unpaired") != bool(refused):
                against = f", though {refused[0] if refused else 'nobody'} is refused"
            elif entry.status != "refused" and (problem := next(self._against(entry), None)):
                against = f", though {problem}"
            if against:
                return f"{entry.domain} is {entry.status}{against}"
        return None

    def _against(self, entry: RecordingEntry) -> Iterator[str]:
        """Yield the values of an entry that keep it out by METHOD 4.4, or contradict the others."""
        synthetic = self.recordings[0]
        same = [other.domain for other in self.recordings if other.bag_sha256 == entry.bag_sha256]
        if same[0] != entry.domain:
            yield f"it is the {same[0]} recording"
        if entry.event_version is None or entry.event_version != self.event_version:
            yield f"it realises {entry.event_version}, the audit is of {self.event_version}"
        if entry.scenario not in (None, self.scenario):
            yield f"it is of {entry.scenario}, the audit is of {self.scenario}"
        if entry.verdict not in (None, "valid"):
            yield f"the run's verdict is {entry.verdict}"
        if incidents := [*entry.safety_events, *entry.identities]:
            yield f"it has {incidents[0]}"
        if unlogged := [change.field for change in entry.changes if not change.logged]:
            yield f"the change of {unlogged[0]} isn't logged"
        if set(entry.properties) != set(FIELDS):
            yield f"its properties aren't {', '.join(FIELDS)}"
        for name, value in entry.properties.items():
            reference = synthetic.properties.get(name)
            apart = reference and differences(
                value.property(entry.varying), reference.property(entry.varying)
            )
            if value.source == "unverified":
                yield f"its {name} is unverified"
            elif value.equal is False or value.differences or apart:
                yield f"its {name} differs"
        yield from self._against_times(entry, synthetic)
        if entry.pictures is not None and (failing := entry.pictures.failing):
            yield f"its pictures differ from its states: {failing[0].told}"
        sights = {**entry.coverage.participants, "the conflict zone": entry.coverage.zone}
        if entry.coverage.source == "none":
            yield "what its camera covers is unknown"
        for who, sight in sights.items():
            if sight and sight.fraction is not None and sight.fraction < sight.needed - _ROUNDING:
                yield f"{who} is visible for {sight.fraction:g}, needed are {sight.needed:g}"

    def _against_times(self, entry: RecordingEntry, synthetic: RecordingEntry) -> Iterator[str]:
        """Yield the contradictions in phases, φ, EPD and KPR."""
        crop, phases = entry.crop, entry.phases
        times = [phases.trigger_s, phases.conflict_s, phases.resolution_s]
        located = [t_s for t_s in times if t_s is not None]
        if crop is None or len(located) < len(times):
            yield "its phases aren't located"
            return
        span = crop.start_s, crop.end_s
        ends = phases.start_s, phases.end_s
        in_order = [span[0], *located, span[1]]
        if ends != span or sorted(in_order) != in_order:
            yield f"its phases at {located} s don't lie in its clip, {span[0]:g} to {span[1]:g} s"
            return
        phi = {k: phase_fraction(t_s, *span) for k, t_s in zip(EVENT_PHASES, located, strict=True)}
        if not _same(phi, phases.phi):
            yield f"its phi is {phases.phi}, and by its phases it is {phi}"
        elif entry.epd is None or set(synthetic.phases.phi) != set(phi):
            # A source clip that is refused, as one of another event, has no phases to differ from.
            if synthetic.status != "refused" or entry.epd is not None:
                yield "its EPD is missing"
        elif not _same({"epd": phase_difference(phi, synthetic.phases.phi)}, {"epd": entry.epd}):
            yield f"its EPD of {entry.epd:g} isn't that of its phi"
        if entry.kpr is not None and entry.kpr < 1.0 - _ROUNDING:
            yield f"its KPR is {entry.kpr:g}"

    @property
    def admitted(self) -> bool:
        """True when all three are."""
        return all(recording.status == "admitted" for recording in self.recordings)


def _same(ours: Mapping[str, float], theirs: Mapping[str, float]) -> bool:
    return ours.keys() == theirs.keys() and all(
        math.isclose(ours[k], theirs[k], rel_tol=_ROUNDING, abs_tol=_ROUNDING) for k in ours
    )


def load_audit(path: str | Path) -> Audit:
    """Read an audit file, or that of a folder.

    Raises:
        InputError: it can't be read, is no valid audit, or gives a status that its own values
            contradict.
    """
    path = Path(path) / AUDIT_FILE if Path(path).is_dir() else Path(path)
    audit = load_model(Audit, path)
    if why := audit.contradiction():
        raise InputError(
            f"contradicts itself: {why}",
            file=path,
            field="recordings",
            remedy="make it again with `ssp audit`",
        )
    return audit
