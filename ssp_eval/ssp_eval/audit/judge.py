"""Three recordings of one event: KPR, EPD, and a verdict for each (METHOD 4)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ssp_core import __version__
from ssp_core.errors import InputError
from ssp_core.vocab import DOMAINS
from ssp_eval.audit.compare import property_findings
from ssp_eval.audit.disclosures import disclosures
from ssp_eval.audit.examined import Examined
from ssp_eval.audit.expected import expected_properties
from ssp_eval.audit.imported import examine_video
from ssp_eval.audit.model import (
    Audit,
    FindingEntry,
    PhasesEntry,
    PropertyEntry,
    ReasonEntry,
    RecordingEntry,
    Status,
)
from ssp_eval.audit.ratios import phase_difference, property_retention
from ssp_eval.audit.reasons import Finding, Reason, explain
from ssp_eval.audit.recording import Recording
from ssp_eval.audit.session import examine_session
from ssp_eval.labels.model import labels_version
from ssp_eval.recordings.event_rules import event_thresholds
from ssp_eval.recordings.properties import EVENT_PHASES, FIELDS, Property, differences, is_equal
from ssp_eval.recordings.provenance import bag_folder
from ssp_scenario_manager.spec.load import event_version
from ssp_scenario_manager.spec.model import Event


@dataclass(frozen=True)
class Judged:
    """An audit with what its page needs besides.

    Args:
        audit: as it is written.
        examined: per domain, in the order of the audit.
    """

    audit: Audit
    examined: tuple[Examined, ...]


def check_domains(recordings: Sequence[Recording]) -> None:
    """The three recordings must be Synthetic, Simulation and Physical, in this order.

    Raises:
        InputError: one is of another domain.
    """
    for recording, domain in zip(recordings, DOMAINS, strict=True):
        if recording.provenance.domain != domain:
            raise InputError(
                f"is of the domain {recording.provenance.domain}, in its place stands {domain}",
                file=recording.path,
                remedy="give the recordings in the order SYN SIM PHY",
            )


def find_event(recordings: Sequence[Recording]) -> Event | None:
    """The K* that a recording carries: the simulation's, else the others'; None: none does."""
    by_domain = {r.provenance.domain: r.attached.event for r in recordings}
    found = [by_domain.get(domain) for domain in ("simulation", "physical", "synthetic")]
    return next((event for event in found if event is not None), None)


def judge(recordings: Sequence[Recording], event: Event | None = None) -> Judged:
    """Audits three recordings.

    Args:
        recordings: Synthetic, Simulation, Physical.
        event: the K*; None: the one that the recordings carry.

    Raises:
        InputError: they aren't of these domains, or states can't be used at all.
    """
    check_domains(recordings)
    event = event or find_event(recordings)
    version = None if event is None else event_version(event)
    examined = tuple(_examine(recording, event, version) for recording in recordings)
    reference = _reference(examined[0], event)
    weights = {} if event is None else {str(k): w for k, w in event.constraints.weights.items()}
    # Measured states of Synthetic are held against the K*; against themselves they would always do.
    wanted = [_wanted(event), reference, reference]
    pairs = zip(examined, wanted, strict=True)
    reasons = [explain(_findings(one, properties)) for one, properties in pairs]
    refused = [bool(found) for found in reasons]
    entries = []
    for index, one in enumerate(examined):
        status: Status = "admitted"
        if refused[index]:
            status = "refused"
        elif any(refused):
            status = "unpaired"
        entries.append(_entry(one, examined[0], weights, status, reasons[index]))
    thresholds = None if event is None else event_thresholds(event)
    audit = Audit(
        software=f"ssp {__version__}",
        scenario=_scenario(recordings, event),
        event_version=version,
        weights={field: weights.get(field, 1.0) for field in FIELDS},
        thresholds={} if thresholds is None else thresholds.model_dump(),
        recordings=entries,
    )
    return Judged(audit, examined)


def _examine(recording: Recording, event: Event | None, version: str | None) -> Examined:
    run = recording.provenance.run
    if run is None:
        return examine_video(recording, event, version)
    return examine_session(recording, run, event, version)


def _scenario(recordings: Sequence[Recording], event: Event | None) -> str:
    if event is not None:
        return event.name
    return next((r.provenance.scenario for r in recordings if r.provenance.scenario), "unknown")


def _reference(synthetic: Examined, event: Event | None) -> dict[str, Property]:
    """q(Syn, k), and where Synthetic doesn't have it the K*'s."""
    wanted = _wanted(event)
    return {
        field: synthetic.properties[field]
        if synthetic.properties[field].words is not None
        else wanted[field]
        for field in FIELDS
    }


def _wanted(event: Event | None) -> dict[str, Property]:
    """The K*'s own q."""
    wanted: Mapping[str, Property] = {} if event is None else expected_properties(event)
    unknown = Property(None, "neither Synthetic nor a K* says")
    return {field: wanted.get(field, unknown) for field in FIELDS}


def _findings(one: Examined, reference: Mapping[str, Property]) -> list[Finding]:
    found = list(one.findings)
    if one.measured is None:
        return found
    phases, arrival_s = one.measured.phases, one.measured.first_arrival_s
    return found + property_findings(one.properties, reference, phases, arrival_s)


def _entry(
    one: Examined,
    synthetic: Examined,
    weights: Mapping[str, float],
    status: Status,
    reasons: Sequence[Reason],
) -> RecordingEntry:
    recording, facts = one.recording, one.recording.provenance
    is_reference = one is synthetic
    task = recording.attached.task
    return RecordingEntry.model_validate(
        {
            "domain": facts.domain,
            "name": _name(recording),
            "bag": str(recording.path),
            "bag_sha256": facts.bag_sha256,
            "origin": facts.origin,
            "stand_in": facts.stand_in,
            "evidence": "reviewed" if facts.run is None else "states",
            "measured_from": _source(one),
            "scenario": facts.scenario,
            "event_version": facts.event_version,
            "task_version": None if task is None else task.version,
            "verdict": facts.verdict,
            "verdict_reasons": list(facts.verdict_reasons),
            "verdict_sha256": facts.verdict_sha256,
            "labels_sha256": None if recording.labels is None else labels_version(recording.labels),
            "status": status,
            "reasons": [_reason(reason) for reason in reasons],
            "properties": {
                field: _property(one.properties[field], synthetic.properties[field], is_reference)
                for field in FIELDS
            },
            "phases": _phases(one),
            "kpr": _kpr(one, synthetic, weights),
            "epd": _epd(one, synthetic),
            "coverage": one.coverage,
            "safety_events": [event.text for event in recording.safety],
            "identities": list(one.identities),
            "changes": list(one.changes),
            "contradictions": list(one.contradictions),
            "disclosures": disclosures(one),
            "facts": {} if one.measured is None else dict(one.measured.facts),
        }
    )


def _name(recording: Recording) -> str:
    """Of the bag; of the run's folder where all bags have one name."""
    folder = bag_folder(recording.path.absolute())
    return folder.parent.name if folder.name == "bag" else folder.name


def _source(one: Examined) -> str:
    recording = one.recording
    if recording.provenance.run is not None:
        return recording.source
    labels = recording.labels_file
    return "the reviewed K*" + (f" and {labels.name}" if labels is not None else ", without labels")


def _reason(reason: Reason) -> ReasonEntry:
    def plain(finding: Finding) -> dict[str, str]:
        return {"code": finding.code, "text": finding.text, "detail": finding.detail}

    return ReasonEntry(
        **plain(reason.finding),
        consequences=[FindingEntry(**plain(found)) for found in reason.consequences],
    )


def _property(found: Property, reference: Property, is_reference: bool) -> PropertyEntry:
    parts = differences(found, reference)
    known = not is_reference and parts is not None
    return PropertyEntry(
        words=None if found.words is None else {k: list(v) for k, v in found.words.items()},
        how=found.how,
        equal=is_equal(found, reference) if known else None,
        differences=parts if known and parts else {},
    )


def _phases(one: Examined) -> PhasesEntry:
    phases = one.phases
    return PhasesEntry(
        source="reviewed" if one.recording.provenance.run is None else "states",
        start_s=None if phases is None else phases.start_s,
        end_s=None if phases is None else phases.end_s,
        trigger_s=None if phases is None else phases.trigger_s,
        conflict_s=None if phases is None else phases.conflict_s,
        resolution_s=None if phases is None else phases.resolution_s,
        phi=dict(one.phi),
        phi_half_width=dict(one.phi_half),
    )


def _kpr(one: Examined, synthetic: Examined, weights: Mapping[str, float]) -> float | None:
    """None where Synthetic's own properties aren't all known: then there is nothing to retain."""
    if any(synthetic.properties[field].words is None for field in FIELDS):
        return None
    try:
        return property_retention(one.properties, synthetic.properties, weights)
    except ValueError:  # the K*'s weights sum to 0
        return None


def _epd(one: Examined, synthetic: Examined) -> float | None:
    if set(one.phi) != set(EVENT_PHASES) or set(synthetic.phi) != set(EVENT_PHASES):
        return None
    return phase_difference(one.phi, synthetic.phi)
