"""The time that the disk lasts, and its consequences for a recording."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.run_file.model import RunSpec
from ssp_monitor.recorder.disk import (
    LEAST_S,
    RATE_WINDOW_S,
    WARN_S,
    DiskNeeds,
    WriteRate,
    expected_rate,
    free_bytes,
    outlook,
)

MB = 1_000_000
NEEDS = DiskNeeds(reserve_bytes=100 * MB, run_s=40.0, rate_bps=2.0 * MB)


def test_room_enough_is_worth_no_word():
    found = outlook(10_000 * MB, 1.0 * MB, NEEDS)
    assert (found.left_s, found.ends, found.unready, found.warning) == (9900.0, None, None, None)
    assert outlook(10_000 * MB, 0.0, NEEDS).left_s == math.inf


@pytest.mark.parametrize("free", [0, 99 * MB, 100 * MB])
def test_less_than_the_reserve_ends_a_recording(free):
    for rate in (0.0, 5.0 * MB):
        found = outlook(free, rate, NEEDS)
        assert found.left_s == 0.0
        assert found.ends == f"the disk has {free / 1e6:.1f} MB, the reserve is 100.0 MB"
        assert found.unready == found.warning == found.ends


def test_a_disk_that_is_full_soon_ends_a_recording():
    rate = 10.0 * MB
    just = 100 * MB + round(rate * LEAST_S)
    assert outlook(just, rate, NEEDS).ends is None
    found = outlook(just - 1, rate, NEEDS)
    assert found.ends == "the disk is full in 20 s, limit 20 s: 300.0 MB left"


def test_a_run_that_would_not_fit_does_not_begin():
    just = 100 * MB + 80 * MB
    assert outlook(just, 0.0, NEEDS).unready is None
    found = outlook(just - 1, 0.0, NEEDS)
    assert found.ends is None
    assert found.unready == (
        "the disk has 180.0 MB, the run may need 80.0 MB (40 s at 2.0 MB/s) "
        "over 100.0 MB in reserve"
    )
    # What is really written counts when it is more than what was expected.
    assert outlook(just, 3.0 * MB, NEEDS).unready is not None


def test_people_are_told_in_time():
    needs = DiskNeeds(reserve_bytes=0)
    assert outlook(round(WARN_S * MB), 1.0 * MB, needs).warning is None
    found = outlook(round(WARN_S * MB) - 1, 1.0 * MB, needs)
    assert (found.ends, found.unready) == (None, None)
    assert found.warning == "the disk is full in 600 s: 600.0 MB left at 1.0 MB/s"


def test_a_disk_that_can_not_be_asked_is_no_end():
    found = outlook(None, 1.0, NEEDS)
    assert (found.ends, found.unready) == (None, None)
    assert found.warning == "the free space of the disk is unknown"


@given(st.integers(0, 10**13), st.integers(0, 10**13), st.floats(0, 1e9), st.integers(0, 10**12))
def test_more_room_is_never_worse(free, more, rate, reserve):
    needs = DiskNeeds(reserve, 40.0, 1e6)
    less, greater = outlook(free, rate, needs), outlook(free + more, rate, needs)
    assert greater.left_s >= less.left_s
    for verdict in ("ends", "unready", "warning"):
        assert getattr(greater, verdict) is None or getattr(less, verdict) is not None
    assert less.unready is not None or less.ends is None


def test_the_rate_is_that_of_the_last_seconds():
    rate = WriteRate()
    assert rate.note(0.0, 0) == 0.0
    assert rate.note(1.0, 10) == 10.0 / RATE_WINDOW_S
    for k in range(2, 40):
        latest = rate.note(float(k), 10 + 100 * (k - 1))
    assert latest == 100.0
    assert rate.note(40.0 + RATE_WINDOW_S, 10 + 100 * 38) < 100.0
    assert rate.note(40.0 + 3 * RATE_WINDOW_S, 10 + 100 * 38) == 0.0


def test_one_burst_at_the_beginning_is_no_rate():
    rate = WriteRate()
    rate.note(0.0, 0)
    burst = rate.note(0.1, 50 * MB)
    assert burst == 50 * MB / RATE_WINDOW_S
    free = NEEDS.reserve_bytes + 1000 * MB
    assert outlook(free, burst, NEEDS).ends is None
    assert outlook(NEEDS.reserve_bytes, rate.note(0.2, 50 * MB), NEEDS).ends is not None


def test_a_camera_and_objects_are_expected(run_mapping):
    run = RunSpec.model_validate(run_mapping)
    bare = run.model_copy(update={"camera": None})
    assert run.camera is not None
    pixels = run.camera.width_px * run.camera.height_px * run.camera.rate_hz
    assert expected_rate(run) - expected_rate(bare) == pytest.approx(0.3 * pixels)
    assert expected_rate(bare) == pytest.approx(3 * 1500 / run.step_s)


def test_free_space_is_asked_of_the_file_system(tmp_path):
    assert (free_bytes(tmp_path) or 0) > 0
    assert free_bytes(tmp_path / "nowhere") is None
