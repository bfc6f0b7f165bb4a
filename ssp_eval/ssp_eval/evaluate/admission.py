"""What the transfer audit says of a recording that is to be evaluated (METHOD 4).

A recording is known by the hash of its bag. What an audit refused is not evaluated. What is
``unpaired`` or in no audit is, and stays out of domain means.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_eval.audit.model import AUDIT_FILE, RecordingEntry, load_audit

ADMITTED, REFUSED, UNPAIRED, UNAUDITED = "admitted", "refused", "unpaired", "unaudited"


@dataclass(frozen=True)
class Admission:
    """Whether a recording enters evaluation.

    Args:
        status: admitted, refused, unpaired, or unaudited where no audit knows the bag.
        audit_sha256: hash of the audit's file, None where there is none.
        reasons: of a refusal, the primary one first; or why an audit doesn't hold any more.
        by_labels: the audit rests on labels, since the recording has no states.
        labels_sha256: hash of what these labels say, None where there were none.
        verdict_sha256: hash of the runner's verdict.json as the audit read it.
    """

    status: str = UNAUDITED
    audit_sha256: str | None = None
    reasons: tuple[str, ...] = ()
    by_labels: bool = False
    labels_sha256: str | None = None
    verdict_sha256: str | None = None

    @property
    def read(self) -> tuple[str | None, str | None]:
        """What the audit read beside the MCAP file."""
        return (self.labels_sha256, self.verdict_sha256)

    @property
    def refusal(self) -> str | None:
        """Why the recording isn't evaluated, None when it is."""
        if self.status != REFUSED:
            return None
        return f"refused by the audit: {'; '.join(self.reasons)}"

    def held_against(self, labels_sha256: str | None, verdict_sha256: str | None) -> Admission:
        """The admission, if what the audit read beside the MCAP file is as it was then.

        A refusal stays: it needs another audit to be lifted. Whatever else it says isn't said of
        other labels or of another verdict: the recording is unaudited then.

        Args:
            labels_sha256: of the labels that the recording is scored against (labels_version).
            verdict_sha256: of verdict.json in the bag, None where there is none.
        """
        if self.status in (REFUSED, UNAUDITED):
            return self
        why = []
        if self.by_labels and labels_sha256 != self.labels_sha256:
            why.append(
                f"the audit rests on the labels {self.labels_sha256}, these are {labels_sha256}"
            )
        if verdict_sha256 != self.verdict_sha256:
            why.append(
                f"the audit read the verdict {self.verdict_sha256}, the bag's is {verdict_sha256}"
            )
        return replace(self, status=UNAUDITED, reasons=tuple(why)) if why else self

    def to_json(self) -> dict[str, Any]:
        """As it stands in cell.json."""
        return {
            "status": self.status,
            "audit_sha256": self.audit_sha256,
            "reasons": list(self.reasons),
        }


NO_AUDIT = Admission()


def load_admissions(files: Iterable[Path]) -> dict[str, Admission]:
    """Admissions by the hash of the bag.

    Args:
        files: audits, or folders with an audit.json.

    Raises:
        InputError: a file is no audit, or two audits say different things of one recording.
    """
    found: dict[str, tuple[Admission, Path]] = {}
    for file in files:
        audit = load_audit(file)
        digest = sha256_file(file / AUDIT_FILE if file.is_dir() else file)
        for entry in audit.recordings:
            admission = admission_of(entry, digest)
            known = found.setdefault(entry.bag_sha256, (admission, file))
            if known[0].status != admission.status:
                raise InputError(
                    f"says {admission.status} of {entry.name}, and {known[1]} says "
                    f"{known[0].status}",
                    file=file,
                    remedy="give the audit that this evaluation is to go by",
                )
            if known[0].read != admission.read:
                raise InputError(
                    f"is of other labels or another verdict of {entry.name} than {known[1]}",
                    file=file,
                    remedy="give the audit that this evaluation is to go by",
                )
    return {bag: admission for bag, (admission, _) in found.items()}


def admission_of(entry: RecordingEntry, audit_sha256: str) -> Admission:
    """What an audit says of one recording.

    Args:
        entry: of the audit.
        audit_sha256: hash of its file.
    """
    return Admission(
        status=entry.status,
        audit_sha256=audit_sha256,
        reasons=tuple(f"{reason.text} ({reason.detail})" for reason in entry.reasons),
        by_labels=entry.evidence == "reviewed",
        labels_sha256=entry.labels_sha256,
        verdict_sha256=entry.verdict_sha256,
    )
