"""Identity switches: every way in which one id stops meaning one object."""

from __future__ import annotations

from dataclasses import replace

import pytest

from ssp_eval.audit.evidence.history import find_switches
from ssp_eval.recordings.states import WORLD, Sighting

END_S = 10.0


def make_sightings(*, reported: bool = True) -> list[Sighting]:
    """A VUT and two OTs at 10 m/s, 30 m apart, in the world and in their own states."""
    found = []
    for k in range(round(END_S * 50) + 1):
        t_s = k / 50.0
        for index, name in enumerate(("vut", "ot1", "ot2")):
            x_m = 30.0 * index + 10.0 * t_s
            cls = "truck" if name == "ot2" else "car"
            found.append(Sighting(t_s, WORLD, name, cls, x_m, 0.0, 10.0))
            if reported and k % 2:
                found.append(Sighting(t_s, name, name, cls, x_m + 0.1, 0.05, 10.0, k))
    return found


def texts(found: list[Sighting], traffic: tuple[str, ...] = ()) -> list[str]:
    switches = find_switches(found, ("vut", "ot1", "ot2"), traffic, 0.0, END_S)
    assert switches == sorted(switches, key=lambda s: (s.t_s, s.text))
    return [switch.text for switch in switches]


def test_nothing_is_found_where_nothing_is() -> None:
    assert texts(make_sightings()) == []
    assert texts(make_sightings(reported=False)) == []


def test_lost_states_and_traffic_that_comes_and_goes_are_none() -> None:
    found = [s for s in make_sightings() if s.source == WORLD or not 4.0 < s.t_s < 4.4]
    car = Sighting(5.0, WORLD, "t1", "car", 300.0, 3.5, 12.0)
    assert texts([*found, car], traffic=("t1",)) == []


def test_another_name_in_its_own_states() -> None:
    found = [
        replace(s, object_id="ot7") if s.source == "ot1" and s.t_s >= 6.0 else s
        for s in make_sightings()
    ]
    assert texts(found) == [
        "the states of ot1 say ot7 from 6.02 s on",
        "its own states: ot1 is gone from 5.98 to 10.00 s",
    ]


def test_another_class() -> None:
    found = [
        replace(s, object_class="pedestrian") if s.object_id == "ot1" and s.t_s > 3.0 else s
        for s in make_sightings()
    ]
    assert texts(found) == ["ot1 is a car until 3.00 s, then a pedestrian"]
    own = [replace(s, object_class="bus") if s.source == "ot2" else s for s in make_sightings()]
    assert texts(own) == ["ot2 is a bus in its own states and a truck in the world"]


def test_vanishing_and_appearing() -> None:
    gone = [
        s for s in make_sightings(reported=False) if s.object_id != "ot1" or not 4.0 < s.t_s < 5.0
    ]
    assert texts(gone) == ["ot1 is gone from 4.00 to 5.00 s"]
    late = [s for s in make_sightings(reported=False) if s.object_id != "ot1" or s.t_s > 2.0]
    assert texts(late) == ["ot1 is gone from 0.00 to 2.02 s"]
    stranger = Sighting(7.0, WORLD, "ghost", "car", 0.0, 0.0, 0.0)
    assert texts([*make_sightings(), stranger]) == ["ghost, an unknown id, appears at 7.00 s"]


def test_a_jump() -> None:
    found = [
        replace(s, x_m=s.x_m + 8.0) if s.object_id == "ot1" and s.t_s >= 6.0 else s
        for s in make_sightings(reported=False)
    ]
    assert texts(found) == ["ot1 jumps by 8.2 m at 6.00 s"]


def test_two_that_are_exchanged() -> None:
    other = {"ot1": "ot2", "ot2": "ot1"}
    found = [
        replace(s, object_id=other.get(s.object_id, s.object_id), object_class="car")
        if s.t_s >= 6.0
        else replace(s, object_class="car")
        for s in make_sightings(reported=False)
    ]
    assert texts(found)[0] == "ot1 and ot2 are exchanged at 6.00 s"


def test_two_senders_under_one_id() -> None:
    found = make_sightings()
    index = next(i for i, s in enumerate(found) if s.source == "ot1" and s.t_s > 5.0)
    found.insert(index + 1, replace(found[index], sequence=3))
    (text,) = texts(found)
    assert text.startswith("the states of ot1 come from two senders")


@pytest.mark.parametrize("step_m", [0.5, 1.0])
def test_noise_is_no_jump(step_m: float) -> None:
    noisy = [
        replace(s, y_m=s.y_m + (step_m if i % 2 else 0.0)) for i, s in enumerate(make_sightings())
    ]
    assert texts(noisy) == []
