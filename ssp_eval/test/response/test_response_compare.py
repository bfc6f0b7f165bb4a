"""The verdict on two drives: alike, unlike or not assessable, and what explains a difference."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.errors import InputError
from ssp_core.geometry import FloatArray
from ssp_core.motion.state import ObjectState
from ssp_eval.data.response import PairEntry
from ssp_eval.response.compare import DEFAULT_LIMITS, compare, grade, load_limits, respond
from ssp_eval.response.drive import Drive, braking, drive_of, no_drive, strong
from tests.support.braking import drive, pulse, stand_in_drive
from tests.support.states import object_state

LIMITS = load_limits()
T_S = 0.02 * np.arange(250)
BRAKES = drive(T_S, pulse(T_S, start_s=1.6), gap_m=50.0)


def pair(reference: Drive, comparison: Drive) -> PairEntry:
    return compare(("physical", "simulation"), reference, comparison, LIMITS)


def causes(found: PairEntry) -> dict[str, float | None]:
    return {cause.name: cause.value for cause in found.causes if cause.notable}


def test_a_drive_is_like_itself_and_needs_no_explanation() -> None:
    found = pair(BRAKES, BRAKES)
    assert (found.verdict, found.why, causes(found)) == ("alike", [], {})
    assert found.rating is not None
    assert (found.rating.overall, found.rating.grade) == (1.0, "excellent")
    assert [figure.difference for figure in found.figures] == [0.0, 0.0, 0.0]


def test_the_braking_starts_at_the_crossing_before_its_first_strong_point() -> None:
    # A tap on the brake comes first; it isn't the braking, and neither is a crossing before it.
    a = np.interp(T_S, [0.5, 0.6, 0.7, 2.0, 2.5], [0.0, -2.0, 0.0, 0.0, -5.0])

    def start_s(a: FloatArray) -> float | None:
        own = drive(T_S, a)
        found = braking(own, strong([own]))
        assert found is not None
        return found.start_s

    assert start_s(a) == pytest.approx(2.1, abs=0.001)
    assert start_s(np.maximum(a, -3.0)) == pytest.approx(2.1, abs=0.001)
    # A gentle one begins at half of its strongest.
    assert start_s(0.4 * a) == pytest.approx(2.25, abs=0.001)
    assert start_s(0.3 * a) == pytest.approx(2.25, abs=0.001)
    assert start_s(0.2 * a) == pytest.approx(2.25, abs=0.001)
    assert start_s(np.full(len(T_S), -5.0)) is None


def test_who_decelerates_by_less_than_the_method_says_does_not_brake() -> None:
    # METHOD 6.6: the mean speeds of two steps of 0.5 s, 0.5 s apart, fall by 0.25 m/s.
    slow = np.clip((T_S - 2.0) / 0.2, 0.0, 1.0)
    for level, brakes in ((-0.49, False), (-0.51, True)):
        assert (strong([drive(T_S, level * slow)]) is not None) == brakes
    # A jolt isn't held, and beside a strong braking a weak one is none.
    jolt = drive(T_S, np.where(np.arange(len(T_S)) == 100, -9.0, 0.0))
    assert strong([jolt]) is None
    gentle = drive(T_S, -1.4 * slow)
    assert braking(gentle, strong([gentle])) is not None
    assert braking(gentle, strong([gentle, drive(T_S, -3.0 * slow)])) is None
    assert strong([gentle, drive(T_S, -9.0 * slow)]) == -3.0


def test_a_late_response_is_told_by_its_delay_and_by_what_it_costs() -> None:
    late = drive(T_S, pulse(T_S, start_s=1.9), gap_m=50.0)
    found = pair(BRAKES, late)
    assert causes(found) == pytest.approx({"delay": 0.3})
    assert found.rating is not None
    assert found.on_common_clock is not None
    assert found.rating.overall == pytest.approx(1.0, abs=0.01)
    assert found.on_common_clock.overall < 0.85
    # Aligned the curves are the same: it is the key figures that differ.
    assert found.verdict == "unlike"
    assert [f.name for f in found.figures if not f.within] == [
        "ttc_at_braking",
        "remaining_distance",
    ]
    assert causes(pair(late, BRAKES)) == pytest.approx({"delay": -0.3})


def test_a_weaker_response_is_told_by_its_gain() -> None:
    found = pair(BRAKES, drive(T_S, 0.7 * BRAKES.acceleration_mps2, gap_m=50.0))
    assert causes(found) == pytest.approx({"gain": 0.7}, abs=0.001)
    assert found.rating is not None
    assert found.without_gain is not None
    assert found.without_gain.overall == pytest.approx(1.0, abs=0.02)
    assert found.verdict == "unlike"
    assert f"the rating {found.rating.overall:.2f} is below 0.8" in found.why


def test_another_speed_and_another_gap_at_the_trigger_are_told() -> None:
    found = pair(BRAKES, drive(T_S, BRAKES.acceleration_mps2, speed_mps=16.0, gap_m=51.0))
    assert causes(found) == pytest.approx({"initial_speed": 1.0})
    found = pair(BRAKES, replace(BRAKES, trigger_gap_m=20.0, gap_m=BRAKES.gap_m + 0.4))
    assert BRAKES.trigger_gap_m is not None
    assert causes(found) == pytest.approx({"initial_gap": 20.0 - BRAKES.trigger_gap_m})
    assert found.verdict == "alike"


def test_a_limit_is_still_alike() -> None:
    # 0.25 m and m/s are exact in binary.
    further = replace(BRAKES, gap_m=BRAKES.gap_m + 0.25)
    weaker = drive(T_S, 0.9 * BRAKES.acceleration_mps2, gap_m=50.0)
    rated = pair(BRAKES, weaker).rating
    assert rated is not None

    def verdict(other: Drive, **limits: float) -> str:
        wide = {"ttc_at_braking": 9.0, "remaining_distance": 9.0, "impact_speed": 9.0}
        given = {
            name: getattr(LIMITS, name).model_copy(update={"limit": value})
            for name, value in {**wide, **limits}.items()
        }
        bounds = LIMITS.model_copy(update=given)
        return compare(("physical", "simulation"), BRAKES, other, bounds).verdict

    assert verdict(further, remaining_distance=0.25) == "alike"
    assert verdict(further, remaining_distance=0.249) == "unlike"
    assert verdict(weaker, rating=rated.overall) == "alike"
    assert verdict(weaker, rating=rated.overall + 1e-6) == "unlike"


@pytest.mark.parametrize(
    ("drives", "text"),
    [
        ((drive(T_S, 0.0 * T_S), drive(T_S, 0.0 * T_S)), "neither brakes"),
        ((BRAKES, no_drive()), "simulation has no states"),
        ((replace(BRAKES, trigger_s=None), BRAKES), "physical has no trigger"),
        ((BRAKES, drive(T_S, np.where(T_S < 4.0, 0.0, -1001.0))), "more than 1000 m/s²"),
        ((BRAKES, drive(T_S, pulse(T_S, start_s=-0.5))), "from its beginning on"),
        ((BRAKES, drive(T_S, pulse(T_S, start_s=0.0))), "less than 0.2 s before"),
        ((BRAKES, drive(T_S, pulse(T_S, start_s=4.7))), "less than 0.5 s after"),
    ],
)
def test_where_there_is_no_braking_to_compare_nothing_is_rated(
    drives: tuple[Drive, Drive], text: str
) -> None:
    found = pair(*drives)
    assert found.verdict == "not assessable"
    assert text in "; ".join(found.why)
    assert (found.rating, found.figures, found.causes) == (None, [], [])


def test_one_who_brakes_and_one_who_does_not_are_unlike() -> None:
    found = pair(BRAKES, drive(T_S, 0.0 * T_S))
    assert (found.verdict, found.rating) == ("unlike", None)
    assert found.why == ["physical brakes, simulation never falls below -3 m/s²"]


def test_an_impact_that_only_one_has_is_outside_its_limit() -> None:
    found = pair(BRAKES, drive(T_S, BRAKES.acceleration_mps2, gap_m=15.0))
    assert any("impact speed differs by" in text for text in found.why)
    figure = next(f for f in found.figures if f.name == "impact_speed")
    assert figure.reference == 0.0
    assert figure.comparison is not None
    assert figure.comparison > 1.0


def test_synthetic_is_compared_where_it_has_states() -> None:
    three = respond([no_drive(), BRAKES, BRAKES], LIMITS)
    assert [(p.reference, p.comparison) for p in three.pairs] == [("physical", "simulation")]
    assert set(three.curves) == {"simulation", "physical"}
    pairs = [(p.reference, p.comparison) for p in respond([BRAKES] * 3, LIMITS).pairs]
    assert pairs == [
        ("physical", "simulation"),
        ("synthetic", "simulation"),
        ("synthetic", "physical"),
    ]


def test_key_figures_are_of_the_object_of_the_event() -> None:
    def states(x_m: float, gap_m: float, speed_mps: float) -> dict[str, ObjectState]:
        return {
            "vut": object_state("vut", x_m=x_m, speed_mps=speed_mps, acceleration_mps2=-4.0),
            "ot1": object_state(x_m=x_m + 4.5 + gap_m),
        }

    series = [(0.0, states(0.0, 20.0, 10.0)), (1.0, states(10.0, 10.0, 10.0)),
              (2.0, states(20.0, 0.0, 5.0))]  # fmt: skip
    found = drive_of(series, "vut", "ot1", 1.0)
    assert found.gap_m == pytest.approx([20.0, 10.0, 0.0], abs=0.3)
    assert found.ttc_s[:2] == pytest.approx([2.0, 1.0], abs=0.05)
    assert found.trigger_gap_m == pytest.approx(10.0, abs=0.3)
    assert found.acceleration_mps2.tolist() == [-4.0, -4.0, -4.0]
    alone = drive_of(series, "vut", None, 1.0)
    assert np.isnan(alone.gap_m).all()
    assert alone.trigger_gap_m is None


def test_limits_cite_their_source_and_say_that_nobody_checked_them() -> None:
    for name in ("rating", "ttc_at_braking", "remaining_distance", "impact_speed"):
        limit = getattr(LIMITS, name)
        assert limit.checked_by is None
        assert "no published limit" in limit.source.lower()


def test_a_limit_without_a_source_is_refused(tmp_path: Path) -> None:
    text = DEFAULT_LIMITS.read_text()
    file = tmp_path / "limits.yaml"
    file.write_text(text.replace("  checked_by: null\n", "", 1))
    with pytest.raises(InputError, match=r"rating\.checked_by"):
        load_limits(file)
    file.write_text(text.replace("limit: 0.2", "limit: -0.2"))
    with pytest.raises(InputError, match=r"ttc_at_braking\.limit"):
        load_limits(file)


def test_grades_begin_above_their_bounds() -> None:
    assert [grade(x) for x in (0.95, 0.94, 0.81, 0.80, 0.59, 0.58)] == [
        "excellent",
        "good",
        "good",
        "fair",
        "fair",
        "poor",
    ]


def test_a_hundred_stand_in_runs_are_ordered_by_lag_and_by_gain() -> None:
    lags_s, gains = 0.04 * np.arange(10), 1.0 - 0.02 * np.arange(10)
    rng = np.random.default_rng(18)
    for deceleration_mps2, speed_mps in rng.uniform((4.5, 12.0), (6.9, 18.0), (5, 2)):
        given = deceleration_mps2, speed_mps
        reference, lag_s = stand_in_drive(0.0, 1.0, *given), float(rng.choice(lags_s))
        later = [pair(reference, stand_in_drive(lag, 1.0, *given)) for lag in lags_s]
        weaker = [pair(reference, stand_in_drive(lag_s, gain, *given)) for gain in gains]
        clock = [p.on_common_clock.overall for p in later if p.on_common_clock is not None]
        aligned = [p.rating.overall for p in weaker if p.rating is not None]
        assert len(clock) == len(aligned) == 10
        assert max(np.diff(clock)) < 0.0
        assert max(np.diff(aligned)) < 0.0
        known = [*((lag, 1.0) for lag in lags_s), *((lag_s, gain) for gain in gains)]
        for found, (lag, gain) in zip([*later, *weaker], known, strict=True):
            told = {cause.name: cause.value for cause in found.causes}
            assert told["delay"] == pytest.approx(lag, abs=reference.step_s)
            assert told["gain"] == pytest.approx(gain, abs=0.01)


@settings(max_examples=40, deadline=None)
@given(st.lists(st.floats(-12.0, 4.0), min_size=3, max_size=60), st.floats(0.0, 3.0))
def test_no_recorded_motion_makes_a_comparison_fail(values: list[float], trigger_s: float) -> None:
    t_s = 0.05 * np.arange(len(values))
    found = pair(BRAKES, drive(t_s, np.array(values), trigger_s=trigger_s))
    assert found.verdict in ("alike", "unlike", "not assessable")
    assert bool(found.why) == (found.verdict != "alike")
