"""A reference made ready gives what the reference means."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Polyline
from ssp_core.motion.manoeuvre import drive_along, lane_change
from ssp_core.motion.reference import Reference, ReferencePoint, sample
from ssp_ot_controller.control.tracker import Track
from tests.support.states import make_reference

S = 1_000_000_000
PATH = Polyline([(0.0, 0.0), (120.0, 0.0), (180.0, 60.0)])
START_NS = 3 * S + 7


DRIVE = make_reference(drive_along(PATH, 0.0, 0.0, 12.0, 2.0, 2.0))
CHANGE = make_reference(lane_change(PATH, 5.0, 10.0, 3.5, 2.5, 12.0, 2.0))
# Turns through pi, waits before its first point, and its points are few.
TURN = make_reference(
    (
        ReferencePoint(0.5, 0.0, 0.0, 3.0, 2.0, 0.0, 0.1),
        ReferencePoint(1.0, -1.0, 0.1, -3.1, 2.0, 0.4, 0.0),
        ReferencePoint(3.0, -4.0, -0.2, -3.0, 0.0, -1.0, 0.2),
    )
)


@given(st.sampled_from([DRIVE, CHANGE, TURN]), st.integers(-S, 40 * S))
@settings(max_examples=300, deadline=None)
def test_it_is_what_sampling_the_reference_gives(ref: Reference, after_ns: int) -> None:
    t_ns = START_NS + after_ns
    wanted = sample(ref, t_ns)
    track = Track(ref)
    t_s = track.seconds(t_ns)
    point = track.at(t_s)
    assert point == pytest.approx(
        (
            wanted.x_m,
            wanted.y_m,
            wanted.yaw_rad,
            wanted.speed_mps,
            wanted.acceleration_mps2,
            wanted.curvature_1pm,
        ),
        abs=1e-9,
    )
    assert track.speed_mps(t_s) == pytest.approx(point.speed_mps, abs=1e-12)
    assert track.curvature_1pm(t_s) == pytest.approx(point.curvature_1pm, abs=1e-12)
    (acceleration,) = track.accelerations(np.array([t_s]))
    assert acceleration == pytest.approx(point.acceleration_mps2, abs=1e-9)


def test_what_is_left_of_a_path() -> None:
    track = Track(DRIVE)
    assert track.length_m == pytest.approx(120.0 + math.hypot(60.0, 60.0), abs=0.1)
    assert track.left_m(-1.0, 0.0) == track.length_m
    assert track.left_m(99.0, 0.0) == 0.0
    assert track.left_m(99.0, 0.5) == -0.5
    a, b = DRIVE.points[40], DRIVE.points[41]
    assert track.left_m(a.t_s, 0.0) == pytest.approx(track.length_m - a.x_m, abs=1e-6)
    halfway = track.left_m(0.5 * (a.t_s + b.t_s), 0.25) + 0.25
    assert track.length_m - halfway == pytest.approx(0.5 * (a.x_m + b.x_m), abs=1e-6)
    assert (track.end.x_m, track.end.y_m) == pytest.approx((180.0, 60.0))
