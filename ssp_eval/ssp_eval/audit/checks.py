"""The findings that keep a recording out by themselves (METHOD 4.4): a table of small functions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from operator import attrgetter

from ssp_core.run_file.model import ConflictThresholds
from ssp_eval.audit.evidence.evidence import (
    PHASES_FIELD,
    Subject,
    expected_properties,
    review_of,
)
from ssp_eval.audit.evidence.further import departures
from ssp_eval.audit.evidence.holding import holds_otherwise
from ssp_eval.audit.evidence.leaving import leaves_otherwise
from ssp_eval.audit.evidence.measure import Measurements, Phases
from ssp_eval.audit.evidence.reasons import Finding
from ssp_eval.audit.evidence.recording import Recording
from ssp_eval.audit.server import server_findings
from ssp_eval.data.audit import (
    CONFLICT,
    FIELDS,
    MOTION,
    ORDER,
    ROLES,
    TOPOLOGY,
    Property,
    differences,
)
from ssp_eval.recordings.event import LOCATED_S, source_times
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.extract.questions import GATE_REASONS

# A crop may be off by one frame at 10 Hz.
CROP_TOLERANCE_S = 0.11


def _of_event(one: Subject) -> Iterable[Finding]:
    return version_findings(one.whole, one.event, one.version)


def version_findings(
    recording: Recording, event: Event | None, version: str | None
) -> list[Finding]:
    """Check that a recording is of the K* that the audit is of."""
    facts = recording.provenance
    findings = [] if facts.run is None else list(recording.attached.findings)
    # One cause, however many of its signs there are.
    other = []
    if version is None:
        findings.append(Finding("not_compiled", "there is no K* to compare the recording with"))
    elif facts.event_version is None:
        other.append("the recording names no K* version")
    elif facts.event_version != version:
        other.append(f"it realises {facts.event_version}, the audit is of {version}")
    if event is not None and facts.scenario not in (None, event.name):
        other.append(f"it is of {facts.scenario}, the audit is of {event.name}")
    if other:
        findings.append(Finding("other_event", "; ".join(other)))
    task = recording.attached.task
    if task is not None and facts.event_version not in (None, task.event.version):
        findings.append(
            Finding(
                "seal_broken",
                f"the run names K* {facts.event_version}, its task {task.event.version}",
            )
        )
    return findings


def _video(one: Subject) -> Iterator[Finding]:
    if not one.whole.frames_s:
        yield Finding("no_video", "the recording has no camera frames", math.inf)


def _crop(one: Subject) -> Iterator[Finding]:
    """Check that the K*'s source clip is in the K*'s crop, independently of any observer."""
    if one.event is None or not one.is_source:
        return
    imported, at = one.whole.provenance.imported, source_times(one.event)
    is_other = False
    for name in ("start", "end"):
        crop_s = None if imported is None else imported.crop.get(f"{name}_s")
        if name not in at or not isinstance(crop_s, int | float) or not math.isfinite(crop_s):
            continue
        when = at[name]
        if not when.low - CROP_TOLERANCE_S <= crop_s <= when.high + CROP_TOLERANCE_S:
            is_other = True
            text = f"the crop's {name} is {crop_s:g} s, the K*'s clip's is {when.mid:g} s"
            yield Finding("other_source", text)
    last_s = one.whole.end_s
    if not {"start", "end"} <= set(at) or last_s is None or is_other:
        return
    # The last frame lies a period before the end.
    period_s = last_s / max(1, len(one.whole.frames_s) - 1)
    if last_s < at["end"].low - at["start"].high - CROP_TOLERANCE_S - period_s:
        length_s = at["end"].mid - at["start"].mid
        text = f"{last_s:.2f} s of it are left, the K*'s clip is {length_s:g} s long"
        yield Finding("other_source", text)


def _review(one: Subject) -> Iterator[Finding]:
    """List what isn't reviewed of the K*'s source clip, where it isn't measured."""
    if one.event is None or not one.is_source or one.measured is not None:
        return
    gaps, properties = review_of(one.event).gaps, expected_properties(one.event)
    for name in FIELDS:
        if gaps[name] or properties[name].words is None:
            why = "; ".join(gaps[name]) or properties[name].how
            yield Finding("unverified", f"{name.replace('_', ' ')}: {why}")
    if gaps[PHASES_FIELD]:
        yield Finding("unverified", f"phases: {'; '.join(gaps[PHASES_FIELD])}")


def _gate(one: Subject) -> Iterator[Finding]:
    """Yield the five reasons of the source gate (METHOD 1), as any observation states them."""
    if one.agreement is not None:
        for reason, text in GATE_REASONS.items():
            for who, has_it in one.agreement.statements(attrgetter(f"source_gate.{reason}.value")):
                if has_it:
                    yield Finding("source_rejected", f"{text}, as {who} saw")


def _contradictions(one: Subject) -> Iterator[Finding]:
    for difference in one.observed_differences:
        if difference.refuses:
            yield Finding("observation_differs", difference.text)


def _unverified(one: Subject) -> Iterator[Finding]:
    """Yield one finding for all that no source confirms, with what would mend it."""
    missing = [name.replace("_", " ") for name in FIELDS if one.values[name].source == "unverified"]
    if one.located is None:
        missing.append("phases")
    if not missing:
        return
    why = ["no road is bound to it" if one.whole.series else "it has no states"]
    agreement = one.agreement
    if agreement is None:
        why.append("no person observed it (`ssp audit observe`)")
    elif agreement.differing:
        why.append(f"{agreement.by} differ in {', '.join(agreement.differing)}")
    else:
        why.append(f"{agreement.by} couldn't tell")
    event, imported = one.event, one.whole.provenance.imported
    if event is not None and imported is not None:
        digest = event.source.sha256
        if digest is None:
            why.append(
                "the K* doesn't know its source's hash and qualifies no video; `ssp spec clip` "
                "writes a K* that does"
            )
        elif imported.source_sha256 != digest:
            why.append(f"the video is {imported.source_sha256}, the K* was taken from {digest}")
        else:
            why.append(f"the K*'s source clip is synthetic, and this is declared {imported.domain}")
    yield Finding("unverified", f"{', '.join(missing)}: {'; '.join(why)}")


def _phases(one: Subject) -> Iterable[Finding]:
    if one.phases is None:
        return ()
    closest = "" if one.measured is None else _closest(one.measured, one.rules.thresholds)
    return phase_findings(one.phases, closest)


def _closest(measured: Measurements, limits: ConflictThresholds) -> str:
    ttc = measured.facts.get("min_ttc_s")
    text = "TTC is never finite" if ttc is None else f"TTC is at least {ttc:.2f} s"
    if limits.ttc_s is not None:
        text += f", not under {limits.ttc_s:g} s"
    if limits.arrival_gap_s is not None:
        text += f", and the arrivals are never within {limits.arrival_gap_s:g} s"
    return text


def _clip(one: Subject) -> Iterator[Finding]:
    if one.crop is None:
        yield Finding("epd_missing", "the recording has no clip", math.inf)
    elif one.event is not None and one.rules.window is None:
        text = "the K* doesn't say how long its source's approach and resolution are"
        yield Finding("epd_missing", text, math.inf)


def _domain(one: Subject) -> Iterator[Finding]:
    facts = one.whole.provenance
    if facts.imported is not None and facts.imported.declaration is None and not one.is_source:
        text = f"domain: no person declared that this is {facts.domain}, when and where it was made"
        yield Finding("unverified", text)


def _server(one: Subject) -> Iterable[Finding]:
    return server_findings(one.whole.provenance)


def _off_spec(one: Subject) -> Iterator[Finding]:
    """Time gap and passing order lie in K*'s range where they are determined."""
    if one.event is None:
        return
    gap_s = None if one.measured is None else one.measured.facts.get("time_gap_s")
    time_gap = one.event.constraints.time_gap
    if gap_s is not None and isinstance(time_gap, Interval):
        span = time_gap.si
        if not span.low - 1e-9 <= gap_s <= span.high + 1e-9:
            text = f"time gap {gap_s:.2f} s, K* has {span.low:g} to {span.high:g} s"
            yield Finding("off_spec", text)
    words = one.values[ORDER].property.words
    if words is not None:
        order = " before ".join(one.event.interaction.passing_order)
        if order not in words["order"]:
            yield Finding(
                "off_spec", f"passing order {' or '.join(words['order'])}, K* has {order}"
            )


def _further(one: Subject) -> Iterable[Finding]:
    if one.event is None or one.measured is None:
        return ()
    return further_findings(one.event, one.measured, one.rules.thresholds)


def further_findings(
    event: Event, measured: Measurements, limits: ConflictThresholds
) -> Iterator[Finding]:
    """Check that further participants keep to their scripts and leave the conflict to another.

    An occluder that leaves the lane does so to the side, and at the gap, of K*; an initiator that
    does nothing holds speed and offset.
    """
    for intrusion in measured.intrusions:
        initiator = event.interaction.initiator
        text = f"{intrusion.text(limits)}, K* has the conflict with {initiator} first"
        yield Finding("off_spec", text)
    for text in departures(event, measured.courses):
        yield Finding("off_spec", text)
    if measured.leaving is not None:
        for text in leaves_otherwise(event, measured.leaving):
            yield Finding("off_spec", text)
    if measured.holding is not None:
        for text in holds_otherwise(event, measured.holding):
            yield Finding("off_spec", text)


Check = Callable[[Subject], Iterable[Finding]]
# Beside these: what happened beside the event (history), the camera (visibility), pictures against
# states (pictures), what differs from Synthetic (property_findings), and recordings that are the
# same (doubles.hold_apart).
CHECKS: tuple[Check, ...] = (
    _of_event,
    _video,
    _crop,
    _review,
    _gate,
    _contradictions,
    _unverified,
    _phases,
    _clip,
    _domain,
    _server,
    _off_spec,
    _further,
)


_MIRRORED = {
    "cutting_in_from_left": "cutting_in_from_right",
    "cutting_in_from_right": "cutting_in_from_left",
    "crossing_from_left": "crossing_from_right",
    "crossing_from_right": "crossing_from_left",
}
_OF_LANES = {"vut_lane", "adjacency"}
_CODES = {CONFLICT: "conflict_type_differs", ORDER: "order_differs", MOTION: "motion_differs"}


def property_findings(
    properties: Mapping[str, Property],
    references: Mapping[str, Property],
    phases: Phases | None,
    first_arrival_s: float | None,
) -> list[Finding]:
    """List the mandatory properties that aren't preserved.

    Args:
        properties: q(d, k) of the fields that are verified.
        references: what it must be equal to; a field that isn't determined there judges nothing.
        phases: of this recording; None: none were located.
        first_arrival_s: at the conflict zone, None: no participant arrives.
    """
    # From when on nothing that happens can change the value.
    decided_s = {
        MOTION: math.inf if phases is None or phases.resolution_s is None else phases.resolution_s,
        CONFLICT: math.inf if first_arrival_s is None else first_arrival_s,
        ORDER: math.inf if first_arrival_s is None else first_arrival_s,
    }
    findings: list[Finding] = []
    for name in FIELDS:
        value, reference = properties.get(name), references[name]
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
    """List the key phases that can't be located, with reasons.

    Args:
        phases: the recording's phases in clip time.
        closest: how near it came to a conflict, for people; empty where it wasn't measured.
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
        text = "no participant's manoeuvre becomes observable in the clip"
        findings.append(Finding("no_manoeuvre", text, never))
        missing = ["trigger", "conflict", "resolution"]
    elif phases.conflict_s is None:
        text = f"after the trigger at {phases.trigger_s:.2f} s {closest or 'none was observed'}"
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
