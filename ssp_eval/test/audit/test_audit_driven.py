"""A driven session is of no domain: the audit admits none (METHOD 8)."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ssp_eval.audit.evidence.recording import read_recording
from ssp_eval.audit.judge import judge


def test_a_recording_whose_vut_was_led_by_a_driver_is_refused_for_that(
    make_bag: Callable[..., Path],
) -> None:
    bags = [
        make_bag("syn/bag", domain="synthetic"),
        make_bag("sim/bag", driver="oracle"),
        make_bag("phy/bag", domain="physical"),
    ]
    entries = judge([read_recording(bag) for bag in bags]).audit.recordings
    codes = [
        {one.code: one for reason in entry.reasons for one in (reason, *reason.consequences)}
        for entry in entries
    ]
    assert ["driven" in found for found in codes] == [False, True, False]
    assert entries[1].status == "refused"
    assert "oracle" in codes[1]["driven"].detail
