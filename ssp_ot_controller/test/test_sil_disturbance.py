"""Disturbances repeat exactly for a seed, and are as large as they are said to be."""

from __future__ import annotations

import math

import numpy as np
import pytest

from ssp_core.run_spec import LinkDisturbance
from ssp_core.state import DEFAULT_SIZES, ObjectState
from ssp_core.vocab import ObjectClass, Role
from ssp_ot_controller.sil.disturbance import Localisation, make_link

NOISY = LinkDisturbance(
    position_noise_m=0.05, speed_noise_mps=0.02, state_loss=0.1, state_delay_s=0.06
)


def truth(k: int, speed_mps: float = 10.0) -> ObjectState:
    return ObjectState(
        "ot1", ObjectClass.CAR, Role.OT, k * 20_000_000, 0.2 * k, 3.0, 0.1, speed_mps, 0.0, 0.0,
        DEFAULT_SIZES[ObjectClass.CAR], sequence=k,
    )  # fmt: skip


def measured(seed: int, object_id: str = "ot1", n: int = 50) -> list[ObjectState]:
    localisation = Localisation(NOISY, seed, object_id)
    return [localisation.measure(truth(k)) for k in range(n)]


def arrivals(seed: int, object_id: str = "ot1", n: int = 200) -> list[int | None]:
    link = make_link(NOISY, seed, object_id, 0.02)
    return [s.sequence if (s := link.pass_on(truth(k))) else None for k in range(n)]


def test_the_same_seed_gives_the_same_stream() -> None:
    assert measured(1) == measured(1)
    assert arrivals(1) == arrivals(1)


def test_other_seeds_and_other_objects_have_streams_of_their_own() -> None:
    assert measured(1) != measured(2)
    assert measured(1) != measured(1, "ot2")
    assert arrivals(1) != arrivals(2)
    assert arrivals(1) != arrivals(1, "ot2")


def test_streams_do_not_depend_on_the_sizes_of_the_disturbances() -> None:
    """A run with less noise is the same run with less noise."""
    half = LinkDisturbance(position_noise_m=0.025)
    small, large = Localisation(half, 3, "ot1"), Localisation(NOISY, 3, "ot1")
    for k in range(20):
        a, b = small.measure(truth(k)), large.measure(truth(k))
        assert (a.x_m - 0.2 * k) * 2 == pytest.approx(b.x_m - 0.2 * k)


def test_without_noise_it_is_the_truth() -> None:
    localisation = Localisation(LinkDisturbance(), 1, "ot1")
    assert localisation.measure(truth(3)) is not None
    assert localisation.measure(truth(3)) == truth(3)


def test_noise_has_the_size_that_is_said_and_stated() -> None:
    states = measured(7, n=4000)
    dx = np.array([s.x_m - 0.2 * k for k, s in enumerate(states)])
    dy = np.array([s.y_m - 3.0 for s in states])
    dv = np.array([s.speed_mps - 10.0 for s in states])
    for errors, sigma in ((dx, 0.05), (dy, 0.05), (dv, 0.02)):
        assert errors.std() == pytest.approx(sigma, rel=0.06)
        assert abs(errors.mean()) < 4 * sigma / math.sqrt(len(errors))
    assert {s.position_std_m for s in states} == {0.05}
    # What isn't measured by it stays true.
    assert {(s.yaw_rad, s.acceleration_mps2, s.yaw_rate_radps) for s in states} == {(0.1, 0.0, 0.0)}


@pytest.mark.parametrize("name", ["position_noise_m", "speed_noise_mps"])
def test_each_noise_by_itself(name: str) -> None:
    localisation = Localisation(LinkDisturbance(**{name: 0.5}), 1, "ot1")
    state = localisation.measure(truth(1))
    assert (state.x_m != 0.2) == (state.y_m != 3.0) == (name == "position_noise_m")
    assert (state.speed_mps != 10.0) == (name == "speed_noise_mps")


def test_who_stands_knows_it() -> None:
    localisation = Localisation(NOISY, 1, "ot1")
    assert localisation.measure(truth(1, speed_mps=0.0)).speed_mps == 0.0
    assert localisation.measure(truth(1, speed_mps=0.2)).speed_mps != 0.2


@pytest.mark.parametrize(("delay_s", "steps"), [(0.0, 0), (0.02, 1), (0.06, 3), (0.049, 2)])
def test_delay_is_exact(delay_s: float, steps: int) -> None:
    link = make_link(LinkDisturbance(state_delay_s=delay_s), 1, "ot1", 0.02)
    for k in range(20):
        arrived = link.pass_on(truth(k))
        assert (arrived.sequence if arrived else None) == (k - steps if k >= steps else None)


def test_loss_has_its_rate_and_delays_nothing_else() -> None:
    got = arrivals(11, n=5000)
    lost = got[3:].count(None)
    assert lost / len(got[3:]) == pytest.approx(0.1, abs=0.015)
    assert all(sequence is None or sequence == k - 3 for k, sequence in enumerate(got))
    sure = make_link(LinkDisturbance(), 11, "ot1", 0.02)
    assert all(sure.pass_on(truth(k)) for k in range(500))
