"""The transfer audit's judgement of a recording that is to be evaluated (METHOD 4).

A recording is known by the hash of its bag. What an audit refused is not evaluated. What is
``unpaired`` or in no audit is, and stays out of domain means.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files.folders import make_folder
from ssp_core.files.writing import write_bytes
from ssp_core.hashing import sha256_file
from ssp_eval.data.audit import AUDIT_FILE, PAGE_FILE, Audit, RecordingEntry, load_audit
from ssp_eval.data.provenance import Provenance
from ssp_eval.recordings.event import Crop

# Where a campaign keeps its audits, each in a folder of its own.
AUDITS = "audits"
ADMITTED, REFUSED, UNPAIRED, UNAUDITED = "admitted", "refused", "unpaired", "unaudited"


@dataclass(frozen=True)
class Admission:
    """The admission of a recording to evaluation.

    Args:
        status: admitted, refused, unpaired, or unaudited where no audit knows the bag.
        audit_sha256: hash of the audit's file, None where there is none.
        reasons: of a refusal, the primary one first; or why an audit doesn't hold any more.
        verdict_sha256: hash of the runner's verdict.json as the audit read it.
        crop: the clip that the audit compared (METHOD 4.1), which is evaluated and nothing else;
            None: the whole recording.
        entry: what the audit says of the recording, None where there is none.
        file: the audit's, None where there is none.
    """

    status: str = UNAUDITED
    audit_sha256: str | None = None
    reasons: tuple[str, ...] = ()
    verdict_sha256: str | None = None
    crop: Crop | None = None
    entry: RecordingEntry | None = field(default=None, repr=False)
    file: Path | None = None

    @property
    def refusal(self) -> str | None:
        """Say why the recording isn't evaluated, None when it is."""
        if self.status != REFUSED:
            return None
        return f"refused by the audit: {'; '.join(self.reasons)}"

    def confirm(
        self, verdict_sha256: str | None, observations: Mapping[str, str] | None = None
    ) -> Admission:
        """Return the admission, if the files that the audit read beside the MCAP file are the same.

        A refusal stays: it needs another audit to be lifted. Whatever else it says isn't said of
        another verdict or observation: the recording is unaudited then.

        Args:
            verdict_sha256: of verdict.json in the bag, None where there is none.
            observations: hash of each observation file of the bag by name, None: not looked for.
        """
        if self.status in (REFUSED, UNAUDITED):
            return self
        why = []
        if verdict_sha256 != self.verdict_sha256:
            why.append(
                f"the audit read the verdict {self.verdict_sha256}, the bag's is {verdict_sha256}"
            )
        audit_observations = self.entry.observations if self.entry is not None else None
        read = {} if audit_observations is None else audit_observations.files
        if observations is not None and observations != read:
            names = sorted(
                n for n in {**read, **observations} if read.get(n) != observations.get(n)
            )
            why.append(f"the audit read other observations: {', '.join(names)}")
        return replace(self, status=UNAUDITED, reasons=tuple(why)) if why else self

    def check_is_of(self, facts: Provenance) -> None:
        """Refuse an audit of another recording under this one's hash.

        Args:
            facts: of the bag that has the hash in the audit.

        Raises:
            InputError: naming audit, field and both values.
        """
        for name in ("domain", "scenario", "event_version", "origin", "stand_in", "verdict"):
            claim, fact = getattr(self.entry, name, None), getattr(facts, name)
            # The verdict may have come later; confirm says so.
            if (
                self.entry is None
                or claim == fact
                or (name == "verdict" and self.verdict_sha256 != facts.verdict_sha256)
            ):
                continue
            raise InputError(
                f"isn't of the recording {facts.name} that it names by its hash: that has {fact}",
                file=self.file,
                field=f"recordings.{facts.domain}.{name}",
                value=claim,
                remedy="make it again with `ssp audit`",
            )

    def to_json(self) -> dict[str, Any]:
        """Return the admission as cell.json has it."""
        return {
            "status": self.status,
            "audit_sha256": self.audit_sha256,
            "reasons": list(self.reasons),
            "crop": None if self.crop is None else asdict(self.crop),
        }


NO_AUDIT = Admission()


def load_admissions(files: Iterable[Path]) -> dict[str, Admission]:
    """Return admissions by the hash of the bag.

    Args:
        files: audits, or folders with an audit.json.

    Raises:
        InputError: a file is no audit, or two audits say different things of one recording.
    """
    admissions: dict[str, tuple[Admission, Path]] = {}
    for file in files:
        audit = load_audit(file)
        path = file / AUDIT_FILE if file.is_dir() else file
        digest = sha256_file(path)
        for entry in audit.recordings:
            admission = replace(admission_of(entry, digest), file=path)
            first = admissions.setdefault(entry.bag_sha256, (admission, file))
            if first[0].status != admission.status:
                raise InputError(
                    f"says {admission.status} of {entry.name}, and {first[1]} says "
                    f"{first[0].status}",
                    file=file,
                    remedy="give the audit that this evaluation is to go by",
                )
            if (first[0].verdict_sha256, first[0].crop) != (
                admission.verdict_sha256,
                admission.crop,
            ):
                raise InputError(
                    f"is of another verdict or another clip of {entry.name} than {first[1]}",
                    file=file,
                    remedy="give the audit that this evaluation is to go by",
                )
    return {bag: admission for bag, (admission, _) in admissions.items()}


def admission_of(entry: RecordingEntry, audit_sha256: str) -> Admission:
    """Read the admission of one recording from an audit's entry."""
    return Admission(
        status=entry.status,
        audit_sha256=audit_sha256,
        reasons=tuple(f"{reason.text} ({reason.detail})" for reason in entry.reasons),
        verdict_sha256=entry.verdict_sha256,
        crop=None if entry.crop is None else Crop(**entry.crop.model_dump()),
        entry=entry,
    )


def audit_statuses(audit: Audit, bag: str | None, verdict_sha256: str | None) -> set[str]:
    """Return an audit's statuses of a recording: one, or none where it doesn't know it."""
    return {
        admission_of(entry, "").confirm(verdict_sha256).status
        for entry in audit.recordings
        if entry.bag_sha256 == bag
    }


def keep_audits(out: Path, admissions: Iterable[Admission]) -> None:
    """Leave the audits that cells go by in the campaign, where the report checks them."""
    archive = audit_files(out)
    files = {a.audit_sha256: a.file for a in admissions if a.file is not None}
    for digest, file in files.items():
        if digest is None or digest in archive:
            continue
        folder = make_folder(out / AUDITS / digest.removeprefix("sha256:")[:16])
        write_bytes(folder / AUDIT_FILE, file.read_bytes())
        page = file.with_name(PAGE_FILE)
        if file.name == AUDIT_FILE and page.is_file():
            write_bytes(folder / PAGE_FILE, page.read_bytes())


def audit_files(out: Path) -> dict[str, Path]:
    """Return the audits in a campaign's folder by hash."""
    return {sha256_file(file): file for file in sorted(out.glob(f"{AUDITS}/*/{AUDIT_FILE}"))}
