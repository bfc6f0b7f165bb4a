"""Proposed labels on disk, and how one knows later whether a person has looked them over.

The schema of labels is closed, so the mark stands in a sidecar: ``labels.proposal.json`` beside
``labels.json`` names the hash of the file that was proposed, the phases that were measured, and
the source. Labels whose hash the sidecar still names are unreviewed; whoever reviews them edits
them, or removes the sidecar.
"""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

from ssp_core.files import read_mapping, write_json
from ssp_core.hashing import sha256_file
from ssp_eval.labels.model import labels_to_json
from ssp_eval.labels.propose import Proposal

SCHEMA = "ssp.proposal/1"


def sidecar(labels: Path) -> Path:
    """Where the mark of a labels file stands."""
    return labels.with_name(f"{labels.stem}.proposal.json")


def write_proposal(path: Path, proposal: Proposal, source: str) -> None:
    """Writes proposed labels and their mark.

    Args:
        path: the labels file.
        proposal: labels and measured event.
        source: hash or name of what they were made from.
    """
    write_json(path, labels_to_json(proposal.labels))
    mark = {
        "schema": SCHEMA,
        "labels_sha256": sha256_file(path),
        "source": source,
        "event": asdict(proposal.event),
    }
    write_json(sidecar(path), mark)


def is_unreviewed(path: Path) -> bool:
    """True for labels that stand as they were proposed.

    Raises:
        InputError: the sidecar can't be read.
    """
    mark = sidecar(path)
    if not mark.is_file():
        return False
    return read_mapping(mark).get("labels_sha256") == sha256_file(path)
