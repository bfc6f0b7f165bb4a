"""Noise of recorded states tells measured places from those of a model (docs/audit.md)."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import savgol_filter  # type: ignore[import-untyped]  # scipy has no types

from ssp_eval.recordings.noise import NONE_M, noise_text, step_noises_m
from ssp_eval.recordings.states import Sighting
from ssp_scenario_manager.run.in_process import run_in_process
from tests.support.events.adaptation import base

Places = np.ndarray


@pytest.fixture(scope="module")
def driven() -> list[Sighting]:
    """True states of a VUT that drives, brakes and goes on."""
    states = run_in_process(base("cut_in"))[1].truths("vut")
    return [
        Sighting(1e-9 * s.stamp_ns, "vut", "vut", "car", s.x_m, s.y_m, s.speed_mps) for s in states
    ]


def measured(states: list[Sighting], change: Callable[[Places], Places]) -> float:
    """Noise of states at places that were changed."""
    places = change(np.array([(one.x_m, one.y_m) for one in states]))
    moved = [
        Sighting(one.t_s, "vut", "vut", "car", float(x), float(y), one.speed_mps)
        for one, (x, y) in zip(states, places, strict=True)
    ]
    return step_noises_m(moved, ["vut"])["vut"]


def test_a_model_has_none_at_any_rate(driven: list[Sighting]) -> None:
    for every in (1, 2, 5):
        (noise_m,) = step_noises_m(driven[::every], ["vut"]).values()
        assert noise_m < NONE_M
    assert noise_text({"vut": noise_m}) == "vut none, as of a model"


@pytest.mark.parametrize("noise_m", [0.002, 0.02])
def test_what_was_measured_has_some_and_keeps_some_when_it_is_smoothed(
    driven: list[Sighting], noise_m: float
) -> None:
    noise = np.random.default_rng(1).normal(0.0, noise_m, (len(driven), 2))
    assert measured(driven, lambda at: at + noise) == pytest.approx(noise_m, rel=0.2)
    smooth = measured(driven, lambda at: savgol_filter(at + noise, 51, 3, axis=0))
    assert smooth > 3.0 * NONE_M
    assert measured(driven, lambda at: np.round(at, 3)) > 3.0 * NONE_M


def test_states_of_others_and_standing_ones_tell_nothing() -> None:
    stands = [Sighting(0.1 * k, "vut", "vut", "car", 0.0, 0.0, 0.0) for k in range(100)]
    of_the_world = [Sighting(0.1 * k, "", "vut", "car", 1.0 * k, 0.0, 10.0) for k in range(100)]
    assert step_noises_m(stands, ["vut"]) == {}
    assert step_noises_m(of_the_world, ["vut"]) == {}
    assert noise_text({}) == ""
    assert math.isclose(
        step_noises_m(
            [Sighting(0.1 * k, "vut", "vut", "car", 1.1 * k, 0.0, 10.0) for k in range(100)],
            ["vut"],
        )["vut"],
        0.1,
    )
