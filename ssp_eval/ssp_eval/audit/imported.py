"""Examines an imported video, which has no states: what persons reviewed counts (METHOD 4)."""

from __future__ import annotations

import math

from ssp_eval.audit.examined import Examined, version_findings
from ssp_eval.audit.expected import (
    PHASES_FIELD,
    Timeline,
    When,
    expected_properties,
    review_of,
    timeline,
)
from ssp_eval.audit.measure import Phases
from ssp_eval.audit.model import CoverageEntry, SightEntry
from ssp_eval.audit.ratios import phase_fraction
from ssp_eval.audit.reasons import Finding
from ssp_eval.audit.recording import Recording
from ssp_eval.recordings.properties import EVENT_PHASES, FIELDS, Property
from ssp_scenario_manager.spec.model import Event

# A time in a K* is rounded, and a label lies on a frame.
LABEL_TOLERANCE_S = 0.05
# A crop may be off by one frame at 10 Hz.
CROP_TOLERANCE_S = 0.11


def examine_video(recording: Recording, event: Event | None, version: str | None) -> Examined:
    """What a video shows by its K* and its labels, and what is wrong with it by itself.

    Args:
        recording: read.
        event: the K* of the audit, None: there is none at hand.
        version: of that K*.
    """
    findings = version_findings(recording, event, version)
    unknown: dict[str, Property] = dict.fromkeys(
        FIELDS, Property(None, "a video without states, and no K* to say more")
    )
    if not recording.frames_s:
        findings.append(Finding("no_video", "the recording has no camera frames", math.inf))
    if event is None:
        return Examined(
            recording, unknown, None, {}, {}, None, tuple(findings), CoverageEntry(source="none")
        )
    findings += _source(recording, event)
    review = review_of(event)
    wanted = expected_properties(event)
    properties = {}
    for name in FIELDS:
        gaps = review.gaps[name]
        value = wanted[name]
        if gaps or value.words is None:
            why = "; ".join(gaps) or value.how
            findings.append(Finding("unverified", f"{name.replace('_', ' ')}: {why}"))
            properties[name] = Property(None, f"unverified: {why}")
        else:
            how = f"reviewed in the K*; evidence: {review.evidence[name]}"
            properties[name] = Property(value.words, how)
    times = timeline(event)
    if review.gaps[PHASES_FIELD]:
        findings.append(Finding("unverified", f"phases: {'; '.join(review.gaps[PHASES_FIELD])}"))
    phases, phi, half = _reviewed_phases(times)
    if phases is None:
        findings.append(Finding("epd_missing", "the K* leaves the clip's crop open", math.inf))
    else:
        findings += [
            Finding(f"{name}_phase", f"the K* leaves the start of the {name} open", math.inf)
            for name in EVENT_PHASES
            if name not in phi
        ]
        if not phases.has_approach:
            findings.append(Finding("approach_phase", "the clip begins with the trigger", 0.0))
        if len(phi) < len(EVENT_PHASES):
            findings.append(Finding("epd_missing", "not all times are known", math.inf))
    coverage, more = _labelled(recording, event, times)
    return Examined(recording, properties, phases, phi, half, None, (*findings, *more), coverage)


def _source(recording: Recording, event: Event) -> list[Finding]:
    """The imported video must be the clip that the K* was taken from."""
    imported = recording.provenance.imported
    if imported is None:
        return []
    source, crop = imported.source, imported.crop
    found = []
    if event.source.sha256 is not None:
        if source.get("sha256") != event.source.sha256:
            found.append(
                Finding(
                    "other_source",
                    f"the video is {source.get('sha256')}, the K* was taken from "
                    f"{event.source.sha256}",
                )
            )
    elif imported.generator != event.source.generator:
        found.append(
            Finding(
                "other_source",
                f"the video was made by {imported.generator}, the K* was taken from one of "
                f"{event.source.generator}",
            )
        )
    times = timeline(event)
    for name, when in (("start", times.start), ("end", times.end)):
        given = crop.get(f"{name}_s")
        if when is None or not isinstance(given, int | float):
            continue
        if not when.low_s - CROP_TOLERANCE_S <= given <= when.high_s + CROP_TOLERANCE_S:
            found.append(
                Finding(
                    "other_source",
                    f"the crop's {name} is {given:g} s, the K*'s clip's is {when.middle_s:g} s",
                )
            )
    return found


def _reviewed_phases(
    times: Timeline,
) -> tuple[Phases | None, dict[str, float], dict[str, float]]:
    """Phases in clip time (0 is the crop's start) and φ with its half width."""
    if times.start is None or times.end is None or times.end.middle_s <= times.start.middle_s:
        return None, {}, {}
    zero_s = times.start.middle_s
    length_s = times.end.middle_s - zero_s
    found: dict[str, When] = {}
    for name in EVENT_PHASES:
        when = getattr(times, name)
        if when is not None and 0.0 <= when.middle_s - zero_s <= length_s:
            found[name] = when
    starts = {name: when.middle_s - zero_s for name, when in found.items()}
    phases = Phases(
        0.0, length_s, starts.get("trigger"), starts.get("conflict"), starts.get("resolution")
    )
    phi = {name: phase_fraction(t_s, 0.0, length_s) for name, t_s in starts.items()}
    half = {
        name: min(1.0, when.half_s / length_s) for name, when in found.items() if when.half_s > 0.0
    }
    return phases, phi, half


def _labelled(
    recording: Recording, event: Event, times: Timeline
) -> tuple[CoverageEntry, list[Finding]]:
    """Coverage of a video without states: where a label knows the position, somebody saw it."""
    labels = recording.labels
    if labels is None:
        detail = "a video without states needs a labels file beside its bag"
        return CoverageEntry(source="none"), [Finding("coverage_unknown", detail)]
    findings = []
    zero_s = 0.0 if times.start is None else times.start.middle_s
    for index, label in enumerate(labels.labels):
        allowed = _phases_at(label.t_s + zero_s, times)
        if allowed and label.phase not in allowed:
            findings.append(
                Finding(
                    "labels_disagree",
                    f"labels[{index}] at {label.t_s:g} s says {label.phase}, by the K* it is "
                    f"{' or '.join(allowed)}",
                )
            )
    if labels.event_version != recording.provenance.event_version:
        findings.append(Finding("labels_disagree", f"the labels are of K* {labels.event_version}"))
    critical = [label for label in labels.labels if label.phase in ("trigger", "conflict")]
    needed = event.constraints.camera.visible_fraction.min or 0.0
    fraction = None
    if critical:
        fraction = sum(label.position is not None for label in critical) / len(critical)
    who = event.interaction.initiator
    sight = SightEntry(
        fraction=fraction,
        needed=needed,
        how=f"labels from trigger to resolution that give its position, of {len(critical)}",
    )
    if fraction is None:
        findings.append(Finding("coverage_unknown", "no label lies between trigger and resolution"))
    elif fraction < needed - 1e-9:
        findings.append(
            Finding(
                "participant_off_camera",
                f"{who} has a position in {100 * fraction:.0f} % of the labels from trigger to "
                f"resolution, needed are {100 * needed:.0f} %",
            )
        )
    notes = ["the conflict zone is judged by the evidence that the K* names for the conflict"]
    return (
        CoverageEntry(
            source="labels", participants={who: sight}, frames=len(critical), notes=notes
        ),
        findings,
    )


def _phases_at(t_s: float, times: Timeline) -> tuple[str, ...]:
    """The phases that a K* allows at a time of its source; empty where it leaves them open."""
    if times.trigger is None or times.conflict is None or times.resolution is None:
        return ()
    bounds = [
        ("approach", None, times.trigger),
        ("trigger", times.trigger, times.conflict),
        ("conflict", times.conflict, times.resolution),
        ("resolution", times.resolution, None),
    ]
    return tuple(
        name
        for name, begin, end in bounds
        if (begin is None or t_s >= begin.low_s - LABEL_TOLERANCE_S)
        and (end is None or t_s < end.high_s + LABEL_TOLERANCE_S)
    )
