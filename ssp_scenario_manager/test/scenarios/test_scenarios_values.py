"""Values inside part C: preferred first, inside K* and place, in SI units."""

from __future__ import annotations

from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.scenarios.base import CannotPlace
from ssp_scenario_manager.scenarios.values import (
    Choice,
    choice_entries,
    choose,
    combinations,
    fixed,
    quantity_at,
)

FIELD = "constraints.speeds.vut.approach"


@cache
def cut_in() -> Event:
    return load_event("cut_in")[0].model_copy(update={"uncertainty": {}})


def event(interval: dict[str, Any] | str) -> Event:
    value = cut_in().model_dump(mode="json", by_alias=True)
    value["constraints"]["speeds"]["vut"]["approach"] = interval
    return Event.model_validate(value)


def speeds(low: float | None, high: float | None, unit: str = "m/s") -> Event:
    return event({"min": low, "max": high, "unit": unit})


def test_the_middle_comes_first_then_ever_further_away() -> None:
    choice = choose(speeds(10.0, 14.0), FIELD, "m/s", {})
    assert choice.values == (12.0, 11.0, 13.0, 10.0, 14.0)
    assert choice.why == "middle of what K* allows"
    assert choice.unit == "m/s"


def test_a_validated_value_comes_first() -> None:
    choice = choose(speeds(10.0, 14.0), FIELD, "m/s", {FIELD: 13.2})
    assert choice.values[:2] == (13.2, 13.0)
    assert choice.why == "validated in simulation"
    moved = choose(speeds(10.0, 14.0), FIELD, "m/s", {FIELD: 15.0})
    assert moved.values[0] == 14.0
    assert "as 15 m/s, moved" in moved.why


def test_the_place_cuts_the_interval() -> None:
    choice = choose(speeds(10.0, 14.0), FIELD, "m/s", {}, at_most=11.0)
    assert choice.values[0] == 11.0
    assert "place's limit" in choice.why
    assert max(choice.values) == 11.0
    with pytest.raises(CannotPlace, match="the place allows 0 to 9 m/s"):
        choose(speeds(10.0, 14.0), FIELD, "m/s", {}, at_most=9.0)


@pytest.mark.parametrize(
    ("low", "high", "first"), [(None, 12.0, 12.0), (9.0, None, 9.0), (7.0, 7.0, 7.0)]
)
def test_half_open_and_exact_intervals(low: float | None, high: float | None, first: float) -> None:
    assert choose(speeds(low, high), FIELD, "m/s", {}).values[0] == first


def test_other_units_are_converted() -> None:
    assert choose(speeds(36.0, 72.0, "km/h"), FIELD, "m/s", {}).values[0] == pytest.approx(15.0)


def test_what_nobody_knows_is_not_made_up() -> None:
    with pytest.raises(CannotPlace, match="is unresolved; it needs an interval in m/s"):
        choose(event("unresolved"), FIELD, "m/s", {})
    with pytest.raises(CannotPlace, match="is missing"):
        choose(speeds(1.0, 2.0), "constraints.speeds.nobody.approach", "m/s", {})
    with pytest.raises(CannotPlace, match="neither min nor max"):
        choose(speeds(None, None), FIELD, "m/s", {})


def test_a_value_that_follows_from_others_must_lie_inside() -> None:
    assert fixed(speeds(10.0, 14.0), FIELD, "m/s", 10.5, "so").values == (10.5,)
    assert fixed(event("unresolved"), FIELD, "m/s", 99.0, "so").values == (99.0,)
    with pytest.raises(CannotPlace, match=r"would be 14\.10 m/s"):
        fixed(speeds(10.0, 14.0), FIELD, "m/s", 14.1, "so")


def test_only_known_fields_have_quantities() -> None:
    shipped = cut_in()
    assert quantity_at(shipped, "constraints.trigger.below") == Interval(min=16, max=20, unit="m")
    for field in ("constraints.trigger.object", "run.driver.headway_s"):
        assert quantity_at(shipped, field) is None


def test_combinations_go_out_from_the_preferred_values() -> None:
    choices = {
        "a": Choice("a", "m", (1.0, 2.0, 3.0), "x"),
        "b": Choice("b", "m", (10.0, 20.0), "y"),
    }
    found = list(combinations(choices))
    assert found[0] == {"a": 1.0, "b": 10.0}
    assert len(found) == 6
    assert found[-1] == {"a": 3.0, "b": 20.0}
    told = choice_entries(choices, found[-1])
    assert told["a"][2] == "1 m (x) doesn't work here"
    assert choice_entries(choices, found[0])["b"] == (10.0, "m", "y")


@settings(deadline=None)
@given(
    low=st.floats(0.0, 20.0),
    width=st.floats(0.0, 10.0),
    at_most=st.floats(0.0, 30.0),
    wanted=st.none() | st.floats(-5.0, 40.0),
)
def test_every_value_is_inside(
    low: float, width: float, at_most: float, wanted: float | None
) -> None:
    preferred = {} if wanted is None else {FIELD: wanted}
    try:
        choice = choose(speeds(low, low + width), FIELD, "m/s", preferred, at_most=at_most)
    except CannotPlace:
        assert low > at_most
        return
    assert all(low - 1e-9 <= v <= min(low + width, at_most) + 1e-9 for v in choice.values)
    assert len(set(choice.values)) == len(choice.values)
