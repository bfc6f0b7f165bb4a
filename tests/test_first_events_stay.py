"""The first four events stay as they were: their K*, source clips and compiled runs.

A change that is meant to change them brings new values here, and a line under *Migration* in
CHANGELOG.md.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import pytest

from ssp_core.hashing import sha256_json
from ssp_ot_controller.camera.storyboards import storyboard
from ssp_scenario_manager.compile.compiler import Request, compile_task
from ssp_scenario_manager.compile.task import Target
from ssp_scenario_manager.event_spec.load import load_event

# Of lengths, times, speeds and angles in SI units, what processors may compute differently.
DIGITS = 6


def as_rounded(value: Any) -> Any:
    """The value with all its floats rounded; what isn't of JSON as text."""
    if isinstance(value, float):
        return round(value, DIGITS) + 0.0
    if isinstance(value, dict):
        return {str(key): as_rounded(one) for key, one in value.items()}
    if isinstance(value, (list, tuple)):
        return [as_rounded(one) for one in value]
    return value if isinstance(value, (str, int, type(None))) else str(value)


def digest(value: Any) -> str:
    return sha256_json(as_rounded(value))[:23]


# By event: version of its K*, its clip of seed 1, and its runs on boulevard and north_track.
FIRST = {
    "cut_in": (
        "sha256:1d8063efbf2a9fe3",
        "sha256:280cfaac6d8b3d06",
        "sha256:07b0537acacec56f",
        "sha256:6c7567f7822adcd4",
    ),
    "lead_braking": (
        "sha256:cb067c48f88c0846",
        "sha256:aa8cdaa0b3ed21df",
        "sha256:28812ead5a94f241",
        "sha256:17eb9bd698ca59d8",
    ),
    "occluded_crossing": (
        "sha256:7cf5817d2088a367",
        "sha256:76ff525bfd190043",
        "sha256:1fc52b04c8e00951",
        "sha256:93a41e9e4b1b8d18",
    ),
    "vru_crossing": (
        "sha256:ea3755c573cfdab9",
        "sha256:b7c3adb6a22f0990",
        "sha256:795e7a22397a51c9",
        "sha256:f75af771cc61da8f",
    ),
}


def compiled(name: str, target: Target, site: str) -> str:
    run = compile_task(Request(event=name, target=target, site=site)).task.run
    return digest(run.model_dump(mode="json", by_alias=True))


@pytest.mark.parametrize("name", sorted(FIRST))
def test_event_clip_and_runs_are_the_same(name: str) -> None:
    board = storyboard(name, 1)
    clip = [[asdict(state) for state in board.states(t_s)] for t_s in board.times()]
    assert (
        load_event(name)[1][: len("sha256:") + 16],
        digest(clip),
        compiled(name, "sumo", "boulevard"),
        compiled(name, "track", "north_track"),
    ) == FIRST[name]
