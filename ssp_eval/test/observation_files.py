"""Observations as a person would write them of the recordings of conftest.py."""

from __future__ import annotations

from copy import deepcopy
from pathlib import Path
from typing import Any

from ssp_core.bag.reading.reader import BagReader
from ssp_core.files.writing import write_json
from ssp_eval.data.provenance import read_provenance
from ssp_eval.observations.files import Footage, sealed_observation, write_observation
from ssp_eval.observations.model import REASONS
from ssp_eval.recordings.states import frame_times

NOW = "2026-03-02T10:00:00Z"
ALL = [[5, 90]]


def footage_of(bag: Path) -> Footage:
    """The frames of a recording, by their clip times."""
    with BagReader(bag) as reader:
        provenance = read_provenance(reader)
        frames_s, _ = frame_times(reader, provenance)
    return Footage(provenance.bag_sha256, frames_s)


def answers() -> dict[str, Any]:
    """Return the observation of a shipped cut_in: two lanes, a car comes over from the left."""
    return {
        "schema": "ssp.observation/1",
        "recording": None,
        "bag_sha256": None,
        "scenario": "cut_in",
        "event_version": None,
        "who": "Ada Vance",
        "role": "reviewer",
        "when": None,
        "remark": None,
        "topology": {
            "segment": "straight",
            "lanes_same_direction": 2,
            "lanes_opposite": 2,
            "vut_lane": "rightmost",
            "road_type": "urban",
            "left_boundary": "kerb",
            "right_boundary": "kerb",
            "frames": [5],
        },
        "roles": {
            "participants": {
                "vut": {"role": "VUT", "class": "car"},
                "ot1": {"role": "OT", "class": "car", "starts_in": "left_lane"},
            },
            "initiator": "ot1",
            "affected": "vut",
            "frames": [5, 40],
        },
        "dominant_motion": {"value": "cutting_in_from_left", "frames": [[35, 60]]},
        "conflict_type": {"value": "merge", "frames": [45]},
        "passing_order": {"value": ["ot1", "vut"], "frames": [50]},
        "phases": {
            "start_s": None,
            "end_s": None,
            "trigger": {"t_s": 3.2, "frames": [37]},
            "conflict": {"t_s": 4.0, "frames": [45]},
            "resolution": {"t_s": 7.0, "frames": [75]},
        },
        "identity_stable": {"value": True, "frames": ALL},
        "source_gate": {reason: {"value": False, "frames": ALL} for reason in REASONS},
        "visibility": {
            "participants": {"ot1": {"value": "throughout", "frames": ALL}},
            "conflict_region": {"value": 0.9, "frames": ALL},
        },
        "log": {"safety_abort": False, "identity_switch": False, "site_changes": []},
    }


def changed(path: str, value: Any, content: dict[str, Any] | None = None) -> dict[str, Any]:
    """The answers with another value at a path; KeyError where there is none."""
    found = deepcopy(answers() if content is None else content)
    *before, last = path.split(".")
    place = found
    for part in before:
        place = place[part]
    if last not in place:
        raise KeyError(path)
    place[last] = value
    return found


def seal(bag: Path, path: Path, content: dict[str, Any]) -> Path:
    """Writes a sealed observation of a bag."""
    write_json(path, content)
    write_observation(path, sealed_observation(path, footage_of(bag), bag.name, NOW))
    return path
