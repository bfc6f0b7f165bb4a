"""An object whose heading isn't known at rest: its first metre shows whether it faces its start."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.run_file.values import Start
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.limits import LimitViolation, is_standing
from ssp_core.safety.start_heading import StartHeading, start_heading
from ssp_core.vocabulary import ObjectClass, Role
from tests.support.states import object_state
from tests.support.tracks import RATES_HZ, SOURCES, Row, measured, motion

S = 1_000_000_000
BOUNDS = Bounds(math.radians(20.0), jump_m=1.0, position_std_m=0.5)
WAYS_M = tuple(0.2 * k for k in range(1, 15))
LIMITS = Limits(speed_mps=30.0, acceleration_mps2=5.0, heading_by_course=["one"])


def first_violation(
    rows: list[Row], yaw_rad: float, cls: ObjectClass = ObjectClass.CAR, limits: Limits = LIMITS
) -> tuple[float, LimitViolation] | None:
    """Return when the first metre contradicted a start's heading, and the limit violated."""
    start = Start(x_m=0.0, y_m=0.0, yaw_rad=yaw_rad)
    one = ParticipantSpec(id="one", object_class=cls.name.lower(), start=start)
    watch, heading = ConsistencyWatch(Bounds.of("one", cls, limits)), start_heading(one, limits)
    assert heading is not None
    for t_s, x, y, yaw, v, std in rows:
        state = ObjectState(
            "one",
            cls,
            Role.VUT,
            round(t_s * S),
            x,
            y,
            yaw,
            v,
            0.0,
            0.0,
            DEFAULT_SIZES[cls],
            position_std_m=std,
        )
        watch.see(state)
        if (found := heading.see(state, stands=is_standing(state, watch))) is not None:
            return t_s, found
    return None


def way(
    course_rad: float, speed: float, *, step_m: float = 0.0, rate_hz: float = 50.0
) -> list[Row]:
    """A source without noise that stands for a second; what it states as yaw has no meaning."""
    rows = []
    for k in range(round(4.0 * rate_hz)):
        t = k / rate_hz
        s = abs(speed) * max(t - 1.0, 0.0)
        x, y = s * math.cos(course_rad) - step_m * (t > 1.2), s * math.sin(course_rad)
        rows.append((t, x, y, -2.0, speed * (t > 1.0), 0.02))
    return rows


@pytest.mark.parametrize("rate_hz", [5.0, 50.0])
@pytest.mark.parametrize("yaw_rad", [0.0, 2.0, -3.0])
def test_who_drives_the_other_way_is_found_within_a_metre_and_a_half(
    yaw_rad: float, rate_hz: float
) -> None:
    assert first_violation(way(yaw_rad + 0.3, 2.0, rate_hz=rate_hz), yaw_rad) is None
    found = first_violation(way(yaw_rad + math.pi, 2.0, rate_hz=rate_hz), yaw_rad)
    assert found is not None
    assert found[1].code is SafetyCode.STATE_CONTRADICTS
    assert "lead +180° off its start's heading, limit 20°" in found[1].words
    assert (found[0] - 1.0) * 2.0 <= 2.5


def test_who_states_that_it_reverses_faces_its_start() -> None:
    assert first_violation(way(math.pi, -2.0), 0.0) is None
    assert first_violation(way(0.0, -2.0), 0.0) is not None
    assert first_violation(way(math.pi / 2.0, -2.0), 0.0) is not None


def test_a_person_may_go_backwards_and_what_is_omnidirectional_anywhere() -> None:
    backwards, sideways = way(math.pi, 1.5), way(math.pi / 2.0, 1.5)
    assert first_violation(backwards, 0.0, ObjectClass.PEDESTRIAN) is None
    assert first_violation(sideways, 0.0, ObjectClass.PEDESTRIAN) is not None
    any_way = LIMITS.model_copy(update={"omnidirectional": ["one"]})
    assert first_violation(sideways, 0.0, limits=any_way) is None


def test_one_correction_of_the_receiver_is_no_way() -> None:
    assert first_violation(way(0.0, 1.0, step_m=0.99), 0.0) is None
    assert first_violation(way(math.pi, 1.0, step_m=0.99), 0.0) is not None


def violations_on(
    *places: tuple[float, float],
    yaw_rad: float = 0.0,
    tolerance_deg: float = 10.0,
    std_m: float = 0.0,
    speed_mps: float = 1.0,
    stood_std_m: float | None = None,
    bounds: Bounds = BOUNDS,
) -> list[tuple[int, LimitViolation]]:
    """Tell what is found after each place, half a second apart; at the first the object stands."""
    heading = StartHeading(bounds, yaw_rad, math.radians(tolerance_deg))
    found = []
    for k, (x_m, y_m) in enumerate(((0.0, 0.0), *places)):
        std = std_m if k or stood_std_m is None else stood_std_m
        state = object_state(
            x_m=3.0 + x_m,
            y_m=7.0 + y_m,
            speed_mps=speed_mps,
            stamp_ns=S + k * S // 2,
            position_std_m=std,
        )
        if (passed := heading.see(state, stands=k == 0)) is not None:
            found.append((k, passed))
    return found


def at(course_deg: float, *ways_m: float) -> list[tuple[float, float]]:
    c, s = math.cos(math.radians(course_deg)), math.sin(math.radians(course_deg))
    return [(way_m * c, way_m * s) for way_m in ways_m]


def test_the_first_metre_is_judged_once_it_is_gone() -> None:
    """Steps of less than a correction are one by which the way may have begun."""
    wide = replace(BOUNDS, jump_m=0.1)
    assert violations_on(*at(90.0, 0.5, 0.99), bounds=wide) == []
    ((k, found),) = violations_on(*at(90.0, 0.5, 1.0, 1.5, 9.0), bounds=wide)
    words = "its first 1.00 m lead +90° off its start's heading, limit 20°"
    assert (k, found) == (2, LimitViolation(SafetyCode.STATE_CONTRADICTS, 1.0, 0.0, words))
    # A first metre that was right is the last that is looked at.
    assert violations_on(*at(0.0, 0.5, 1.1), *at(90.0, 3.0, 9.0), bounds=wide) == []


@pytest.mark.parametrize(
    ("course_deg", "tolerance_deg", "turned"),
    [
        (19.9, 10.0, False),
        (-19.9, 10.0, False),
        (20.1, 10.0, True),
        (-20.1, 10.0, True),
        (29.9, 30.0, False),
        (30.1, 30.0, True),
    ],
)
def test_the_wider_of_tolerance_and_direction_counts(
    course_deg: float, tolerance_deg: float, turned: bool
) -> None:
    for yaw_rad in (0.0, 2.0, 3.0):
        places = at(course_deg + math.degrees(yaw_rad), *WAYS_M)
        found = violations_on(*places, yaw_rad=yaw_rad, tolerance_deg=tolerance_deg)
        assert bool(found) is turned


@pytest.mark.parametrize(
    ("course_deg", "speed_mps", "signed", "turned"),
    [
        (0.0, 0.0, True, False),
        (0.0, 0.5, True, False),
        (0.0, -0.5, True, True),
        (180.0, -0.5, True, False),
        (170.0, -0.5, True, False),
        (150.0, -0.5, True, True),
        (180.0, 0.5, True, True),
        (180.0, 0.5, False, False),
        (0.0, -0.5, False, False),
        (90.0, 0.5, False, True),
    ],
)
def test_the_sign_of_the_speed_says_whether_it_faces_where_it_goes(
    course_deg: float, speed_mps: float, signed: bool, turned: bool
) -> None:
    for yaw_rad in (0.0, 2.5):
        places = at(course_deg + math.degrees(yaw_rad), *WAYS_M)
        by = replace(BOUNDS, signed=signed, jump_m=0.1)
        assert (
            bool(violations_on(*places, yaw_rad=yaw_rad, speed_mps=speed_mps, bounds=by)) is turned
        )


def test_a_site_says_whose_heading_is_watched_and_how_far_it_may_be_off() -> None:
    site = {"start_yaw_rad": 0.75, "jump_m": 0.1, "omnidirectional": ["two"]}
    limits = LIMITS.model_copy(update={**site, "heading_by_course": ["one", "two"]})
    start = Start(x_m=0.0, y_m=0.0, yaw_rad=2.0)

    def violation_of(who: str, cls: str, course_rad: float) -> LimitViolation | None:
        one = ParticipantSpec(id=who, object_class=cls, start=start)
        watch = start_heading(one, limits)
        assert watch is not None
        for k, way_m in enumerate((0.0, 0.5, 1.0, 1.5)):
            x_m, y_m = way_m * math.cos(course_rad), way_m * math.sin(course_rad)
            state = object_state(x_m=x_m, y_m=y_m, speed_mps=1.0, stamp_ns=k * S)
            if (passed := watch.see(state, stands=k == 0)) is not None:
                return passed
        return None

    assert violation_of("one", "car", 2.0 + 0.74) is violation_of("one", "car", 2.0 - 0.74) is None
    assert violation_of("one", "car", 2.0 + 0.76) is not None
    assert violation_of("one", "car", 2.0 + math.pi) is not None
    assert violation_of("one", "pedestrian", 2.0 + math.pi) is None
    assert violation_of("two", "car", 2.0 + math.pi) is None


@pytest.mark.parametrize(
    ("std_m", "stood_std_m", "first"),
    [
        (0.25, 0.0, 3),
        (0.0, 0.25, 3),
        (0.25, 0.25, 3),
        (0.5, 0.0, 5),
        # No place counts as less certain than the bound.
        (9.0, 0.0, 5),
        (math.nan, 0.0, 5),
    ],
)
def test_a_way_is_judged_when_it_is_longer_than_its_places_are_uncertain(
    std_m: float, stood_std_m: float, first: int
) -> None:
    """Three sigma of two places: 1.06 m of 0.25 m, 2.12 m of 0.5 m."""
    ways_m = (0.5, 1.05, 1.07, 2.11, 2.13, 3.0)
    sure = replace(BOUNDS, jump_m=0.1)
    ((k, found),) = violations_on(
        *at(180.0, *ways_m), std_m=std_m, stood_std_m=stood_std_m, bounds=sure
    )
    assert k == first
    # A direction that is that uncertain is 45 degrees wide.
    assert found.words.endswith("limit 45°")
    assert (
        violations_on(*at(43.0, *ways_m), std_m=std_m, stood_std_m=stood_std_m, bounds=sure) == []
    )


def test_one_step_of_the_place_begins_the_way_behind_it_and_a_second_one_does_not() -> None:
    once = (-0.99, 0.0), (-0.8, 0.0), (-0.5, 0.0), (-1.0, 0.0)
    assert violations_on(*once[:3]) == []
    backwards = ((-0.9, 0.0), (-1.1, 0.0), (-1.5, 0.0), (-1.89, 0.0), (-1.91, 0.0))
    assert [k for k, _ in violations_on(*backwards)] == [5]
    # What is longer than a correction is a way at once.
    assert [k for k, _ in violations_on((-1.01, 0.0))] == [1]
    assert [k for k, _ in violations_on((-1.0, 0.0))] == []
    # The longest step counts, whichever it was, and wherever it led.
    up = ((0.0, 0.9), (0.1, 0.95), (0.3, 1.0), (0.9, 1.0), (2.0, 0.95))
    assert violations_on(*up) == []


def test_older_states_and_standstill_are_no_way() -> None:
    heading = StartHeading(replace(BOUNDS, jump_m=0.1), 0.0, 0.3)

    def see(stamp_s: float, x_m: float, *, stands: bool = False) -> LimitViolation | None:
        state = object_state(x_m=x_m, speed_mps=1.0, stamp_ns=round(stamp_s * S))
        return heading.see(state, stands=stands)

    # The first state is where it stood, whether it says so or not.
    assert see(1.0, 50.0) is None
    assert see(2.0, 0.0, stands=True) is None
    assert see(2.0, -9.0) is None
    assert see(1.9, -9.0) is None
    assert see(3.0, -0.9) is None
    assert see(4.0, -0.9, stands=True) is None
    assert see(5.0, -1.8) is None
    assert see(6.0, -1.91) is not None
    assert see(7.0, -9.0) is None
    heading.clear()
    assert see(1.0, 0.0, stands=True) is None
    assert see(2.0, -1.5) is not None


def test_an_object_that_is_not_listed_is_not_watched() -> None:
    start = Start(x_m=0.0, y_m=0.0, yaw_rad=0.0)
    one = ParticipantSpec(id="two", object_class="car", start=start)
    assert start_heading(one, LIMITS) is None


def test_of_200_sound_tracks_none_is_taken_for_turned_and_each_that_is_turned_is_found() -> None:
    manoeuvres = ("drive", "walk", "reverse", "stand", "dropout")
    cases = list(product(manoeuvres, SOURCES, RATES_HZ))
    for seed in range(200):
        manoeuvre, source, rate_hz = case = cases[seed % len(cases)]
        random = np.random.default_rng(seed)
        true = motion(manoeuvre, random)
        rows = list(measured(true, SOURCES[source], rate_hz, random))
        yaw_rad = float(true.rows[200, 3])  # where it sets off
        cls = ObjectClass.PEDESTRIAN if true.walks else ObjectClass.CAR
        assert first_violation(rows, yaw_rad, cls) is None, (seed, case)
        if manoeuvre in ("drive", "reverse", "dropout"):
            assert first_violation(rows, yaw_rad + math.pi, cls) is not None, (seed, case)
