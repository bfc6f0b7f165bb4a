"""Twins as they lie beside a recording, of bags that a test made itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ssp_core.files.writing import write_json
from ssp_eval.recordings.clip import Clip
from ssp_eval.twins.files import (
    SET_FILE,
    TwinAudit,
    TwinIdentity,
    TwinRecord,
    TwinSet,
    bag_of,
    twins_folder,
)


def bag_sha256(bag: Path) -> str:
    with Clip(bag) as clip:
        return clip.provenance.bag_sha256


def audit_of_twin(*reasons: str) -> TwinAudit:
    """An audit that holds, or one that doesn't for these reasons."""
    values: dict[str, Any] = dict.fromkeys(TwinAudit.model_fields, 0)
    values |= {"holds": not reasons, "reasons": list(reasons), "outside_judged": True}
    values |= {name: {} for name in ("messages_changed", "messages_missing")}
    return TwinAudit(**values)


def write_twin_set(bag: Path, audits: Mapping[str, TwinAudit]) -> TwinSet:
    """Writes ``twin_set.json`` of the twins whose bags lie beside a recording.

    Args:
        audits: by the twins' names.
    """
    of = bag_sha256(bag)
    twins = []
    for name, audit in audits.items():
        kind, _, rest = name.partition(".")
        identity = TwinIdentity(
            name=name,
            kind=kind,
            object_id=rest.partition(".")[0],
            value=0.0,
            words=f"with {name}",
            of="bag",
            of_sha256=of,
            seed=1,
            software="a test",
        )
        digest = bag_sha256(bag_of(bag, name))
        twins.append(TwinRecord(identity=identity, audit=audit, bag_sha256=digest))
    found = TwinSet(of="bag", of_sha256=of, twins=twins)
    write_json(twins_folder(bag) / SET_FILE, found.model_dump(mode="json", by_alias=True))
    return found
