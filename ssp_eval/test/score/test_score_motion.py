"""Reading a trajectory between its samples (METHOD 5.4) and what it does (METHOD 6.6)."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.vocabulary import LAT_ACTIONS
from ssp_eval.data.records import BehaviourRecord
from ssp_eval.score.columns import RecordBlocks
from ssp_eval.score.motion import Motion, feasible, lat_action, lon_action, measure
from ssp_eval.score.thresholds import DEFAULT
from ssp_vla_bridge.trajectory import Trajectory, check_trajectory, interpolate

BENT = Trajectory((-1.0, 0.25, 0.75, 2.0), (-4.0, 1.0, 4.0, 4.0), (0.0, 0.0, 1.0, -4.0))


@pytest.mark.parametrize(
    ("t_s", "position"),
    [
        (-1.0, (-4.0, 0.0)),
        (-1.0 - 5e-10, (-4.0, 0.0)),
        (0.0, (0.0, 0.0)),
        (0.25, (1.0, 0.0)),
        (0.5, (2.5, 0.5)),
        (0.75, (4.0, 1.0)),
        (1.0, (4.0, 0.0)),
        (2.0, (4.0, -4.0)),
        (2.0 + 5e-10, (4.0, -4.0)),
    ],
)
def test_interpolation_is_linear_between_samples(t_s, position):
    assert interpolate(BENT, t_s) == pytest.approx(position, abs=1e-12)


@pytest.mark.parametrize("t_s", [-1.000000002, 2.000000002, 50.0])
def test_nothing_is_read_outside_the_support(t_s):
    with pytest.raises(ValueError, match="outside the support"):
        interpolate(BENT, t_s)


def test_a_shorter_horizon_can_be_asked_for():
    short = Trajectory((0.0, 0.5), (0.0, 1.0), (0.0, 0.0))
    assert check_trajectory(short) == ("coverage",)
    assert check_trajectory(short, support_end_s=0.5) == ()


def motion_of(forward_m, left_m):
    """The motion of one trajectory."""
    return Motion(
        tuple(np.array([x]) for x in forward_m), tuple(np.array([x]) for x in left_m), 0.5
    )


def measured(trajectory):
    """Forward and left of a trajectory at the three times, and its motion."""
    blocks = RecordBlocks()
    blocks.add([BehaviourRecord(0.0, "", trajectory=trajectory)])
    motion = measure(blocks.columns(), DEFAULT).motion
    return [float(x[0]) for x in motion.forward_m], [float(x[0]) for x in motion.left_m], motion


def test_what_is_measured():
    forward_m, left_m, motion = measured(BENT)
    assert (forward_m, left_m, motion.step_s) == ([0.0, 2.5, 4.0], [0.0, 0.5, 0.0], 0.5)
    assert motion.forward_steps_m == (2.5, 1.5)
    assert motion.left_steps_m == (0.5, -0.5)
    assert (motion.end_speed_mps, motion.accel_mps2, motion.shift_m) == (3.0, -4.0, 0.0)


# Multiples of 1/8 m are exact, so shifting and mirroring them is too.
eighths = st.integers(-120, 120).map(lambda steps: steps / 8)
motions = st.builds(
    motion_of, st.tuples(eighths, eighths, eighths), st.tuples(eighths, eighths, eighths)
)


def lateral(motion):
    """The word of the lateral action."""
    return LAT_ACTIONS[lat_action(motion)[0]]


@settings(max_examples=100, deadline=None)
@given(motions)
def test_left_is_right_in_a_mirror_and_nothing_else_changes(motion):
    mirrored = Motion(motion.forward_m, tuple(-value for value in motion.left_m), motion.step_s)
    swapped = {"left": "right", "right": "left", "straight": "straight"}
    assert lateral(mirrored) == swapped[lateral(motion)]
    assert lon_action(mirrored) == lon_action(motion)
    assert feasible(mirrored) == feasible(motion)


@settings(max_examples=100, deadline=None)
@given(motions, eighths, eighths)
def test_only_differences_count(motion, forward_m, left_m):
    moved = Motion(
        tuple(value + forward_m for value in motion.forward_m),
        tuple(value + left_m for value in motion.left_m),
        motion.step_s,
    )
    for judge in (lon_action, lat_action, feasible):
        assert judge(moved) == judge(motion)


@pytest.mark.parametrize(
    ("forward_m", "left_m", "drivable"),
    [
        # 24.6 m/s forward, 5 or 3 m/s sideways in one half: 25.1 or 24.8; 24 m/s in the other.
        ((0.0, 12.3, 24.3), (0.0, 2.5, 2.5), False),
        ((0.0, 12.3, 24.3), (0.0, 1.5, 1.5), True),
        ((0.0, 12.0, 24.3), (0.0, 0.0, 2.5), False),
        ((0.0, 12.0, 24.3), (0.0, 0.0, 1.5), True),
    ],
)
def test_speed_counts_both_directions_in_either_half(forward_m, left_m, drivable):
    assert feasible(motion_of(forward_m, left_m)).tolist() == [drivable]


def test_all_of_a_path_is_read_between_its_samples():
    forward_m, left_m, _ = measured(Trajectory((-1.0, 3.0), (-4.0, 12.0), (-2.0, 6.0)))
    assert (forward_m, left_m) == ([0.0, 2.0, 4.0], [0.0, 1.0, 2.0])
