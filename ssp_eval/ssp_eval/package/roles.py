"""What a file is, from its content; from its name only where the content doesn't say."""

from __future__ import annotations

import json
from pathlib import Path, PurePosixPath
from typing import Any

from ssp_core.bag.metadata import ROOT_KEY
from ssp_core.errors import InputError
from ssp_core.files import MAX_TEXT_BYTES, parse_mapping
from ssp_eval.audit.model import SCHEMA as AUDIT_SCHEMA
from ssp_eval.evaluate.cell_file import CELL_FILE, RECORDS_FILE, SCORE_FILE
from ssp_eval.evaluate.store import RAW_FILE, REQUESTS_FILE
from ssp_eval.labels.template import SCHEMA as LABELS_SCHEMA
from ssp_eval.package.model import Role
from ssp_eval.recordings.observation import SCHEMA as OBSERVATION_SCHEMA
from ssp_scenario_manager.compile.task import SCHEMA as TASK_SCHEMA
from ssp_scenario_manager.event_spec.model import SCHEMA as EVENT_SCHEMA

_BY_SCHEMA: dict[str, Role] = {
    EVENT_SCHEMA: "event",
    "ssp.site/1": "site",
    "ssp.shortlist/1": "shortlist",
    TASK_SCHEMA: "task",
    "ssp.run/1": "run",
    LABELS_SCHEMA: "labels",
    "ssp.proposal/1": "proposal",
    OBSERVATION_SCHEMA: "observation",
    AUDIT_SCHEMA: "audit",
    "ssp.cell/1": "cell",
    "ssp.result/1": "result",
    "ssp.verdict/1": "verdict",
    "ssp.truth/1": "truth",
    "ssp.log/1": "log",
}
_BY_SUFFIX: dict[str, Role] = {
    ".mcap": "recording",
    ".mp4": "video",
    ".avi": "video",
    ".mkv": "video",
    ".mov": "video",
    ".webm": "video",
    ".m4v": "video",
    ".xodr": "map",
    ".html": "page",
}
# These have no schema of their own, or not in every line.
_IN_A_CELL: dict[str, Role] = {
    RAW_FILE: "raw",
    REQUESTS_FILE: "requests",
    RECORDS_FILE: "records",
    SCORE_FILE: "score",
}


def role_of(path: str, file: Path, in_a_cell: bool) -> Role:
    """What a file is.

    Args:
        path: that it had.
        file: where its bytes lie.
        in_a_cell: a cell.json lies beside it.
    """
    name = PurePosixPath(path).name
    suffix = PurePosixPath(name).suffix.lower()
    if in_a_cell and name in _IN_A_CELL:
        return _IN_A_CELL[name]
    if name.endswith(".net.xml"):
        return "map"
    if suffix in _BY_SUFFIX:
        return _BY_SUFFIX[suffix]
    if suffix in (".jpg", ".jpeg") and PurePosixPath(path).parent.name == "frames":
        return "frame"
    if suffix in (".json", ".yaml", ".yml"):
        return _of_mapping(_mapping(file, path))
    if suffix == ".jsonl":
        return _of_mapping(_first_line(file))
    return "other"


def is_cell_folder(names: frozenset[str]) -> bool:
    """True where the files of a folder are those of a cell."""
    return CELL_FILE in names


def _of_mapping(value: dict[str, Any]) -> Role:
    if ROOT_KEY in value:
        return "bag_metadata"
    return _BY_SCHEMA.get(str(value.get("schema")), "other")


def _mapping(file: Path, path: str) -> dict[str, Any]:
    """Empty where the file holds none: it is evidence all the same, of nothing known here."""
    try:
        with file.open("rb") as stream:
            data = stream.read(MAX_TEXT_BYTES + 1)
        return parse_mapping(data, path)
    except InputError:
        return {}


def _first_line(file: Path) -> dict[str, Any]:
    with file.open("rb") as stream:
        line = stream.readline(MAX_TEXT_BYTES)
    try:
        value = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return value if isinstance(value, dict) else {}
