"""Audits of made-up recordings, and cells that a test changes and seals again."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ssp_core.bag.reading.reader import BagReader
from ssp_core.files.writing import write_json
from ssp_core.hashing import sha256_file
from ssp_core.vocabulary import DOMAINS
from ssp_eval.data.audit import FIELDS, Audit
from ssp_eval.data.provenance import Provenance, read_provenance
from ssp_eval.evaluate.store.cell_file import CELL_FILE, HASHED, sealed

CROP = {"start_s": 0.0, "end_s": 9.0, "chosen_by": "METHOD 4.1"}


def facts_of(bag: Path) -> Provenance:
    with BagReader(bag) as reader:
        return read_provenance(reader)


def entry(domain: str, status: str, **more: Any) -> dict[str, Any]:
    reason = {"code": "safety_abort", "text": "safety abort", "detail": "separation at 7.10 s"}
    times = {"trigger": 4.0, "conflict": 4.5, "resolution": 6.0}
    sight = {"fraction": 1.0, "needed": 0.9, "how": "projected"}
    value = {
        "domain": domain,
        "name": f"r-{domain}",
        "bag": "bag",
        "bag_sha256": f"sha256:{domain}",
        "origin": "made up",
        "stand_in": False,
        "evidence": "states",
        "measured_from": "ticks",
        "domain_said_by": "somebody",
        "log_said_by": "somebody",
        "crop": CROP,
        "scenario": "cut_in",
        "event_version": "sha256:1",
        "task_version": None,
        "status": status,
        "reasons": [{**reason, "consequences": []}] if status == "refused" else [],
        "properties": {
            name: {"source": "states", "words": {"it": ["is"]}, "how": "", "equal": None}
            for name in FIELDS
        },
        "kpr": 1.0,
        "epd": 0.0,
        "coverage": {"source": "projection", "participants": {"ot1": sight}, "zone": sight},
        **more,
    }
    crop = value["crop"]
    length_s = crop["end_s"] - crop["start_s"]
    value["phases"] = {
        "source": "states",
        "start_s": crop["start_s"],
        "end_s": crop["end_s"],
        **{f"{k}_s": t_s for k, t_s in times.items()},
        "phi": {k: (t_s - crop["start_s"]) / length_s for k, t_s in times.items()},
    }
    return value


def audit_file(
    path: Path, status: str, *bags: Path | str, others: str | None = None, **more: Any
) -> Path:
    """An audit in which the bags have this status, and made-up recordings those that follow.

    Args:
        path: of the file.
        status: of the bags.
        bags: recordings, or a hash that is a simulation's.
        others: status of the rest.
        more: of the bags' entries; crop and event version of all.
    """
    others = others or {"unpaired": "refused", "refused": "unpaired"}.get(status, status)
    known: dict[str, dict[str, Any]] = {}
    same = {k: more[k] for k in ("crop",) if k in more}
    for bag in bags:
        if isinstance(bag, str):
            known["simulation"] = {"bag_sha256": bag}
            continue
        told = facts_of(bag)
        same["event_version"] = told.event_version
        names = ("bag_sha256", "scenario", "origin", "stand_in", "verdict", "verdict_sha256")
        known[told.domain] = {name: getattr(told, name) for name in names}
    values = [
        entry(d, status, **{**same, **known[d], **more}) if d in known else entry(d, others, **same)
        for d in DOMAINS
    ]
    audit = Audit.model_validate(
        {
            "schema": "ssp.audit/2",
            "software": "ssp",
            "scenario": "cut_in",
            "event_version": same.get("event_version", "sha256:1"),
            "weights": dict.fromkeys(FIELDS, 1.0),
            "thresholds": {},
            "recordings": values,
        }
    )
    assert audit.contradiction() is None
    write_json(path, audit.model_dump(mode="json", by_alias=True))
    return path


def resealed(folder: Path, change: Callable[[dict[str, Any]], object] = lambda facts: None) -> None:
    """Changes a cell.json, and lets it name what lies beside it now, as an evaluation would."""
    facts = json.loads((folder / CELL_FILE).read_text())
    there = {(folder / name).stem: folder / name for name in HASHED if (folder / name).is_file()}
    facts["hashes"] |= {key: sha256_file(file) for key, file in there.items()}
    change(facts)
    write_json(folder / CELL_FILE, sealed(facts))
