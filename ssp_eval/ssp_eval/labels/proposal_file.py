"""Proposed labels on disk, and how one knows later whether a person has looked them over.

The schema of labels is closed, so the mark stands in a sidecar: ``labels.proposal.json`` beside
``labels.json`` names the hash of the file that was proposed, the phases that were measured, the
clip (METHOD 4.1), and the source. Labels whose hash the sidecar still names are unreviewed; whoever
reviews them edits them, removes the sidecar, or goes through them with ``ssp spec review``. While
such a review goes on, the sidecar lists what was decided so far, and the labels stay unreviewed
until all of it is.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ssp_core.errors import InputError
from ssp_core.files import read_mapping, write_json
from ssp_core.hashing import sha256_file
from ssp_eval.labels.model import Labels, labels_to_json
from ssp_eval.labels.proposal.propose import Proposal

SCHEMA = "ssp.proposal/1"
# Key of the sidecar of labels that are under review: the fields that were decided.
_DECIDED = "decided"


def sidecar(labels: Path) -> Path:
    """Where the mark of a labels file stands."""
    return labels.with_name(f"{labels.stem}.proposal.json")


@dataclass(frozen=True)
class NewFile:
    """A labels file or template that is to be written.

    Args:
        path: where.
        content: of METHOD 5.2.
        mark: what its sidecar says besides its hash; None: it has none, as a template.
    """

    path: Path
    content: Mapping[str, Any]
    mark: Mapping[str, Any] | None = None


def proposed_file(path: Path, proposal: Proposal, source: str) -> NewFile:
    """Proposed labels and their mark, to be written.

    Args:
        path: the labels file.
        proposal: labels, measured event and clip.
        source: hash or name of what they were made from.
    """
    mark = {"source": source, "event": asdict(proposal.event), "crop": asdict(proposal.crop)}
    return NewFile(path, labels_to_json(proposal.labels), mark)


def write_files(files: Sequence[NewFile]) -> None:
    """Writes all files and their marks, or none of them."""
    staged: list[tuple[Path, Path]] = []
    try:
        for file in files:
            labels = file.path.with_name(f".{file.path.name}.new")
            staged.append((labels, file.path))
            write_json(labels, file.content)
            if file.mark is not None:
                mark, digest = sidecar(labels), sha256_file(labels)
                staged.append((mark, sidecar(file.path)))
                write_json(mark, {"schema": SCHEMA, "labels_sha256": digest, **file.mark})
        for file in files:
            if file.mark is None:  # of a proposal that this file replaces
                sidecar(file.path).unlink(missing_ok=True)
        for made, target in staged:
            made.replace(target)
    finally:
        for made, _ in staged:
            made.unlink(missing_ok=True)


def write_proposal(path: Path, proposal: Proposal, source: str) -> None:
    """Writes proposed labels and their mark; see proposed_file."""
    write_files([proposed_file(path, proposal, source)])


def is_unreviewed(path: Path) -> bool:
    """True for labels that stand as they were proposed, or whose review isn't finished.

    Raises:
        InputError: the sidecar can't be read.
    """
    mark = sidecar(path)
    if not mark.is_file():
        return False
    value = read_mapping(mark)
    return _DECIDED in value or value.get("labels_sha256") == sha256_file(path)


def decided_fields(path: Path) -> frozenset[str]:
    """Fields that an unfinished review has decided, such as ``labels[3]``.

    Raises:
        InputError: the sidecar can't be read.
    """
    value = read_mapping(sidecar(path)).get(_DECIDED, [])
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise InputError(
            "must be a list of fields", file=sidecar(path), field=_DECIDED, value=value
        )
    return frozenset(value)


def write_decided(path: Path, labels: Labels, decided: Iterable[str]) -> None:
    """Writes labels under review; the mark first, so that they never look reviewed before they are.

    Args:
        path: the labels file, with a sidecar.
        labels: as decided so far.
        decided: fields that are.
    """
    mark: dict[str, Any] = read_mapping(sidecar(path))
    mark[_DECIDED] = sorted(decided)
    write_json(sidecar(path), mark)
    write_json(path, labels_to_json(labels))
    mark["labels_sha256"] = sha256_file(path)
    write_json(sidecar(path), mark)


def confirm(path: Path) -> None:
    """Takes the mark off: a person has decided every label."""
    sidecar(path).unlink(missing_ok=True)
