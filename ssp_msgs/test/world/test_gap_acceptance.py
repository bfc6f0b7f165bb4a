"""Gap acceptance: go, yield or wait at a place where others have priority, by hand and by law."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from ssp_core.geometry import Polyline
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.run_file.model import RunSpec
from ssp_core.run_file.participants import Driver, GiveWay
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.car_following import earliest_arrival_s
from ssp_core.world.gap_acceptance import (
    BEHIND_S,
    HYSTERESIS_S,
    Coming,
    Place,
    PriorityWatch,
    Word,
    coming_along,
    decide,
    places_of,
)
from tests.support.runs import cut_in_run
from tests.support.states import object_state

CAR = ObjectClass.CAR
SIZE = DEFAULT_SIZES[CAR]
# The VUT drives along x; those with priority come down x = 32, and cross from 30 to 34.
PLACE = GiveWay(
    line_m=28.0,
    zone_m=(30.0, 34.0),
    priority_path=[(32.0, 100.0), (32.0, -100.0)],
    priority_zone_m=(98.0, 102.0),
)
DRIVER = Driver(cruise_mps=8.0, gives_way=[PLACE])
LEAST_S = PLACE.critical_gap_s


def at_line(arrives_s: float, leaves_s: float = 99.0, before: Word = "approach") -> Word:
    """Decides for a driver who stands at the line."""
    one = Coming("ot1", arrives_s, leaves_s)
    return decide(PLACE, 28.0, 0.0, [one], DRIVER, before).word


def test_at_the_line_it_goes_into_a_gap_of_the_critical_length_and_no_shorter_one() -> None:
    assert at_line(LEAST_S) == "go"
    assert at_line(LEAST_S - 0.01) == "wait"
    assert at_line(LEAST_S - 0.01, before="wait") == "wait"


def test_an_accepted_gap_stays_accepted_within_the_hysteresis() -> None:
    assert at_line(LEAST_S - HYSTERESIS_S + 0.01, before="go") == "go"
    assert at_line(LEAST_S - HYSTERESIS_S - 0.01, before="go") == "wait"


def test_nobody_with_priority_is_no_reason_to_stop() -> None:
    decision = decide(PLACE, 20.0, 8.0, [], DRIVER)
    assert (decision.word, decision.most_mps2) == ("go", math.inf)


def test_far_from_the_line_nothing_is_decided_and_nobody_with_priority_is_an_obstacle() -> None:
    """A comfortable stop from 8 m/s takes 12.8 m, a second 8 m, and 3 m are the standstill gap."""
    soon = [Coming("ot1", 2.0, 3.0)]
    assert decide(PLACE, 28.0 - 23.9, 8.0, soon, DRIVER).word == "approach"
    assert decide(PLACE, 28.0 - 23.9, 8.0, soon, DRIVER).heeded == {"ot1"}
    assert decide(PLACE, 28.0 - 23.7, 8.0, soon, DRIVER).word != "approach"


@pytest.mark.parametrize(
    ("arrives_s", "leaves_s", "word"),
    [(0.2, 1.0, "go"), (1.5, 3.0, "yield"), (4.0, 6.0, "wait"), (7.0, 9.0, "go")],
)
def test_on_its_way_the_time_of_the_object_decides(
    arrives_s: float, leaves_s: float, word: str
) -> None:
    """18 m before the line at 8 m/s it is there in 2.25 s, and in the zone in 2.5 s."""
    decision = decide(PLACE, 10.0, 8.0, [Coming("ot1", arrives_s, leaves_s)], DRIVER)
    assert decision.word == word
    assert (decision.most_mps2 < 0.0) is (word != "go")


def test_one_who_yields_is_at_the_zone_half_a_second_after_the_object_left_it() -> None:
    """The driver brakes evenly, 20 m away at 8 m/s: 2 (20 - 8 * 3.5) / 3.5^2 = -1.31 m/s^2."""
    decision = decide(PLACE, 10.0, 8.0, [Coming("ot1", 1.5, 3.0)], DRIVER)
    assert decision.most_mps2 == pytest.approx(-1.306, abs=1e-3)


def test_of_a_row_of_objects_it_waits_for_the_last_before_a_gap() -> None:
    row = [Coming("a", 0.0, 0.5), Coming("b", 2.0, 3.0), Coming("c", 4.0, 5.0)]
    assert decide(PLACE, 28.0, 0.0, row, DRIVER).word == "wait"
    assert decide(PLACE, 28.0, 0.0, [Coming("d", 9.0, 9.5)], DRIVER, "wait").word == "go"


def test_one_who_passes_between_two_needs_the_gap_after_the_first() -> None:
    first = Coming("a", 0.0, 0.5)
    assert decide(PLACE, 28.0, 0.0, [first, Coming("b", 4.2, 5.0)], DRIVER).word == "go"
    assert decide(PLACE, 28.0, 0.0, [first, Coming("b", 3.0, 4.0)], DRIVER).word == "wait"


def test_in_the_zone_it_goes_on_and_only_who_is_in_it_too_stands_in_its_way() -> None:
    both = [Coming("in", 0.0, 1.0), Coming("near", 0.5, 1.5)]
    decision = decide(PLACE, 30.0, 1.0, both, DRIVER, "go")
    assert (decision.word, decision.heeded) == ("go", {"near"})


def test_a_stop_that_is_too_hard_is_not_begun() -> None:
    """The vehicle stops within 6.4 m at 8 m/s and 5 m/s^2."""
    one = [Coming("ot1", 1.0, 2.0)]
    assert decide(PLACE, 30.0 - 6.3, 8.0, one, DRIVER, "go").word == "go"
    assert decide(PLACE, 30.0 - 6.5, 8.0, one, DRIVER, "go").word != "go"


def test_times_come_from_the_measured_state() -> None:
    """It is on the path, 70 m before the zone's begin at y = 2, and drives 10 m/s."""
    car = object_state("ot1", CAR, 32.5, 72.0, -math.pi / 2, 10.0)
    [one] = coming_along(places_of(DRIVER)[0], [car])
    assert one.arrives_s == pytest.approx((70.0 - SIZE.front_m) / 10.0)
    assert one.leaves_s == pytest.approx((74.0 + SIZE.rear_m) / 10.0)


@pytest.mark.parametrize(
    ("acceleration_mps2", "sooner"), [(2.0, True), (0.0, False), (-2.0, False)]
)
def test_one_that_speeds_up_arrives_by_its_acceleration_and_one_that_brakes_by_its_speed(
    acceleration_mps2: float, sooner: bool
) -> None:
    """The car has driven v t + a t^2 / 2 at that time; the driver doesn't rely on it to stop."""
    car = object_state("ot1", CAR, 32.0, 72.0, -math.pi / 2, 10.0)
    car = replace(car, acceleration_mps2=acceleration_mps2)
    [one] = coming_along(places_of(DRIVER)[0], [car])
    t_s, way_m = one.arrives_s, 70.0 - SIZE.front_m
    assert (t_s < way_m / 10.0 - 0.5) is sooner
    assert 10.0 * t_s + max(acceleration_mps2, 0.0) * t_s * t_s / 2.0 == pytest.approx(way_m)
    assert one.leaves_s == pytest.approx((74.0 + SIZE.rear_m) / 10.0)


@pytest.mark.parametrize(("radius_m", "most_mps"), [(9.0, 6.0), (16.0, 8.0), (400.0, 40.0)])
def test_one_that_speeds_up_is_no_faster_than_the_bend_ahead_of_it_allows(
    radius_m: float, most_mps: float
) -> None:
    """It turns by 45 deg on its way to the zone; 4 m/s^2 sideways are sqrt(4 r) m/s."""
    angles = np.linspace(0.0, math.pi / 4.0, 200)
    bend = [(radius_m * math.sin(a), radius_m * (1.0 - math.cos(a))) for a in angles]
    (x_m, y_m), c = bend[-1], math.sqrt(0.5)
    path = [(-40.0, 0.0), *bend, (x_m + 60.0 * c, y_m + 60.0 * c)]
    first_m = 60.0 + radius_m * math.pi / 4.0
    spec = PLACE.model_copy(
        update={"priority_path": path, "priority_zone_m": (first_m, first_m + 4.0)}
    )
    place = Place(spec, Polyline(path))
    car = object_state("ot1", CAR, -40.0, 0.0, 0.0, 4.0)
    [one] = coming_along(place, [replace(car, acceleration_mps2=2.0)])
    way_m = first_m - SIZE.front_m
    rising_s = (min(most_mps, math.sqrt(16.0 + 4.0 * way_m)) - 4.0) / 2.0
    rest_m = way_m - (4.0 + rising_s) * rising_s
    assert one.arrives_s == pytest.approx(rising_s + max(rest_m, 0.0) / most_mps, rel=0.01)
    # What is behind it, and how fast it is already, keep it from nothing.
    [past] = coming_along(
        place,
        [
            replace(
                car,
                x_m=x_m + 8.0 * c,
                y_m=y_m + 8.0 * c,
                yaw_rad=math.pi / 4.0,
                acceleration_mps2=2.0,
            )
        ],
    )
    left_m = 12.0 - SIZE.front_m
    assert 4.0 * past.arrives_s + past.arrives_s**2 == pytest.approx(left_m, abs=0.1)
    [fast] = coming_along(place, [replace(car, speed_mps=50.0, acceleration_mps2=2.0)])
    assert fast.arrives_s == pytest.approx(way_m / 50.0, rel=0.03)


@pytest.mark.parametrize(
    ("x_m", "y_m", "yaw_rad", "speed_mps"),
    [
        (36.0, 50.0, -math.pi / 2, 10.0),  # beside
        (32.0, 50.0, math.pi / 2, 10.0),  # the other way
        (32.0, 50.0, -math.pi / 2, 0.0),  # stands before it
        (32.0, -50.0, -math.pi / 2, 10.0),  # gone
    ],
)
def test_who_does_not_come_has_no_priority(
    x_m: float, y_m: float, yaw_rad: float, speed_mps: float
) -> None:
    car = object_state("ot1", CAR, x_m, y_m, yaw_rad, speed_mps)
    assert coming_along(places_of(DRIVER)[0], [car]) == []


def test_one_that_stands_in_the_zone_is_waited_for() -> None:
    car = object_state("ot1", CAR, 32.0, 0.0, -math.pi / 2, 0.0)
    watch = PriorityWatch(DRIVER)
    assert watch.decide(28.0, 0.0, [car], DRIVER).word == "wait"
    assert watch.words == ["wait"]


@pytest.mark.parametrize(("front_m", "heeded"), [(31.0, set()), (35.0, {"ot1"})])
def test_one_in_the_zone_with_it_is_in_its_way_though_it_comes_to_a_later_place(
    front_m: float, heeded: set[str]
) -> None:
    """The priority path crosses the VUT's a second time, at x = 62."""
    again = [(32.0, 100.0), (32.0, -20.0), (62.0, -20.0), (62.0, 100.0)]
    first = PLACE.model_copy(update={"priority_path": again})
    second = GiveWay(
        line_m=58.0, zone_m=(60.0, 64.0), priority_path=again, priority_zone_m=(168.0, 172.0)
    )
    driver = DRIVER.model_copy(update={"gives_way": [first, second]})
    car = object_state("ot1", CAR, 32.0, 0.5, -math.pi / 2, 1.0)
    assert PriorityWatch(driver).decide(front_m, 2.0, [car], driver).heeded == heeded


def test_a_driver_who_does_not_react_gives_nobody_way() -> None:
    assert not PriorityWatch(DRIVER.model_copy(update={"reacts": False}))


@given(
    st.floats(0.0, 30.0),
    st.floats(0.0, 15.0),
    st.lists(st.tuples(st.floats(0.0, 20.0), st.floats(0.0, 5.0)), max_size=4),
    st.sampled_from(["approach", "go", "yield", "wait"]),
)
def test_one_who_decides_to_go_meets_no_object_in_the_zone(
    to_line_m: float, speed_mps: float, times: list[tuple[float, float]], before: Word
) -> None:
    coming = [Coming(str(k), a, a + d) for k, (a, d) in enumerate(times)]
    made = decide(PLACE, 28.0 - to_line_m, speed_mps, coming, DRIVER, before)
    assert made.heeded == {c.object_id for c in coming}
    assert not math.isnan(made.most_mps2)
    if made.word == "go" and before != "go":
        line_s = earliest_arrival_s(to_line_m, speed_mps, DRIVER)
        zone_s = earliest_arrival_s(to_line_m + 2.0, speed_mps, DRIVER)
        assert all(
            c.arrives_s - line_s >= LEAST_S or c.leaves_s + BEHIND_S <= zone_s for c in coming
        )


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"line_m": 31.0}, "beyond the begin of zone_m"),
        ({"zone_m": (34.0, 30.0)}, "zone_m begins at 34 m"),
        ({"priority_zone_m": (300.0, 310.0)}, "give a longer path"),
    ],
)
def test_places_that_contradict_themselves_are_refused(
    changes: dict[str, object], words: str
) -> None:
    with pytest.raises(ValidationError, match=words):
        GiveWay(**{**PLACE.model_dump(), **changes})


def test_a_run_file_refuses_a_place_that_the_vut_does_not_come_to() -> None:
    data = cut_in_run()
    place = {**PLACE.model_dump(), "zone_m": (9000.0, 9010.0)}
    driver = {**data["driver"], "gives_way": [place]}
    with pytest.raises(ValidationError, match="zone_m ends at 9010 m and the VUT's path at"):
        RunSpec.model_validate({**data, "driver": driver})


def test_a_run_file_without_such_a_place_does_not_name_any() -> None:
    assert "gives_way" not in Driver(cruise_mps=8.0).model_dump()
    assert Driver.model_validate(DRIVER.model_dump()) == DRIVER
