"""Every limit at, just inside and just outside its boundary; no number never keeps one."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ssp_core.geometry import box_distance
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState, Size
from ssp_core.run_file.model import Limits
from ssp_core.safety import limits as judge
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.fence import box_excess_m
from ssp_core.safety.limits import Continuity, LimitViolation, follow, near_pairs
from ssp_core.vocabulary import ControlState, ObjectClass, Role
from tests.support.states import object_state

S = 1_000_000_000
FENCE = [(-10.0, -5.0), (110.0, -5.0), (110.0, 5.0), (-10.0, 5.0)]
# A limit of its own for each, so that none can be taken for another.
LIMITS = Limits(
    speed_mps=15.0,
    acceleration_mps2=3.0,
    heartbeat_s=0.5,
    state_age_s=0.3,
    error_longitudinal_m=2.0,
    error_lateral_m=0.8,
    error_yaw_rad=0.35,
    position_std_m=0.6,
    jump_m=1.0,
    frozen_s=0.4,
    clock_offset_s=0.05,
    link_delay_s=0.45,
)
STATE = ObjectState(
    object_id="ot1",
    object_class=ObjectClass.CAR,
    role=Role.OT,
    stamp_ns=20 * S,
    x_m=50.0,
    y_m=0.0,
    yaw_rad=0.0,
    speed_mps=10.0,
    acceleration_mps2=0.0,
    yaw_rate_radps=0.0,
    size=DEFAULT_SIZES[ObjectClass.CAR],
)
Judge = Callable[[float], LimitViolation | None]
SCALARS: list[tuple[SafetyCode, float, Judge]] = [
    (SafetyCode.HEARTBEAT_LOST, 0.5, lambda v: judge.heartbeat_lost(v, LIMITS)),
    (SafetyCode.STATE_STALE, 0.3, lambda v: judge.state_stale(v, LIMITS)),
    (SafetyCode.OVER_SPEED, 15.0, lambda v: judge.over_speed(replace(STATE, speed_mps=v), LIMITS)),
    (
        SafetyCode.OVER_ACCELERATION,
        3.0,
        lambda v: judge.over_acceleration(replace(STATE, acceleration_mps2=v), LIMITS),
    ),
    (SafetyCode.ERROR_LONGITUDINAL, 2.0, lambda v: judge.error_longitudinal(v, LIMITS)),
    (SafetyCode.ERROR_LATERAL, 0.8, lambda v: judge.error_lateral(v, LIMITS)),
    (SafetyCode.ERROR_YAW, 0.35, lambda v: judge.error_yaw(v, LIMITS)),
    (
        SafetyCode.LOCALISATION,
        0.6,
        lambda v: judge.localisation(replace(STATE, position_std_m=v), LIMITS),
    ),
    (SafetyCode.STATE_FROZEN, 0.4, lambda v: judge.state_frozen(v, LIMITS)),
    (SafetyCode.CLOCK_OFFSET, 0.05, lambda v: judge.clock_offset(v, LIMITS)),
    (SafetyCode.LINK_DELAY, 0.45, lambda v: judge.link_delay(v, LIMITS)),
]


@pytest.mark.parametrize(("code", "limit", "passed"), SCALARS, ids=lambda v: getattr(v, "name", ""))
def test_at_inside_and_outside_the_boundary(code: SafetyCode, limit: float, passed: Judge) -> None:
    assert passed(limit) is None
    assert passed(math.nextafter(limit, 0.0)) is None
    beyond = math.nextafter(limit, math.inf)
    assert passed(beyond) == LimitViolation(code, beyond, limit)
    for wrong in (math.nan, math.inf):
        found = passed(wrong)
        assert found is not None
        assert (found.code, found.limit) == (code, limit)


@pytest.mark.parametrize(("code", "limit", "passed"), SCALARS, ids=lambda v: getattr(v, "name", ""))
def test_signed_values_count_on_both_sides(code: SafetyCode, limit: float, passed: Judge) -> None:
    assert passed(-limit) is None
    found = passed(-math.nextafter(limit, math.inf))
    if code is SafetyCode.STATE_STALE:
        assert found is None  # a stamp ahead of the clock is no age
        return
    assert found is not None
    assert found.measured < -limit


@pytest.mark.parametrize(
    "field", ["x_m", "y_m", "yaw_rad", "speed_mps", "acceleration_mps2", "yaw_rate_radps"]
)
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_no_number_in_a_state(field: str, value: float) -> None:
    assert judge.state_not_finite(STATE) is None
    found = judge.state_not_finite(replace(STATE, **{field: value}))
    assert found is not None
    assert (found.code, found.limit) == (SafetyCode.STATE_NOT_FINITE, 0.0)


@pytest.mark.parametrize("field", ["front_m", "rear_m", "width_m", "height_m"])
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e300])
def test_no_number_in_an_extent(field: str, value: float) -> None:
    """Such a box would be inside every fence, and far from everybody."""
    found = judge.state_not_finite(replace(STATE, size=replace(STATE.size, **{field: value})))
    assert found is not None
    assert found.code is SafetyCode.STATE_NOT_FINITE


@pytest.mark.parametrize(
    ("extents", "says"),
    [
        ((3.6, 0.9, 1.8, 1.5), ""),
        ((2.25, 0.0, 0.9, 0.0), ""),
        ((2.24, 0.0, 1.8, 1.5), "an extent of 2.24 × 1.8 m, the least for a car is 2.25 × 0.9 m"),
        ((3.6, 0.9, 0.8, 1.5), "an extent of 4.5 × 0.8 m, the least for a car is 2.25 × 0.9 m"),
        ((0.0, 0.0, 0.0, 0.0), "an extent of 0 × 0 m, the least for a car is 2.25 × 0.9 m"),
        ((12.0, 4.0, 3.0, 4.0), ""),
    ],
)
def test_a_body_that_is_too_small_for_its_class(
    extents: tuple[float, float, float, float], says: str
) -> None:
    assert judge.other_body(replace(STATE, size=Size(*extents)), ObjectClass.CAR) == says


def test_a_body_of_another_class() -> None:
    says = judge.other_body(replace(STATE, object_class=ObjectClass.TRUCK), ObjectClass.CAR)
    assert says == "that it is a truck, and run.yaml that it is a car"
    unknown = replace(STATE, object_class=ObjectClass.UNKNOWN)
    assert judge.other_body(unknown, ObjectClass.CAR) == ""


@pytest.mark.parametrize(
    ("place", "excess_m"),
    [
        ({"y_m": 4.1}, None),  # the box is 1.8 m wide
        ({"y_m": 4.1 - 1e-6}, None),
        ({"y_m": 4.1 + 1e-6}, 1e-6),
        ({"y_m": -4.35}, 0.25),
        ({"x_m": 106.4}, None),  # its front is 3.6 m ahead
        ({"x_m": 106.4 + 1e-6}, 1e-6),
        ({"x_m": 106.0, "yaw_rad": 3.141592653589793}, None),
        ({"x_m": math.nan}, math.inf),
    ],
)
def test_the_whole_box_stays_in_the_fence(place: dict[str, float], excess_m: float | None) -> None:
    found = judge.outside_geofence(box_excess_m(replace(STATE, **place).box, FENCE))
    if excess_m is None:
        assert found is None
        return
    assert found is not None
    assert found.code is SafetyCode.OUTSIDE_GEOFENCE
    assert found.measured == pytest.approx(excess_m, rel=1e-3)


# -- jumps and positions that stand ---------------------------------------------------------------


def later(seconds: float, **changes: Any) -> ObjectState:
    return replace(STATE, stamp_ns=STATE.stamp_ns + round(seconds * S), **changes)


@pytest.mark.parametrize(
    ("seconds", "x_m", "y_m", "passed"),
    [
        (0.5, 55.0, 0.0, False),
        (0.5, 55.0, 1.0, False),
        (0.5, 55.0, 1.375, False),  # 1 m, and 3 m/s^2 for half a second
        (0.5, 55.0, 1.375 + 1e-9, True),
        (0.5, 55.0, -1.375 - 1e-9, True),
        (0.5, 56.375 + 1e-9, 0.0, True),
        (0.5, 50.0, 0.0, True),
        (0.125, 51.25 + 1.0234375, 0.0, False),
        (0.125, 51.25 + 1.0234375 + 1e-9, 0.0, True),
    ],
)
def test_a_jump(seconds: float, x_m: float, y_m: float, passed: bool) -> None:
    found = judge.position_jump(STATE, later(seconds, x_m=x_m, y_m=y_m), LIMITS)
    assert (found is not None) == passed
    if found is not None:
        assert found.code is SafetyCode.POSITION_JUMP
        assert found.limit == 1.0 + 1.5 * seconds**2


@pytest.mark.parametrize(("back_m", "passed"), [(0.0, False), (1.1, True)])
def test_a_jump_is_measured_wherever_the_object_is_and_leads(back_m: float, passed: bool) -> None:
    """North-west of the origin and on its way north, a tenth of a second later."""
    before = replace(STATE, x_m=-30.0, y_m=70.0, yaw_rad=math.pi / 2.0)
    after = replace(before, stamp_ns=before.stamp_ns + S // 10, x_m=-30.0, y_m=71.0 - back_m)
    found = judge.position_jump(before, after, LIMITS)
    assert (found is not None) is passed
    assert found is None or found.measured == pytest.approx(back_m)


def test_a_bend_is_no_jump() -> None:
    turning = replace(STATE, yaw_rate_radps=0.5)
    assert judge.position_jump(turning, turning.extrapolated(21 * S), LIMITS) is None


def violations_of(states: list[ObjectState]) -> list[tuple[int, str]]:
    """Index of the state and name of the limit, for each limit that a row of states passes."""
    memory, found = Continuity(), []
    for index, state in enumerate(states):
        memory, passed = follow(memory, state, LIMITS)
        found += [(index, p.code.name) for p in passed]
    return found


def test_a_jump_is_told_once_and_the_new_place_believed() -> None:
    row = [later(0.02 * i, x_m=50.0 + 0.2 * i + (2.0 if i >= 3 else 0.0)) for i in range(8)]
    assert violations_of(row) == [(3, "POSITION_JUMP")]


def test_a_body_changes_neither_its_extent_nor_its_class() -> None:
    small = Size(0.1, 0.0, 0.1, 0.1)
    row = [later(0.02 * i, size=small if i == 2 else STATE.size) for i in range(5)]
    assert violations_of(row) == [(2, "STATE_CONTRADICTS"), (3, "STATE_CONTRADICTS")]
    _, (found,) = follow(Continuity(row[1], None), row[2], LIMITS)
    assert found.words == "states a car of 0.1 × 0.1 m, and stated a car of 4.5 × 1.8 m"
    assert (found.measured, found.limit) == (0.02, 0.0)
    other = replace(row[1], object_class=ObjectClass.BUS)
    assert violations_of([row[0], other]) == [(1, "STATE_CONTRADICTS")]


@pytest.mark.parametrize("lost", [0, 1, 5, 14])
def test_lost_states_are_no_jump(lost: int) -> None:
    """Braking by the limit while up to 0.3 s of states are lost."""
    times = [0.0, 0.02, 0.02 * (2 + lost), 0.02 * (3 + lost)]
    row = [later(t, x_m=50.0 + 10.0 * t - 1.5 * t * t, speed_mps=10.0 - 3.0 * t) for t in times]
    assert violations_of(row) == []


def test_older_and_unreadable_states_are_not_judged() -> None:
    row = [later(0.02), later(0.0, x_m=90.0), later(0.02, x_m=90.0), later(0.04, x_m=math.nan)]
    assert violations_of([*row, later(0.06, x_m=50.4)]) == []


@pytest.mark.parametrize(
    ("speed_mps", "from_state"), [(10.0, 21), (0.21, 21), (0.2, None), (0.0, None), (-10.0, 21)]
)
def test_a_position_that_stands_while_the_object_moves(
    speed_mps: float, from_state: int | None
) -> None:
    """The limit is 0.4 s: 20 periods may pass, the 21st is too many."""
    wide = LIMITS.model_copy(update={"jump_m": 100.0})
    memory, found = Continuity(), []
    for index in range(24):
        state = later(0.02 * index, speed_mps=speed_mps)
        memory, passed = follow(memory, state, wide)
        found += [(index, p.code) for p in passed]
    expected = [] if from_state is None else range(from_state, 24)
    assert found == [(index, SafetyCode.STATE_FROZEN) for index in expected]


@pytest.mark.parametrize(
    ("moved_m", "frozen"), [((0.01, 0.0), True), ((0.0, -0.011), False), ((-0.0101, 0.0), False)]
)
def test_who_went_a_centimetre_has_stayed(moved_m: tuple[float, float], frozen: bool) -> None:
    """The first state lies beside the axes; the place moves once, with the second."""
    first = replace(STATE, x_m=0.0, y_m=30.0)
    then: dict[str, Any] = {"x_m": moved_m[0], "y_m": 30.0 + moved_m[1]}
    memory, found = Continuity(), []
    for step in range(22):
        state = replace(first, stamp_ns=S + step * S // 50, **(then if step else {}))
        memory, passed = follow(memory, state, LIMITS.model_copy(update={"jump_m": 100.0}))
        found += [(step, one.code) for one in passed]
    assert found == ([(21, SafetyCode.STATE_FROZEN)] if frozen else [])


def test_a_short_stop_of_the_position_is_forgiven() -> None:
    at = [0.0, 0.2, 0.4, 0.4, 0.4, 0.4, 1.2, 1.4, 1.6]
    assert violations_of([later(0.02 * i, x_m=50.0 + x) for i, x in enumerate(at)]) == []


# -- what a state says of itself ------------------------------------------------------------------


@pytest.mark.parametrize(
    ("says", "codes"),
    [
        ({"error_longitudinal_m": 2.1}, ["ERROR_LONGITUDINAL"]),
        ({"error_lateral_m": -0.9}, ["ERROR_LATERAL"]),
        ({"error_yaw_rad": 0.4}, ["ERROR_YAW"]),
        ({"error_longitudinal_m": 2.1, "error_yaw_rad": 0.4}, ["ERROR_LONGITUDINAL"]),
        ({"error_lateral_m": 0.9, "reference_id": ""}, []),
        ({"acceleration_mps2": -3.1}, ["OVER_ACCELERATION"]),
        ({"acceleration_mps2": -3.1, "control_state": ControlState.ABORTING}, []),
        ({"acceleration_mps2": -3.1, "reference_id": ""}, []),
        (
            {"position_std_m": 0.7, "acceleration_mps2": 3.1, "error_yaw_rad": -0.4},
            ["LOCALISATION", "OVER_ACCELERATION", "ERROR_YAW"],
        ),
    ],
)
def test_errors_and_acceleration_count_off_a_reference(
    says: dict[str, Any], codes: list[str]
) -> None:
    driven = {"reference_id": "r", "control_state": ControlState.RUNNING}
    found = judge.statement_violations(replace(STATE, **{**driven, **says}), LIMITS)
    assert [one.code.name for one in found] == codes


@pytest.mark.parametrize(
    ("age_s", "allowance_s", "measured"),
    [
        (5.0, 0.0, None),
        (0.0, 0.0, None),
        (-0.05, 0.0, None),
        (-0.06, 0.0, 0.06),
        (-0.06, 0.02, None),
        (-0.08, 0.02, 0.06),
        (math.nan, 0.0, math.nan),
    ],
)
def test_a_stamp_ahead_counts_beyond_what_is_allowed_for(
    age_s: float, allowance_s: float, measured: float | None
) -> None:
    found = judge.stamp_ahead(age_s, LIMITS, allowance_s)
    assert (found is None) is (measured is None)
    if found is not None:
        assert (found.code, found.limit) == (SafetyCode.CLOCK_OFFSET, 0.05)
        assert found.measured == pytest.approx(measured, nan_ok=True)


def test_an_offset_is_known_to_half_of_the_delay_and_a_negative_one_takes_nothing_off() -> None:
    def codes(offset_s: float, delay_s: float) -> list[str]:
        return [one.code.name for one in judge.link_violations(offset_s, delay_s, LIMITS)]

    assert codes(0.25, 0.4) == codes(-0.25, 0.4) == codes(0.05, -0.0005) == []
    assert codes(0.251, 0.4) == codes(-0.251, 0.4) == codes(0.051, -0.0005) == ["CLOCK_OFFSET"]
    assert codes(9.0, 0.46) == ["LINK_DELAY", "CLOCK_OFFSET"]
    assert codes(math.nan, math.nan) == ["LINK_DELAY", "CLOCK_OFFSET"]


def test_who_went_as_far_as_its_places_are_uncertain_has_stood() -> None:
    def watch(way_m: float, std_m: float = 0.0) -> ConsistencyWatch:
        made = ConsistencyWatch(Bounds())
        for step in range(2):
            made.take(step * S, way_m * step, 0.0, 0.0, 0.0, std_m)
        return made

    assert judge.is_standing(replace(STATE, speed_mps=0.0), watch(0.1))
    assert judge.is_standing(replace(STATE, speed_mps=0.0), watch(0.6, 0.25))
    assert judge.net_way_m(watch(math.nextafter(0.1, 1.0))) == (math.nextafter(0.1, 1.0), 0.1)
    assert judge.net_way_m(watch(0.75, 0.25)) == (0.75, 0.6)
    for mps, stood in ((0.05, True), (-0.05, True), (0.051, False), (-0.051, False)):
        assert judge.is_standing(replace(STATE, speed_mps=mps), watch(0.0)) is stood
    assert not judge.is_standing(replace(STATE, speed_mps=0.0), watch(0.2))
    assert not judge.is_standing(replace(STATE, speed_mps=math.nan), watch(0.0))


# -- two objects ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gap_m", "code"),
    [
        (0.5, None),
        (0.5 + 1e-9, None),
        (0.5 - 1e-9, SafetyCode.SEPARATION),
        (1e-9, SafetyCode.SEPARATION),
        (0.0, SafetyCode.COLLISION),
        (-0.3, SafetyCode.COLLISION),
        (40.0, None),
    ],
)
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_the_distance_of_two_boxes(gap_m: float, code: SafetyCode | None, side: float) -> None:
    # Side by side, in sizes that doubles hold exactly.
    a = replace(STATE, size=Size(3.5, 1.0, 2.0, 1.5))
    b = replace(a, object_id="ot2", y_m=side * (2.0 + gap_m))
    found = judge.separation(a, b, LIMITS)
    assert (found.code if found else None) == code
    if found is not None:
        assert found.measured == pytest.approx(max(gap_m, 0.0), abs=1e-12)
        assert found.limit == (0.0 if code is SafetyCode.COLLISION else 0.5)


@pytest.mark.parametrize("course_rad", [k * math.pi / 4.0 for k in range(8)])
@pytest.mark.parametrize(
    ("turned_rad", "ahead_m", "left_m"),
    [
        (0.0, 4.9, 0.5),  # its tail before the other's nose
        (math.pi, 7.6, -0.5),  # nose to nose
        (0.0, -4.9, 0.5),
        (math.pi, -2.2, 0.5),  # tail to tail
        (0.0, 1.0, 2.2),  # side by side
        (math.pi / 2.0, 4.9, 0.5),  # its right side before the other's nose
    ],
)
def test_boxes_that_are_too_near_are_found_whichever_way_they_face(
    course_rad: float, turned_rad: float, ahead_m: float, left_m: float
) -> None:
    """Away from the origin; 0.4 m are left, and 0.5 m are asked for."""
    c, s = math.cos(course_rad), math.sin(course_rad)
    a = replace(STATE, x_m=-20.0, y_m=30.0, yaw_rad=course_rad)
    x_m, y_m = -20.0 + c * ahead_m - s * left_m, 30.0 + s * ahead_m + c * left_m
    b = replace(a, x_m=x_m, y_m=y_m, yaw_rad=course_rad + turned_rad)
    for found in (judge.separation(a, b, LIMITS), judge.separation(b, a, LIMITS)):
        assert found is not None
        assert (found.code, found.limit) == (SafetyCode.SEPARATION, 0.5)
        assert found.measured == pytest.approx(0.4)


def test_of_no_pair_the_cheap_gap_is_wider_than_the_distance() -> None:
    """Pairs that it rules out are measured no closer."""
    random = np.random.default_rng(11)
    apart = 0
    for _ in range(1500):
        x_m, y_m, *yaws = random.uniform((-9.0, -9.0, -7.0, -7.0), (9.0, 9.0, 7.0, 7.0)).tolist()
        extents = random.uniform(0.1, 5.0, (2, 3)).tolist()
        a = state(-4.0, 6.0, yaws[0], *extents[0])
        b = state(-4.0 + x_m, 6.0 + y_m, yaws[1], *extents[1])
        gap_m, distance_m = judge._least_gap_m(a, b), box_distance(a.box, b.box)
        assert gap_m <= distance_m + 1e-9
        apart += gap_m > 0.0
    assert apart > 300


@given(
    st.floats(-8.0, 8.0),
    st.floats(-8.0, 8.0),
    st.floats(-3.2, 3.2),
    st.floats(-3.2, 3.2),
    st.floats(0.0, 3.0),
)
def test_separation_is_the_distance_of_the_boxes(
    x_m: float, y_m: float, yaw_a_rad: float, yaw_b_rad: float, limit_m: float
) -> None:
    a = replace(STATE, x_m=0.0, yaw_rad=yaw_a_rad)
    b = replace(STATE, x_m=x_m, y_m=y_m, yaw_rad=yaw_b_rad)
    distance_m = box_distance(a.box, b.box)
    found = judge.separation(a, b, LIMITS.model_copy(update={"separation_m": limit_m}))
    if distance_m == 0.0 and found is not None:
        assert found.code is SafetyCode.COLLISION
    elif abs(distance_m - limit_m) > 1e-9:
        assert (found is None) == (distance_m > limit_m)


@pytest.mark.parametrize(("asked_mps", "frozen"), [(0.0, False), (0.2, False), (1.4, True)])
def test_a_state_that_froze_at_rest_is_seen_when_motion_is_asked_for(
    asked_mps: float, frozen: bool
) -> None:
    at_rest = replace(STATE, speed_mps=0.0)
    memory, found = Continuity(), []
    for step in range(60):
        state = replace(at_rest, stamp_ns=STATE.stamp_ns + step * S // 50)
        memory, passed = follow(memory, state, LIMITS, asked_mps)
        found += [(step, one.code) for one in passed]
    assert found[:1] == ([(21, SafetyCode.STATE_FROZEN)] if frozen else [])


def test_an_object_that_follows_what_it_is_asked_for_is_not_frozen() -> None:
    memory = Continuity()
    x_m = speed_mps = 0.0
    for step in range(100):
        asked_mps = min(2.0, 0.04 * step)
        speed_mps += (asked_mps - speed_mps) * 0.02 / 0.6  # a sluggish drive
        x_m += speed_mps * 0.02
        stamp_ns = STATE.stamp_ns + step * S // 50
        state = replace(STATE, stamp_ns=stamp_ns, x_m=x_m, speed_mps=speed_mps)
        memory, passed = follow(memory, state, LIMITS, asked_mps)
        assert passed == []


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


@pytest.mark.parametrize("y_m", [-500.0, 0.0, 500.0])
def test_a_pair_is_near_wherever_it_is(y_m: float) -> None:
    states = [state(x_m, y_m + 1.0 + x_m, 0.0, 1.0, 1.0, 1.0) for x_m in (9.0, 3.0, 0.5, -4.0)]
    assert near_pairs(states, 1.0) == [(1, 2)]
    assert near_pairs(states[::-1], 1.0) == [(1, 2)]


@pytest.mark.parametrize("course_rad", [0.0, math.pi / 2.0, -math.pi / 2.0])
@pytest.mark.parametrize("within_m", [0.0, 0.5])
def test_boxes_that_point_corners_at_each_other_are_as_near_as_these(
    course_rad: float, within_m: float
) -> None:
    """The widest reach counts, and rounding leaves none out."""
    a = state(0.0, 0.0, course_rad - math.atan2(1.0, 3.0), 3.0, 1.0, 2.0)
    away_m = 2.0 * math.hypot(3.0, 1.0) + within_m
    x_m, y_m = away_m * math.cos(course_rad), away_m * math.sin(course_rad)
    b = replace(a, x_m=x_m, y_m=y_m, yaw_rad=a.yaw_rad + math.pi)
    assert box_distance(a.box, b.box) == pytest.approx(within_m, abs=1e-9)
    assert near_pairs([a, b], within_m) == [(0, 1)]


def test_an_extent_that_is_no_number_may_reach_anywhere() -> None:
    states = [state(0.0, 0.0, 0.0, 1.0, 1.0, 1.0), state(500.0, 0.0, 0.0, math.nan, 1.0, 1.0)]
    assert near_pairs(states, 0.5) == [(0, 1)]
    assert near_pairs(states[::-1], 0.5) == [(0, 1)]
