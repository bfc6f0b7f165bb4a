"""What the transfer audit says of a recording that is to be evaluated (METHOD 4).

A recording is known by the hash of its bag. What an audit refused is not evaluated. What is
``unpaired`` or in no audit is, and stays out of domain means.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_eval.audit.model import AUDIT_FILE, RecordingEntry, load_audit
from ssp_eval.recordings.crop import Crop

ADMITTED, REFUSED, UNPAIRED, UNAUDITED = "admitted", "refused", "unpaired", "unaudited"


@dataclass(frozen=True)
class Admission:
    """Whether a recording enters evaluation.

    Args:
        status: admitted, refused, unpaired, or unaudited where no audit knows the bag.
        audit_sha256: hash of the audit's file, None where there is none.
        reasons: of a refusal, the primary one first; or why an audit doesn't hold any more.
        verdict_sha256: hash of the runner's verdict.json as the audit read it.
        crop: the clip that the audit compared (METHOD 4.1), which is evaluated and nothing else;
            None: the whole recording.
    """

    status: str = UNAUDITED
    audit_sha256: str | None = None
    reasons: tuple[str, ...] = ()
    verdict_sha256: str | None = None
    crop: Crop | None = None

    @property
    def refusal(self) -> str | None:
        """Why the recording isn't evaluated, None when it is."""
        if self.status != REFUSED:
            return None
        return f"refused by the audit: {'; '.join(self.reasons)}"

    def held_against(self, verdict_sha256: str | None) -> Admission:
        """The admission, if the verdict that the audit read beside the MCAP file is as it was then.

        A refusal stays: it needs another audit to be lifted. Whatever else it says isn't said of
        another verdict: the recording is unaudited then.

        Args:
            verdict_sha256: of verdict.json in the bag, None where there is none.
        """
        if self.status in (REFUSED, UNAUDITED) or verdict_sha256 == self.verdict_sha256:
            return self
        why = f"the audit read the verdict {self.verdict_sha256}, the bag's is {verdict_sha256}"
        return replace(self, status=UNAUDITED, reasons=(why,))

    def to_json(self) -> dict[str, Any]:
        """As it stands in cell.json."""
        return {
            "status": self.status,
            "audit_sha256": self.audit_sha256,
            "reasons": list(self.reasons),
            "crop": None if self.crop is None else asdict(self.crop),
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
            if (known[0].verdict_sha256, known[0].crop) != (
                admission.verdict_sha256,
                admission.crop,
            ):
                raise InputError(
                    f"is of another verdict or another clip of {entry.name} than {known[1]}",
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
        verdict_sha256=entry.verdict_sha256,
        crop=None if entry.crop is None else Crop(**entry.crop.model_dump()),
    )
