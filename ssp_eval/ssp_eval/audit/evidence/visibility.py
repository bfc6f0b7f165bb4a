"""The share of the critical phases that the camera shows, by each source (METHOD 4.3, 4.4).

Projected from states, CameraInfo and mount; of the K*'s source clip as persons reviewed it; else as
a person saw it.
"""

from __future__ import annotations

import math
import statistics
from bisect import bisect_right
from collections.abc import Mapping, Sequence
from functools import partial
from itertools import pairwise
from operator import attrgetter
from typing import Literal

from ssp_eval.audit.evidence.evidence import PHASES_FIELD, Subject, review_of, visibility_field
from ssp_eval.audit.evidence.measure import Measurements, Phases
from ssp_eval.audit.evidence.reasons import Finding
from ssp_eval.audit.evidence.recording import Recording
from ssp_eval.data.audit import CoverageEntry, LabelSize, SightEntry
from ssp_eval.observations.agreement import Agreement
from ssp_eval.observations.model import Answers
from ssp_eval.recordings.sight import Moment, object_height_px, object_sight, zone_sight
from ssp_scenario_manager.event_spec.model import UNRESOLVED, Event
from ssp_scenario_manager.scenarios.further import further_ids

_SAME_S = 1e-6
# The conflict region among what is seen.
_ZONE = ""


def examine_coverage(one: Subject) -> tuple[CoverageEntry, list[Finding]]:
    """Return the coverage from trigger to resolution, and what of it is too little."""
    recording, event, phases = one.recording, one.event, one.phases
    measured, agreement = one.measured, one.agreement
    if not recording.frames_s:
        return CoverageEntry(source="none"), []
    unknown = None
    if event is None:
        unknown = "without a K* the required visibility is unknown"
    elif phases is None or phases.critical_s is None:
        unknown = "without a trigger there are no critical phases"
    if unknown is not None or event is None or phases is None:
        return CoverageEntry(source="none"), [Finding("coverage_unknown", unknown or "", math.inf)]
    needed = event.constraints.camera.visible_fraction.min or 0.0
    # A guessed camera is neither measured nor declared by anybody.
    is_known = recording.optics is not None and recording.provenance.camera != "assumed"
    if measured is not None and is_known:
        entry, findings = _projected(recording, event, measured, one.moments, needed)
        return entry, [*findings, *_losses_in_review(entry, agreement)]
    if one.is_source:
        entry, findings = _reviewed(event, needed)
        return entry, [*findings, *_losses_in_review(entry, agreement)]
    if agreement is not None:
        visibility = agreement.answers.visibility
        shares = {who: one.share for who, one in visibility.participants.items()}
        shares[_ZONE] = visibility.conflict_region.share
        return _coverage_by_person(event, shares, needed, f"seen by {agreement.by}", "observed")
    why = "there are no states"
    if measured is not None:
        guessed = recording.optics is not None
        why = "the camera's geometry is " + ("a guess" if guessed else "not recorded")
    detail = f"{why}, and no person recorded what was visible"
    return CoverageEntry(source="none"), [Finding("coverage_unknown", detail, math.inf)]


def _needed(event: Event, who: str, needed: float) -> float:
    """Return the share for which a participant must be visible.

    A further participant may be hidden, or passed, while the event goes on.
    """
    return 0.0 if who in further_ids(event) else needed


def label_sizes(one: Subject) -> tuple[list[LabelSize], str]:
    """Project the critical object into the newest frame at each label's time.

    The critical object is the one of the event: who initiates it, or whom the VUT meets.

    Returns:
        A size of each label, and whose it is, or why none is known.
    """
    recording, measured = one.whole, one.measured
    labels, who, optics = recording.labels, recording.provenance.participants, recording.optics
    if labels is None:
        return [], ""
    sizes = [LabelSize(t_s=x.t_s, phase=x.phase, height_px=None) for x in labels.labels]
    if optics is None or recording.provenance.camera == "assumed":
        guessed = "is a guess" if optics is not None else "is not recorded"
        return sizes, f"not known: the camera's geometry {guessed}"
    if measured is None or who is None:
        return sizes, "not known: there are no states"
    critical = measured.initiator if measured.initiator != who.vut else measured.affected
    if critical is None:
        return sizes, "not known: no critical object was found"
    moments = recording.moments()
    times = [moment.t_s for moment in moments]
    sizes_in_frames = []
    for size in sizes:
        index = bisect_right(times, size.t_s + _SAME_S) - 1
        states = moments[index].states if index >= 0 else {}
        if critical in states and who.vut in states:
            view = optics.view(states[who.vut].pose)
            others = [s for key, s in states.items() if key not in (who.vut, critical)]
            height_px = object_height_px(view, states[critical], others)
            size = size.model_copy(update={"height_px": height_px})
        sizes_in_frames.append(size)
    return sizes_in_frames, f"box of {critical}, projected into the recorded picture"


def _projected(
    recording: Recording,
    event: Event,
    measured: Measurements,
    moments: Sequence[Moment],
    needed: float,
) -> tuple[CoverageEntry, list[Finding]]:
    who, optics, span = (
        recording.provenance.participants,
        recording.optics,
        measured.phases.critical_s,
    )
    if who is None or optics is None or span is None:
        return CoverageEntry(source="none"), []
    rate_hz = event.constraints.camera.rate.min
    period_s = 1.0 / rate_hz if rate_hz else _period_s(recording.frames_s)
    in_zone = measured.initiator if measured.initiator != who.vut else measured.affected
    findings, sights = [], {}
    for target in [name for name in who.targets if name in event.participants]:
        sight = object_sight(moments, span, period_s, optics, who.vut, target)
        least = _needed(event, target, needed)
        sights[target] = SightEntry(
            fraction=sight.fraction, needed=least, how="projected box, trigger to resolution"
        )
        if sight.fraction is not None and sight.fraction < least - 1e-9:
            text = _lost(target, sight.fraction, least, sight.first_lost_s, measured.phases)
            findings.append(Finding("participant_off_camera", text, sight.first_lost_s))
    zone = None
    if measured.zone is not None and in_zone is not None:
        reached_s = measured.zone_until_s
        until_s = span[1] if reached_s is None else min(span[1], max(reached_s, span[0]))
        sight = zone_sight(
            moments, (span[0], until_s), period_s, optics, who.vut, in_zone, measured.zone
        )
        zone = SightEntry(
            fraction=sight.fraction,
            needed=needed,
            how="projected ground, from the trigger until the VUT reaches it or it is resolved",
        )
        if sight.fraction is not None and sight.fraction < needed - 1e-9:
            text = _lost("the zone", sight.fraction, needed, sight.first_lost_s, measured.phases)
            findings.append(Finding("zone_off_camera", text, sight.first_lost_s))
    frames = sum(span[0] <= t_s <= span[1] for t_s in recording.frames_s)
    entry = CoverageEntry(source="projection", participants=sights, zone=zone, frames=frames)
    return entry, findings


def _losses_in_review(entry: CoverageEntry, agreement: Agreement | None) -> list[Finding]:
    """List what should be visible and wasn't, as a person saw: spray, another lens, black frames.

    Of the conflict region only "never" counts: projected, it is asked for until the VUT reaches it,
    of a person until the resolution.
    """
    if agreement is None:
        return []
    lost = [
        (who, by, share, sight)
        for who, sight in entry.participants.items()
        if who in agreement.answers.visibility.participants
        for by, share in agreement.statements(partial(_share, who=who))
        if share < sight.needed - 1e-9
    ]
    if entry.zone is not None:
        lost += [
            ("the conflict region", by, share, entry.zone)
            for by, share in agreement.statements(attrgetter("visibility.conflict_region.share"))
            if share == 0.0
        ]
    return [
        Finding(
            "observation_differs",
            f"{who}: {by} saw it for {100 * share:.0f} %; {entry.source}: "
            f"{100 * sight.fraction:.0f} %",
        )
        for who, by, share, sight in lost
        if sight.fraction is not None and sight.fraction >= sight.needed - 1e-9
    ]


def _share(answers: Answers, who: str) -> float | None:
    return answers.visibility.participants[who].share


def _reviewed(event: Event, needed: float) -> tuple[CoverageEntry, list[Finding]]:
    """Judge the source clip: an OT is visible where a reviewer confirmed the direction to it."""
    review = review_of(event)
    shares: dict[str, float | None] = {}
    for who, participant in event.participants.items():
        if participant.role == "OT":
            cells = [event.motion.get(who, {}).get(phase) for phase in ("trigger", "conflict")]
            resolved_cells = [
                cell for cell in cells if cell is not None and cell.position != UNRESOLVED
            ]
            reviewed = not review.gaps[visibility_field(who)]
            shares[who] = len(resolved_cells) / len(cells) if reviewed else None
    zone = None if review.gaps[PHASES_FIELD] else 1.0
    return _coverage_by_person(
        event,
        {**shares, _ZONE: zone},
        needed,
        "reviewed in the K*: positions and evidence",
        "reviewed",
    )


def _coverage_by_person(
    event: Event,
    shares: Mapping[str, float | None],
    needed: float,
    how: str,
    source: Literal["observed", "reviewed"],
) -> tuple[CoverageEntry, list[Finding]]:
    """Return the shares that a person gives, by participant; the conflict region's under _ZONE."""
    sights = {
        who: SightEntry(fraction=share, needed=_needed(event, who, needed), how=how)
        for who, share in shares.items()
    }
    findings = []
    for who, fraction in shares.items():
        if who in further_ids(event):
            continue
        name = "the conflict region" if who == _ZONE else who
        if fraction is None:
            findings.append(Finding("coverage_unknown", f"{name}: {how}, but not of it"))
        elif fraction < needed - 1e-9:
            code = "zone_off_camera" if who == _ZONE else "participant_off_camera"
            text = f"{name} is visible for {100 * fraction:.0f} %, needed are {100 * needed:.0f} %"
            findings.append(Finding(code, f"{text} ({how})"))
    zone = sights.pop(_ZONE, None)
    return CoverageEntry(source=source, participants=sights, zone=zone), findings


def _period_s(frames_s: Sequence[float]) -> float:
    gaps = [b - a for a, b in pairwise(frames_s)]
    return statistics.median(gaps) if gaps else 0.1


def _lost(who: str, fraction: float, needed: float, t_s: float | None, phases: Phases) -> str:
    text = f"{who} is visible for {100 * fraction:.0f} %, needed are {100 * needed:.0f} %"
    if t_s is None:
        return text
    in_conflict = phases.conflict_s is not None and t_s >= phases.conflict_s
    return f"{text}; lost first at {t_s:.2f} s, in the {'conflict' if in_conflict else 'trigger'}"
