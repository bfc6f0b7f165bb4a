"""Faults of shipped events, one for each predicate of C4, C5 and the review at least."""

from __future__ import annotations

from tests.support.events.faults import GONE, OT1, C, Case, span

WEIGHTS = ("topology", "participant_roles", "dominant_motion", "conflict_type", "passing_order")

CONFLICT_CASES: list[Case] = [
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
        "intent_fits_the_kind_and_the_motion",
        "vut_turn",
        {"participants.vut.intent": "keep_lane"},
        "participants.vut.intent",
    ),
    (
        "speeds_hold_the_manoeuvre",
        "merge",
        {"constraints.manoeuvre.merging_speed": span(0, 0, "m/s")},
        "constraints.manoeuvre.merging_speed",
    ),
    (
        "conflict_comes_in_time",
        "cut_in",
        {"events.conflict.start": span(16, 16, "s")},
        "events.conflict.start",
    ),
    ("kind_is_known", "cut_in", {"interaction.type": "u_turn"}, "interaction.type"),
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
        {f"{C}.weights": dict.fromkeys(WEIGHTS, 0.0)},
        f"{C}.weights",
    ),
    (
        "further_keep_to_the_road",
        "occluded_crossing",
        {"interaction.occluder": None, "motion.ot2.trigger.speed_trend": "any"},
        "motion.ot2.trigger.speed_trend",
    ),
    (
        "further_drive_in_a_lane",
        "occluded_crossing",
        {"interaction.occluder": None, "motion.ot2.trigger.speed_trend": "constant"},
        "motion.ot2.trigger.speed_trend",
    ),
    (
        "further_cause_no_conflict",
        "occluded_crossing",
        {"interaction.occluder": None, "participants.ot2.region.place": "vut_lane"},
        "participants.ot2.region.gap",
    ),
    (
        "leaving_occluder_causes_no_conflict",
        "cut_out",
        {
            "participants.ot2.region.gap": span(8, 12, "m"),
            f"{C}.speeds.ot2.approach": span(3, 4, "m/s"),
        },
        "participants.ot2.region.gap",
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
