"""Which pairs of many objects need a closer look."""

from __future__ import annotations

import itertools
import math

from hypothesis import given
from hypothesis import strategies as st

from ssp_core.geometry import box_distance
from ssp_core.motion.state import ObjectState, Size
from ssp_core.safety.limits import near_pairs
from support.states import object_state

PLACES = st.floats(-30.0, 30.0)
LENGTHS = st.floats(0.0, 6.0)


def state(x_m: float, y_m: float, yaw_rad: float, *extents_m: float) -> ObjectState:
    return object_state("a", x_m=x_m, y_m=y_m, yaw_rad=yaw_rad, size=Size(*extents_m, 1.5))


STATES = st.builds(state, PLACES, PLACES, st.floats(-4.0, 4.0), LENGTHS, LENGTHS, LENGTHS)


@given(st.lists(STATES, max_size=8), st.floats(0.0, 3.0))
def test_no_pair_within_the_distance_is_left_out(
    states: list[ObjectState], within_m: float
) -> None:
    found = near_pairs(states, within_m)
    assert found == sorted(set(found))
    assert all(0 <= i < k < len(states) for i, k in found)
    for i, k in itertools.combinations(range(len(states)), 2):
        if box_distance(states[i].box, states[k].box) <= within_m:
            assert (i, k) in found


def test_objects_that_are_far_from_each_other_are_left_out() -> None:
    row = [state(10.0 * i, 0.0, 0.0, 3.6, 0.9, 1.8) for i in range(6)]
    column = [state(0.0, 10.0 * i, 0.0, 3.6, 0.9, 1.8) for i in range(6)]
    assert near_pairs(row, 1.0) == []
    assert near_pairs(column, 1.0) == []
    assert near_pairs(row, 6.0) == [(0, 1), (1, 2), (2, 3), (3, 4), (4, 5)]


def test_an_extent_that_is_no_number_may_reach_anywhere() -> None:
    states = [state(0.0, 0.0, 0.0, 1.0, 1.0, 1.0), state(500.0, 0.0, 0.0, math.nan, 1.0, 1.0)]
    assert near_pairs(states, 0.5) == [(0, 1)]
    assert near_pairs(states[::-1], 0.5) == [(0, 1)]
