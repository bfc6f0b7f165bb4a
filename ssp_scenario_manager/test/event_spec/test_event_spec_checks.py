"""Each predicate of C1-C5 and of the form finds the fault that it is there for, at its field."""

from __future__ import annotations

import copy
from functools import cache
from typing import Any

import pytest

from ssp_scenario_manager.checks.base import View
from ssp_scenario_manager.checks.check import PREDICATES, check_event
from ssp_scenario_manager.event_spec.fields import split
from ssp_scenario_manager.event_spec.load import read_event_file
from ssp_scenario_manager.event_spec.model import Event
from tests.support.events.faults import GONE, SCENE_CASES
from tests.support.events.faults_conflict import CONFLICT_CASES


@cache
def shipped(name: str) -> dict[str, Any]:
    return read_event_file(name)[0]


def changed(name: str, **edits: Any) -> dict[str, Any]:
    """A shipped event with other values; ``__`` in a name stands for a dot."""
    value = copy.deepcopy(shipped(name))
    for key, new in edits.items():
        *parents, last = split(key.replace("__", "."))
        at: Any = value
        for parent in parents:
            at = at[parent]
        if new is GONE:
            del at[last]
        else:
            at[last] = new
    return value


CASES = [*SCENE_CASES, *CONFLICT_CASES]
BY_NAME = {p.__name__: p for predicates in PREDICATES.values() for p in predicates}


@pytest.mark.parametrize(("predicate", "name", "edits", "field"), CASES)
def test_predicate_finds_its_fault(
    predicate: str, name: str, edits: dict[str, Any], field: str
) -> None:
    value = changed(name, **{key.replace(".", "__"): new for key, new in edits.items()})
    found = list(BY_NAME[predicate](View(Event.model_validate(value))))
    assert field in {failure.field for failure in found}
    for failure in found:
        assert failure.evidence
        assert failure.reason
        assert failure.remedy
    assert {failure.field for failure in found} <= {f.field for f in check_event(value)}


def test_every_predicate_has_a_case_and_a_rule_in_words() -> None:
    cases = {case[0] for case in CASES} | {"critical_fields_are_decided"}
    assert cases == set(BY_NAME)
    for predicate in BY_NAME.values():
        assert (predicate.__doc__ or "").partition("\n")[0].endswith(".")


def test_a_wrong_form_is_told_whole_and_before_all_else() -> None:
    value = changed(
        "cut_in",
        participants__ot1__class="tram",
        motion__ot1__trigger__lateral="left",
        constraints__speeds__ot1__conflict__min="five",
        surprise=1,
        interaction__zone=GONE,
    )
    found = {f.field: f for f in check_event(value)}
    assert {f.check for f in found.values()} == {"form"}
    assert set(found) == {
        "surprise",
        "participants.ot1.class",
        "constraints.speeds.ot1.conflict.min",
        "interaction.zone",
    }
    assert "pedestrian" in found["participants.ot1.class"].remedy
    assert found["interaction.zone"].evidence == "not there"
    assert "vut_lane, corridor_crossing" in found["interaction.zone"].remedy


def test_quantity_that_is_neither_interval_nor_unresolved_is_one_failure() -> None:
    for wrong in ("unresolvd", 12, None, [1, 2]):
        value = changed("cut_in", constraints__trigger__below=wrong)
        (failure,) = [f for f in check_event(value) if f.check == "form"]
        assert failure.field == "constraints.trigger.below"
        assert "{min, max, unit} or unresolved" in failure.remedy


@pytest.mark.parametrize("name", ["segment", "road_type", "vut_lane", "left_boundary"])
def test_any_is_no_value_of_the_road(name: str) -> None:
    path = f"topology.{name}.value"
    found = [f for f in check_event(changed("cut_in", **{path: "any"})) if f.field == path]
    assert [failure.check for failure in found] == ["C2"]
    assert "what the source shows" in found[0].remedy


def test_a_field_of_the_road_admits_its_value_or_what_it_may_vary_to() -> None:
    road = Event.model_validate(shipped("cut_in")).topology
    assert road.identity_fields == ("segment", "lanes_same_direction", "vut_lane")
    assert set(road.identity_fields) | set(road.varying_fields) == set(
        shipped("cut_in")["topology"]
    )
    assert [road.lanes_same_direction.admits(n) for n in (1, 2, 3)] == [False, True, False]
    assert [road.lanes_opposite.admits(n) for n in (0, 1, 2, 3)] == [False, True, True, False]
    assert [road.segment.admits(w) for w in ("straight", "curve")] == [True, False]
    assert [road.left_boundary.admits(w) for w in ("verge", "any")] == [True, False]
    assert [road.lane_width.admits(w) for w in (2.9, 3.0, 4.2, 4.3)] == [False, True, True, False]
    needed = {"keep_lane", "lane_change_right"}
    assert road.permitted_manoeuvres.admits(frozenset(needed))
    assert road.permitted_manoeuvres.admits(frozenset(needed | {"crossing", "stop"}))
    assert not road.permitted_manoeuvres.admits(frozenset({"keep_lane"}))


def test_order_of_failures_is_always_the_same() -> None:
    value = changed(
        "cut_in", constraints__trigger__object="vut", topology__segment__value="junction"
    )
    assert check_event(value) == check_event(copy.deepcopy(value))
    order = [f.check for f in check_event(value)]
    assert order == sorted(order, key=["form", *PREDICATES].index)


def test_failure_says_both_ends_of_a_relation() -> None:
    value = changed("cut_in", participants__ot1__region__place="right_lane")
    found = {f.field: f for f in check_event(value) if f.check == "C2"}
    evidence = found["participants.ot1.region.place"].evidence
    assert "participants.ot1.region.place = right_lane" in evidence
    assert "interaction.dominant_motion = cutting_in_from_left" in evidence
