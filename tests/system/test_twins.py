"""Twins of a session as its nodes recorded it."""

from __future__ import annotations

import shutil
from pathlib import Path

from ssp_core.bag.operations.check import check_bag
from ssp_eval.twins.files import read_set
from tests.system.recordings import Recordings, ssp


def test_a_recorded_session_has_a_twin_that_differs_in_its_cause_alone(
    recordings: Recordings, tmp_path: Path
) -> None:
    run = tmp_path / "run"
    shutil.copytree(recordings.get("cut_in", "simulation") / "bag", run / "bag")
    assert ssp("twins", run, "--change", "without=ot1") == 0
    found = read_set(run / "bag")
    assert found is not None
    (twin,) = found.twins
    assert twin.audit.frames_redrawn_alike == twin.audit.frames > 100
    assert (twin.audit.outside_px, twin.audit.outside_judged) == (0, True)
    assert check_bag(run / "twins" / "without.ot1" / "bag").ok
