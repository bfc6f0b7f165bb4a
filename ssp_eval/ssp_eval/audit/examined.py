"""What the examination of one recording leaves (METHOD 4), and what all recordings must meet."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ssp_eval.audit.coverage import Moment
from ssp_eval.audit.measure import Measured, Phases
from ssp_eval.audit.model import ChangeEntry, CoverageEntry
from ssp_eval.audit.reasons import Finding
from ssp_eval.audit.recording import Recording
from ssp_eval.recordings.properties import Property
from ssp_scenario_manager.spec.model import Event


@dataclass(frozen=True)
class Examined:
    """One recording, examined.

    Args:
        recording: as it was read.
        properties: q(d, k) per field.
        phases: None: the recording never began.
        phi: φ(d, e) per event that could be located.
        phi_half: half width of φ where a K* gives intervals.
        measured: None without states.
        findings: all that is wrong with it by itself.
        coverage: of the camera.
        identities: switches, for people.
        changes: on site.
        contradictions: between what was announced and what was measured.
    """

    recording: Recording
    properties: Mapping[str, Property]
    phases: Phases | None
    phi: Mapping[str, float]
    phi_half: Mapping[str, float]
    measured: Measured | None
    findings: tuple[Finding, ...]
    coverage: CoverageEntry
    identities: tuple[str, ...] = ()
    changes: tuple[ChangeEntry, ...] = ()
    contradictions: tuple[str, ...] = ()
    moments: tuple[Moment, ...] = field(default=(), repr=False)


def version_findings(
    recording: Recording, event: Event | None, version: str | None
) -> list[Finding]:
    """Whether a recording is of the K* that the audit is of."""
    facts = recording.provenance
    found = []
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
