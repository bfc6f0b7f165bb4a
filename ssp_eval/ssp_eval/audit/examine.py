"""Examines one recording, whoever made it: what it shows, and what is wrong with it (METHOD 4)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from ssp_core.errors import InputError
from ssp_core.run_file.model import ConflictThresholds
from ssp_eval.audit.evidence import (
    Evidence,
    Source,
    Value,
    combined,
    contradictions,
    is_source_clip,
    observed,
    reviewed,
    unknown_source,
)
from ssp_eval.audit.history import examine_history
from ssp_eval.audit.measure import Measured, Phases, Scene, measure
from ssp_eval.audit.reasons import Finding
from ssp_eval.audit.recording import Recording
from ssp_eval.audit.visibility import examine_coverage
from ssp_eval.data.audit import (
    CONFLICT,
    EVENT_PHASES,
    FIELDS,
    MOTION,
    ORDER,
    ROLES,
    TOPOLOGY,
    ChangeEntry,
    CoverageEntry,
    Property,
    differences,
    phase_fraction,
)
from ssp_eval.observations.agreement import Agreement
from ssp_eval.recordings.event import LOCATED_S, Crop, crop_of, rules_of, source_times
from ssp_eval.recordings.sight import Moment
from ssp_eval.recordings.states import STATE_AGE_S
from ssp_scenario_manager.event_spec.extract.questions import GATE_REASONS
from ssp_scenario_manager.event_spec.model import Event, Interval


@dataclass(frozen=True)
class Examined:
    """One recording, examined.

    Args:
        recording: as it was read, within its clip.
        values: q(d, k) per field, with its source.
        phases: None: nobody located any.
        crop: the clip that all of this is of; None: the recording never began.
        phi: φ(d, e) per event that could be located.
        phi_half: half width of φ where a K* gives intervals.
        measured: None without states.
        log_said_by: who says what happened beside the event.
        contradictions: between what was announced and what was measured.
    """

    recording: Recording
    values: Mapping[str, Value]
    phases: Phases | None
    phases_source: Source
    crop: Crop | None
    phi: Mapping[str, float]
    phi_half: Mapping[str, float]
    measured: Measured | None
    findings: tuple[Finding, ...]
    coverage: CoverageEntry
    identities: tuple[str, ...] = ()
    changes: tuple[ChangeEntry, ...] = ()
    log_said_by: str = ""
    contradictions: tuple[str, ...] = ()
    moments: tuple[Moment, ...] = field(default=(), repr=False)

    @property
    def properties(self) -> dict[str, Property]:
        """q(d, k) per field; words are None where it isn't determined."""
        return {name: self.values[name].property for name in FIELDS}

    @property
    def is_verified(self) -> bool:
        """True when every q(d, k) was measured, observed or reviewed."""
        return all(self.values[name].source != "unverified" for name in FIELDS)

    @property
    def evidence(self) -> Source:
        """The weakest source of any q(d, k)."""
        order: tuple[Source, ...] = ("states", "reviewed", "observed", "unverified")
        return max((self.values[name].source for name in FIELDS), key=order.index)


_MIRRORED = {
    "cutting_in_from_left": "cutting_in_from_right",
    "cutting_in_from_right": "cutting_in_from_left",
    "crossing_from_left": "crossing_from_right",
    "crossing_from_right": "crossing_from_left",
}
_OF_LANES = {"vut_lane", "adjacency"}
_CODES = {CONFLICT: "conflict_type_differs", ORDER: "order_differs", MOTION: "motion_differs"}


def property_findings(
    found: Mapping[str, Property],
    wanted: Mapping[str, Property],
    phases: Phases | None,
    first_arrival_s: float | None,
) -> list[Finding]:
    """What of the mandatory properties isn't preserved.

    Args:
        found: q(d, k) of the fields that are verified.
        wanted: what it must be equal to; a field that isn't determined there judges nothing.
        phases: of this recording; None: nobody located any.
        first_arrival_s: at the conflict zone, None: nobody arrives.
    """
    # From when on nothing that happens can change the value.
    decided_s = {
        MOTION: math.inf if phases is None or phases.resolution_s is None else phases.resolution_s,
        CONFLICT: math.inf if first_arrival_s is None else first_arrival_s,
        ORDER: math.inf if first_arrival_s is None else first_arrival_s,
    }
    findings: list[Finding] = []
    for name in FIELDS:
        value, reference = found.get(name), wanted[name]
        if value is None or reference.words is None:
            continue
        if value.words is None:
            code = _CODES.get(name, "topology_differs" if name == TOPOLOGY else "roles_differ")
            findings.append(Finding(code, f"can't be determined: {value.how}", math.inf))
            continue
        parts = differences(value, reference) or {}
        if name == TOPOLOGY:
            findings += _topology(parts)
        elif name == ROLES:
            findings += _roles(parts)
        elif parts:
            findings.append(_one(name, parts, decided_s[name], value.how))
    return findings


def _one(field: str, parts: Mapping[str, tuple[str, str]], decided_s: float, how: str) -> Finding:
    ((ours, theirs),) = parts.values()
    text = f"{ours} instead of {theirs} ({how})"
    if field == MOTION and _MIRRORED.get(theirs) == ours:
        return Finding("wrong_side", text)
    return Finding(_CODES[field], text, decided_s)


def _topology(parts: Mapping[str, tuple[str, str]]) -> list[Finding]:
    findings = []
    for code, names in (
        ("topology_differs", [n for n in parts if n not in _OF_LANES]),
        ("lane_differs", [n for n in parts if n in _OF_LANES]),
    ):
        if names:
            text = "; ".join(f"{n} {parts[n][0]} instead of {parts[n][1]}" for n in names)
            findings.append(Finding(code, text))
    return findings


def _roles(parts: Mapping[str, tuple[str, str]]) -> list[Finding]:
    findings = []
    starts = {name: pair for name, pair in parts.items() if name.endswith(" starts in")}
    if starts:
        text = "; ".join(f"{n} {ours} instead of {theirs}" for n, (ours, theirs) in starts.items())
        findings.append(Finding("place_differs", text, 0.0))
    rest = {name: pair for name, pair in parts.items() if name not in starts}
    if not rest:
        return findings
    text = "; ".join(f"{n}: {ours} instead of {theirs}" for n, (ours, theirs) in rest.items())
    turned = {"initiator", "affected"} <= set(rest) and (
        rest["initiator"] == rest["affected"][::-1]
    )
    people = {n: pair for n, pair in rest.items() if n not in ("initiator", "affected")}
    exchanged = len(people) > 1 and sorted(p[0] for p in people.values()) == sorted(
        p[1] for p in people.values()
    )
    findings.append(Finding("roles_swapped" if turned or exchanged else "roles_differ", text))
    return findings


def phase_findings(phases: Phases, closest: str) -> list[Finding]:
    """Which key phases can't be located, and why.

    Args:
        closest: how near it came to a conflict, for people; empty where nobody measured it.
    """
    findings = []
    never = math.inf
    if not phases.has_approach and phases.trigger_s is not None:
        text = (
            f"{phases.trigger_s - phases.start_s:.2f} s of it lie in the clip, of {LOCATED_S:g} s"
        )
        findings.append(Finding("approach_phase", text, 0.0))
    if not phases.has_resolution and phases.resolution_s is not None:
        text = (
            f"{phases.end_s - phases.resolution_s:.2f} s of it lie in the clip, of {LOCATED_S:g} s"
        )
        findings.append(Finding("resolution_phase", text, phases.resolution_s))
    missing = []
    if phases.trigger_s is None:
        findings.append(
            Finding("no_manoeuvre", "nobody's manoeuvre becomes observable in the clip", never)
        )
        missing = ["trigger", "conflict", "resolution"]
    elif phases.conflict_s is None:
        text = f"after the trigger at {phases.trigger_s:.2f} s {closest or 'nobody saw one'}"
        findings.append(Finding("conflict_missing", text, never))
        missing = ["conflict", "resolution"]
    elif phases.resolution_s is None:
        text = f"it lasts from {phases.conflict_s:.2f} s to the clip's end"
        findings.append(Finding("conflict_unresolved", text, never))
        missing = ["resolution"]
    findings += [
        Finding(f"{phase}_phase", f"the start of the {phase} phase isn't in the clip", never)
        for phase in missing
    ]
    if missing:
        findings.append(
            Finding("epd_missing", f"there is no time of {' and '.join(missing)}", never)
        )
    return findings


# Phases that a run announced and phases measured from states may lie this far apart.
PHASE_TOLERANCE_S = 0.15


def examine(recording: Recording, event: Event | None, version: str | None) -> Examined:
    """What a recording shows by METHOD 4.3, and what is wrong with it by itself.

    Args:
        event: the K* of the audit, None: there is none at hand.

    Raises:
        InputError: its states can't be used at all.
    """
    findings = version_findings(recording, event, version)
    if not recording.frames_s:
        findings.append(Finding("no_video", "the recording has no camera frames", math.inf))
    agreement = recording.agreement
    is_source = is_source_clip(recording, event)
    said: list[Evidence] = []
    crop, measured = _measured(recording, event, is_source)
    if measured is not None:
        by_states = measured.properties, _starts(measured.phases)
        said.append(Evidence("states", recording.source, *by_states))
    if event is not None and is_source:
        evidence, more = reviewed(recording, event)
        said.append(evidence)
        # What isn't reviewed is measured; another crop is another clip whoever looks at it.
        findings += [f for f in more if measured is None or f.code == "other_source"]
    if agreement is not None:
        said.append(observed(agreement))
        findings += _rejections(agreement)
    findings += contradictions(said)
    values = combined(said)
    unverified = [name for name in FIELDS if values[name].source == "unverified"]
    located = next((one for one in said if one.starts is not None), None)
    if unverified or located is None:
        findings.append(_unverified(recording, event, unverified, located is None))
    starts = {} if located is None or located.starts is None else dict(located.starts)
    if crop is None:
        crop = _crop(recording, event, is_source, starts)
    phases = None
    if crop is not None and located is not None:
        phases = Phases(crop.start_s, crop.end_s, *(starts.get(name) for name in EVENT_PHASES))
        closest = (
            ""
            if measured is None
            else _closest(measured, rules_of(event, recording.provenance.run).thresholds)
        )
        findings += phase_findings(phases, closest)
    is_cropped = event is not None and rules_of(event).window is not None
    if crop is None:
        findings.append(Finding("epd_missing", "the recording has no clip", math.inf))
    elif event is not None and not is_cropped:
        text = "the K* doesn't say how long its source's approach and resolution are"
        findings.append(Finding("epd_missing", text, math.inf))
    within = recording if crop is None else recording.within(crop)
    moments = within.moments()
    coverage, blind = examine_coverage(
        within, event, measured, moments, agreement, is_source, phases
    )
    history = examine_history(within, agreement, is_source)
    facts = recording.provenance
    if facts.imported is not None and facts.imported.declaration is None and not is_source:
        text = f"domain: nobody declares that this is {facts.domain}, when and where it was made"
        findings.append(Finding("unverified", text))
    return Examined(
        recording=within,
        values=values,
        phases=phases,
        phases_source="unverified" if located is None else located.source,
        crop=crop,
        phi=_phi(phases) if phases is not None and is_cropped else {},
        phi_half=_half_phi(event, phases)
        if located is not None and located.source == "reviewed"
        else {},
        measured=measured,
        findings=(
            *findings,
            *history.findings,
            *blind,
            *_off_spec(measured, values[ORDER].property, event),
        ),
        coverage=coverage,
        identities=history.identities,
        changes=history.changes,
        log_said_by=history.said_by,
        contradictions=_announced(recording, phases) if measured is not None else (),
        moments=tuple(moments),
    )


def version_findings(
    recording: Recording, event: Event | None, version: str | None
) -> list[Finding]:
    """Whether a recording is of the K* that the audit is of."""
    facts = recording.provenance
    found = [] if facts.run is None else list(recording.attached.findings)
    # One cause, however many of its signs there are.
    other = []
    if version is None:
        found.append(Finding("not_compiled", "there is no K* to hold the recording against"))
    elif facts.event_version is None:
        other.append("the recording names no K* version")
    elif facts.event_version != version:
        other.append(f"it realises {facts.event_version}, the audit is of {version}")
    if event is not None and facts.scenario not in (None, event.name):
        other.append(f"it is of {facts.scenario}, the audit is of {event.name}")
    if other:
        found.append(Finding("other_event", "; ".join(other)))
    task = recording.attached.task
    if task is not None and facts.event_version not in (None, task.event.version):
        found.append(
            Finding(
                "seal_broken",
                f"the run names K* {facts.event_version}, its task {task.event.version}",
            )
        )
    return found


# -- measured -------------------------------------------------------------------------------------


def _measured(
    recording: Recording, event: Event | None, is_source: bool
) -> tuple[Crop | None, Measured | None]:
    """The clip by the states, and what they say within it; None where there are no states."""
    who, (start_s, end_s) = recording.provenance.participants, _covered(recording)
    if who is None or start_s is None or end_s is None or end_s <= start_s or not recording.series:
        return None, None
    rules = rules_of(event, recording.provenance.run)

    def scene(part: Recording, first_s: float, last_s: float) -> Scene:
        return Scene(part.series, who.vut, tuple(who.targets), part.road, first_s, last_s, rules)

    try:
        whole = measure(scene(recording, start_s, end_s))
        crop = (
            _source_crop(recording, event)
            if is_source
            else crop_of(
                start_s, end_s, whole.phases.trigger_s, whole.phases.resolution_s, rules.window
            )
        )
        part = recording.within(crop)
        return crop, measure(scene(part, crop.start_s, crop.end_s))
    except ValueError as error:
        raise InputError(f"can't be measured: {error}", file=recording.path) from error


def _covered(recording: Recording) -> tuple[float | None, float | None]:
    """Where a recording with states begins and ends: a video that goes on without states shows
    nothing that could be measured."""
    start_s, end_s = recording.start_s, recording.end_s
    if start_s is None or end_s is None or not recording.series:
        return start_s, end_s
    first_s, last_s = recording.series[0][0], recording.series[-1][0]
    return (
        first_s if first_s - start_s > STATE_AGE_S else start_s,
        last_s if end_s - last_s > STATE_AGE_S else end_s,
    )


def _source_crop(recording: Recording, event: Event | None) -> Crop:
    """The source clip was cropped when its K* was made; the import holds that crop."""
    at = {} if event is None else source_times(event)
    if {"start", "end"} <= set(at):
        length_s = at["end"].mid - at["start"].mid
        return Crop(0.0, length_s, "the K*'s crop of its source (events.clip)")
    return Crop(
        recording.start_s or 0.0, recording.end_s or 0.0, "the whole clip: the K* names no crop"
    )


def _crop(
    recording: Recording, event: Event | None, is_source: bool, starts: dict[str, float]
) -> Crop | None:
    """The clip of a recording without states."""
    first_s, last_s = recording.start_s, recording.end_s
    if first_s is None or last_s is None or last_s <= first_s:
        return None
    if is_source:
        return _source_crop(recording, event)
    window = rules_of(event).window
    return crop_of(first_s, last_s, starts.get("trigger"), starts.get("resolution"), window)


def _starts(phases: Phases) -> dict[str, float]:
    times = {name: getattr(phases, f"{name}_s") for name in EVENT_PHASES}
    return {name: t_s for name, t_s in times.items() if t_s is not None}


def _closest(measured: Measured, limits: ConflictThresholds) -> str:
    ttc = measured.facts.get("min_ttc_s")
    text = "TTC is never finite" if ttc is None else f"TTC is at least {ttc:.2f} s"
    if limits.ttc_s is not None:
        text += f", not under {limits.ttc_s:g} s"
    if limits.arrival_gap_s is not None:
        text += f", and the arrivals are never within {limits.arrival_gap_s:g} s"
    return text


def _off_spec(measured: Measured | None, order: Property, event: Event | None) -> list[Finding]:
    """METHOD 4.4: time gap and passing order lie in K*'s range where they are determined."""
    if event is None:
        return []
    found = []
    gap_s = None if measured is None else measured.facts.get("time_gap_s")
    wanted = event.constraints.time_gap
    if gap_s is not None and isinstance(wanted, Interval):
        span = wanted.si
        if not span.low - 1e-9 <= gap_s <= span.high + 1e-9:
            text = f"time gap {gap_s:.2f} s, K* has {span.low:g} to {span.high:g} s"
            found.append(Finding("off_spec", text))
    if order.words is not None:
        wanted_order = " before ".join(event.interaction.passing_order)
        if wanted_order not in order.words["order"]:
            text = f"passing order {' or '.join(order.words['order'])}, K* has {wanted_order}"
            found.append(Finding("off_spec", text))
    return found


# -- said by persons ------------------------------------------------------------------------------


def _rejections(agreement: Agreement) -> list[Finding]:
    """The five reasons of the source gate (METHOD 1), as persons saw them."""
    return [
        Finding("source_rejected", f"{GATE_REASONS[reason]}, as {agreement.by} saw")
        for reason in agreement.answers.rejections()
    ]


def _unverified(
    recording: Recording, event: Event | None, fields: Sequence[str], no_phases: bool
) -> Finding:
    """One finding for all that nobody vouches for, with what would mend it."""
    missing = [name.replace("_", " ") for name in fields] + (["phases"] if no_phases else [])
    why = ["no road is bound to it" if recording.series else "it has no states"]
    agreement = recording.agreement
    if agreement is None:
        why.append("nobody observed it (`ssp audit observe`)")
    elif agreement.differing:
        why.append(f"{agreement.by} differ in {', '.join(agreement.differing)}")
    else:
        why.append(f"{agreement.by} couldn't tell")
    if (unknown := unknown_source(recording, event)) is not None:
        why.append(unknown)
    return Finding("unverified", f"{', '.join(missing)}: {'; '.join(why)}")


# -- phases ---------------------------------------------------------------------------------------


def _phi(phases: Phases) -> dict[str, float]:
    return {
        name: phase_fraction(t_s, phases.start_s, phases.end_s)
        for name, t_s in _starts(phases).items()
        if phases.start_s <= t_s <= phases.end_s
    }


def _half_phi(event: Event | None, phases: Phases | None) -> dict[str, float]:
    if event is None or phases is None:
        return {}
    length_s, at = phases.end_s - phases.start_s, source_times(event)
    halves_s = {name: (at[name].high - at[name].low) / 2.0 for name in EVENT_PHASES if name in at}
    return {name: min(1.0, half_s / length_s) for name, half_s in halves_s.items() if half_s > 0.0}


def _announced(recording: Recording, phases: Phases | None) -> tuple[str, ...]:
    """Where the phases that the run announced aren't the ones that its states show."""
    found = []
    for name in EVENT_PHASES:
        said = recording.phase_events.get(name)
        measured = None if phases is None else getattr(phases, f"{name}_s")
        if said is None and (measured is None or recording.provenance.run is None):
            continue
        if said is None or measured is None:
            who = "the run announced" if measured is None else "the states show"
            other = "the states don't show it" if measured is None else "the run didn't announce it"
            t_s = said if measured is None else measured
            found.append(f"{who} the {name} at {t_s:.2f} s, {other}")
        elif abs(said - measured) > PHASE_TOLERANCE_S:
            found.append(
                f"the run announced the {name} at {said:.2f} s, the states show it at "
                f"{measured:.2f} s"
            )
    return tuple(found)
