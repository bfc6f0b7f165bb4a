"""Stated speed, direction and yaw against places: what contradicts itself, and what doesn't."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from ssp_core.run_file.model import Limits
from ssp_core.safety import window
from ssp_core.safety.codes import SafetyCode
from ssp_core.safety.consistency import Bounds, ConsistencyWatch, WindowCounts
from ssp_core.safety.contradiction import Contradiction
from ssp_core.safety.limits import LimitViolation, net_way_m, state_contradicts
from ssp_core.vocabulary import ObjectClass
from tests.support.states import object_state
from tests.support.tracks import (
    MANOEUVRES,
    RATES_HZ,
    SOURCES,
    Motion,
    Row,
    falsified,
    measured,
    motion,
)

S = 1_000_000_000
LIMITS = Limits(speed_mps=30.0, acceleration_mps2=5.0)


def bounds(manoeuvre: str) -> Bounds:
    cls = ObjectClass.PEDESTRIAN if manoeuvre == "walk" else ObjectClass.CAR
    any_way = ["one"] if manoeuvre == "sideways" else []
    return Bounds.of("one", cls, LIMITS.model_copy(update={"omnidirectional": any_way}))


def watched(rows: Iterable[Row], by: Bounds) -> Iterator[ConsistencyWatch]:
    """The watch after each of these states."""
    watch = ConsistencyWatch(by)
    for t_s, *values in rows:
        watch.take(round(t_s * S), *values)
        yield watch


def ended(rows: Iterable[Row], by: Bounds) -> tuple[float, Contradiction] | None:
    """Return when a session would have ended, and the contradiction; None: it goes on."""
    rows = list(rows)
    for row, watch in zip(rows, watched(rows, by), strict=True):
        if watch.contradiction is not None and watch.contradiction.holds:
            return row[0], watch.contradiction
    return None


def track(seed: int, manoeuvre: str, source: str, rate_hz: float, white: float) -> list[Row]:
    random = np.random.default_rng(seed)
    true = motion(manoeuvre, random)
    return list(measured(true, SOURCES[source], rate_hz, random, white=white))


@pytest.mark.parametrize("white", [0.4, 1.0])
def test_of_200_sound_tracks_none_is_refused_and_none_ended(white: float) -> None:
    cases = list(product(MANOEUVRES, SOURCES, RATES_HZ))
    for seed in range(200):
        manoeuvre, source, rate_hz = case = cases[seed % len(cases)]
        rows = track(seed, manoeuvre, source, rate_hz, white)
        for watch in watched(rows, bounds(manoeuvre)):
            assert watch.doubt is None, (seed, case, watch.doubt)
            assert watch.contradiction is None or not watch.contradiction.holds, (seed, case)


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("source", ["rtk", "float"])
@pytest.mark.parametrize(
    ("false", "kind"),
    [
        ("map axes", window.MAP_AXES),
        ("180", window.TURNED),
        ("ned", window.NED_YAW),
        ("empty", window.EMPTY_TWIST),
    ],
)
def test_a_source_that_contradicts_itself_ends_a_session(
    false: str, kind: str, source: str, rate_hz: float
) -> None:
    for heading_rad in (2.0, -1.1, -2.6):
        random = np.random.default_rng(int(10 * rate_hz))
        true = _straight(heading_rad, 9.3)
        sound = list(measured(true, SOURCES[source], rate_hz, random))
        found = ended(falsified(sound, false), bounds("drive"))
        assert found is not None
        assert found[1].kind == kind
        # It sets off at 2 s.
        assert found[0] < 5.0


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("source", list(SOURCES))
@pytest.mark.parametrize("unit", list(window.UNITS))
def test_no_unit_is_named_but_that_of_the_speeds(unit: str, source: str, rate_hz: float) -> None:
    """Half a second of acceleration with a delay rarely tells units apart."""
    for seed in range(8):
        sound = track(seed, "drive", source, rate_hz, 0.4)
        found = ended(falsified(sound, unit), bounds("drive"))
        assert found is not None
        assert found[1].kind.startswith((f"speed in {unit}", f"{window.NOT_MPS}, maybe in "))
        assert unit in found[1].kind, seed


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("unit", list(window.UNITS))
def test_the_unit_is_named_when_the_object_has_driven_on_at_one_speed(
    unit: str, rate_hz: float
) -> None:
    random = np.random.default_rng(4)
    sound = list(measured(_straight(2.0, 9.3), SOURCES["rtk"], rate_hz, random))
    watch = list(watched(falsified(sound, unit), bounds("drive")))[-1]
    assert watch.contradiction is not None
    assert watch.contradiction.text.startswith(f"speed in {unit}: ")


def _straight(yaw_rad: float, top_mps: float) -> Motion:
    t = np.arange(0.0, 12.0, 0.01)
    speed = np.clip((t - 2.0) * 3.0, 0.0, top_mps)
    way = np.cumsum(speed) * 0.01
    columns = [t, way * math.cos(yaw_rad), way * math.sin(yaw_rad), 0.0 * t + yaw_rad, speed]
    return Motion("drive", np.column_stack(columns))


def test_a_twist_in_map_axes_shows_although_its_speed_is_off_by_less_than_a_quarter() -> None:
    sound = list(measured(_straight(0.64, 10.0), 0.02, 50.0, np.random.default_rng(1)))
    found = ended(falsified(sound, "map axes"), Bounds())
    assert found is not None
    assert found[1].kind == window.MAP_AXES


def drive(
    seconds: float,
    place: Callable[[float], tuple[float, float]],
    yaw_rad: float = 0.0,
    speed_mps: float = 10.0,
    rate_hz: float = 50.0,
) -> list[Row]:
    """States of a source without noise."""
    stamps = (np.arange(round(seconds * rate_hz)) / rate_hz).tolist()
    return [(t, *place(t), yaw_rad, speed_mps, 0.0) for t in stamps]


@pytest.mark.parametrize("step_m", [0.3, 0.6, 0.99])
@pytest.mark.parametrize("rate_hz", [5.0, 50.0])
@pytest.mark.parametrize("speed_mps", [0.0, 5.0])
def test_one_step_of_the_place_is_a_correction(
    step_m: float, rate_hz: float, speed_mps: float
) -> None:
    def place(t: float) -> tuple[float, float]:
        return speed_mps * t, step_m * (t > 2.0)

    rows = drive(5.0, place, speed_mps=speed_mps, rate_hz=rate_hz)
    assert all(watch.contradiction is None for watch in watched(rows, Bounds()))


def test_a_place_that_steps_again_and_again_moves() -> None:
    def place(t: float) -> tuple[float, float]:
        return 0.9 * math.floor(t * 10.0), 0.0

    found = ended(drive(5.0, place, speed_mps=0.0, rate_hz=10.0), Bounds())
    assert found is not None
    assert found[1].kind == window.EMPTY_TWIST


@pytest.mark.parametrize("late_s", [-0.29, -0.15, 0.15, 0.29])
@pytest.mark.parametrize("rate_hz", [5.0, 20.0, 100.0])
def test_a_delay_between_place_and_twist_is_no_contradiction(late_s: float, rate_hz: float) -> None:
    def speed(t: float) -> float:
        return min(max(4.0 * (t - 1.0), 0.0), 12.0)

    way = [0.0]
    for i in range(600):
        way.append(way[-1] + 0.01 * speed(i * 0.01))
    stamps = np.arange(0.5, 5.0, 1.0 / rate_hz).tolist()
    rows = [
        (t, float(np.interp(t, np.arange(601) * 0.01, way)), 0.0, 0.0, speed(t - late_s), 0.0)
        for t in stamps
    ]
    assert all(watch.doubt is None for watch in watched(rows, Bounds()))
    assert ended(rows, Bounds()) is None


@pytest.mark.parametrize(("late_s", "ends"), [(0.29, False), (-0.29, False), (None, True)])
@pytest.mark.parametrize("rate_hz", [10.0, 50.0])
def test_one_constant_delay_must_explain_a_whole_track(
    rate_hz: float, late_s: float | None, ends: bool
) -> None:
    """Late while it accelerates and early while it brakes is another speed, and no delay."""

    def speed(t: float) -> float:
        return max(min(8.0 * (t - 1.0), 12.0, 8.0 * (9.0 - t)), 0.0)

    fine = np.arange(0.0, 10.0, 0.01)
    way = np.cumsum([speed(t) for t in fine]) * 0.01
    rows = []
    for t in np.arange(0.5, 9.9, 1.0 / rate_hz).tolist():
        late = late_s if late_s is not None else math.copysign(0.29, 5.0 - t)
        rows.append((t, float(np.interp(t, fine, way)), 0.0, 0.0, speed(t - late), 0.0))
    found = ended(rows, Bounds())
    assert (found is not None) is ends
    if found is not None:
        assert found[1].kind == window.UNSTEADY_DELAY
        assert 7.5 < found[0] < 9.5


HEADINGS_RAD = [k * math.pi / 8.0 for k in range(16)]


@pytest.mark.parametrize("source", [0.0, SOURCES["rtk"]])
@pytest.mark.parametrize("yaw_rad", HEADINGS_RAD)
def test_map_axes_and_an_empty_twist_are_told_apart_wherever_the_way_leads(
    yaw_rad: float, source: float
) -> None:
    """Due north and south a twist in map axes is nearly empty, but for what isn't exact."""
    random = np.random.default_rng(3)
    true = _straight(yaw_rad, 9.3)
    sound = list(measured(true, source, 50.0, random)) if source else true.rows[::2]
    rows = [(*map(float, row[:5]), 0.0) for row in sound]
    found = ended(falsified(rows, "map axes"), Bounds())
    # Within 22.5 degrees of east its speed is off by less than a tenth, which nobody can tell.
    assert (found is None) == (math.cos(yaw_rad) > 0.9)
    assert found is None or found[1].kind == window.MAP_AXES
    found = ended(falsified(rows, "empty"), Bounds())
    assert found is not None
    assert found[1].kind == window.EMPTY_TWIST


@pytest.mark.parametrize("rate_hz", [5.0, 50.0])
@pytest.mark.parametrize("yaw_rad", [0.5 * math.pi, -0.5 * math.pi, 0.5 * math.pi - 0.02])
@pytest.mark.parametrize(("mps", "kind"), [(1e-15, window.MAP_AXES), (0.0, window.EMPTY_TWIST)])
def test_uncertain_places_do_not_hide_that_the_way_leads_north(
    mps: float, kind: str, yaw_rad: float, rate_hz: float
) -> None:
    random = np.random.default_rng(1)
    sound = measured(_straight(yaw_rad, 5.0), SOURCES["float"], rate_hz, random, white=1.0)
    found = ended([(*row[:4], mps, row[5]) for row in sound], Bounds())
    assert found is not None
    assert found[1].kind == kind


@pytest.mark.parametrize("rate_hz", RATES_HZ)
@pytest.mark.parametrize("late_s", [-0.25, 0.25])
def test_a_turned_yaw_is_named_although_the_speed_comes_late(late_s: float, rate_hz: float) -> None:
    fine = _straight(1.0, 9.3).rows
    stamps = np.arange(0.5, 11.0, 1.0 / rate_hz)
    x, y, yaw = (np.interp(stamps, fine[:, 0], fine[:, k]) for k in (1, 2, 3))
    speed = np.interp(stamps - late_s, fine[:, 0], fine[:, 4])
    columns = (c.tolist() for c in (stamps, x, y, yaw, speed, 0.0 * stamps))
    found = ended(falsified(list(zip(*columns, strict=True)), "180"), bounds("drive"))
    assert found is not None
    assert found[1].kind == window.TURNED


def test_of_a_person_the_amount_counts_and_of_what_is_omnidirectional_no_direction() -> None:
    backwards = drive(3.0, lambda t: (-1.5 * t, 0.0), speed_mps=1.5)
    assert ended(backwards, bounds("drive")) is not None
    assert ended(backwards, bounds("walk")) is None
    assert ended(backwards, bounds("sideways")) is None
    sideways = drive(3.0, lambda t: (0.0, 1.5 * t), speed_mps=1.5)
    assert ended(sideways, bounds("walk")) is not None
    assert ended(sideways, bounds("sideways")) is None
    assert (
        ended(drive(3.0, lambda t: (0.0, 1.5 * t), speed_mps=0.0), bounds("sideways")) is not None
    )


def test_a_doubt_lasts_until_the_object_has_moved_without_one() -> None:
    def states(begin_s: float, seconds: float, mps: float, stated_mps: float) -> list[Row]:
        rows = drive(seconds, lambda t: (begin + mps * t, 0.0), speed_mps=stated_mps)
        return [(t + begin_s, *values) for t, *values in rows]

    watch, begin = ConsistencyWatch(Bounds()), 0.0

    def see(rows: list[Row]) -> Contradiction | None:
        for t_s, *values in rows:
            watch.take(round(t_s * S), *values)
        return watch.doubt

    assert see(states(0.0, 1.0, 5.0, 0.0)) is not None
    begin = 5.0
    # It stands, and what it states fits; that it will when it moves is not known.
    assert see(states(1.0, 5.0, 0.0, 0.0)) is not None
    assert watch.contradiction is None
    assert see(states(6.0, 0.4, 5.0, 5.0)) is not None
    begin = 7.0
    assert see(states(6.4, 0.5, 5.0, 5.0)) is None


def test_a_clock_that_is_set_back_ends_a_contradiction_and_keeps_its_doubt() -> None:
    watch = ConsistencyWatch(Bounds())
    for t_s, *values in drive(1.0, lambda t: (5.0 * t, 0.0), speed_mps=0.0):
        watch.take(round((t_s + 9.0) * S), *values)
    doubt = watch.doubt
    assert doubt is not None
    assert watch.contradiction == doubt
    watch.take(7 * S, 5.0, 0.0, 0.0, 0.0)
    assert watch.contradiction is None
    for t_s, *values in drive(2.0, lambda _: (5.0, 0.0), speed_mps=0.0):
        watch.take(round((t_s + 7.1) * S), *values)
    assert watch.doubt == doubt
    for t_s, *values in drive(1.5, lambda t: (5.0 + 5.0 * t, 0.0), speed_mps=5.0):
        watch.take(round((t_s + 9.1) * S), *values)
    assert watch.doubt is None


def test_a_contradiction_ends_a_session_once_it_has_held() -> None:
    held = set()
    for watch in watched(drive(2.0, lambda t: (5.0 * t, 0.0), speed_mps=0.0), Bounds()):
        found, passed = watch.contradiction, state_contradicts(watch)
        held.add(found is not None and found.holds)
        if found is None or not found.holds:
            assert passed is None
        else:
            assert passed == LimitViolation(SafetyCode.STATE_CONTRADICTS, found.held_s, 0.5)
    assert held == {False, True}


def test_the_bounds_of_an_object_are_those_of_its_class_and_its_site() -> None:
    site: dict[str, Any] = {"jump_m": 0.75, "position_std_m": 0.25, "state_age_s": 0.25}
    site |= {"omnidirectional": ["two"]}
    limits, late = (
        LIMITS.model_copy(update={**site, **more}) for more in ({}, {"state_age_s": 0.5})
    )
    turned = {ObjectClass.CAR: 20.0, ObjectClass.CYCLIST: 30.0, ObjectClass.PEDESTRIAN: 60.0}
    for cls, bound_deg in turned.items():
        signed = cls is not ObjectClass.PEDESTRIAN
        expected = Bounds(math.radians(bound_deg), signed, 0.75, 0.25, 0.5)
        assert Bounds.of("one", cls, limits) == expected
        assert Bounds.of("one", cls, late) == replace(expected, pause_s=0.75)
        assert Bounds.of("two", cls, limits) == replace(expected, direction_rad=None)


@pytest.mark.parametrize(
    ("before_s", "is_forgotten"), [(0.0, False), (0.5, False), (1.0, False), (1.125, True)]
)
def test_a_stamp_far_before_the_newest_forgets_it_and_one_a_little_before_has_no_effect(
    before_s: float, is_forgotten: bool
) -> None:
    watch = ConsistencyWatch(Bounds())
    for k in range(17):
        watch.take(8 * S + k * S // 8, float(k), 0.0, 0.0, 8.0)
    watch.take(10 * S - round(before_s * S), 99.0, 0.0, 0.0, 0.0, 0.25)
    assert watch.net_way_m(1.0) == ((0.0, 0.0) if is_forgotten else (8.0, 1.0))
    assert watch.position_std_m == (0.25 if is_forgotten else 0.0)
    assert watch.counts.total == 13


def test_a_state_is_taken_by_its_stamp_its_place_and_its_motion() -> None:
    seen, taken = ConsistencyWatch(Bounds()), ConsistencyWatch(Bounds())
    for k in range(30):
        # It drives north, and states that it faces south: the numbers are those of one mistake.
        values = 8 * S + k * S // 20, 3.0, 0.5 * k, -math.pi / 2.0, 10.0, 0.01
        taken.take(*values)
        stamp_ns, x_m, y_m, yaw_rad, speed_mps, std_m = values
        state = object_state(x_m=x_m, y_m=y_m, yaw_rad=yaw_rad, speed_mps=speed_mps)
        seen.see(replace(state, stamp_ns=stamp_ns, position_std_m=std_m))
    assert seen.contradiction == taken.contradiction
    assert seen.contradiction is not None
    assert seen.contradiction.kind == window.TURNED
    assert seen.net_way_m(1.0) == pytest.approx((10.0, 1.0))
    assert (seen.position_std_m, seen.counts) == (0.01, taken.counts)


def nearest(rows: Iterable[Row], by: Bounds) -> float:
    """The share of its bound that the one window of three states reaches, where it is above 0.8."""
    *_, watch = watched(rows, by)
    assert watch.counts.total == 1
    return watch.counts.nearest


NOISE_MPS = 0.2 * 3.0 * math.sqrt(2.0) / 0.5


@pytest.mark.parametrize(
    ("places_m", "speeds_mps", "stds_m", "share"),
    [
        ((0.0, 2.5, 5.0), (7.6, 7.6, 7.6), (0.0, 0.0, 0.0), 2.4 / 2.5),
        ((0.0, 1.9, 3.8), (10.0, 10.0, 10.0), (0.0, 0.0, 0.0), 2.4 / 2.5),
        ((0.0, -1.9, -3.8), (-10.0, -10.0, -10.0), (0.0, 0.0, 0.0), 2.4 / 2.5),
        # The chord of the places, and the mean of the speeds.
        ((0.0, 0.5, 4.6), (14.0, 10.0, 14.0), (0.0, 0.0, 0.0), 2.8 / 3.0),
        ((0.0, 4.5, 4.6), (10.0, 14.0, 10.0), (0.0, 0.0, 0.0), 2.8 / 3.0),
        ((0.0, 0.25, 0.5), (1.45, 1.45, 1.45), (0.0, 0.0, 0.0), 0.9),
        # The less certain of both ends counts.
        ((0.0, 1.0, 2.0), (5.6, 5.6, 5.6), (0.2, 0.0, 0.0), 1.6 / NOISE_MPS),
        ((0.0, 1.0, 2.0), (5.6, 5.6, 5.6), (0.0, 0.0, 0.2), 1.6 / NOISE_MPS),
        ((0.0, 1.0, 2.0), (5.3, 5.3, 5.3), (0.0, 0.2, 0.0), 1.3 / (0.25 * 5.3)),
    ],
)
def test_a_speed_is_as_near_to_its_bound_as_the_larger_of_both_lets_it(
    places_m: tuple[float, ...],
    speeds_mps: tuple[float, ...],
    stds_m: tuple[float, ...],
    share: float,
) -> None:
    for c, s in ((1.0, 0.0), (0.0, -1.0)):
        rows = [
            (0.25 * k, 7.0 + c * way, 9.0 + s * way, math.atan2(s, c), speed, std)
            for k, (way, speed, std) in enumerate(zip(places_m, speeds_mps, stds_m, strict=True))
        ]
        assert nearest(rows, Bounds()) == pytest.approx(share)


@pytest.mark.parametrize(
    ("way_mps", "stated_mps", "std_m", "moves", "off"),
    [
        (10.0, 11.1, 0.0, True, False),
        (10.0, 11.2, 0.0, True, True),
        (10.0, -11.2, 0.0, True, True),
        (10.0, 8.9, 0.0, True, True),
        (2.0, 2.45, 0.0, True, False),
        (2.0, 2.55, 0.0, True, True),
        (4.0, 5.6, 0.2, True, False),
        (4.0, 5.75, 0.2, True, True),
        (1.0, 1.0, 0.0, True, False),
        (0.99, 0.99, 0.0, False, False),
        (0.9, 0.2, 0.0, False, False),
        (0.2, 1.0, 0.0, True, True),
    ],
)
def test_a_twist_is_looked_at_in_map_axes_where_its_speed_is_off_by_a_tenth_and_more_than_noise(
    way_mps: float, stated_mps: float, std_m: float, moves: bool, off: bool
) -> None:
    rows = [(0.25 * k, 0.0, 0.25 * k * way_mps, 0.0, stated_mps, std_m) for k in range(3)]
    *_, watch = watched(rows, Bounds())
    assert watch._share(0)[1:] == (moves, off)
    *_, watch = watched(rows, Bounds(None))
    assert watch._share(0)[1:] == (moves, False)


@pytest.mark.parametrize(
    ("turned_deg", "speed_mps", "signed", "share"),
    [
        (17.0, 10.0, True, 0.85),
        (-17.0, 10.0, True, 0.85),
        (15.0, 10.0, True, 0.0),
        (25.0, 10.0, True, 1.25),
        (180.0, 10.0, True, 9.0),
        (0.0, -10.0, True, 9.0),
        (180.0 - 17.0, -10.0, True, 0.85),
        (180.0 + 17.0, -10.0, True, 0.85),
        (17.0, -10.0, False, 0.85),
        (180.0 - 17.0, 10.0, False, 0.85),
        (90.0, 10.0, False, 4.5),
    ],
)
@pytest.mark.parametrize("course_rad", [0.0, 2.0])
def test_a_direction_is_as_near_to_its_bound_as_the_way_leads_off_the_yaw(
    turned_deg: float, speed_mps: float, signed: bool, share: float, course_rad: float
) -> None:
    c, s = math.cos(course_rad), math.sin(course_rad)
    yaw_rad = course_rad + math.radians(turned_deg)
    rows = [(0.25 * k, 2.5 * k * c, 2.5 * k * s, yaw_rad, speed_mps, 0.0) for k in range(3)]
    assert nearest(rows, Bounds(signed=signed)) == pytest.approx(share)
    assert nearest(rows, Bounds(None, signed)) == 0.0
    # So slow that it doesn't count, or so short that it isn't known.
    slow = [(t, 0.09 * x, 0.09 * y, yaw, 0.09 * v, std) for t, x, y, yaw, v, std in rows]
    assert nearest(slow, Bounds(signed=signed)) == 0.0
    unsure = [(*row[:5], 0.5) for row in rows]
    bound_deg = math.degrees(math.atan2(0.5 * 3.0 * math.sqrt(2.0), 5.0))
    lower = share * 20.0 / bound_deg
    assert nearest(unsure, Bounds(signed=signed)) == pytest.approx(lower if lower > 0.8 else 0.0)


def test_shares_of_a_bound_count_from_four_fifths_on() -> None:
    counts = WindowCounts()
    for share in (0.3, 0.8):
        counts.see_share(share)
    assert (counts.near_misses, counts.nearest) == (0, 0.0)
    for share in (0.81, 1.5, 0.9):
        counts.see_share(share)
    assert (counts.near_misses, counts.nearest) == (3, 1.5)


def test_a_pause_and_a_clock_that_is_set_back_begin_anew() -> None:
    before = drive(2.0, lambda t: (10.0 * t, 0.0))
    after = [(t + 4.0, x + 60.0, y, yaw, v, std) for t, x, y, yaw, v, std in before]
    assert all(watch.contradiction is None for watch in watched(before + after, Bounds()))
    back = [(t - 30.0, *values) for t, *values in after]
    *_, watch = watched(before + back, Bounds())
    assert watch.counts.total > 1.4 * 75
    assert watch.contradiction is None
    late = [(1.5, 0.0, 0.0, 0.0, 10.0, 0.0)]
    *_, watch = watched(before + late, Bounds())
    assert watch.contradiction is None
    assert watch.net_way_m(1.0) == pytest.approx((10.0, 1.0))


@pytest.mark.parametrize(
    ("std_m", "mps", "stands"),
    [
        (0.0, 0.09, True),
        (0.0, 0.11, False),
        (0.2, 0.49, True),
        (0.2, 0.51, False),
        (math.inf, 1.09, True),
        (math.nan, 1.11, False),
    ],
)
def test_standing_is_a_net_way_of_a_decimetre_and_two_deviations(
    std_m: float, mps: float, stands: bool
) -> None:
    rows = [(t, x, y, yaw, 0.0, std_m) for t, x, y, yaw, *_ in drive(2.0, lambda t: (mps * t, 0.0))]
    *_, watch = watched(rows, Bounds())
    assert (net_way_m(watch) is None) is stands


def test_near_misses_are_counted() -> None:
    rows = drive(2.0, lambda t: (8.1 * t, 0.0))
    *_, watch = watched(rows, Bounds())
    assert watch.contradiction is None
    assert watch.counts == WindowCounts(total=75, moving=75)
    *_, watch = watched(drive(2.0, lambda t: (7.9 * t, 0.0)), Bounds())
    assert (watch.contradiction, watch.counts.near_misses) == (None, 75)
    assert watch.counts.nearest == pytest.approx(0.84)
