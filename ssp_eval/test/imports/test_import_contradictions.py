"""States held against their places in windows: sound motions pass, what is wrong is named."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from itertools import product

import numpy as np
import pytest

from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.window import UNITS
from ssp_core.vocabulary import ObjectClass
from ssp_eval.importers.contradiction_texts import problem_and_remedy
from ssp_eval.importers.contradictions import (
    Contradiction,
    Course,
    contradictions,
    noise_m,
    twist_in_parent_axes,
)
from tests.support.tracks import RATES_HZ, SOURCES, Row, falsified, measured, motion

SOUND = ("drive", "walk", "reverse", "stand", "dropout")


def course(
    rows: Sequence[Row], kind: ObjectClass = ObjectClass.CAR, ahead_m: float = 0.0
) -> Course:
    """A course whose source reports a point so far ahead of the one that is judged."""
    t, x, y, yaw, speed, _ = np.array(rows).T
    judged = np.column_stack([x, y])
    ahead = ahead_m * np.column_stack([np.cos(yaw), np.sin(yaw)])
    return Course(kind, t - t[0], judged, judged + ahead, yaw, speed)


def contradictions_of(rows: Sequence[Row], ahead_m: float = 0.0) -> list[Contradiction]:
    return contradictions(course(rows, ahead_m=ahead_m))


def names(rows: Sequence[Row], ahead_m: float = 0.0) -> list[str]:
    return [one.name for one in contradictions_of(rows, ahead_m)]


def drive(
    seconds: float = 6.0,
    rate_hz: float = 50.0,
    speed: Callable[[float], float] = lambda t: 10.0,
    yaw_rad: float = 0.4,
) -> list[Row]:
    """Straight on, by the integral of a speed."""
    fine = np.arange(0.0, seconds + 0.01, 0.001)
    speeds = np.array([speed(t) for t in fine.tolist()])
    way = np.concatenate([[0.0], np.cumsum((speeds[1:] + speeds[:-1]) / 2.0) * 0.001])
    rows = []
    for k in range(round(seconds * rate_hz)):
        t = k / rate_hz
        s = float(np.interp(t, fine, way))
        rows.append((t, s * math.cos(yaw_rad), s * math.sin(yaw_rad), yaw_rad, speed(t), 0.0))
    return rows


def changed(
    rows: Sequence[Row], since: float, until: float, **change: Callable[[float], float]
) -> list[Row]:
    """Columns changed for a while."""
    columns = ("t", "x", "y", "yaw", "speed", "std")
    out = []
    for row in rows:
        values = dict(zip(columns, row, strict=True))
        if since <= row[0] < until:
            values |= {name: to(values[name]) for name, to in change.items()}
        out.append(tuple(values[name] for name in columns))
    return out  # type: ignore[return-value]  # six columns, as they came


@pytest.mark.parametrize("white", [0.4, 1.0])
def test_of_120_sound_tracks_none_is_refused(white: float) -> None:
    cases = list(product(SOUND, SOURCES, RATES_HZ))
    for seed in range(120):
        manoeuvre, source, rate_hz = case = cases[seed % len(cases)]
        random = np.random.default_rng(seed)
        rows = list(
            measured(motion(manoeuvre, random), SOURCES[source], rate_hz, random, white=white)
        )
        walks = manoeuvre == "walk"
        kind = ObjectClass.PEDESTRIAN if walks else ObjectClass.CAR
        assert contradictions(course(rows, kind)) == [], (seed, case)


@pytest.mark.parametrize("rate_hz", [2.0, 5.0, 20.0, 100.0])
@pytest.mark.parametrize("late_s", [-0.28, 0.0, 0.28])
def test_hard_manoeuvres_with_one_delay_are_no_contradiction(rate_hz: float, late_s: float) -> None:
    def stop(t: float) -> float:
        return float(np.interp(t, [0.0, 2.0, 3.25, 4.0, 7.0], [10.0, 10.0, 0.0, 0.0, 9.0]))

    rows = drive(7.0, rate_hz, stop)
    told = [(*row[:4], stop(row[0] - late_s), 0.0) for row in rows]
    assert names(told) == []
    times = [row[0] for row in rows]
    assert names([(t, *bend(t)[:2], bend(t - late_s)[2], 6.0, 0.0) for t in times]) == []


def bend(t: float) -> tuple[float, float, float]:
    """x, y and yaw on a circle of 12 m at 6 m/s."""
    return 12.0 * math.sin(t / 2.0), 12.0 * (1.0 - math.cos(t / 2.0)), t / 2.0


def test_a_gap_in_which_it_drives_on_brakes_or_starts_is_none() -> None:
    def speed(t: float) -> float:
        return float(np.interp(t, [0, 3.0, 4.0, 5.0, 7.0], [10.0, 10.0, 2.0, 2.0, 10.0]))

    for steady in (True, False):
        rows = drive(8.0, 50.0, (lambda t: 10.0) if steady else speed)
        for since, until in ((2.0, 2.8), (2.5, 4.0), (2.0, 6.5), (3.2, 5.8)):
            assert names([row for row in rows if not since <= row[0] < until]) == []


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 50.0])
@pytest.mark.parametrize(
    ("since", "until", "factor"),
    [(0.0, 0.6, 0.0), (1.0, 1.6, 0.0), (5.4, 6.0, 0.0), (1.0, 3.0, 0.0), (1.0, 3.0, 1.6)],
)
def test_a_speed_that_is_wrong_for_a_while_is_named_with_its_stretch(
    rate_hz: float, since: float, until: float, factor: float
) -> None:
    sound = drive(6.0, rate_hz)
    assert names(sound) == []
    (one,) = contradictions_of(changed(sound, since, until, speed=lambda v: factor * v))
    assert one.name == "speed"
    assert one.first / rate_hz == pytest.approx(since, abs=0.11)
    assert one.last / rate_hz == pytest.approx(until - 1.0 / rate_hz, abs=0.11)
    assert one.way == pytest.approx(10.0, rel=0.01)
    # A stretch isn't in another unit.
    assert one.why == ("" if factor else "empty twist") or until - since < 1.0
    if until - since > 1.0:
        assert one.stated == pytest.approx(10.0 * factor, abs=0.01)


@pytest.mark.parametrize("rate_hz", [5.0, 50.0])
@pytest.mark.parametrize("ahead_m", [0.0, 1.4])
@pytest.mark.parametrize("turned_deg", [180.0, -90.0, 30.0])
def test_a_heading_that_is_turned_for_a_while_is_named_with_its_stretch(
    rate_hz: float, ahead_m: float, turned_deg: float
) -> None:
    turned = math.radians(turned_deg)
    rows = changed(drive(6.0, rate_hz), 1.0, 2.2, yaw=lambda yaw: yaw + turned)
    # The reported point goes straight on; the judged one is moved by the wrong heading.
    moved = [
        (t, x - ahead_m * math.cos(yaw), y - ahead_m * math.sin(yaw), yaw, v, std)
        for t, x, y, yaw, v, std in rows
    ]
    (one,) = contradictions_of(moved, ahead_m)
    assert one.name == "heading"
    assert abs(one.stated) == pytest.approx(abs(turned_deg), abs=11.0)
    assert one.first / rate_hz == pytest.approx(1.0, abs=0.25)
    assert one.last / rate_hz == pytest.approx(2.2, abs=0.05 + 2.0 / rate_hz)


def test_a_speed_backwards_while_it_goes_forwards_is_a_heading() -> None:
    assert names(changed(drive(), 1.0, 2.0, speed=lambda v: -v)) == ["heading"]
    assert names(drive(speed=lambda t: -2.0)) == []


@pytest.mark.parametrize("rate_hz", [5.0, 10.0, 50.0])
@pytest.mark.parametrize("step_s", [0.3, 0.8, 3.0, 3600.0])
@pytest.mark.parametrize("has_speed", [True, False])
def test_a_clock_that_steps_is_the_reason(rate_hz: float, step_s: float, has_speed: bool) -> None:
    rows = changed(drive(6.0, rate_hz), 2.0, 9.0, t=lambda t: t + step_s)
    whole = course(rows)
    judged = (
        whole
        if has_speed
        else Course(whole.object_class, whole.t_s, whole.xy_m, whole.xy_m, None, None)
    )
    (one,) = contradictions(judged)
    assert (one.name, one.why) == ("clock_step", "a step of the clock?")
    assert one.last / rate_hz == pytest.approx(2.0, abs=0.01)


def test_a_clock_that_steps_while_it_stands_does_no_harm() -> None:
    rows = changed(drive(speed=lambda t: 0.0), 2.0, 9.0, t=lambda t: t + 0.8)
    assert names(rows) == []


@pytest.mark.parametrize("has_speed", [True, False])
def test_a_leap_is_a_step_of_more_than_half_as_much_again(has_speed: bool) -> None:
    for step_m, is_leap in ((1.4, False), (1.6, True), (30.0, True)):
        # At 10 Hz and 10 m/s a step is 1 m.
        rows = changed(drive(6.0, 10.0, yaw_rad=0.0), 3.0, 9.0, x=lambda x, by=step_m: x + by - 1.0)
        whole = course(rows)
        judged = (
            whole
            if has_speed
            else Course(whole.object_class, whole.t_s, whole.xy_m, whole.xy_m, None, None)
        )
        assert [one.name for one in contradictions(judged)] == (["leap"] if is_leap else [])


def test_places_that_stand_still_and_then_leap_are_both_named() -> None:
    rows = drive(8.0)
    stuck = next(row for row in rows if row[0] >= 3.0)
    told = changed(rows, 3.0, 5.0, x=lambda x: stuck[1], y=lambda y: stuck[2])
    assert sorted(names(told)) == ["leap", "speed"]


def test_a_car_goes_sideways_by_a_tenth_of_its_speed_at_the_most() -> None:
    for lean_deg, refused in ((5.0, False), (7.0, True)):
        rows = changed(drive(), 0.0, 9.0, yaw=lambda yaw, by=lean_deg: yaw + math.radians(by))
        assert names(rows) == (["sideways"] if refused else [])
        assert contradictions(course(rows, ObjectClass.PEDESTRIAN)) == []
    slow = changed(drive(speed=lambda t: 2.0), 0.0, 9.0, yaw=lambda yaw: yaw + math.radians(13.0))
    assert names(slow) == []  # 0.45 m/s


@pytest.mark.parametrize("false", ["180", "ned", "km/h", "empty"])
def test_what_ends_a_live_session_is_refused_in_a_recording(false: str) -> None:
    ended = 0
    for seed in range(4):
        random = np.random.default_rng(seed)
        rows = list(falsified(list(measured(motion("drive", random), 0.02, 20.0, random)), false))
        watch = ConsistencyWatch(Bounds())
        for t_s, *values in rows:
            watch.take(round(t_s * 1e9), *values)
            if watch.contradiction is not None and watch.contradiction.holds:
                ended += 1
                assert contradictions_of(rows)
                break
    assert ended >= 3  # Some yaws are nearly the same in both frames.


@pytest.mark.parametrize("late_s", [-0.28, 0.28])
@pytest.mark.parametrize("unit", list(UNITS))
def test_no_unit_is_named_but_that_of_an_accelerating_track(unit: str, late_s: float) -> None:
    def speed(t: float) -> float:
        return float(np.interp(t, [0.0, 6.0, 20.0], [1.0, 8.0, 8.0]))

    def hint(seconds: float) -> str:
        sound = drive(seconds, 20.0, speed)
        one = course([(*row[:4], UNITS[unit] * speed(row[0] - late_s), 0.0) for row in sound])
        (off,) = contradictions(one)
        problem, _ = problem_and_remedy(off, one, np.gradient(one.xy_m, one.t_s, axis=0), "ot1")
        return problem.partition("after its first sample): ")[2]

    assert f"speeds in {unit}" in hint(3.0)
    assert hint(20.0) == f"speeds in {unit}?"


def test_noise_is_told_from_motion() -> None:
    random = np.random.default_rng(5)
    rows = np.array(drive(6.0, 20.0, lambda t: 10.0 + 8.0 * math.sin(2.0 * t)))
    t_s, xy_m = rows[:, 0], rows[:, 1:3]
    assert noise_m(t_s, xy_m) < 0.005
    for std_m in (0.02, 0.3):
        noisy = xy_m + random.normal(scale=std_m, size=xy_m.shape)
        assert noise_m(t_s, noisy) == pytest.approx(std_m, rel=0.5)


def twist(rows: Sequence[Row], in_parent: bool) -> tuple[float, float, int] | None:
    t, x, y, yaw, speed, _ = np.array(rows).T
    own = np.column_stack([speed, np.zeros(len(t))])
    if in_parent:
        own = np.column_stack([speed * np.cos(yaw), speed * np.sin(yaw)])
    return twist_in_parent_axes(t, np.column_stack([x, y]), yaw, own)


@pytest.mark.parametrize("source", ["rtk", "float"])
def test_a_twist_along_the_parents_axes_is_told_at_any_heading(source: str) -> None:
    for seed in range(10):
        random = np.random.default_rng(seed)
        rows = list(measured(motion("drive", random), SOURCES[source], 20.0, random))
        assert twist(rows, in_parent=False) is None
        assert twist(rows, in_parent=True) is not None
    for yaw_deg in (7.0, 36.0, 90.0, 179.0, -120.0):
        rows = drive(yaw_rad=math.radians(yaw_deg))
        told = twist(rows, in_parent=True)
        assert told is not None
        own_mps, parent_mps, _ = told
        assert own_mps == pytest.approx(20.0 * abs(math.sin(math.radians(yaw_deg) / 2.0)), abs=0.01)
        assert parent_mps == pytest.approx(0.0, abs=0.01)
    # Along the parent's x axis both are the same.
    assert twist(drive(yaw_rad=0.0), in_parent=True) is None


def test_a_wrong_yaw_is_not_taken_for_a_wrong_twist() -> None:
    east = drive(yaw_rad=0.0)
    for yaw in (math.pi, math.pi / 2.0, 1.0):
        rows = changed(east, 0.0, 9.0, yaw=lambda _, to=yaw: to)
        t, x, y, told, speed, _ = np.array(rows).T
        stated = np.column_stack([speed, np.zeros(len(t))])
        assert twist_in_parent_axes(t, np.column_stack([x, y]), told, stated) is None
