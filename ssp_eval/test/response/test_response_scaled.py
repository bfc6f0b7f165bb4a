"""A braking that is a little weaker or stronger is rated a little otherwise, never not at all."""

from __future__ import annotations

import numpy as np
import pytest

from ssp_core.geometry import FloatArray
from ssp_eval.response.compare import braking_starts, compare, load_limits
from ssp_eval.response.drive import STEP_S, Drive, sampled
from ssp_eval.response.iso18571 import rate
from tests.support.braking import drive, pulse, stand_in_drive

LIMITS = load_limits()
T_S = 0.02 * np.arange(220)
SCALES = 0.01 * np.arange(80, 121)
NEAR = 0.01 * np.arange(95, 106)
MOST_STEP = 0.03


def corners(*points: tuple[float, float]) -> FloatArray:
    """Straight pieces between times and accelerations."""
    found: FloatArray = np.interp(T_S, *zip(*points, strict=True))
    return found


def noisy(level: float, seed: int) -> FloatArray:
    numbers = np.random.default_rng(seed)
    smooth = np.convolve(numbers.normal(0.0, 1.0, len(T_S) + 10), np.ones(11) / 11, "valid")
    found: FloatArray = pulse(T_S, level, start_s=1.6) + 0.4 * smooth
    return found


DRIVES = {
    "just below the threshold": pulse(T_S, -3.12, start_s=1.6),
    "strong": pulse(T_S, -7.0, start_s=1.6),
    "a tap just above the threshold, then the braking": (
        pulse(T_S, -2.95, start_s=1.2, hold_s=0.1, release_s=0.2) + pulse(T_S, -5.0, start_s=2.4)
    ),
    "a tap just below the threshold, then the braking": (
        pulse(T_S, -3.05, start_s=1.2, hold_s=0.1, release_s=0.2) + pulse(T_S, -5.0, start_s=2.4)
    ),
    "the engine's drag near -1 m/s² before": np.minimum(
        pulse(T_S, -0.98, start_s=0.6, hold_s=4.0), pulse(T_S, -6.0, start_s=2.0)
    ),
    "the engine's drag beyond -1 m/s² before": np.minimum(
        pulse(T_S, -1.02, start_s=0.6, hold_s=4.0), pulse(T_S, -3.3, start_s=2.0)
    ),
    "the engine's drag near -1 m/s² from the beginning on": np.minimum(
        -0.98, pulse(T_S, -5.0, start_s=1.6)
    ),
    "the engine's drag beyond -1 m/s² from the beginning on": np.minimum(
        -1.02, pulse(T_S, -3.3, start_s=1.6)
    ),
    "two steps": corners(
        (1.5, 0.0), (1.8, -2.9), (2.6, -2.9), (2.8, -6.0), (3.6, -6.0), (4.0, 0.0)
    ),
    "slow": corners((1.0, 0.0), (3.5, -3.5), (4.0, 0.0)),
    "noise at the threshold": noisy(-3.0, 1),
    "strong and noisy": noisy(-6.0, 2),
    "the stand-in": np.interp(
        T_S, stand_in_drive(0.0, 1.0).t_s, stand_in_drive(0.0, 1.0, 3.2).acceleration_mps2
    ),
}


def rated(reference: Drive, comparison: Drive) -> float:
    found = compare(("physical", "simulation"), reference, comparison, LIMITS)
    assert found.rating is not None, found.why
    assert found.on_common_clock is not None
    assert found.without_gain is not None
    return found.rating.overall


CASES = [
    ("just below the threshold", SCALES, "comparison"),
    ("just below the threshold", SCALES, "reference"),
    *((name, NEAR, "comparison") for name in DRIVES),
    ("a tap just above the threshold, then the braking", NEAR, "reference"),
    ("noise at the threshold", NEAR, "reference"),
    ("the engine's drag near -1 m/s² from the beginning on", NEAR, "reference"),
    ("the engine's drag beyond -1 m/s² from the beginning on", NEAR, "reference"),
]


@pytest.mark.parametrize(("name", "scales", "scaled"), CASES)
def test_a_scaled_braking_is_always_rated_and_without_leaps(
    name: str, scales: FloatArray, scaled: str
) -> None:
    a = DRIVES[name]
    own = drive(T_S, a, gap_m=90.0)
    others = [drive(T_S, scale * a, gap_m=90.0) for scale in scales]
    pairs = [(own, other) if scaled == "comparison" else (other, own) for other in others]
    ratings = np.array([rated(*pair) for pair in pairs])
    assert np.abs(np.diff(ratings)).max() <= MOST_STEP
    assert ratings.argmax() == len(scales) // 2
    assert ratings.max() == 1.0
    starts = np.array([braking_starts(*pair) for pair in pairs])
    # Of each the same instant of the braking is aligned.
    assert np.abs(np.diff(starts, axis=1)).max() <= 0.001


# Of strength 1: pieces that are as straight as recorded ones never are, too.
SHAPES = {
    "pulse": pulse(T_S, -1.0, start_s=1.6),
    "short": pulse(T_S, -1.0, start_s=1.6, rise_s=0.2, hold_s=0.4, release_s=0.3),
    "step": np.where((T_S >= 1.6) & (T_S < 3.2), -1.0, 0.0),
    "step to the end": corners((1.6, 0.0), (1.9, -1.0), (9.0, -1.0)),
    "ramp": corners((1.2, 0.0), (3.2, -1.0), (3.6, 0.0)),
    "ramp to the end": corners((1.2, 0.0), (4.38, -1.0)),
    "two steps": corners(
        (1.5, 0.0), (1.8, -0.5), (2.6, -0.5), (2.8, -1.0), (3.6, -1.0), (4.0, 0.0)
    ),
    "after accelerating": corners((1.5, 0.4), (1.9, -1.0), (3.2, -1.0), (3.5, 0.3)),
}
LEVELS = (1.2, 1.5, 2.0, 2.8, 3.2, 3.4, 4.0, 6.0, 8.0)


@pytest.mark.parametrize("name", SHAPES)
def test_a_gentle_braking_is_rated_as_a_strong_one(name: str) -> None:
    for level in LEVELS:
        own = drive(T_S, level * SHAPES[name], gap_m=90.0)
        for scale in SCALES[::5]:
            other = drive(T_S, scale * own.acceleration_mps2, gap_m=90.0)
            for pair in ((own, other), (other, own)):
                starts = braking_starts(*pair)
                assert None not in starts, (level, scale)
                # Of each the same instant is aligned, so that the rating is that of the shape.
                assert starts[1] == pytest.approx(starts[0], abs=0.001), (level, scale)
    own = drive(T_S, LEVELS[0] * SHAPES[name], gap_m=90.0)
    ratings = []
    for scale in SCALES:
        pair = own, drive(T_S, scale * own.acceleration_mps2, gap_m=90.0)
        start_s = braking_starts(*pair)[0]
        assert start_s is not None
        ratings.append(rate(*(sampled(d, start_s, -0.2, 2.0) for d in pair), STEP_S).overall)
    assert np.abs(np.diff(ratings)).max() <= MOST_STEP
    assert ratings[len(SCALES) // 2] == max(ratings) == 1.0


def test_a_little_weaker_is_alike_on_either_side_of_the_threshold() -> None:
    for level in (-3.12, -7.0):
        a = pulse(T_S, level, start_s=1.6)
        own, weaker = drive(T_S, a, gap_m=90.0), drive(T_S, 0.95 * a, gap_m=90.0)
        found = compare(("physical", "simulation"), own, weaker, LIMITS)
        others = [f.name for f in found.figures if not f.within and f.name != "remaining_distance"]
        assert (found.rating is not None, others) == (True, [])
        assert rated(own, weaker) >= 0.95


def test_who_does_not_brake_is_still_no_weaker_braking() -> None:
    own = drive(T_S, pulse(T_S, -3.12, start_s=1.6), gap_m=90.0)
    drag = drive(T_S, pulse(T_S, -0.9, start_s=1.6), gap_m=90.0)
    found = compare(("physical", "simulation"), own, drag, LIMITS)
    assert (found.verdict, found.rating) == ("unlike", None)
    assert found.why == ["physical brakes, simulation never falls below -1.6 m/s²"]
    slow = drive(T_S, 0.5 * drag.acceleration_mps2, gap_m=90.0)
    nobody = compare(("physical", "simulation"), slow, slow, LIMITS)
    assert nobody.verdict == "not assessable"
