"""``ssp.audit/2``: what an audit found, as a file; evaluation and evidence packages read it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import ConfigDict, Field, model_validator

from ssp_core.files import load_model
from ssp_core.run_spec import Finite, NonNegative, Strict
from ssp_core.vocab import DomainWord, PhaseWord

SCHEMA: Literal["ssp.audit/2"] = "ssp.audit/2"
AUDIT_FILE = "audit.json"
PAGE_FILE = "audit.html"

Status = Literal["admitted", "refused", "unpaired"]
Evidence = Literal["states", "reviewed", "observed", "unverified"]
Share = Annotated[float, Field(ge=0, le=1)]


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
    """What persons wrote down of a recording, in files beside its bag."""

    observers: Annotated[list[str], Field(min_length=1)]
    files: dict[str, str] = Field(description="SHA-256 of each file")
    tolerance_s: Finite = Field(description="of times")
    rows: list[AgreementEntry]


class LabelCount(Strict):
    """Labels that lay beside the recording (METHOD 4.5). They decide nothing here, so that they may
    be reviewed afterwards; whoever scores with them counts them anew."""

    plan: Literal["phase", "clock"]
    per_phase: dict[PhaseWord, Annotated[int, Field(ge=0)]]
    outside_crop: Annotated[int, Field(ge=0)] = 0


class SightEntry(Strict):
    """How much of the critical phases something is visible for; null: nobody can say."""

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

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    @model_validator(mode="after")
    def _check_statuses(self) -> Self:
        """A status is what the findings say, so that a verdict alone can't be rewritten."""
        refused = [entry.domain for entry in self.recordings if entry.status == "refused"]
        for entry in self.recordings:
            if (entry.status == "refused") != bool(entry.reasons):
                why = "without a reason" if entry.status == "refused" else "with reasons against it"
                raise ValueError(f"{entry.domain} is {entry.status} {why}")
            if entry.status != "admitted":
                continue
            if refused:
                raise ValueError(f"{entry.domain} is admitted, though {refused[0]} is refused")
            if unsaid := [k for k, q in entry.properties.items() if q.source == "unverified"]:
                raise ValueError(
                    f"{entry.domain} is admitted, though its {unsaid[0]} is unverified"
                )
            if differing := [k for k, found in entry.properties.items() if found.equal is False]:
                raise ValueError(f"{entry.domain} is admitted, though its {differing[0]} differs")
        return self

    @property
    def admitted(self) -> bool:
        """True when all three are."""
        return all(recording.status == "admitted" for recording in self.recordings)


def load_audit(path: str | Path) -> Audit:
    """Reads an audit file, or that of a folder.

    Raises:
        InputError: it can't be read or is no valid audit.
    """
    path = Path(path)
    return load_model(Audit, path / AUDIT_FILE if path.is_dir() else path)
