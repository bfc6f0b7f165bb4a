"""Examines the recording of a session: everything is measured from its states (METHOD 4)."""

from __future__ import annotations

import math
import statistics
from dataclasses import replace
from itertools import pairwise

from ssp_core.errors import InputError
from ssp_core.run_spec import RunSpec
from ssp_core.safety_codes import SafetyCode
from ssp_eval.audit.changes import site_changes
from ssp_eval.audit.compare import phase_findings
from ssp_eval.audit.coverage import Moment, object_sight, zone_sight
from ssp_eval.audit.examined import Examined, version_findings
from ssp_eval.audit.identity import find_switches
from ssp_eval.audit.measure import Measured, Phases, Scene, measure
from ssp_eval.audit.model import CoverageEntry, SightEntry
from ssp_eval.audit.ratios import phase_fraction
from ssp_eval.audit.reasons import Finding
from ssp_eval.audit.recording import Recording
from ssp_eval.recordings.event_rules import event_observable, event_thresholds
from ssp_eval.recordings.properties import EVENT_PHASES, FIELDS, Property
from ssp_eval.recordings.provenance import NO_VERDICT
from ssp_scenario_manager.spec.model import Event

# The session waits for these events; that they stay away is a consequence of what the states say.
_AWAITED = (SafetyCode.EVENT_MISSING, SafetyCode.DURATION)
# Phases that a run announced and phases measured from states may lie this far apart.
PHASE_TOLERANCE_S = 0.15


def examine_session(
    recording: Recording, run: RunSpec, event: Event | None, version: str | None
) -> Examined:
    """What a session shows, and what is wrong with it by itself.

    Args:
        recording: read.
        run: as it was executed.
        event: the K* of the audit, None: there is none at hand.
        version: of that K*.

    Raises:
        InputError: its states can't be used at all.
    """
    findings = [*recording.attached.findings, *version_findings(recording, event, version)]
    changes, unlogged = site_changes(recording.attached, run)
    findings += unlogged
    findings += _safety(recording)
    switches = find_switches(
        recording.sightings,
        [run.vut.id, *(t.id for t in run.targets)],
        [t.id for t in run.traffic],
        _there_until_s(recording),
    )
    findings += [Finding("identity_switch", s.text, s.t_s) for s in switches]
    result = Examined(
        recording,
        dict.fromkeys(FIELDS, Property(None, "the session never ran")),
        None,
        {},
        {},
        None,
        (),
        CoverageEntry(source="none"),
        tuple(s.text for s in switches),
        tuple(changes),
    )
    start_s, end_s = recording.start_s, recording.end_s
    if start_s is None or end_s is None or end_s <= start_s or not recording.series:
        findings.append(Finding("epd_missing", "the recording has no clip", math.inf))
        return replace(result, findings=tuple(findings))
    scene = Scene(
        recording.series,
        run.vut.id,
        tuple(target.id for target in run.targets),
        run.road,
        start_s,
        end_s,
        run.thresholds if event is None else event_thresholds(event),
        (None if event is None else event_observable(event)) or run.observable,
    )
    try:
        measured = measure(scene)
    except ValueError as error:
        raise InputError(f"can't be measured: {error}", file=recording.path) from error
    phases = measured.phases
    findings += phase_findings(phases, _closest(measured, scene))
    moments = recording.moments()
    coverage, blind = _coverage(recording, run, measured, event, moments)
    return replace(
        result,
        properties=measured.properties,
        phases=phases,
        phi=_phi(phases),
        measured=measured,
        findings=tuple(findings + blind),
        coverage=coverage,
        contradictions=_contradictions(recording, phases),
        moments=tuple(moments),
    )


def _there_until_s(recording: Recording) -> float:
    """Until when every participant must be there: the end of the clip, or of the world's states."""
    last_s = recording.series[-1][0] if recording.series else 0.0
    return min(last_s, last_s if recording.end_s is None else recording.end_s)


def _safety(recording: Recording) -> list[Finding]:
    facts = recording.provenance
    found = [
        Finding("event_awaited", s.text, math.inf)
        if s.code in _AWAITED
        else Finding("safety_abort", s.text, s.t_s)
        for s in recording.safety
    ]
    if facts.refusal not in (None, NO_VERDICT):
        if facts.verdict == "aborted" and not found:
            found.append(Finding("safety_abort", facts.refusal))
        elif not found or any(f.code == "safety_abort" for f in found):
            found.append(Finding("run_invalid", facts.refusal, math.inf))
    if facts.lacks_verdict:
        found.append(Finding("verdict_missing", NO_VERDICT, math.inf))
    return found


def _closest(measured: Measured, scene: Scene) -> str:
    ttc = measured.facts.get("min_ttc_s")
    limits = scene.thresholds
    text = "TTC is never finite" if ttc is None else f"TTC is at least {ttc:.2f} s"
    if limits.ttc_s is not None:
        text += f", not under {limits.ttc_s:g} s"
    if limits.arrival_gap_s is not None:
        text += f", and the arrivals are never within {limits.arrival_gap_s:g} s"
    return text


def _phi(phases: Phases) -> dict[str, float]:
    times = {name: getattr(phases, f"{name}_s") for name in EVENT_PHASES}
    return {
        name: phase_fraction(t_s, phases.start_s, phases.end_s)
        for name, t_s in times.items()
        if t_s is not None
    }


def _contradictions(recording: Recording, phases: Phases) -> tuple[str, ...]:
    """Where the phases that the run announced aren't the ones that its states show."""
    found = []
    for name in EVENT_PHASES:
        said, measured = recording.phase_events.get(name), getattr(phases, f"{name}_s")
        if said is None and measured is None:
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


def _coverage(
    recording: Recording,
    run: RunSpec,
    measured: Measured,
    event: Event | None,
    moments: list[Moment],
) -> tuple[CoverageEntry, list[Finding]]:
    if not recording.frames_s:
        detail = "the recording has no camera frames"
        return CoverageEntry(source="none"), [Finding("no_video", detail, math.inf)]
    unknown = None
    span = measured.phases.critical_s
    if recording.optics is None:
        unknown = "the camera's geometry isn't recorded"
    elif event is None:
        unknown = "without a K* nobody says how much must be visible"
    elif span is None:
        unknown = "without a trigger there are no critical phases"
    if unknown is not None or recording.optics is None or event is None or span is None:
        return CoverageEntry(source="none"), [Finding("coverage_unknown", unknown or "", math.inf)]
    needed = event.constraints.camera.visible_fraction.min or 0.0
    rate_hz = event.constraints.camera.rate.min
    period_s = 1.0 / rate_hz if rate_hz else _period_s(recording.frames_s)
    vut_id = run.vut.id
    targets = [t.id for t in run.targets if t.id in event.participants]
    in_zone = measured.initiator if measured.initiator != vut_id else measured.affected
    findings = []
    sights = {}
    for target in targets:
        found = object_sight(moments, span, period_s, recording.optics, vut_id, target)
        sights[target] = SightEntry(
            fraction=found.fraction, needed=needed, how="projected box, trigger to resolution"
        )
        if found.fraction is not None and found.fraction < needed - 1e-9:
            findings.append(
                Finding(
                    "participant_off_camera",
                    _lost(target, found.fraction, needed, found.first_lost_s, measured.phases),
                    found.first_lost_s,
                )
            )
    zone = None
    if measured.zone is not None and in_zone is not None:
        reached_s = measured.zone_until_s
        until_s = span[1] if reached_s is None else min(span[1], max(reached_s, span[0]))
        found = zone_sight(
            moments, (span[0], until_s), period_s, recording.optics, vut_id, in_zone, measured.zone
        )
        zone = SightEntry(
            fraction=found.fraction,
            needed=needed,
            how="projected ground, from the trigger until the VUT reaches it or it is resolved",
        )
        if found.fraction is not None and found.fraction < needed - 1e-9:
            findings.append(
                Finding(
                    "zone_off_camera",
                    _lost("the zone", found.fraction, needed, found.first_lost_s, measured.phases),
                    found.first_lost_s,
                )
            )
    frames = sum(span[0] <= t_s <= span[1] for t_s in recording.frames_s)
    entry = CoverageEntry(source="projection", participants=sights, zone=zone, frames=frames)
    return entry, findings


def _period_s(frames_s: tuple[float, ...]) -> float:
    gaps = [b - a for a, b in pairwise(frames_s)]
    return statistics.median(gaps) if gaps else 0.1


def _lost(who: str, fraction: float, needed: float, t_s: float | None, phases: Phases) -> str:
    text = f"{who} is visible for {100 * fraction:.0f} %, needed are {100 * needed:.0f} %"
    if t_s is None:
        return text
    in_conflict = phases.conflict_s is not None and t_s >= phases.conflict_s
    return f"{text}; lost first at {t_s:.2f} s, in the {'conflict' if in_conflict else 'trigger'}"
