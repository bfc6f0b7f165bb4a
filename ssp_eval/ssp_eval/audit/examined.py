"""What the examination of one recording leaves (METHOD 4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from ssp_eval.audit.coverage import Moment
from ssp_eval.audit.evidence import Source, Value
from ssp_eval.audit.measure import Measured, Phases
from ssp_eval.audit.model import ChangeEntry, CoverageEntry
from ssp_eval.audit.reasons import Finding
from ssp_eval.audit.recording import Recording
from ssp_eval.recordings.crop import Crop
from ssp_eval.recordings.properties import FIELDS, Property


@dataclass(frozen=True)
class Examined:
    """One recording, examined.

    Args:
        recording: as it was read, within its clip.
        values: q(d, k) per field, with its source.
        phases: None: nobody located any.
        phases_source: where they come from.
        crop: the clip that all of this is of; None: the recording never began.
        phi: φ(d, e) per event that could be located.
        phi_half: half width of φ where a K* gives intervals.
        measured: None without states.
        findings: all that is wrong with it by itself.
        coverage: of the camera.
        identities: switches, for people.
        changes: on site.
        log_said_by: who says what happened beside the event.
        contradictions: between what was announced and what was measured.
        moments: the states at each frame.
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
