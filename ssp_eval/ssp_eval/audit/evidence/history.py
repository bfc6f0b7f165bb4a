"""The history beside the event: aborts, identity switches, changes on site (METHOD 4.4)."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import combinations
from operator import attrgetter

from ssp_core.safety.codes import SafetyCode
from ssp_eval.audit.evidence.evidence import Subject
from ssp_eval.audit.evidence.reasons import Finding
from ssp_eval.audit.evidence.recording import Recording, site_changes
from ssp_eval.data.audit import ChangeEntry
from ssp_eval.data.provenance import NO_VERDICT, LogDeclaration
from ssp_eval.observations.agreement import Agreement
from ssp_eval.observations.model import Log
from ssp_eval.recordings.states import WORLD, Sighting

# Silence of a participant that counts as vanishing; states may be lost and late.
GONE_S = 0.5
# Between two states an object moves by its speed; more than this beyond it is a jump.
JUMP_M = 1.5

# Kind (each is told once), clip time, text.
Tell = Callable[[str, float, str], None]


@dataclass(frozen=True)
class Switch:
    """An identity that doesn't hold."""

    t_s: float
    text: str


def find_switches(
    sightings: Sequence[Sighting],
    participants: Sequence[str],
    traffic: Iterable[str],
    start_s: float,
    end_s: float,
) -> list[Switch]:
    """Find everything that contradicts one id for one object.

    Args:
        sightings: in time order per source.
        participants: ids of the VUT and the OTs, who are there from start to end.
        traffic: ids of other objects, which may come and go.
        start_s: clip time from which on participants must be there.
        end_s: clip time up to which they must be there.

    Returns:
        In time order, each kind once per object.
    """
    ids = {*participants, *traffic}
    switches: dict[str, Switch] = {}

    def tell(kind: str, t_s: float, text: str) -> None:
        switches.setdefault(kind, Switch(t_s, text))

    last: dict[tuple[str, str], Sighting] = {}
    jumps: list[tuple[Sighting, Sighting]] = []
    for now in sightings:
        who, t_s = now.object_id, now.t_s
        if now.source not in (WORLD, who):
            text = f"the states of {now.source} say {who} from {t_s:.2f} s on"
            tell(f"name {now.source}", t_s, text)
        elif who not in ids:
            tell(f"unknown {who}", t_s, f"{who}, an unknown id, appears at {t_s:.2f} s")
        before = last.get((now.source, who), now)
        last[(now.source, who)] = now
        if before.object_class != now.object_class:
            was = f"{who} is a {before.object_class} until {before.t_s:.2f} s"
            tell(f"class {who}", t_s, f"{was}, then a {now.object_class}")
        if 0 < now.sequence < before.sequence:
            text = f"their numbers go back from {before.sequence} to {now.sequence} at {t_s:.2f} s"
            tell(f"sequence {who}", t_s, f"the states of {who} come from two senders: {text}")
        if not _within_reach(before, now):
            jumps.append((before, now))
    sources = {s.source for s in sightings}
    for source, who in [(WORLD, p) for p in participants] + [(p, p) for p in participants]:
        if source in sources:
            _report_silence(source, who, sightings, (start_s, end_s), tell)
    for (old_a, new_a), (old_b, new_b) in combinations(jumps, 2):
        same_time = old_a.source == old_b.source == WORLD and abs(new_a.t_s - new_b.t_s) < 1e-6
        if same_time and _within_reach(old_a, new_b) and _within_reach(old_b, new_a):
            a, b = sorted((new_a.object_id, new_b.object_id))
            tell(f"exchanged {a} {b}", new_a.t_s, f"{a} and {b} are exchanged at {new_a.t_s:.2f} s")
    for before, now in jumps:
        text = f"{now.object_id} jumps by {_distance_m(before, now):.1f} m at {now.t_s:.2f} s"
        whose = "" if now.source == WORLD else " in its own states"
        tell(f"jump {now.object_id}", now.t_s, text + whose)
    for (source, who), own in last.items():
        world = last.get((WORLD, who))
        if source == who and world is not None and world.object_class != own.object_class:
            text = f"{who} is a {own.object_class} in its own states and a {world.object_class}"
            tell(f"class {who}", own.t_s, f"{text} in the world")
    return sorted(switches.values(), key=lambda switch: (switch.t_s, switch.text))


def _report_silence(
    source: str,
    who: str,
    sightings: Sequence[Sighting],
    span_s: tuple[float, float],
    tell: Tell,
) -> None:
    """Report the first time at which a participant is silent for too long within the clip."""
    times = [s.t_s for s in sightings if s.source == source and s.object_id == who]
    where = "" if source == WORLD else "its own states: "
    before, end_s = span_s
    for t_s in [*(t for t in times if before <= t <= end_s), end_s]:
        if t_s - before > GONE_S:
            text = f"{where}{who} is gone from {before:.2f} to {t_s:.2f} s"
            tell(f"gone {who}", before + GONE_S, text)
            return
        before = t_s


def _within_reach(before: Sighting, now: Sighting) -> bool:
    """Tell whether one object may have got from one place to the other at its speeds."""
    speed_mps = max(abs(before.speed_mps), abs(now.speed_mps))
    reach_m = speed_mps * max(now.t_s - before.t_s, 0.0) + JUMP_M
    return _distance_m(before, now) <= reach_m


def _distance_m(a: Sighting, b: Sighting) -> float:
    return math.hypot(a.x_m - b.x_m, a.y_m - b.y_m)


# The session waits for these events; that they stay away is a consequence of what the states say.
_AWAITED = (SafetyCode.EVENT_MISSING, SafetyCode.DURATION)


@dataclass(frozen=True)
class History:
    """The history beside the event."""

    source: str
    findings: tuple[Finding, ...]
    identities: tuple[str, ...] = ()
    changes: tuple[ChangeEntry, ...] = ()


def examine_history(one: Subject) -> History:
    """Examine the history by a recording's log, its states or a named person."""
    recording, agreement = one.recording, one.agreement
    facts = recording.provenance
    findings, identities = _switches(recording)
    changes: list[ChangeEntry] = []
    source = "the source gate of the K*" if one.is_source else "nobody"
    if facts.run is not None:
        source = "the session's log"
        changes, unlogged = site_changes(recording.attached, facts.run)
        findings += [*unlogged, *_safety(recording)]
    if agreement is not None:
        observer_findings, observer_identities = _observer_statements(
            agreement, bool(recording.series)
        )
        findings, identities = [*findings, *observer_findings], (*identities, *observer_identities)
    declared: list[tuple[str, Log | LogDeclaration]] = []
    disputed: list[tuple[str, Log | LogDeclaration]] = []
    if agreement is not None and any(field.startswith("log.") for field in agreement.differing):
        disputed = [(f"declared by {one.who}", one.log) for one in agreement.observations]
    elif agreement is not None:
        declared.append((f"declared by {agreement.by}", agreement.answers.log))
    if facts.imported is not None and (log := facts.imported.log) is not None:
        declared.append((f"declared by {log.by}, {log.on.isoformat()}", log))
    # What one person saw happen isn't undone by another who, or a log that, doesn't know of it.
    for by, entry in (*disputed, *declared):
        if entry.safety_abort:
            findings.append(Finding("safety_abort", by))
        if entry.identity_switch:
            findings.append(Finding("identity_switch", by))
            identities = (*identities, f"a switch, {by}")
        changes += [
            ChangeEntry(field=change, old=None, new=None, logged=True, who=by)
            for change in entry.site_changes or ()
        ]
    for by, entry in declared:
        is_whole = None not in (entry.safety_abort, entry.identity_switch, entry.site_changes)
        if is_whole and facts.run is None:
            source = by
    if source == "nobody":
        text = (
            "log: no person declared whether there was an abort, an identity switch or a change on "
            "site"
        )
        findings.append(Finding("unverified", text))
    return History(source, tuple(findings), identities, tuple(changes))


def _observer_statements(
    agreement: Agreement, has_states: bool
) -> tuple[list[Finding], tuple[str, ...]]:
    """Check the observers' statements on identities.

    Of a video alone they must be able to make them.
    """
    findings, identities = [], []
    for who, is_stable in agreement.statements(attrgetter("identity_stable.value")):
        if not is_stable:
            findings.append(Finding("identity_switch", f"seen by {who}"))
            identities.append(f"a switch, seen by {who}")
    open_questions = list(agreement.answers.unverified_reasons())
    if agreement.answers.identity_stable.value is None:
        open_questions.append("identity")
    if open_questions and not has_states:
        names = ", ".join(dict.fromkeys(open_questions))
        findings.append(Finding("unverified", f"{agreement.by} leaves open: {names}"))
    return findings, tuple(identities)


def _switches(recording: Recording) -> tuple[list[Finding], tuple[str, ...]]:
    """Return identity switches within the clip, by the states."""
    who = recording.provenance.participants
    if who is None or not recording.series:
        return [], ()
    first_s, last_s = recording.series[0][0], recording.series[-1][0]
    if recording.end_s is not None:
        last_s = min(last_s, recording.end_s)
    switches = find_switches(recording.sightings, who.ids, who.traffic, first_s, last_s)
    return (
        [Finding("identity_switch", s.text, s.t_s) for s in switches],
        tuple(s.text for s in switches),
    )


def _safety(recording: Recording) -> list[Finding]:
    facts = recording.provenance
    findings = []
    if facts.run is not None and facts.run.driven is not None:
        findings.append(Finding("driven", facts.run.driven.driver, math.inf))
    findings += [
        Finding("event_awaited", s.text, math.inf)
        if s.code in _AWAITED
        else Finding("safety_abort", s.text, s.t_s)
        for s in recording.safety
    ]
    if facts.refusal not in (None, NO_VERDICT):
        if facts.verdict == "aborted" and not findings:
            findings.append(Finding("safety_abort", facts.refusal))
        elif facts.verdict == "off_spec":
            findings.append(Finding("off_spec", facts.refusal, math.inf))
        elif not findings or any(f.code == "safety_abort" for f in findings):
            findings.append(Finding("run_invalid", facts.refusal, math.inf))
    if facts.lacks_verdict:
        findings.append(Finding("verdict_missing", NO_VERDICT, math.inf))
    if facts.is_undeclared and facts.participation is not None:
        part = facts.participation
        remedy = "`ssp audit declare` takes a person's word"
        if part.lost:
            remedy = f"take the bag as it was recorded: it held the words of {', '.join(part.lost)}"
        findings.append(Finding("undeclared", f"{', '.join(part.silent)}; {remedy}"))
    return findings
