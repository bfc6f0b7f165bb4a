"""What happened beside the event: safety aborts, identity switches, changes on site (METHOD 4.4).

A session of ours has a log that tells. Of another's recording a named person declares it, and what
nobody declares is unverified. Nobody drives in a K*'s own source clip: of it the source gate says
whether every participant stays the same (METHOD 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.safety_codes import SafetyCode
from ssp_eval.audit.changes import site_changes
from ssp_eval.audit.identity import find_switches
from ssp_eval.audit.model import ChangeEntry
from ssp_eval.audit.reasons import Finding
from ssp_eval.audit.recording import Recording
from ssp_eval.recordings.agreement import Agreement
from ssp_eval.recordings.provenance import NO_VERDICT

# The session waits for these events; that they stay away is a consequence of what the states say.
_AWAITED = (SafetyCode.EVENT_MISSING, SafetyCode.DURATION)


@dataclass(frozen=True)
class History:
    """What happened beside the event.

    Args:
        said_by: who says so, for people.
        findings: what of it keeps the recording out.
        identities: switches, for people.
        changes: on site.
    """

    said_by: str
    findings: tuple[Finding, ...]
    identities: tuple[str, ...] = ()
    changes: tuple[ChangeEntry, ...] = ()


def examine_history(recording: Recording, agreement: Agreement | None, is_source: bool) -> History:
    """What a recording's log, its states or a named person say.

    Args:
        recording: within its clip.
        agreement: of those who looked at it, None: nobody did.
        is_source: it is the K*'s source clip.
    """
    facts = recording.provenance
    findings, identities = _switches(recording)
    if facts.run is not None:
        logged, unlogged = site_changes(recording.attached, facts.run)
        findings += [*unlogged, *_safety(recording)]
        return History("the session's log", tuple(findings), identities, tuple(logged))
    if agreement is not None:
        found, told = _seen(agreement, bool(recording.series))
        findings, identities = [*findings, *found], (*identities, *told)
    log = _log_of(recording, agreement)
    if log is not None:
        said_by, safety_abort, identity_switch, site_changed = log
        if safety_abort:
            findings.append(Finding("safety_abort", said_by))
        if identity_switch:
            findings.append(Finding("identity_switch", said_by))
            identities = (*identities, f"a switch, {said_by}")
        changes = tuple(
            ChangeEntry(field=change, old=None, new=None, logged=True, who=said_by)
            for change in site_changed
        )
        return History(said_by, tuple(findings), identities, changes)
    if is_source:
        return History("the source gate of the K*", tuple(findings), identities)
    detail = "log: nobody declares whether there was an abort, an identity switch, a change on site"
    return History("nobody", (*findings, Finding("unverified", detail)), identities)


def _seen(agreement: Agreement, has_states: bool) -> tuple[list[Finding], tuple[str, ...]]:
    """What observers say of identities; of a video alone they must be able to say it."""
    found, told = [], []
    stable = agreement.answers.identity_stable.value
    if stable is False:
        found.append(Finding("identity_switch", f"seen by {agreement.by}"))
        told.append(f"a switch, seen by {agreement.by}")
    open_questions = list(agreement.answers.unverified_reasons())
    if stable is None:
        open_questions.append("identity")
    if open_questions and not has_states:
        names = ", ".join(dict.fromkeys(open_questions))
        found.append(Finding("unverified", f"{agreement.by} leaves open: {names}"))
    return found, tuple(told)


def _log_of(
    recording: Recording, agreement: Agreement | None
) -> tuple[str, bool, bool, Sequence[str]] | None:
    """Who declares whether there was an abort, a switch, which changes on site; None: nobody."""
    imported = recording.provenance.imported
    if imported is not None and (log := imported.log) is not None:
        said_by = f"declared by {log.by}, {log.on.isoformat()}"
        return said_by, log.safety_abort, log.identity_switch, log.site_changes
    if agreement is None:
        return None
    seen = agreement.answers.log
    if seen.safety_abort is None or seen.identity_switch is None or seen.site_changes is None:
        return None
    said_by = f"declared by {agreement.by}"
    return said_by, seen.safety_abort, seen.identity_switch, seen.site_changes


def _switches(recording: Recording) -> tuple[list[Finding], tuple[str, ...]]:
    """Identity switches within the clip, by the states."""
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
    found = [
        Finding("event_awaited", s.text, math.inf)
        if s.code in _AWAITED
        else Finding("safety_abort", s.text, s.t_s)
        for s in recording.safety
    ]
    if facts.refusal not in (None, NO_VERDICT):
        if facts.verdict == "aborted" and not found:
            found.append(Finding("safety_abort", facts.refusal))
        elif facts.verdict == "off_spec":
            found.append(Finding("off_spec", facts.refusal, math.inf))
        elif not found or any(f.code == "safety_abort" for f in found):
            found.append(Finding("run_invalid", facts.refusal, math.inf))
    if facts.lacks_verdict:
        found.append(Finding("verdict_missing", NO_VERDICT, math.inf))
    return found
