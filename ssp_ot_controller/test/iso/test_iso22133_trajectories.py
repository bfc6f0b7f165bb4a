"""References as trajectories of ISO 22133, and back."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.clock import NS_PER_S
from ssp_core.geodesy import Datum, Place
from ssp_core.motion.reference import Points, Reference, ReferencePoint, sample
from ssp_ot_controller.bodies.iso22133.framing import (
    LONGEST_TRAJECTORY_BYTES,
    Frame,
    Reason,
    RejectedBytes,
    StreamDecoder,
)
from ssp_ot_controller.bodies.iso22133.messages import (
    DecodedMessage,
    Traj,
    TrajectoryInfo,
    TrajPoint,
    decode,
    encode,
)
from ssp_ot_controller.bodies.iso22133.trajectories import (
    POINT_STEP_NS,
    points_of,
    trajectory_of,
)
from ssp_ot_controller.objects.references import contradiction
from tests.support.states import make_reference

MS = 1_000_000
T0 = 1_790_000_000 * NS_PER_S
FLAT = Datum(Place(57.7779, 12.7810, 201.5))
TURNED = replace(FLAT, yaw_rad=2.0)


def over_the_wire(trajectory: Traj) -> Traj:
    (frame,) = StreamDecoder(LONGEST_TRAJECTORY_BYTES).feed(encode(trajectory))
    assert isinstance(frame, Frame)
    found = decode(frame)
    assert isinstance(found, DecodedMessage)
    assert isinstance(found.message, Traj)
    return found.message


def bend(execute_at_ns: int = T0, speed_mps: float = 8.0, curvature_1pm: float = 0.02) -> Reference:
    """Drives on a circle and brakes at 2 m/s² to a standstill, a point about every 0.1 s."""
    points = []
    for t in np.linspace(0.0, speed_mps / 2.0, round(speed_mps * 5.0) + 1).tolist():
        way = speed_mps * t - t * t
        yaw = curvature_1pm * way
        x, y = math.sin(yaw) / curvature_1pm, (1.0 - math.cos(yaw)) / curvature_1pm
        points.append(ReferencePoint(t, x, y, yaw, speed_mps - 2.0 * t, -2.0, curvature_1pm))
    return make_reference(points, execute_at_ns=execute_at_ns)


@given(
    st.integers(0, 20_000),
    st.floats(2.0, 14.0),
    st.floats(-0.05, 0.05).filter(lambda curvature: abs(curvature) > 1e-4),
    st.floats(-math.pi, math.pi),
)
@settings(max_examples=25)
def test_a_reference_drives_the_same_way_after_the_wire(
    later_ms: int, speed_mps: float, curvature_1pm: float, yaw_rad: float
) -> None:
    datum = replace(FLAT, yaw_rad=yaw_rad)
    sent = bend(T0 + later_ms * MS, speed_mps, curvature_1pm)
    points = points_of(over_the_wire(trajectory_of(sent, T0, datum, 7)), datum)
    assert isinstance(points, Points)
    assert contradiction(points.columns) is None
    came = replace(sent, execute_at_ns=T0, points=points)
    for at_ns in range(T0 + int(points.columns[0][0] * 1000) * MS, came.end_ns, 37 * MS):
        a, b = sample(sent, at_ns), sample(came, at_ns)
        assert math.hypot(a.x_m - b.x_m, a.y_m - b.y_m) < 0.002
        assert math.remainder(a.yaw_rad - b.yaw_rad, 2 * math.pi) == pytest.approx(0.0, abs=2e-4)
        assert a.speed_mps == pytest.approx(b.speed_mps, abs=0.12)


def test_points_lie_on_a_grid_and_end_with_a_standstill() -> None:
    reference = bend(T0 + 1_234 * MS)
    trajectory = trajectory_of(reference, T0, FLAT, 7)
    steps = [round(point.t_s * NS_PER_S) for point in trajectory.points]
    first = -(-1234 * MS // POINT_STEP_NS) * POINT_STEP_NS
    assert steps == list(range(first, steps[-1] + 1, POINT_STEP_NS))
    assert 0 <= T0 + steps[-1] - reference.end_ns < POINT_STEP_NS
    assert trajectory.points[-1].speed_mps == 0.0
    assert (trajectory.info, trajectory.line_info) == (TrajectoryInfo.RELATIVE_TO_ORIGIN, 4)


@given(st.lists(st.integers(0, 4_500), min_size=1, max_size=6))
def test_parts_one_after_the_other_are_the_whole(cuts_ms: list[int]) -> None:
    reference = bend()
    edges = [T0, *(T0 + cut * MS for cut in sorted(cuts_ms)), reference.end_ns + POINT_STEP_NS]
    parts = [
        point
        for a, b in pairwise(edges)
        for point in trajectory_of(reference, T0, FLAT, 7, from_ns=a, to_ns=b).points
    ]
    assert tuple(parts) == trajectory_of(reference, T0, FLAT, 7).points


def test_an_adapted_reference_has_its_points_at_the_same_times() -> None:
    """So that an object which takes points by their time replaces the old ones."""
    old = {point.t_s for point in trajectory_of(bend(), T0, FLAT, 7).points}
    adapted = bend(T0 + 731 * MS, speed_mps=6.0)
    new = {point.t_s for point in trajectory_of(adapted, T0, FLAT, 8).points}
    assert {t for t in new if t <= max(old)} <= old


def test_a_site_that_is_turned_is_told_in_east_and_north() -> None:
    straight = make_reference(
        [ReferencePoint(0.1 * n, 0.5 * n, 0.0, 0.0, 5.0, 0.0, 0.0) for n in range(11)],
        execute_at_ns=T0,
    )
    last = trajectory_of(straight, T0, TURNED, 1).points[-1]
    assert (last.x_m, last.y_m) == pytest.approx((5.0 * math.cos(2.0), 5.0 * math.sin(2.0)))
    assert last.yaw_rad == pytest.approx(2.0)


def test_a_reference_from_before_the_start_is_refused_and_long_names_are_cut() -> None:
    with pytest.raises(ValueError, match=r"begins 0\.001 s before the start"):
        trajectory_of(bend(T0), T0 + MS, FLAT, 7)
    named = replace(bend(), reference_id="ü" * 40)
    assert over_the_wire(trajectory_of(named, T0, FLAT, 7)).name == "ü" * 31


def traj(*points: TrajPoint, info: int = 2) -> Traj:
    return Traj(1, info, "", points)


def point(t_s: float, **changes: Any) -> TrajPoint:
    base = TrajPoint(t_s, 5.0 * t_s, 0.0, 0.0, 0.0, 5.0, None, None, None, None)
    return replace(base, **changes)


@pytest.mark.parametrize(
    ("trajectory", "reason"),
    [
        (traj(point(0.0), point(1.0), info=1), Reason.ITEM),
        (traj(point(0.0)), Reason.MISSING),
        (traj(point(0.0), point(1.0, yaw_rad=None)), Reason.MISSING),
        (traj(point(0.0), point(1.0, speed_mps=None)), Reason.MISSING),
        (traj(point(0.0), point(1.0), point(1.0)), Reason.ORDER),
    ],
)
def test_a_trajectory_that_cannot_be_driven_says_why(trajectory: Traj, reason: Reason) -> None:
    found = points_of(trajectory, FLAT)
    assert isinstance(found, RejectedBytes)
    assert found.reason is reason


def test_what_a_trajectory_states_is_kept() -> None:
    points = [point(t, acceleration_mps2=-0.7, curvature_1pm=0.03) for t in (0.0, 0.5)]
    found = points_of(traj(*points), FLAT)
    assert isinstance(found, Points)
    assert found.columns[5:].tolist() == [[-0.7, -0.7], [0.03, 0.03]]


def test_what_a_trajectory_does_not_state_is_taken_from_speeds_and_yaws() -> None:
    points = [point(t, speed_mps=5.0 - t, yaw_rad=0.1 * t) for t in (0.0, 0.5, 1.0, 1.5)]
    found = points_of(traj(*points), FLAT)
    assert isinstance(found, Points)
    assert np.allclose(found.columns[5], -1.0)
    assert np.allclose(found.columns[6], 0.1 / (5.0 - found.columns[0]))
