"""Three recordings of sessions: each is held against the K* and not against itself (METHOD 4)."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path

import pytest

from ssp_core.errors import InputError
from ssp_core.hashing import sha256_file
from ssp_core.vocabulary import DOMAINS
from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.audit.judge import judge, judge_files
from ssp_scenario_manager.event_spec.load import load_event


def test_what_lies_beside_the_recording_is_bound_by_hash(make_bag: Callable[..., Path]) -> None:
    bags = [
        make_bag(f"{domain}/bag", domain=domain, told=domain != "physical") for domain in DOMAINS
    ]
    entries = judge([read_recording(bag) for bag in bags], load_event("cut_in")[0]).audit.recordings
    assert [e.labels for e in entries] == [None] * 3
    assert [e.verdict for e in entries] == ["valid"] * 3
    told = sha256_file(bags[0] / "verdict.json")
    assert [e.verdict_sha256 for e in entries] == [told, told, None]
    missing = [[r.code for r in e.reasons if r.code == "verdict_missing"] for e in entries]
    assert missing == [[], [], ["verdict_missing"]]
    named = judge([read_recording(next(b.glob("*.mcap"))) for b in bags]).audit.recordings
    assert [e.name for e in named] == [e.name for e in entries] == list(DOMAINS)


def test_a_synthetic_session_is_held_against_the_event(make_bag: Callable[..., Path]) -> None:
    # One lane, and the OT comes from the right of it: three times the same, never the event.
    bags = [make_bag(f"{domain}/bag", domain=domain) for domain in DOMAINS]
    audit = judge([read_recording(bag) for bag in bags], load_event("cut_in")[0]).audit
    codes = {
        found.code
        for reason in audit.recordings[0].reasons
        for found in (reason, *reason.consequences)
    }
    assert {"topology_differs", "place_differs"} <= codes
    assert [recording.kpr for recording in audit.recordings] == [1.0, 1.0, 1.0]


@pytest.mark.parametrize("steps", [3, 4], ids=["before its states are read", "after that"])
def test_a_bag_that_is_changed_after_its_seal_was_checked_is_refused(
    steps: int, make_bag: Callable[..., Path]
) -> None:
    bags = [make_bag(f"{one}/bag", domain=one, duration_s=1.0) for one in DOMAINS]
    other = make_bag("other/bag", domain=DOMAINS[0], duration_s=2.0)
    read = []

    def step() -> None:
        read.append(1)
        if len(read) == steps:
            os.replace(next(other.glob("*.mcap")), next(bags[0].glob("*.mcap")))

    def audit() -> None:
        for one in judge_files(bags, on_step=step).examined:
            one.whole.files.check_same()

    with pytest.raises(InputError, match="was changed while it was read"):
        audit()
