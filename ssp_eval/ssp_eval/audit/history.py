"""What happened beside the event: safety aborts, identity switches, changes on site (METHOD 4.4).

A session of ours has a log that tells. Of another's recording a named person declares it, and what
nobody declares is unverified. Nobody drives in a K*'s own source clip: of it the source gate says
whether every participant stays the same (METHOD 1).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ssp_core.safety.codes import SafetyCode
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
    changes: list[ChangeEntry] = []
    said_by = "the source gate of the K*" if is_source else "nobody"
    if facts.run is not None:
        said_by = "the session's log"
        changes, unlogged = site_changes(recording.attached, facts.run)
        findings += [*unlogged, *_safety(recording)]
    if agreement is not None:
        found, told = _seen(agreement, bool(recording.series))
        findings, identities = [*findings, *found], (*identities, *told)
    # What one person saw happen isn't undone by another who, or a log that, doesn't know of it.
    for one in reversed(_declared(recording, agreement)):
        if one.safety_abort:
            findings.append(Finding("safety_abort", one.said_by))
        if one.identity_switch:
            findings.append(Finding("identity_switch", one.said_by))
            identities = (*identities, f"a switch, {one.said_by}")
        changes += [
            ChangeEntry(field=change, old=None, new=None, logged=True, who=one.said_by)
            for change in one.site_changes or ()
        ]
        if one.is_whole and facts.run is None:
            said_by = one.said_by
    if said_by == "nobody":
        text = (
            "log: nobody declares whether there was an abort, an identity switch, a change on site"
        )
        findings.append(Finding("unverified", text))
    return History(said_by, tuple(findings), identities, tuple(changes))


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


@dataclass(frozen=True)
class _Declared:
    """What a person declares of a log that isn't there; None where he doesn't say."""

    said_by: str
    safety_abort: bool | None
    identity_switch: bool | None
    site_changes: Sequence[str] | None

    @property
    def is_whole(self) -> bool:
        return None not in (self.safety_abort, self.identity_switch, self.site_changes)


def _declared(recording: Recording, agreement: Agreement | None) -> list[_Declared]:
    """Who declares whether there was an abort, a switch, which changes on site; the importer's
    word first."""
    found, imported = [], recording.provenance.imported
    if imported is not None and (log := imported.log) is not None:
        by = f"declared by {log.by}, {log.on.isoformat()}"
        found.append(_Declared(by, log.safety_abort, log.identity_switch, log.site_changes))
    if agreement is not None:
        seen, by = agreement.answers.log, f"declared by {agreement.by}"
        found.append(_Declared(by, seen.safety_abort, seen.identity_switch, seen.site_changes))
    return found


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
