"""Each predicate of C1-C5 and of the form finds the fault that it is there for, at its field."""

from __future__ import annotations

import copy
from functools import cache
from typing import Any

import pytest

from ssp_scenario_manager.event_spec.checks.base import View
from ssp_scenario_manager.event_spec.checks.check import PREDICATES, check_event
from ssp_scenario_manager.event_spec.fields import split
from ssp_scenario_manager.event_spec.load import read_event_file
from ssp_scenario_manager.event_spec.model import Event

GONE = object()
C = "constraints"
OT1 = "motion.ot1"


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


def span(low: float | None, high: float | None, unit: str) -> dict[str, Any]:
    return {"min": low, "max": high, "unit": unit}


# (predicate, event, edits, the field that is named)
CASES: list[tuple[str, str, dict[str, Any], str]] = [
    ("one_vut", "cut_in", {"participants.ot1.role": "VUT"}, "participants.ot1.role"),
    ("one_vut", "cut_in", {"participants.vut.role": "OT"}, "participants.vut.role"),
    (
        "only_the_vut_has_an_intent",
        "cut_in",
        {"participants.vut.intent": GONE},
        "participants.vut.intent",
    ),
    (
        "only_the_vut_has_an_intent",
        "cut_in",
        {"participants.ot1.intent": "keep_lane"},
        "participants.ot1.intent",
    ),
    (
        "fields_say_whether_they_vary",
        "cut_in",
        {"topology.segment.identity": GONE},
        "topology.segment",
    ),
    (
        "fields_say_whether_they_vary",
        "cut_in",
        {"topology.segment.varies": ["straight", "curve"]},
        "topology.segment",
    ),
    (
        "fields_say_whether_they_vary",
        "cut_in",
        {"topology.lanes_opposite.value": 3},
        "topology.lanes_opposite",
    ),
    (
        "fields_say_whether_they_vary",
        "cut_in",
        {"topology.lanes_opposite.varies": {"min": 2, "max": 1}},
        "topology.lanes_opposite.varies",
    ),
    (
        "fields_say_whether_they_vary",
        "cut_in",
        {"topology.left_boundary.varies": ["kerb"]},
        "topology.left_boundary",
    ),
    (
        "fields_say_whether_they_vary",
        "cut_in",
        {"topology.curvature.value": span(0.001, 0.002, "1/m")},
        "topology.curvature",
    ),
    (
        "intent_fits_the_kind_and_the_motion",
        "cut_in",
        {"participants.vut.intent": "lane_change_left"},
        "participants.vut.intent",
    ),
    (
        "intent_fits_the_kind_and_the_motion",
        "cut_in",
        {"participants.vut.intent": "turn_left", "motion.vut.trigger.lateral": "right"},
        "motion.vut.trigger.lateral",
    ),
    (
        "intent_fits_the_kind_and_the_motion",
        "cut_in",
        {"interaction.lateral_responses": ["left"]},
        "interaction.lateral_responses",
    ),
    (
        "intent_fits_the_kind_and_the_motion",
        "cut_in",
        {"participants.vut.intent": "stop", "motion.vut.resolution.speed_trend": "increasing"},
        "motion.vut.resolution.speed_trend",
    ),
    (
        "enough_before_and_after",
        "cut_in",
        {"events.clip.end": span(5.999, 5.999, "s")},
        "events.clip.end",
    ),
    (
        "enough_before_and_after",
        "cut_in",
        {"events.clip.start": span(2.709, 2.709, "s")},
        "events.trigger.start",
    ),
    ("identity_is_known", "cut_in", {"topology.segment.value": "unresolved"}, "topology.segment"),
    (
        "what_varies_is_justified",
        "cut_in",
        {"topology.lanes_opposite.why": " "},
        "topology.lanes_opposite",
    ),
    ("what_varies_is_justified", "cut_in", {"uncertainty": {}}, "topology.lanes_opposite"),
    ("same_ids_everywhere", "cut_in", {"motion.vut": GONE}, "motion.vut"),
    (
        "same_ids_everywhere",
        "occluded_crossing",
        {"participants.ot2": GONE},
        "constraints.speeds.ot2",
    ),
    ("every_phase", "cut_in", {f"{OT1}.conflict": GONE}, f"{OT1}.conflict"),
    ("every_phase", "cut_in", {f"{C}.speeds.ot1.trigger": GONE}, f"{C}.speeds.ot1.trigger"),
    (
        "interaction_names_participants",
        "cut_in",
        {"interaction.initiator": "vut"},
        "interaction.initiator",
    ),
    (
        "interaction_names_participants",
        "cut_in",
        {"interaction.passing_order": ["ot1", "ot1"]},
        "interaction.passing_order",
    ),
    (
        "interaction_names_participants",
        "occluded_crossing",
        {f"{C}.trigger.object": "ot2"},
        f"{C}.trigger.object",
    ),
    (
        "classes_fit_roles",
        "cut_in",
        {"participants.ot1.class": "pedestrian"},
        "participants.ot1.class",
    ),
    (
        "classes_fit_roles",
        "cut_in",
        {"participants.vut.class": "cyclist"},
        "participants.vut.class",
    ),
    ("occluder_hides", "occluded_crossing", {"interaction.occluder": GONE}, "interaction.occluder"),
    (
        "occluder_hides",
        "occluded_crossing",
        {"participants.ot2.class": "cyclist"},
        "participants.ot2.class",
    ),
    (
        "occluder_hides",
        "occluded_crossing",
        {"participants.ot2.region.gap": span(60, 130, "m")},
        "participants.ot2.region.gap",
    ),
    (
        "vut_drives_along_the_road",
        "cut_in",
        {"participants.vut.region.along": "ahead"},
        "participants.vut.region.along",
    ),
    (
        "vut_drives_along_the_road",
        "cut_in",
        {f"{OT1}.trigger.motion": None},
        f"{OT1}.trigger.motion",
    ),
    (
        "places_exist",
        "cut_in",
        {"topology.vut_lane.value": "leftmost"},
        "participants.ot1.region.place",
    ),
    (
        "places_exist",
        "vru_crossing",
        {"topology.right_boundary": {"value": "verge", "identity": True}},
        "participants.ot1.region.place",
    ),
    (
        "places_exist",
        "cut_in",
        {"topology.vut_lane.value": "middle"},
        "topology.lanes_same_direction",
    ),
    (
        "first_seen_where_they_start",
        "cut_in",
        {f"{OT1}.approach.position": "front_right"},
        f"{OT1}.approach.position",
    ),
    ("motion_fits_words", "cut_in", {f"{OT1}.trigger.lateral": "left"}, f"{OT1}.trigger.lateral"),
    (
        "motion_fits_words",
        "vru_crossing",
        {f"{OT1}.conflict.heading": "same"},
        f"{OT1}.conflict.heading",
    ),
    (
        "vut_keeps_its_lane",
        "cut_in",
        {"motion.vut.trigger.heading": "opposite"},
        "motion.vut.trigger.heading",
    ),
    (
        "gap_fits_speeds",
        "cut_in",
        {f"{OT1}.approach.longitudinal": "opening"},
        f"{OT1}.approach.longitudinal",
    ),
    (
        "who_stands_is_passed",
        "occluded_crossing",
        {"motion.ot2.resolution.position": "left"},
        "motion.ot2.resolution.position",
    ),
    (
        "nobody_turns_round",
        "cut_in",
        {f"{OT1}.resolution.heading": "opposite"},
        f"{OT1}.resolution.heading",
    ),
    (
        "road_has_the_lanes",
        "cut_in",
        {"topology.lanes_same_direction.value": 1},
        "topology.lanes_same_direction",
    ),
    (
        "road_permits_it",
        "cut_in",
        {"topology.permitted_manoeuvres.value": ["keep_lane"]},
        "topology.permitted_manoeuvres",
    ),
    (
        "initiator_comes_from_there",
        "cut_in",
        {"participants.ot1.region.place": "right_lane"},
        "participants.ot1.region.place",
    ),
    (
        "path_meets_the_corridor",
        "vru_crossing",
        {f"{OT1}.resolution.position": "front_right"},
        f"{OT1}.resolution.position",
    ),
    (
        "segment_fits_curvature",
        "cut_in",
        {"topology.segment.value": "curve"},
        "topology.curvature.varies",
    ),
    (
        "segment_fits_curvature",
        "cut_in",
        {"topology.curvature.varies": span(0, 0.05, "1/m")},
        "topology.curvature.varies",
    ),
    (
        "lanes_are_changed_on_open_road",
        "cut_in",
        {"topology.segment.value": "junction"},
        "topology.segment",
    ),
    (
        "phases_in_order",
        "cut_in",
        {"events.conflict.start": span(3, 3, "s")},
        "events.conflict.start",
    ),
    (
        "phases_inside_the_clip",
        "cut_in",
        {"events.clip.end": span(5, 5, "s")},
        "events.resolution.start",
    ),
    (
        "evidence_is_readable",
        "cut_in",
        {"events.trigger.evidence": [{"frames": [87, 80], "span_s": [3.208, 3.333]}]},
        "events.trigger.evidence[0].frames",
    ),
    (
        "evidence_shows_its_phase",
        "cut_in",
        {"events.trigger.evidence": [{"span_s": [3.0, 3.333]}]},
        "events.trigger.evidence[0]",
    ),
    (
        "trigger_is_observable",
        "cut_in",
        {f"{OT1}.approach.lateral": "right"},
        f"{OT1}.approach.lateral",
    ),
    (
        "trigger_is_observable",
        "lead_braking",
        {f"{OT1}.trigger.speed_trend": "constant"},
        f"{OT1}.trigger.speed_trend",
    ),
    (
        "conflict_follows_the_trigger",
        "vru_crossing",
        {f"{C}.thresholds.ttc": span(3.2, 3.2, "s")},
        f"{C}.trigger.below",
    ),
    (
        "trigger_can_fire",
        "cut_in",
        {"participants.ot1.region.gap": span(15, 40, "m")},
        f"{C}.trigger.below",
    ),
    (
        "vut_comes_steadily",
        "cut_in",
        {"motion.vut.approach.speed_trend": "increasing"},
        "motion.vut.approach.speed_trend",
    ),
    (
        "vut_comes_steadily",
        "cut_in",
        {"motion.vut.trigger.speed_trend": "increasing"},
        "motion.vut.trigger.speed_trend",
    ),
    (
        "speeds_follow_trends",
        "vru_crossing",
        {f"{C}.speeds.ot1.approach": span(0, 1, "m/s")},
        f"{C}.speeds.ot1.approach",
    ),
    ("kind_is_known", "cut_in", {"interaction.type": "cut_out"}, "interaction.type"),
    ("words_fit_the_kind", "cut_in", {"interaction.relation": "crossing"}, "interaction.relation"),
    (
        "dominant_motion_is_seen",
        "cut_in",
        {f"{OT1}.conflict.motion": "same_direction"},
        f"{OT1}.conflict.motion",
    ),
    (
        "conflict_is_closing",
        "cut_in",
        {f"{OT1}.conflict.longitudinal": "any"},
        f"{OT1}.conflict.longitudinal",
    ),
    (
        "passing_order_fits",
        "cut_in",
        {"interaction.passing_order": ["vut", "ot1"]},
        "interaction.passing_order",
    ),
    (
        "responses_agree",
        "cut_in",
        {"interaction.longitudinal_responses": ["accelerate"]},
        "interaction.longitudinal_responses",
    ),
    (
        "responses_have_room",
        "cut_in",
        {"interaction.lateral_responses": ["straight", "right"]},
        "interaction.lateral_responses",
    ),
    (
        "vut_does_what_is_admissible",
        "cut_in",
        {"motion.vut.conflict.speed_trend": "increasing"},
        "motion.vut.conflict.speed_trend",
    ),
    (
        "vut_keeps_its_lane_untouched",
        "cut_in",
        {"motion.vut.resolution.lateral": "left"},
        "motion.vut.resolution.lateral",
    ),
    (
        "vut_gives_way_in_the_conflict",
        "cut_in",
        {
            "motion.vut.conflict.speed_trend": "any",
            "motion.vut.resolution.speed_trend": "decreasing",
        },
        "motion.vut.conflict.speed_trend",
    ),
    (
        "separation_fits_the_time_gap",
        "vru_crossing",
        {f"{C}.safety.separation": span(2.3, None, "m")},
        f"{C}.safety.separation",
    ),
    (
        "thresholds_fit_the_kind",
        "vru_crossing",
        {f"{C}.thresholds.arrival_gap": None},
        f"{C}.thresholds.arrival_gap",
    ),
    (
        "a_response_is_feasible",
        "lead_braking",
        {f"{C}.safety.acceleration": span(None, 2, "m/s^2")},
        f"{C}.trigger.below",
    ),
    (
        "a_response_is_feasible",
        "slow_lead",
        {f"{C}.safety.acceleration": span(None, 0.8, "m/s^2")},
        f"{C}.trigger.below",
    ),
    (
        "trigger_is_observable",
        "slow_lead",
        {f"{C}.thresholds.ttc": span(4, 4, "s")},
        f"{C}.thresholds.ttc",
    ),
    (
        "trigger_is_observable",
        "slow_lead",
        {f"{OT1}.trigger.speed_trend": "decreasing"},
        f"{OT1}.trigger.speed_trend",
    ),
    (
        "conflict_follows_the_trigger",
        "slow_lead",
        {f"{C}.trigger.below": span(35, 46, "m")},
        f"{C}.trigger.below",
    ),
    (
        "first_seen_where_they_start",
        "slow_lead",
        {
            "participants.ot1.class": "cyclist",
            "participants.ot1.region.place": "left_lane",
            f"{OT1}.approach.position": "front_left",
        },
        "participants.ot1.region.place",
    ),
    (
        "units_are_right",
        "cut_in",
        {f"{C}.trigger.below": span(16, 20, "s")},
        f"{C}.trigger.below.unit",
    ),
    (
        "one_unit_each",
        "cut_in",
        {f"{C}.speeds.ot1.conflict": span(18, 32.4, "km/h")},
        f"{C}.speeds.ot1.conflict.unit",
    ),
    ("intervals_are_shaped", "cut_in", {f"{C}.time_gap": span(6, 0.2, "s")}, f"{C}.time_gap.min"),
    (
        "intervals_are_shaped",
        "cut_in",
        {f"{C}.thresholds.ttc": span(2, 3, "s")},
        f"{C}.thresholds.ttc.max",
    ),
    (
        "intervals_are_shaped",
        "cut_in",
        {f"{C}.safety.speed": span(15, None, "m/s")},
        f"{C}.safety.speed.max",
    ),
    (
        "inside_the_platform",
        "cut_in",
        {f"{C}.camera.hfov": span(60, 170, "deg")},
        f"{C}.camera.hfov.max",
    ),
    (
        "manoeuvre_is_complete",
        "cut_in",
        {f"{C}.manoeuvre.duration": GONE},
        f"{C}.manoeuvre.duration",
    ),
    (
        "critical_fields_are_known",
        "cut_in",
        {f"{C}.trigger.below": "unresolved"},
        f"{C}.trigger.below",
    ),
    (
        "inside_the_safety_limits",
        "cut_in",
        {f"{C}.safety.speed": span(None, 13, "m/s")},
        f"{C}.speeds.vut.approach.max",
    ),
    (
        "speeds_hold_the_manoeuvre",
        "cut_in",
        {f"{C}.manoeuvre.end_speed": span(4, 6, "m/s")},
        f"{C}.speeds.ot1.conflict",
    ),
    (
        "vut_only_brakes",
        "cut_in",
        {f"{C}.speeds.vut.resolution": span(1, 14, "m/s")},
        f"{C}.speeds.vut.resolution",
    ),
    (
        "lane_change_is_drivable",
        "cut_in",
        {f"{C}.manoeuvre.duration": span(1, 3, "s")},
        f"{C}.manoeuvre.duration",
    ),
    (
        "site_is_large_enough",
        "vru_crossing",
        {f"{C}.site.length": span(100, None, "m")},
        f"{C}.site.length",
    ),
    (
        "weights_count_something",
        "cut_in",
        {
            f"{C}.weights": dict.fromkeys(
                (
                    "topology",
                    "participant_roles",
                    "dominant_motion",
                    "conflict_type",
                    "passing_order",
                ),
                0.0,
            )
        },
        f"{C}.weights",
    ),
    ("every_field_is_covered", "cut_in", {"uncertainty": {}}, "topology.segment"),
    ("entries_name_fields", "cut_in", {f"{C}.manoeuvre.duration": GONE}, f"{C}.manoeuvre.duration"),
    (
        "seals_hold",
        "cut_in",
        {"topology.curvature.value": span(0, 0.0005, "1/m")},
        "topology.curvature",
    ),
]
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
