"""Replay, extraction, metrics and reports of SSP.

Its public API is what ``PUBLIC`` names; docs/api.md describes it.
"""

from typing import Any

from ssp_core.public_names import public_name

# Loaded when they are asked for, so that a node or command pays for what it uses alone.
PUBLIC = {
    "Extractor": "ssp_eval.extract.combined.extractor",
    "examine": "ssp_eval.audit.examine",
    "load_audit": "ssp_eval.data.audit",
    "load_labels": "ssp_eval.data.labels",
    "load_records": "ssp_eval.data.records",
    "read_recording": "ssp_eval.audit.evidence.recording",
    "score_cell": "ssp_eval.score.cell",
}


def __getattr__(name: str) -> Any:
    return public_name(__name__, PUBLIC, name)
