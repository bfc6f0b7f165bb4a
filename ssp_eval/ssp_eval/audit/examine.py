"""Examines one recording, whoever made it: what it shows, and what is wrong with it (METHOD 4)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.errors import InputError
from ssp_core.motion.encounter import Observable
from ssp_core.run_file.model import ConflictThresholds
from ssp_eval.audit.compare import phase_findings
from ssp_eval.audit.evidence import (
    Evidence,
    combined,
    contradictions,
    half_widths,
    is_source_clip,
    observed,
    reviewed,
    unknown_source,
)
from ssp_eval.audit.examined import Examined
from ssp_eval.audit.history import examine_history
from ssp_eval.audit.measure import Measured, Phases, Scene, measure
from ssp_eval.audit.ratios import phase_fraction
from ssp_eval.audit.reasons import Finding
from ssp_eval.audit.recording import Recording
from ssp_eval.audit.visibility import examine_coverage
from ssp_eval.recordings.agreement import Agreement
from ssp_eval.recordings.crop import Crop, Window, crop_of
from ssp_eval.recordings.event_rules import (
    event_observable,
    event_thresholds,
    source_times,
    window_of,
)
from ssp_eval.recordings.properties import EVENT_PHASES, FIELDS, ORDER, Property
from ssp_eval.recordings.states import STATE_AGE_S
from ssp_scenario_manager.event_spec.extract.questions import GATE_REASONS
from ssp_scenario_manager.event_spec.fields import si
from ssp_scenario_manager.event_spec.model import Event, Interval

# Phases that a run announced and phases measured from states may lie this far apart.
PHASE_TOLERANCE_S = 0.15


def examine(recording: Recording, event: Event | None, version: str | None) -> Examined:
    """What a recording shows by METHOD 4.3, and what is wrong with it by itself.

    Args:
        recording: read.
        event: the K* of the audit, None: there is none at hand.
        version: of that K*.

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
        closest = "" if measured is None else _closest(measured, _thresholds(recording, event))
        findings += phase_findings(phases, closest)
    is_cropped = event is not None and window_of(event) is not None
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


@dataclass(frozen=True)
class _Rules:
    """What decides when a phase begins."""

    thresholds: ConflictThresholds
    observable: Observable
    window: Window | None


def _thresholds(recording: Recording, event: Event | None) -> ConflictThresholds:
    run = recording.provenance.run
    if event is not None:
        return event_thresholds(event)
    return ConflictThresholds() if run is None else run.thresholds


def _rules(recording: Recording, event: Event | None) -> _Rules:
    run = recording.provenance.run
    observable = None if event is None else event_observable(event)
    if observable is None:
        observable = "lateral" if run is None else run.observable
    window = None if event is None else window_of(event)
    return _Rules(_thresholds(recording, event), observable, window)


def _measured(
    recording: Recording, event: Event | None, is_source: bool
) -> tuple[Crop | None, Measured | None]:
    """The clip by the states, and what they say within it; None where there are no states."""
    who, (start_s, end_s) = recording.provenance.participants, _covered(recording)
    if who is None or start_s is None or end_s is None or end_s <= start_s or not recording.series:
        return None, None
    rules = _rules(recording, event)

    def scene(part: Recording, first_s: float, last_s: float) -> Scene:
        return Scene(
            part.series,
            who.vut,
            tuple(who.targets),
            part.road,
            first_s,
            last_s,
            rules.thresholds,
            rules.observable,
            None if rules.window is None else rules.window.after_s,
        )

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
    times = None if event is None else source_times(event)
    if times is not None and times.start is not None and times.end is not None:
        length_s = times.end.middle_s - times.start.middle_s
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
    window = None if event is None else window_of(event)
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
    """METHOD 4.4: time gap and passing order lie in K*'s range where they are determined.

    Args:
        measured: None without states, which alone determine a time gap.
        order: of passing, by whoever may say so (METHOD 4.3).
        event: the K*; None: there is none at hand.
    """
    if event is None:
        return []
    found = []
    gap_s = None if measured is None else measured.facts.get("time_gap_s")
    wanted = event.constraints.time_gap
    if gap_s is not None and isinstance(wanted, Interval):
        span = si(wanted)
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
        for reason in agreement.rejections()
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
    length_s = phases.end_s - phases.start_s
    return {
        name: min(1.0, half_s / length_s)
        for name, half_s in half_widths(source_times(event)).items()
    }


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
