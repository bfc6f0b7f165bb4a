"""Trigger conditions on hand-computed geometry, and the watch against a slow second opinion."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Polyline, Pose2
from ssp_core.run_spec import Condition, LaneChange, RelativeDistance, TimeToArrival, TriggerSpec
from ssp_core.state import ObjectState
from ssp_core.vocab import ObjectClass
from ssp_scenario_manager.core.conditions import (
    Firing,
    Sample,
    Watch,
    condition_text,
    condition_threshold,
    condition_value,
    observe,
)

MS = 1_000_000
S = 1_000_000_000
STRAIGHT = Polyline([(0.0, 0.0), (200.0, 0.0)])
GAP = RelativeDistance(type="relative_distance", object_id="ot1", below_m=12.0)
ARRIVAL = TimeToArrival(type="time_to_arrival", anchor=(100.0, -5.0), below_s=3.0)

StateMaker = Callable[..., ObjectState]
# Values seen from the other side of a rotation about this pose.
ROTATED = Pose2(512.0, -240.0, math.radians(37.0))


def turned(state: StateMaker, *args: Any, x_m: float, y_m: float, **given: Any) -> ObjectState:
    x, y = ROTATED.to_parent(x_m, y_m)
    return state(*args, x_m=x, y_m=y, yaw_rad=ROTATED.yaw_rad, **given)


# -- values ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("vut_x", "other_x", "other_y", "gap_m"),
    [
        (10.0, 40.0, 0.0, 25.5),  # 40 - 0.9 - (10 + 3.6)
        (10.0, 40.0, 3.5, 25.5),  # in the next lane it is the same distance along the path
        (10.0, 14.6, 0.0, 0.1),  # nearly bumper to bumper
        (10.0, 14.4, 0.0, math.inf),  # overlapping: no longer ahead
        (40.0, 10.0, 0.0, math.inf),  # behind
        (10.0, -30.0, 0.0, math.inf),  # before the path's start
        (10.0, 240.0, 0.0, 225.5),  # beyond the path's end, which doesn't end the road
        (198.0, 240.0, 0.0, 37.5),
    ],
)
def test_relative_distance(
    state: StateMaker, vut_x: float, other_x: float, other_y: float, gap_m: float
) -> None:
    vut = state("vut", x_m=vut_x)
    other = state("ot1", x_m=other_x, y_m=other_y)
    assert condition_value(GAP, vut, {"ot1": other}, STRAIGHT) == pytest.approx(gap_m)
    path = Polyline([ROTATED.to_parent(0.0, 0.0), ROTATED.to_parent(200.0, 0.0)])
    vut = turned(state, "vut", x_m=vut_x, y_m=0.0)
    other = turned(state, "ot1", x_m=other_x, y_m=other_y)
    assert condition_value(GAP, vut, {"ot1": other}, path) == pytest.approx(gap_m, abs=1e-9)


def test_exactly_at_the_edges(state: StateMaker) -> None:
    """With sizes that binary fractions hold: bumper to bumper, and the front at the anchor."""
    size = replace(state().size, front_m=3.5, rear_m=1.0)
    vut = state("vut", size=size, x_m=10.0, speed_mps=5.0)
    touching = state("ot1", size=size, x_m=14.5)
    path = Polyline([(0.0, 0.0), (256.0, 0.0)])
    assert condition_value(GAP, vut, {"ot1": touching}, path) == 0.0
    assert condition_value(ARRIVAL, replace(vut, x_m=96.5), {}, path) == 0.0


def test_relative_distance_to_a_small_object_uses_its_own_size(state: StateMaker) -> None:
    walker = state("ot1", ObjectClass.PEDESTRIAN, x_m=40.0)
    assert condition_value(GAP, state("vut"), {"ot1": walker}, STRAIGHT) == pytest.approx(36.15)


def test_relative_distance_along_a_bend(state: StateMaker) -> None:
    """20 m to the corner and 10 m beyond it."""
    path = Polyline([(0.0, 0.0), (20.0, 0.0), (20.0, 50.0)])
    other = state("ot1", x_m=20.0, y_m=10.0, yaw_rad=math.pi / 2)
    assert condition_value(GAP, state("vut"), {"ot1": other}, path) == pytest.approx(25.5)


def test_an_object_that_is_not_known_is_infinitely_far(state: StateMaker) -> None:
    assert condition_value(GAP, state("vut"), {}, STRAIGHT) == math.inf


@pytest.mark.parametrize(
    ("x_m", "speed_mps", "value_s"),
    [
        (46.4, 10.0, 5.0),
        (46.4, 0.1, 500.0),
        (46.4, 0.099, math.inf),  # stands
        (46.4, 0.0, math.inf),
        (46.4, -3.0, math.inf),  # backs away
        (96.3, 10.0, 0.01),  # the front is nearly there
        (96.5, 10.0, math.inf),  # passed
    ],
)
def test_time_to_arrival(state: StateMaker, x_m: float, speed_mps: float, value_s: float) -> None:
    vut = state("vut", x_m=x_m, speed_mps=speed_mps)
    assert condition_value(ARRIVAL, vut, {}, STRAIGHT) == pytest.approx(value_s)
    path = Polyline([ROTATED.to_parent(0.0, 0.0), ROTATED.to_parent(200.0, 0.0)])
    anchor = TimeToArrival(
        type="time_to_arrival", anchor=ROTATED.to_parent(100.0, -5.0), below_s=3.0
    )
    vut = turned(state, "vut", x_m=x_m, y_m=0.0, speed_mps=speed_mps)
    assert condition_value(anchor, vut, {}, path) == pytest.approx(value_s, abs=1e-9)


def test_a_vut_without_a_number_triggers_nothing(state: StateMaker) -> None:
    vut = state("vut", x_m=math.nan, speed_mps=math.nan)
    for condition in (GAP, ARRIVAL):
        value = condition_value(condition, vut, {"ot1": state("ot1", x_m=40.0)}, STRAIGHT)
        assert not value < condition_threshold(condition)


def test_conditions_as_text() -> None:
    assert condition_text(GAP) == "gap vut - ot1 < 12 m"
    assert condition_text(ARRIVAL) == "time of vut to anchor (100.0, -5.0) < 3 s"


# -- the watch ------------------------------------------------------------------------------------


def trigger(
    held_for_s: float = 0.0, not_before_s: float = 0.0, condition: Condition = GAP
) -> TriggerSpec:
    return TriggerSpec(
        id="t",
        condition=condition,
        held_for_s=held_for_s,
        not_before_s=not_before_s,
        object_id="ot1",
        manoeuvre=LaneChange(
            kind="lane_change", lateral_shift_m=1.0, duration_s=1.0, cruise_mps=5.0
        ),
    )


def watch_all(
    spec: TriggerSpec, samples: list[tuple[int, float]], start_ns: int = 0
) -> list[Firing]:
    watch, firings = Watch(), []
    for stamp_ns, value in samples:
        watch, firing = observe(watch, spec, Sample(stamp_ns, value), start_ns)
        if firing is not None:
            firings.append(firing)
    return firings


def test_crossing_is_interpolated_and_the_bracket_kept() -> None:
    (firing,) = watch_all(trigger(), [(0, 16.0), (100 * MS, 13.0), (200 * MS, 9.0)])
    assert firing.crossing_ns == 125 * MS
    assert firing.fired_ns == 200 * MS
    assert firing.samples == (Sample(100 * MS, 13.0), Sample(200 * MS, 9.0))


def test_a_value_at_the_threshold_is_not_below_it() -> None:
    assert watch_all(trigger(), [(0, 16.0), (1, 12.0), (2, 12.0)]) == []
    (firing,) = watch_all(trigger(), [(0, 16.0), (10, 12.0), (20, 11.0)])
    assert firing.crossing_ns == 10


def test_true_from_the_first_sample_fires_there() -> None:
    (firing,) = watch_all(trigger(), [(7, 3.0), (8, 2.0)])
    assert (firing.crossing_ns, firing.fired_ns, firing.samples) == (7, 7, (Sample(7, 3.0),))


def test_from_infinity_the_crossing_is_the_first_finite_sample() -> None:
    (firing,) = watch_all(trigger(), [(0, math.inf), (100, 3.0)])
    assert firing.crossing_ns == 100
    assert firing.samples == (Sample(0, math.inf), Sample(100, 3.0))


def test_it_fires_once() -> None:
    values = [(i, 20.0 if i % 4 < 2 else 5.0) for i in range(40)]
    assert len(watch_all(trigger(), values)) == 1


def test_held_counts_from_the_crossing_and_an_interruption_resets_it() -> None:
    spec = trigger(held_for_s=0.2)
    falling = [(0, 13.0), (100 * MS, 11.0)]  # crosses at 50 ms
    assert watch_all(spec, [*falling, (249 * MS, 11.0)]) == []
    (firing,) = watch_all(spec, [*falling, (249 * MS, 11.0), (250 * MS, 11.0)])
    assert (firing.crossing_ns, firing.fired_ns) == (50 * MS, 250 * MS)
    assert firing.samples == (Sample(0, 13.0), Sample(100 * MS, 11.0))
    # One sample at the threshold and it starts again.
    again = [*falling, (200 * MS, 12.0), (300 * MS, 10.0), (399 * MS, 10.0)]
    assert watch_all(spec, again) == []
    (firing,) = watch_all(spec, [*again, (400 * MS, 10.0)])
    assert (firing.crossing_ns, firing.fired_ns) == (200 * MS, 400 * MS)


def test_not_before_counts_from_the_start_of_the_run() -> None:
    spec = trigger(not_before_s=1.0)
    early = [(5 * S, 20.0), (5 * S + 500 * MS, 3.0), (6 * S - 1, 3.0)]
    assert watch_all(spec, early, start_ns=5 * S) == []
    (firing,) = watch_all(spec, [*early, (6 * S, 3.0)], start_ns=5 * S)
    # What happened before doesn't count: it is true from the first sample on.
    assert (firing.crossing_ns, firing.fired_ns) == (6 * S, 6 * S)
    assert firing.samples == (Sample(6 * S, 3.0),)


def test_no_number_is_no_hold() -> None:
    spec = trigger(held_for_s=0.2)
    samples = [(0, 3.0), (100 * MS, math.nan), (200 * MS, 3.0), (399 * MS, 3.0)]
    assert watch_all(spec, samples) == []


def slow_opinion(
    spec: TriggerSpec, samples: list[tuple[int, float]], start_ns: int
) -> tuple[int, int] | None:
    """Crossing and firing time, straight from the definition and with exact arithmetic.

    The earliest counted sample such that every counted sample from the crossing on is below the
    threshold, and the crossing is at least held_for_s ago.
    """
    threshold = condition_threshold(spec.condition)
    counted = [s for s in samples if s[0] >= start_ns + round(spec.not_before_s * S)]
    for end in range(len(counted)):
        begin = end
        while begin >= 0 and counted[begin][1] < threshold:
            begin -= 1
        if begin == end:
            continue  # not below at this sample
        first = begin + 1
        crossing = counted[first][0]
        if begin >= 0 and math.isfinite(counted[begin][1]):
            (t0, v0), (t1, v1) = counted[begin], counted[first]
            share = (Fraction(v0) - Fraction(threshold)) / (Fraction(v0) - Fraction(v1))
            crossing = round(t0 + share * (t1 - t0))
        if counted[end][0] - crossing >= spec.held_for_s * S:
            return crossing, counted[end][0]
    return None


sample_lists = st.lists(
    st.tuples(
        st.integers(1, 400 * MS),
        st.one_of(st.floats(9.0, 15.0), st.sampled_from([math.inf, math.nan, 12.0, 11.999, 0.0])),
    ),
    max_size=25,
)


@settings(max_examples=100, deadline=None)
@given(
    steps=sample_lists,
    held_for_s=st.sampled_from([0.0, 0.05, 0.3, 1.0]),
    not_before_s=st.sampled_from([0.0, 0.2, 1.5]),
    start_ns=st.integers(0, 3 * S),
)
def test_observe_agrees_with_the_definition(
    steps: list[tuple[int, float]], held_for_s: float, not_before_s: float, start_ns: int
) -> None:
    spec = trigger(held_for_s, not_before_s)
    stamp_ns, samples = start_ns, []
    for step_ns, value in steps:
        stamp_ns += step_ns
        samples.append((stamp_ns, value))
    firings = watch_all(spec, samples, start_ns)
    expected = slow_opinion(spec, samples, start_ns)
    assert len(firings) <= 1
    if expected is None:
        assert firings == []
    else:
        (firing,) = firings
        assert abs(firing.crossing_ns - expected[0]) <= 1  # rounding of the interpolation
        assert firing.fired_ns == expected[1]
        assert firing.crossing_ns <= firing.fired_ns
        assert firing.samples[-1].value < condition_threshold(spec.condition)
