"""A later event kind, from its clip over sessions on two sites to labels, audit and scores."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from ssp_core.bag.operations.check import check_bag
from ssp_eval.twins.files import read_set
from tests.system.live.scored import admitted_and_scored
from tests.system.recordings import Recordings, ssp

# Of the demonstration, test_demo.py judges cut_in and vru_crossing.
KINDS = (
    "crossing_car",
    "cut_out",
    "merge",
    "oncoming_turn",
    "roundabout",
    "slow_lead",
    "vut_turn",
)


@pytest.mark.parametrize("event", KINDS)
def test_it_is_admitted_in_all_domains_and_scored_alike(
    recordings: Recordings, event: str, tmp_path: Path
) -> None:
    physical = tmp_path / "physical"
    shutil.copytree(recordings.get(event, "physical"), physical)
    audit = admitted_and_scored(recordings, event, physical, tmp_path)
    for entry in audit.recordings:
        assert entry.kpr == 1.0
        assert entry.epd is not None
        assert entry.epd < 0.05
    assert ssp("twins", tmp_path / "simulation", "--change", "without=ot1") == 0
    found = read_set(tmp_path / "simulation" / "bag")
    assert found is not None
    (twin,) = found.twins
    assert twin.audit.holds
    assert twin.audit.frames_redrawn_alike == twin.audit.frames > 50
    assert (twin.audit.outside_px, twin.audit.outside_judged) == (0, True)
    assert check_bag(tmp_path / "simulation" / "twins" / "without.ot1" / "bag").ok
