"""Three recordings of one event: KPR, EPD, disclosures, and a verdict for each (METHOD 4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from datetime import datetime
from pathlib import Path

from ssp_core import __version__
from ssp_core.bag.reading.reader import BagReader
from ssp_core.bag.seals.declaration import written_topics
from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_core.vocabulary import DOMAINS
from ssp_eval.audit.checks import property_findings
from ssp_eval.audit.doubles import TRACKS, hold_apart
from ssp_eval.audit.evidence.evidence import expected_properties, outside_ranges, varying_parts
from ssp_eval.audit.evidence.measure import Phases
from ssp_eval.audit.evidence.reasons import Finding, Reason, explain
from ssp_eval.audit.evidence.recording import Head, Recording, disclosed, read_head, read_recording
from ssp_eval.audit.evidence.visibility import label_sizes
from ssp_eval.audit.examine import Examination, examine
from ssp_eval.audit.server import server_disclosures
from ssp_eval.data.audit import (
    EVENT_PHASES,
    FIELDS,
    TOPOLOGY,
    Audit,
    LabelCount,
    ObservationsEntry,
    PhasesEntry,
    Property,
    PropertyEntry,
    RecordingEntry,
    Status,
    differences,
    is_equal,
    phase_difference,
    property_retention,
)
from ssp_eval.data.labels import compare_labels, phase_counts
from ssp_eval.data.provenance import Provenance, bag_folder
from ssp_eval.data.response import ResponseLimits
from ssp_eval.recordings.event import rules_of
from ssp_eval.recordings.noise import noise_text, step_noises_m
from ssp_eval.response.compare import load_limits, respond
from ssp_eval.response.drive import Drive, drive_of, no_drive
from ssp_scenario_manager.compile.compiler import LOGGED_AS
from ssp_scenario_manager.event_spec.load import event_version
from ssp_scenario_manager.event_spec.log import Record
from ssp_scenario_manager.event_spec.model import Event

RENDERER = "renderer"
ACCEPTED = "accepted at import"
NO_RENDERER = "none is known"


def disclosures(one: Examination) -> dict[str, str]:
    """Return renderer, local speed, tracking error, disturbance, camera, look, log's additions."""
    recording, run = one.recording, one.recording.provenance.run
    texts: dict[str, str] = {RENDERER: recording.provenance.renderer or NO_RENDERER}
    texts["seal"] = recording.provenance.seal
    if one.crop is not None and one.crop.shortfall:
        texts["clip"] = f"{one.crop.shortfall}: the recording holds no more"
    texts |= _local_speed(one)
    who = recording.provenance.participants
    noises_m = {} if who is None else step_noises_m(recording.sightings, who.ids)
    if noises_m:
        texts["noise of states, per step"] = noise_text(noises_m)
    if run is None:
        return texts | _of_import(recording.provenance)
    texts["site"] = f"{run.site}, {run.mode}, seed {run.seed}"
    if gone := _left_out(recording):
        texts["topics that were left out"] = ", ".join(gone)
    if recording.provenance.stand_in:
        texts["stand-in"] = "software stands in for vehicles on a track"
    if recording.provenance.participation is not None:
        texts["participants"] = recording.provenance.participation.text
    for name, (along_m, aside_m) in recording.tracking_m.items():
        texts[f"tracking error of {name}"] = (
            f"at most {along_m:.2f} m along and {aside_m:.2f} m beside its reference"
        )
    link = run.disturbance
    if link != type(link)():
        texts["communication"] = (
            f"states {1000 * link.state_delay_s:.0f} ms late, {100 * link.state_loss:.1f} % lost, "
            f"noise {link.position_noise_m:g} m and {link.speed_noise_mps:g} m/s"
        )
        if not math.isclose(link.actuator_lag_scale, 1.0):
            texts["actuators"] = f"lag times {link.actuator_lag_scale:g}"
    if run.camera is not None:
        camera = run.camera
        texts["camera"] = (
            f"{camera.width_px} x {camera.height_px} px, {camera.hfov_deg:g} degrees, "
            f"{camera.rate_hz:g} Hz"
        )
    texts["look"] = f"palette {run.look.palette}"
    texts |= server_disclosures(recording.provenance)
    attached = recording.attached
    return {
        **texts,
        **disclosed(attached),
        **order_remark([*attached.records, *attached.later]),
    }


def _left_out(recording: Recording) -> list[str]:
    """List the topics that the session's recorder wrote and its bag lacks."""
    with BagReader(recording.path) as bag:
        return sorted(written_topics(bag) - set(bag.topics))


def shared_renderers(
    disclosure_texts: Sequence[Mapping[str, str]], domains: Sequence[str]
) -> list[str]:
    """Name for each recording the other domains drawn by the same renderer; empty: none."""
    renderers = [one[RENDERER] for one in disclosure_texts]
    return [
        ", ".join(
            other
            for other, by in zip(domains, renderers, strict=True)
            if other != domain and by == mine and mine != NO_RENDERER
        )
        for domain, mine in zip(domains, renderers, strict=True)
    ]


def _of_import(facts: Provenance) -> dict[str, str]:
    imported = facts.imported
    texts = {"source": facts.origin, "camera": f"{facts.camera}, ego motion {facts.ego}"}
    if imported is None:
        return texts
    source = imported.source
    if "width_px" in source:
        texts["picture"] = (
            f"{source['width_px']} x {source['height_px']} px at {source['fps']:g} Hz"
        )
    if imported.site is not None:
        texts["site"] = f"{imported.site.name}, {imported.site.block}"
    if imported.states is not None and imported.states.notes:
        texts["states"] = "; ".join(imported.states.notes)
    if imported.notes:
        texts["frames"] = "; ".join(imported.notes)
    if imported.accepted:
        texts[ACCEPTED] = imported.accepted_text
    return texts


def _local_speed(one: Examination) -> dict[str, str]:
    if one.measured is None:
        return {}
    facts = one.measured.facts
    speeds = [
        f"{who} {facts[key]:.1f} m/s"
        for who, key in (("VUT", "vut_speed_at_trigger_mps"), ("OT", "ot_speed_at_trigger_mps"))
        if facts.get(key) is not None
    ]
    return {"local speed": f"at the trigger {', '.join(speeds)}"} if speeds else {}


def order_remark(records: Iterable[Record]) -> dict[str, str]:
    """Return a remark on log entries that are dated before an entry above them.

    A log is only appended to, so such a time was typed wrongly, or a clock was. The compiler's
    entries carry a fixed time (docs/log.md) and are not judged.

    Args:
        records: one log, in the order in which its entries were appended.

    Returns:
        Empty, or one text under ``times in the log``.
    """
    newest: Record | None = None
    remarks = []
    for number, record in enumerate(records, start=1):
        if newest is not None and _time(record) < _time(newest) and record.who != LOGGED_AS:
            remarks.append(
                f"entry {number} ({record.field or record.kind}, {record.who}) says "
                f"{record.when}, and one above it {newest.when}"
            )
        if newest is None or _time(record) > _time(newest):
            newest = record
    return {"times in the log": "; ".join(remarks)} if remarks else {}


def _time(record: Record) -> datetime:
    return datetime.fromisoformat(record.when)


@dataclass(frozen=True)
class Judgement:
    """An audit with what its page needs besides."""

    audit: Audit
    examined: tuple[Examination, ...]


def check_domains(recordings: Sequence[Head | Recording]) -> None:
    """Check that the three recordings are Synthetic, Simulation and Physical, in this order.

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


def find_event(recordings: Sequence[Head | Recording]) -> Event | None:
    """Return the K* in a recording: the simulation's, else another's; None: none has one."""
    by_domain = {r.provenance.domain: r.attached.event for r in recordings}
    events = [by_domain.get(domain) for domain in ("simulation", "physical", "synthetic")]
    return next((event for event in events if event is not None), None)


def judge(
    recordings: Sequence[Recording],
    event: Event | None = None,
    limits: ResponseLimits | None = None,
    on_measured: Callable[[], None] = lambda: None,
) -> Judgement:
    """Audit three recordings that were read.

    Args:
        recordings: Synthetic, Simulation, Physical.
        event: the K*; None: the one that the recordings carry.
        limits: of responses that count as alike; None: the shipped ones.
        on_measured: is called after each recording.

    Raises:
        InputError: they aren't of these domains, or states can't be used at all.
    """
    check_domains(recordings)
    event = event or find_event(recordings)
    version = None if event is None else event_version(event)
    examined = []
    for recording in recordings:
        examined.append(examine(recording, event, version))
        on_measured()
    return _compare(tuple(examined), event, version, limits)


def judge_files(
    paths: Sequence[Path],
    event: Event | None = None,
    limits: ResponseLimits | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> Judgement:
    """Audit three recordings as ``judge`` does, with the states of one of them in memory at a time.

    Args:
        paths: bag directories or run folders of Synthetic, Simulation, Physical.
        event: the K*; None: that of a recording, see find_event.
        limits: of the VUT's response; None: those that ship with the package.
        on_step: is called six times: when what a recording is was read, and when it was examined.
    """
    heads = []
    for path in paths:
        heads.append(read_head(path))
        on_step()
    check_domains(heads)
    event = event or find_event(heads)
    version = None if event is None else event_version(event)
    examined = []
    for head in heads:
        examined.append(examine(read_recording(head.path, head), event, version))
        on_step()
    return _compare(tuple(examined), event, version, limits)


def _compare(
    examined: tuple[Examination, ...],
    event: Event | None,
    version: str | None,
    limits: ResponseLimits | None,
) -> Judgement:
    recordings = [one.whole for one in examined]
    varying = frozenset() if event is None else varying_parts(event)
    counted = [_without(one.properties, varying) for one in examined]
    event_properties: Mapping[str, Property] = {} if event is None else expected_properties(event)
    unknown = Property(None, "neither Synthetic nor a K* says")
    requirements = _without(
        {field: event_properties.get(field, unknown) for field in FIELDS}, varying
    )
    synthetic = _with_event_words(counted[0], requirements)
    # Where nobody verified Synthetic's value, what the K* wants is at least no other event.
    reference = {k: requirements[k] if synthetic[k].words is None else synthetic[k] for k in FIELDS}
    weights = {} if event is None else {str(k): w for k, w in event.constraints.weights.items()}
    reasons = []
    apart = hold_apart(examined)
    for index, (one, same) in enumerate(zip(examined, apart, strict=True)):
        verified = {k: q for k, q in counted[index].items() if one.values[k].source != "unverified"}
        arrival_s = None if one.measured is None else one.measured.first_arrival_s
        # Synthetic is held against the K*; against itself it would always do.
        standard = reference if index else requirements
        differing = property_findings(verified, standard, one.phases, arrival_s)
        outside = []
        if event is not None and one.is_verified:
            outside = outside_ranges(event, one.properties[TOPOLOGY])
        if outside:
            differing.append(Finding("topology_differs", "; ".join(outside)))
        reasons.append(explain([*one.findings, *differing, *same.findings]))
    refused = [bool(of_one) for of_one in reasons]
    entries = []
    for index, one in enumerate(examined):
        status: Status = "admitted"
        if refused[index]:
            status = "refused"
        elif any(refused):
            status = "unpaired"
        compared = QuantityPair(counted[index], synthetic, index == 0)
        entries.append(_entry(one, examined[0], compared, varying, weights, status, reasons[index]))
    shared = shared_renderers([e.disclosures for e in entries], [e.domain for e in entries])
    entries = [
        _disclosing(entry, {"shares its renderer with": others, TRACKS: same.tracks})
        for entry, others, same in zip(entries, shared, apart, strict=True)
    ]
    labelled = {r.provenance.domain: r.labels for r in recordings if r.labels is not None}
    thresholds = None if event is None else rules_of(event).thresholds
    audit = Audit(
        software=f"ssp {__version__}",
        scenario=_scenario(recordings, event),
        event_version=version,
        weights={field: weights.get(field, 1.0) for field in FIELDS},
        thresholds={} if thresholds is None else thresholds.model_dump(),
        labels=compare_labels(labelled).line if labelled else None,
        recordings=entries,
        response=respond([_drive(one) for one in examined], limits or load_limits()),
    )
    return Judgement(audit, examined)


def _disclosing(entry: RecordingEntry, more: Mapping[str, str]) -> RecordingEntry:
    """Return the entry with further disclosures; empty ones are left out."""
    texts = {name: text for name, text in more.items() if text}
    return entry.model_copy(update={"disclosures": entry.disclosures | texts})


def _drive(one: Examination) -> Drive:
    """Measure the response of a recording's VUT to the OT of its event, within the clip."""
    who, measured = one.recording.provenance.participants, one.measured
    if who is None or measured is None:
        return no_drive()
    parts = {measured.initiator, measured.affected} - {who.vut}
    other = next((name for name in who.targets if name in parts), None)
    trigger_s = None if one.phases is None else one.phases.trigger_s
    return drive_of(one.recording.series, who.vut, other, trigger_s)


def _scenario(recordings: Sequence[Recording], event: Event | None) -> str:
    if event is not None:
        return event.name
    return next((r.provenance.scenario for r in recordings if r.provenance.scenario), "unknown")


@dataclass(frozen=True)
class QuantityPair:
    """q(d, k) and q(Syn, k) without what may vary (METHOD 4.2)."""

    measured: Mapping[str, Property]
    reference: Mapping[str, Property]
    is_reference: bool


def _without(properties: Mapping[str, Property], varying: frozenset[str]) -> dict[str, Property]:
    return {k: q.without(varying) if k == TOPOLOGY else q for k, q in properties.items()}


def _with_event_words(
    synthetic: Mapping[str, Property], requirements: Mapping[str, Property]
) -> dict[str, Property]:
    """Return q(Syn, k) with those of its words that mean the same there replaced by the K*'s.

    The only lane of a road is its rightmost and its leftmost; a lane of several isn't.
    """
    properties = {}
    for field, value in synthetic.items():
        event_words = requirements[field].words or {}
        words = value.words and {
            part: tuple(w for w in ours if w in event_words.get(part, ())) or ours
            for part, ours in value.words.items()
        }
        properties[field] = Property(words, value.how)
    return properties


def _entry(
    one: Examination,
    synthetic: Examination,
    compared: QuantityPair,
    varying: frozenset[str],
    weights: Mapping[str, float],
    status: Status,
    reasons: Sequence[Reason],
) -> RecordingEntry:
    recording, facts = one.recording, one.recording.provenance
    task = recording.attached.task
    is_verified = one.is_verified and synthetic.is_verified
    return RecordingEntry.model_validate(
        {
            "domain": facts.domain,
            "domain_said_by": "the source clip of the K*"
            if "reviewed" in (one.phases_source, *(v.source for v in one.values.values()))
            else facts.domain_said_by,
            "name": _name(recording),
            "bag": str(recording.path),
            "bag_sha256": facts.bag_sha256,
            "origin": facts.origin,
            "stand_in": facts.stand_in,
            "evidence": one.evidence,
            "measured_from": "; ".join(dict.fromkeys(v.origin for v in one.values.values())),
            "scenario": facts.scenario,
            "event_version": facts.event_version,
            "task_version": None if task is None else task.version,
            "verdict": facts.verdict,
            "verdict_reasons": list(facts.verdict_reasons),
            "verdict_sha256": facts.verdict_sha256,
            "declaration_sha256": facts.declaration_sha256,
            "labels": _labels(one),
            "observations": _observations(recording),
            "log_said_by": one.history.source,
            "status": status,
            "reasons": [
                {**reason.finding.entry, "consequences": [c.entry for c in reason.consequences]}
                for reason in reasons
            ],
            "properties": {field: _property(one, compared, field) for field in FIELDS},
            "varying": _varying(one, synthetic, varying),
            "crop": None if one.crop is None else asdict(one.crop),
            "phases": _phases(one),
            "kpr": _kpr(compared, weights) if is_verified else None,
            "epd": _epd(one, synthetic) if is_verified else None,
            "coverage": one.coverage,
            "pictures": one.pictures.entry,
            "safety_events": [event.text for event in recording.safety],
            "identities": list(one.history.identities),
            "changes": list(one.history.changes),
            "contradictions": list(one.contradictions),
            "disclosures": disclosures(one),
            "facts": {} if one.measured is None else dict(one.measured.facts),
        }
    )


def _name(recording: Recording) -> str:
    """Name a recording by its bag, or by the run's folder where all bags have one name."""
    folder = bag_folder(recording.path.absolute())
    return folder.parent.name if folder.name == "bag" else folder.name


def _property(one: Examination, compared: QuantityPair, field: str) -> PropertyEntry:
    value = one.values[field]
    parts = differences(compared.measured[field], compared.reference[field])
    is_comparable = not compared.is_reference and parts is not None
    words = value.property.words
    return PropertyEntry(
        source=value.source,
        said_by=value.origin,
        words=None if words is None else {k: list(v) for k, v in words.items()},
        how=value.property.how,
        equal=is_equal(compared.measured[field], compared.reference[field])
        if is_comparable
        else None,
        differences=parts if is_comparable and parts else {},
    )


def _varying(
    one: Examination, synthetic: Examination, varying: frozenset[str]
) -> dict[str, tuple[str, str]]:
    """Return how the topology may differ, here and in Synthetic (METHOD 4.2)."""
    here = one.properties[TOPOLOGY].words or {}
    there = synthetic.properties[TOPOLOGY].words or {}
    return {
        part: (" or ".join(here.get(part, ("–",))), " or ".join(there.get(part, ("–",))))
        for part in sorted(varying)
        if part in here or part in there
    }


def _observations(recording: Recording) -> ObservationsEntry | None:
    agreement = recording.agreement
    if agreement is None:
        return None
    return ObservationsEntry(
        observers=list(agreement.observers),
        files={file.name: sha256_file(file) for file in recording.observation_files},
        tolerance_s=agreement.tolerance_s,
        rows=list(agreement.rows),
    )


def _labels(one: Examination) -> LabelCount | None:
    labels, crop = one.recording.labels, one.crop
    if labels is None:
        return None
    outside = 0 if crop is None else sum(not crop.holds(x.t_s) for x in labels.labels)
    sizes, sizes_from = label_sizes(one)
    return LabelCount(
        plan=labels.plan,
        per_phase=phase_counts(labels),
        outside_crop=outside,
        sizes=sizes,
        sizes_from=sizes_from,
    )


def _phases(one: Examination) -> PhasesEntry:
    names = [field.name for field in fields(Phases)]
    times = dict.fromkeys(names) if one.phases is None else asdict(one.phases)
    return PhasesEntry(
        source=one.phases_source, phi=dict(one.phi), phi_half_width=dict(one.phi_half), **times
    )


def _kpr(compared: QuantityPair, weights: Mapping[str, float]) -> float | None:
    """Compute the KPR; None where Synthetic lacks a property: there is none to retain."""
    if any(compared.reference[field].words is None for field in FIELDS):
        return None
    try:
        return property_retention(compared.measured, compared.reference, weights)
    except ValueError:  # the K*'s weights sum to 0
        return None


def _epd(one: Examination, synthetic: Examination) -> float | None:
    if set(one.phi) != set(EVENT_PHASES) or set(synthetic.phi) != set(EVENT_PHASES):
        return None
    return phase_difference(one.phi, synthetic.phi)
