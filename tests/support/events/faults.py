"""Faults of shipped events, one for each predicate of C1, C2 and C3 at least."""

from __future__ import annotations

from typing import Any

# Predicate, event, edits, and the field that is named.
Case = tuple[str, str, dict[str, Any], str]

GONE = object()
C = "constraints"
OT1 = "motion.ot1"


def span(low: float | None, high: float | None, unit: str) -> dict[str, Any]:
    return {"min": low, "max": high, "unit": unit}


SCENE_CASES: list[Case] = [
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
    ("occluder_hides", "cut_out", {"interaction.occluder": GONE}, "interaction.occluder"),
    (
        "occluder_hides",
        "cut_out",
        {"participants.ot2.region.gap": span(130, 170, "m")},
        "participants.ot2.region.gap",
    ),
    (
        "occluder_hides",
        "cut_out",
        {"motion.ot2.approach.speed_trend": "standing"},
        "motion.ot2.approach.speed_trend",
    ),
    (
        "occluder_hides",
        "cut_out",
        {"motion.ot2.trigger.lateral": "none"},
        "motion.ot2.trigger.lateral",
    ),
    (
        "occluder_hides",
        "cut_out",
        {"motion.ot2.trigger.motion": "cutting_in_from_right"},
        "motion.ot2.trigger.motion",
    ),
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
        "motion_fits_words",
        "oncoming_turn",
        {f"{OT1}.conflict.heading": "rightwards"},
        f"{OT1}.conflict.heading",
    ),
    (
        "nobody_turns_round",
        "oncoming_turn",
        {f"{OT1}.resolution.heading": "leftwards"},
        f"{OT1}.resolution.heading",
    ),
    (
        "initiator_turns",
        "oncoming_turn",
        {
            f"{OT1}.resolution.motion": "oncoming",
            f"{OT1}.resolution.heading": "opposite",
            f"{OT1}.resolution.longitudinal": "any",
        },
        f"{OT1}.resolution.heading",
    ),
    (
        "initiator_turns",
        "oncoming_turn",
        {f"{OT1}.trigger.lateral": "none"},
        f"{OT1}.trigger.lateral",
    ),
    (
        "initiator_turns",
        "oncoming_turn",
        {f"{OT1}.conflict.lateral": "left"},
        f"{OT1}.conflict.lateral",
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
        "initiator_comes_from_there",
        "oncoming_turn",
        {"participants.ot1.region.place": "left_road"},
        "participants.ot1.region.place",
    ),
    (
        "initiator_comes_from_there",
        "roundabout",
        {"participants.ot1.region.place": "right_road"},
        "participants.ot1.region.place",
    ),
    (
        "path_meets_the_corridor",
        "oncoming_turn",
        {f"{OT1}.trigger.position": "front_right"},
        f"{OT1}.trigger.position",
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
        "roads_cross_at_a_junction",
        "crossing_car",
        {"topology.segment.value": "straight"},
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
    (
        "trigger_is_observable",
        "cut_out",
        {f"{C}.thresholds.ttc": span(4, 4, "s")},
        f"{C}.thresholds.ttc",
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
]
