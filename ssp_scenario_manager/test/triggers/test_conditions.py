"""Single conditions on hand-computed geometry: values, truth, unknown, and instants of change."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from pydantic import TypeAdapter

from ssp_core.clock import NS_PER_S
from ssp_core.geometry import Polyline, Pose2
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import Condition
from ssp_core.vocabulary import ObjectClass, Phase
from ssp_scenario_manager.triggers.conditions import (
    Quantity,
    Reading,
    Sample,
    Snapshot,
    ThresholdCondition,
    condition_text,
    question,
)

MS = 1_000_000
S = 1_000_000_000
STRAIGHT = Polyline([(0.0, 0.0), (200.0, 0.0)])
SQUARE = [(20.0, -2.0), (30.0, -2.0), (30.0, 2.0), (20.0, 2.0)]
PARSER: TypeAdapter[Any] = TypeAdapter(Condition)
GAP = {"type": "relative_distance", "object_id": "ot1", "below_m": 12.0}
ARRIVAL = {"type": "time_to_arrival", "anchor": (100.0, -5.0), "below_s": 3.0}
HEADWAY = {"type": "time_headway", "object_id": "ot1", "below_s": 2.0}
TTC = {"type": "time_to_collision", "object_id": "ot1", "below_s": 3.0}
FASTER = {"type": "speed", "object_id": "ot1", "relation": "above", "value_mps": 5.0}
SLOWER = {"type": "speed", "object_id": "vut", "relation": "below", "value_mps": 5.0}
INSIDE = {"type": "in_region", "object_id": "ot1", "polygon": SQUARE}
BEGUN = {"type": "phase_reached", "phase": "conflict"}
LATE = {"type": "elapsed_time", "after_s": 4.5}

StateMaker = Callable[..., ObjectState]
# Values seen from the other side of a rotation about this pose.
ROTATED = Pose2(512.0, -240.0, math.radians(37.0))


def read(
    condition: dict[str, Any],
    vut: ObjectState,
    other: ObjectState | None = None,
    path: Polyline = STRAIGHT,
    started_ns: int = 0,
    phases: dict[Phase, int] | None = None,
) -> Reading:
    """Return a condition's reading of these states, which may be 0.3 s old."""
    targets = {} if other is None else {other.object_id: other}
    snapshot = Snapshot(vut, targets, path, 300 * MS, phases or {})
    return question(PARSER.validate_python(condition), path, started_ns).read(snapshot)


def value(*args: Any, **given: Any) -> float:
    return read(*args, **given).sample.value


def turned(state: StateMaker, *args: Any, x_m: float, y_m: float, **given: Any) -> ObjectState:
    x, y = ROTATED.to_parent(x_m, y_m)
    return state(*args, x_m=x, y_m=y, yaw_rad=ROTATED.yaw_rad, **given)


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
    assert value(GAP, vut, other) == pytest.approx(gap_m)
    path = Polyline([ROTATED.to_parent(0.0, 0.0), ROTATED.to_parent(200.0, 0.0)])
    vut = turned(state, "vut", x_m=vut_x, y_m=0.0)
    other = turned(state, "ot1", x_m=other_x, y_m=other_y)
    assert value(GAP, vut, other, path) == pytest.approx(gap_m, abs=1e-9)


def test_exactly_at_the_edges(state: StateMaker) -> None:
    """Sizes and places are binary fractions: bumper touches bumper, the front is at the anchor."""
    size = replace(state().size, front_m=3.5, rear_m=1.0)
    vut = state("vut", size=size, x_m=10.0, speed_mps=5.0)
    touching = state("ot1", size=size, x_m=14.5)
    path = Polyline([(0.0, 0.0), (256.0, 0.0)])
    assert value(GAP, vut, touching, path) == 0.0
    assert value(ARRIVAL, replace(vut, x_m=96.5), None, path) == 0.0


def test_a_gap_ends_at_the_nearest_point_of_the_object(state: StateMaker) -> None:
    walker = state("ot1", ObjectClass.PEDESTRIAN, x_m=40.0)
    assert value(GAP, state("vut"), walker) == pytest.approx(36.15)
    # A car that comes towards the VUT has its front there; one that stands across, its side.
    assert value(GAP, state("vut"), state("ot1", x_m=40.0, yaw_rad=math.pi)) == pytest.approx(32.8)
    across = state("ot1", x_m=40.0, yaw_rad=math.pi / 2)
    assert value(GAP, state("vut"), across) == pytest.approx(35.5)


def test_relative_distance_along_a_bend(state: StateMaker) -> None:
    """20 m to the corner and 10 m beyond it."""
    path = Polyline([(0.0, 0.0), (20.0, 0.0), (20.0, 50.0)])
    other = state("ot1", x_m=20.0, y_m=10.0, yaw_rad=math.pi / 2)
    assert value(GAP, state("vut"), other, path) == pytest.approx(25.5)


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
    assert value(ARRIVAL, vut) == pytest.approx(value_s)
    path = Polyline([ROTATED.to_parent(0.0, 0.0), ROTATED.to_parent(200.0, 0.0)])
    anchor = {**ARRIVAL, "anchor": ROTATED.to_parent(100.0, -5.0)}
    vut = turned(state, "vut", x_m=x_m, y_m=0.0, speed_mps=speed_mps)
    assert value(anchor, vut, None, path) == pytest.approx(value_s, abs=1e-9)


def test_headway_needs_a_vut_that_moves(state: StateMaker) -> None:
    other = state("ot1", x_m=30.0)
    for speed_mps, value_s in ((10.0, 2.55), (0.1, 255.0), (0.099, math.inf), (-3.0, math.inf)):
        vut = state("vut", speed_mps=speed_mps)
        assert value(HEADWAY, vut, other) == pytest.approx(value_s), speed_mps


def test_speed_of_whom_it_names(state: StateMaker) -> None:
    vut = state("vut", speed_mps=5.0)
    assert read(SLOWER, vut) == Reading(Sample(0, 5.0), False)
    assert read(SLOWER, replace(vut, speed_mps=math.nextafter(5.0, 0.0))).holds is True
    other = state("ot1", speed_mps=5.0)
    assert read(FASTER, vut, other) == Reading(Sample(0, 5.0), False)
    assert read(FASTER, vut, replace(other, speed_mps=math.nextafter(5.0, 6.0))).holds is True


# -- unknown --------------------------------------------------------------------------------------


@pytest.mark.parametrize("condition", [GAP, HEADWAY, TTC, FASTER, INSIDE])
def test_an_object_that_is_not_known_decides_nothing(
    condition: dict[str, Any], state: StateMaker
) -> None:
    vut = state("vut", stamp_ns=S, speed_mps=0.0)
    old, young = S - 300 * MS - 1, S + 300 * MS + 1
    for other in (
        None,
        state("ot1", x_m=25.0, stamp_ns=old),
        state("ot1", x_m=25.0, stamp_ns=young),
        state("ot1", x_m=math.nan, stamp_ns=S),
        state("ot1", x_m=25.0, stamp_ns=S, acceleration_mps2=math.inf),
    ):
        reading = read(condition, vut, other)
        assert math.isnan(reading.sample.value)
        assert reading.holds is None
    for stamp_ns in (old + 1, young - 1):
        assert read(condition, vut, state("ot1", x_m=25.0, stamp_ns=stamp_ns)).holds is not None


@pytest.mark.parametrize("condition", [GAP, HEADWAY, TTC, ARRIVAL, SLOWER])
def test_a_vut_without_a_number_decides_nothing(
    condition: dict[str, Any], state: StateMaker
) -> None:
    for change in ({"x_m": math.nan}, {"speed_mps": math.nan}, {"yaw_rad": math.inf}):
        reading = read(condition, state("vut", **change), state("ot1", x_m=40.0))
        assert reading.holds is None


def test_objects_are_taken_to_the_vuts_stamp(state: StateMaker) -> None:
    vut = state("vut", x_m=10.0, stamp_ns=S)
    older = state("ot1", x_m=40.0, speed_mps=10.0, stamp_ns=S - 200 * MS)
    newer = state("ot1", x_m=40.0, speed_mps=10.0, stamp_ns=S + 200 * MS)
    assert value(GAP, vut, older) == pytest.approx(27.5)
    assert value(GAP, vut, newer) == pytest.approx(23.5)


def test_what_nobody_asks_about_is_not_extrapolated(
    state: StateMaker, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    honest = ObjectState.extrapolated

    def counted(self: ObjectState, stamp_ns: int) -> ObjectState:
        asked.append(self.object_id)
        return honest(self, stamp_ns)

    monkeypatch.setattr(ObjectState, "extrapolated", counted)
    targets = {f"ot{i}": state(f"ot{i}", x_m=40.0, stamp_ns=S) for i in range(20)}
    snapshot = Snapshot(state("vut", stamp_ns=S + MS), targets, STRAIGHT, 300 * MS, {})
    for condition in (GAP, TTC, FASTER, ARRIVAL):
        question(PARSER.validate_python(condition), STRAIGHT, 0).read(snapshot)
    assert asked == ["ot1"]


# -- instants of change, and texts ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("condition", "text"),
    [
        (GAP, "gap vut - ot1 < 12 m"),
        (ARRIVAL, "time of vut to anchor (100.0, -5.0) < 3 s"),
        (HEADWAY, "time headway vut - ot1 < 2 s"),
        (TTC, "TTC vut - ot1 < 3 s"),
        (FASTER, "speed of ot1 > 5 m/s"),
        (SLOWER, "speed of vut < 5 m/s"),
        (INSIDE, "room of ot1 in region (20.0 to 30.0, -2.0 to 2.0) > 0 m"),
        (BEGUN, "time since phase conflict >= 0 s"),
        (LATE, "time since the start >= 4.5 s"),
        (
            {"type": "all", "of": [GAP, {"type": "any", "of": [TTC, LATE]}]},
            "all of (gap vut - ot1 < 12 m; any of (TTC vut - ot1 < 3 s; "
            "time since the start >= 4.5 s))",
        ),
    ],
)
def test_conditions_as_text(condition: dict[str, Any], text: str) -> None:
    assert condition_text(PARSER.validate_python(condition)) == text


@given(
    st.tuples(*[st.floats(-1e6, 1e6)] * 3), st.integers(0, 10**18), st.integers(1, 10 * NS_PER_S)
)
def test_the_crossing_is_the_exact_one_rounded_half_to_even(
    values: tuple[float, float, float], stamp_ns: int, step_ns: int
) -> None:
    before, threshold, after = values
    assume(before != after)
    asked = ThresholdCondition(Quantity("gap", "<", threshold, "m"), lambda snapshot: math.nan)
    first = Reading(Sample(stamp_ns, before), False)
    second = Reading(Sample(stamp_ns + step_ns, after), True)
    share = (Fraction(before) - Fraction(threshold)) / (Fraction(before) - Fraction(after))
    assert asked.changed_ns(first, second) == stamp_ns + round(share * step_ns)
