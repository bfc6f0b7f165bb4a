"""The measurement of a stop: from true states, against the stated bound."""

from __future__ import annotations

import numpy as np
import pytest

from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.safety.stopping import Stopping
from ssp_core.vocabulary import ObjectClass
from ssp_scenario_manager.faults.evidence import Track, stop_of, touch

CAR = DEFAULT_SIZES[ObjectClass.CAR]
STEP_S = 0.02


def braking(speed_mps: float, from_s: float, deceleration_mps2: float, until_s: float) -> Track:
    """Return a drive along x at a constant speed, then a stop; y is 0."""
    t = np.arange(0.0, until_s, STEP_S)
    speed = np.clip(speed_mps - deceleration_mps2 * np.maximum(t - from_s, 0.0), 0.0, None)
    x = np.concatenate(([0.0], np.cumsum(0.5 * (speed[1:] + speed[:-1]) * STEP_S)))
    return Track(t, x, np.zeros_like(t), np.zeros_like(t), speed)


def test_a_stop_is_measured_from_the_fault_to_the_standstill() -> None:
    track = braking(10.0, 2.5, 4.0, 8.0)
    stop = stop_of(track, 2.0, 0.5, Stopping(0.0, 4.0, 0.1))
    assert stop.speed_mps == 10.0
    assert stop.distance_m == pytest.approx(10.0 * 0.5 + 100.0 / 8.0, abs=0.02)
    assert stop.bound_m == pytest.approx(10.0 * 0.5 + 100.0 / 8.0 + 0.1)
    assert stop.standstill_s == pytest.approx(5.0, abs=2 * STEP_S)
    assert stop.is_within_bound


def test_one_that_brakes_too_late_or_too_gently_is_beyond_its_bound() -> None:
    stopping = Stopping(0.0, 4.0, 0.1)
    assert not stop_of(braking(10.0, 2.6, 4.0, 8.0), 2.0, 0.5, stopping).is_within_bound
    assert not stop_of(braking(10.0, 2.5, 3.8, 8.0), 2.0, 0.5, stopping).is_within_bound


def test_a_witness_that_missed_most_states_finds_a_good_stop_good() -> None:
    """Seconds lie between two states that a busy witness heard, also around the fault."""
    track, random = braking(8.5, 2.1, 4.0, 8.0), np.random.default_rng(0)
    for _ in range(200):
        heard = np.sort(random.choice(len(track.t_s), 12, replace=False))
        heard = np.unique([0, *heard, len(track.t_s) - 1])
        columns = (track.t_s, track.x_m, track.y_m, track.yaw_rad, track.speed_mps)
        seen = Track(*(column[heard] for column in columns))
        assert stop_of(seen, 2.0, 0.0, Stopping(0.1, 4.0, 0.1)).is_within_bound


def test_one_that_never_stands_has_kept_nothing() -> None:
    stop = stop_of(braking(1.0, 5.0, 4.0, 5.1), 5.0, 0.0, Stopping(0.3, 4.0))
    assert stop.standstill_s is None
    assert not stop.is_within_bound


def test_the_speed_that_counts_is_the_highest_until_it_had_to_be_noticed() -> None:
    track = braking(6.0, 3.0, 2.0, 8.0)
    fast = Track(track.t_s, track.x_m, track.y_m, track.yaw_rad, track.speed_mps.copy())
    fast.speed_mps[(fast.t_s > 2.4) & (fast.t_s < 2.6)] = 7.0
    assert stop_of(fast, 2.0, 0.5, Stopping(0.0, 4.0)).speed_mps == 7.0
    assert stop_of(fast, 2.0, 0.3, Stopping(0.0, 4.0)).speed_mps == 6.0


def test_what_stands_all_the_while_has_stopped_at_once() -> None:
    stop = stop_of(braking(0.0, 0.0, 1.0, 3.0), 1.0, 0.5, Stopping(0.2, 4.0))
    assert (stop.distance_m, stop.speed_mps) == (0.0, 0.0)
    assert stop.standstill_s == pytest.approx(1.0, abs=STEP_S)
    assert stop.is_within_bound


def test_motion_and_standstill_are_read_off_the_track() -> None:
    track = braking(10.0, 1.0, 5.0, 6.0)
    assert track.speed_at(0.5) == 10.0
    assert track.speed_at(-1.0) == 0.0
    assert track.stands_at_the_end()
    assert track.first_motion_s(1.5) == pytest.approx(1.5, abs=STEP_S)
    assert track.first_motion_s(4.0) is None
    assert not braking(10.0, 1.0, 5.0, 2.0).stands_at_the_end()


def test_leaving_the_fence_counts_by_the_box() -> None:
    track = braking(5.0, 1.0, 5.0, 4.0)  # its reference point ends at 7.5 m
    front = track.x_m[-1] + CAR.front_m
    wide = [(-10.0, -5.0), (front + 0.1, -5.0), (front + 0.1, 5.0), (-10.0, 5.0)]
    assert track.farthest_outside_m(CAR, wide) == 0.0
    tight = [(-10.0, -5.0), (front - 0.2, -5.0), (front - 0.2, 5.0), (-10.0, 5.0)]
    assert track.farthest_outside_m(CAR, tight) == pytest.approx(0.2)


def test_boxes_that_overlap_at_the_same_instant_touch() -> None:
    a = braking(5.0, 1.0, 5.0, 4.0)
    ahead = Track(a.t_s, a.x_m + CAR.length_m + 0.1, a.y_m, a.yaw_rad, a.speed_mps)
    assert not touch(a, CAR, ahead, CAR)
    inside = Track(a.t_s, a.x_m + CAR.length_m - 0.1, a.y_m, a.yaw_rad, a.speed_mps)
    assert touch(a, CAR, inside, CAR)
    later = Track(inside.t_s + 0.01, inside.x_m, inside.y_m, inside.yaw_rad, inside.speed_mps)
    assert not touch(a, CAR, later, CAR)  # no common instant
