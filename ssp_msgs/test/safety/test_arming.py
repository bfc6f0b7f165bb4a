"""The obstacles to arming by need, by whom they are about, and by what was measured."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import pytest

from ssp_core import names
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.safety.arming import Facts, Gate, Need, Obstacle, obstacles
from ssp_core.safety.body_status import BodyStatus
from ssp_core.safety.consistency import Bounds, ConsistencyWatch
from ssp_core.safety.link_quality import LinkEstimate
from ssp_core.safety.object_rules import RulesCheck
from ssp_core.vocabulary import ControlState
from tests.support.runs import small_run
from tests.support.states import object_state

S = 1_000_000_000
NOW_NS = 50 * S
AWAY = {"x_m": 80.0, "y_m": 4.0, "yaw_rad": 0.0}
TARGETS = [*small_run()["targets"], {"id": "ot2", "object_class": "car", "start": AWAY}]
LIMITS = {"speed_mps": 15.0, "acceleration_mps2": 5.0}


def run(**changes: Any) -> RunSpec:
    return RunSpec.model_validate(small_run(**{"targets": TARGETS, **changes}))


RUN = run()
READY = Facts.of_one_process(RUN)


def participants(spec: RunSpec, **changes: dict[str, Any]) -> dict[str, ObjectState]:
    """Everybody at its start, but for what is given by id."""
    return {
        one.id: object_state(
            one.id,
            one.cls,
            **{
                "x_m": one.start.x_m,
                "y_m": one.start.y_m,
                "stamp_ns": NOW_NS,
                "control_state": ControlState.DISARMED,
                **changes.get(one.id, {}),
            },
        )
        for one in (spec.vut, *spec.targets)
    }


def obstacles_of(
    spec: RunSpec = RUN,
    facts: Facts = READY,
    states: dict[str, ObjectState] | None = None,
    gate: Gate = Gate.ARM,
) -> list[tuple[Need, str, float, float, str]]:
    """The obstacles as tuples; a number that isn't one stands as -1, to be compared."""
    known = dict(participants(spec) if states is None else states)
    vut = known.pop("vut", None)

    def number(value: float) -> float:
        return -1.0 if math.isnan(value) else round(value, 9)

    return [
        (one.need, one.who, number(one.measured), number(one.limit), one.detail)
        for one in obstacles(gate, spec, facts, vut, known, NOW_NS)
    ]


def about(need: Need, who: str, detail: str = "") -> tuple[Need, str, float, float, str]:
    return need, who, -1.0, -1.0, detail


def test_who_is_sound_and_in_place_meets_no_obstacle() -> None:
    assert obstacles_of() == []
    assert Obstacle(Need.WORLD).who == ""


def test_while_the_world_waits_for_answers_the_objects_silence_is_named_as_well() -> None:
    waits = replace(READY, unanswered=("monitor", "front_camera"))
    states = participants(RUN)
    del states["vut"], states["ot2"]
    for gate in (Gate.CONNECT, Gate.ARM):
        assert obstacles_of(facts=waits, states=states, gate=gate) == [
            about(Need.ANSWERS, names.SIL_WORLD, "monitor and front_camera"),
            (Need.OBJECT_STATE, "ot2", math.inf, 6.0, ""),
        ]
    # A VUT that was heard waits for nobody, and one without a world is silent itself.
    del states["ot1"]
    dead = replace(waits, ages_s={**READY.ages_s, names.VUT_ID: 7.0})
    own = {"vut": participants(RUN)["vut"], **participants(RUN)}
    assert obstacles_of(facts=dead, states=own) == [(Need.VUT_STATE, names.VUT_ID, 7.0, 6.125, "")]
    ages = {who: age_s for who, age_s in READY.ages_s.items() if who != names.SIL_WORLD}
    alone = obstacles_of(facts=replace(waits, ages_s=ages), states={}, gate=Gate.CONNECT)
    assert alone[0] == (Need.VUT_STATE, names.VUT_ID, math.inf, 6.125, "")


def test_each_obstacle_names_whom_it_is_about() -> None:
    facts = replace(
        READY,
        vut_refused="no fix",
        bodies={
            "ot1": BodyStatus("ot1", ("deaf", "mute"), ("deaf", "no power")),
            "ot2": BodyStatus("ot2", (), ("no key", "no brake")),
        },
        refusals={"ot2": "too early"},
        other_managers=2,
        foreign="/clock has /x",
        rules={"ot2": RulesCheck("d", "ot2 judges by another step_s")},
    )
    states = participants(RUN)
    del states["ot1"]
    gone = "one whose process has ended is forgotten within 20 s"
    assert obstacles_of(facts=facts, states=states) == [
        (Need.OBJECT_STATE, "ot1", math.inf, 6.0, "deaf; mute"),
        about(Need.RECEIVER, "vut", "no fix"),
        about(Need.BODY, "ot1", "no power"),
        about(Need.BODY, "ot2", "no key"),
        about(Need.BODY, "ot2", "no brake"),
        about(Need.NOT_REFUSED, "ot2", "too early"),
        (Need.ONE_MANAGER, "", 2.0, 0.0, f": /clock has /x; {gone}"),
        about(Need.RULES, "ot1", "ot1 has not said what it judges by"),
        about(Need.RULES, "ot2", "ot2 judges by another step_s"),
    ]
    unnamed = replace(READY, other_managers=1)
    assert obstacles_of(facts=unnamed) == [(Need.ONE_MANAGER, "", 1.0, 0.0, "")]


@pytest.mark.parametrize(
    ("link", "obstacle"),
    [
        (LinkEstimate(0.0, 0.0, 0.25), None),
        # An answer that came is none without a delay that was measured.
        (LinkEstimate(age_s=0.0), (Need.REPLY, "ot1", math.inf, 0.25, "")),
        (LinkEstimate(age_s=0.25), (Need.REPLY, "ot1", math.inf, 0.25, "")),
        (LinkEstimate(age_s=0.26), (Need.REPLY, "ot1", 0.26, 0.25, "")),
        (LinkEstimate(0.0, math.inf, 0.25), (Need.REPLY, "ot1", math.inf, 0.25, "")),
        (LinkEstimate(-0.2, 0.25, 0.0), (Need.CLOCK, "ot1", -0.2, 0.175, "")),
        (LinkEstimate(0.0, 0.75, 0.0), (Need.LINK, "ot1", 0.75, 0.5, "")),
    ],
)
def test_a_link_that_is_not_measured_is_silent(
    link: LinkEstimate, obstacle: tuple[Need, str, float, float, str] | None
) -> None:
    facts = replace(READY, links={**READY.links, "ot1": link})
    assert obstacles_of(facts=facts) == ([] if obstacle is None else [obstacle])
    missing = replace(READY, links={"ot2": LinkEstimate(0.0, 0.0, 0.0)})
    assert obstacles_of(facts=missing) == [(Need.REPLY, "ot1", math.inf, 0.25, "")]


def stood(way_m: float) -> ConsistencyWatch:
    watch = ConsistencyWatch(Bounds())
    for step in range(2):
        watch.take(step * S, way_m * step, 0.0, 0.0, 0.0)
    return watch


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        ({"x_m": 41.5}, []),
        ({"x_m": 38.4}, [(Need.AT_START, "ot1", 1.6, 1.5, "")]),
        ({"y_m": 1.6}, [(Need.AT_START, "ot1", 1.6, 1.5, "")]),
        ({"x_m": 41.2, "y_m": -1.2}, [(Need.AT_START, "ot1", round(1.2 * 2**0.5, 9), 1.5, "")]),
        ({"yaw_rad": -0.4}, [(Need.HEADING, "ot1", -0.4, 0.35, "")]),
        ({"yaw_rad": 0.35}, []),
        ({"yaw_rad": 2.0 * math.pi}, []),
        ({"speed_mps": -0.05}, []),
        ({"speed_mps": -0.06}, [(Need.STANDING, "ot1", -0.06, 0.05, "")]),
        ({"position_std_m": 0.6}, [(Need.LOCALISED, "ot1", 0.6, 0.5, "")]),
        ({"control_state": ControlState.INIT}, [about(Need.CONTROL, "ot1", "INIT, not {}")]),
        ({"x_m": math.inf}, [about(Need.FINITE, "ot1")]),
        (
            {"reference_id": "r", "error_yaw_rad": -0.5},
            [about(Need.STATED, "ot1", "error_yaw -0.50 rad, limit 0.35 rad")],
        ),
        ({"stamp_ns": NOW_NS - S}, [(Need.YOUNG, "ot1", 1.0, 0.15, "")]),
        ({"stamp_ns": NOW_NS + S}, [(Need.NOT_AHEAD, "ot1", 1.0, 0.05, "")]),
    ],
)
@pytest.mark.parametrize("gate", [Gate.ARM, Gate.START])
def test_one_object_that_is_not_in_place_is_named_alone(
    gate: Gate, changed: dict[str, Any], expected: list[tuple[Need, str, float, float, str]]
) -> None:
    """Those behind it are looked at as well, and are sound."""
    both = {"ot1": changed, "ot2": {}}
    wanted = "DISARMED or ARMED"
    if gate is Gate.START:
        wanted = "ARMED"
        both = {who: {"control_state": ControlState.ARMED, **one} for who, one in both.items()}
    named = [(*one[:4], one[4].format(wanted)) for one in expected]
    assert obstacles_of(states=participants(RUN, **both), gate=gate) == named


def test_places_that_went_on_are_named_where_the_speed_says_standstill() -> None:
    facts = replace(READY, motion={"ot1": stood(0.5), "ot2": stood(0.1)})
    assert obstacles_of(facts=facts) == [(Need.STAYING, "ot1", 0.5, 0.1, " in 1 s")]
    doubted = ConsistencyWatch(Bounds())
    for step in range(50):
        doubted.take(step * S // 50, 0.2 * step if step < 40 else 7.8, 0.0, 0.0, 0.0)
    assert doubted.doubt is not None
    text = doubted.doubt.text
    assert obstacles_of(facts=replace(READY, motion={"ot2": doubted})) == [
        (Need.STAYING, "ot2", pytest.approx(7.8), 0.1, " in 1 s"),
        about(Need.CONSISTENT, "ot2", text),
    ]
    fast = participants(RUN, ot1={"speed_mps": 1.0})
    assert obstacles_of(facts=facts, states=fast) == [(Need.STANDING, "ot1", 1.0, 0.05, "")]


def test_a_turned_start_is_held_against_the_headings_difference() -> None:
    start = {"x_m": 40.0, "y_m": 0.0, "yaw_rad": 3.0}
    spec = run(targets=[{"id": "ot1", "object_class": "car", "start": start}])
    facts = Facts.of_one_process(spec)
    for yaw_rad, turned_rad in ((-3.0, 0.283185307), (-2.8, 0.483185307), (2.6, -0.4)):
        states = participants(spec, ot1={"yaw_rad": yaw_rad})
        named = [(Need.HEADING, "ot1", turned_rad, 0.35, "")] if abs(turned_rad) > 0.35 else []
        assert obstacles_of(spec, facts, states) == named


def test_only_whose_heading_is_not_known_at_rest_is_turned_as_its_start_is() -> None:
    spec = run(limits={**LIMITS, "heading_by_course": ["ot2"]})
    states = participants(spec, ot1={"yaw_rad": 1.0}, ot2={"yaw_rad": 1.0})
    assert obstacles_of(spec, READY, states) == [(Need.HEADING, "ot1", 1.0, 0.35, "")]


def test_the_farther_of_both_boxes_counts_for_the_fence() -> None:
    """It sticks out by 0.4 m as its start has it, and by 3.1 m as it states itself."""
    spec = run(
        limits={**LIMITS, "heading_by_course": ["ot1"]},
        geofence=[(0.0, -0.5), (400.0, -0.5), (400.0, 12.0), (0.0, 12.0)],
    )
    states = participants(spec, vut={"y_m": 1.0}, ot1={"yaw_rad": -math.pi / 2.0})
    (outside,) = obstacles_of(spec, READY, states)
    assert outside == (Need.INSIDE, "ot1", 3.1, 0.0, "")


@pytest.mark.parametrize(
    ("places", "pairs"),
    [
        ({"ot1": {"x_m": 40.0}, "ot2": {"x_m": 44.75, "y_m": 0.0}}, [("ot2", "ot1", 0.25)]),
        ({"ot1": {"x_m": 40.0}, "ot2": {"x_m": 45.0, "y_m": 0.0}}, []),
        ({"ot1": {"x_m": 14.75}, "ot2": {"x_m": 14.75, "y_m": 2.0}}, "all"),
        ({"ot1": {"x_m": math.nan}, "ot2": {"x_m": 10.0, "y_m": 0.0}}, [("ot2", "vut", 0.0)]),
    ],
)
def test_each_pair_that_is_too_near_is_named(places: dict[str, Any], pairs: Any) -> None:
    near = [one for one in obstacles_of(states=participants(RUN, **places)) if one[0] is Need.APART]
    if pairs == "all":
        gap_m = round(math.hypot(0.25, 0.2), 9)
        pairs = [("ot1", "vut", 0.25), ("ot2", "vut", gap_m), ("ot2", "ot1", 0.2)]
    assert near == [(Need.APART, who, gap_m, 0.5, other) for who, other, gap_m in pairs]


def test_a_pair_is_as_near_as_the_nearest_of_its_boxes() -> None:
    spec = run(limits={**LIMITS, "heading_by_course": ["ot1", "ot2"]})
    places = {"ot1": {"x_m": 40.0, "y_m": 0.0}, "ot2": {"x_m": 40.0, "y_m": 2.25}}
    turned = {"ot1": {**places["ot1"], "yaw_rad": 1.5}, "ot2": {**places["ot2"], "yaw_rad": 0.0}}
    for states, gap_m in ((places, 0.45), (turned, 0.0)):
        *_, last = obstacles_of(spec, READY, participants(spec, **states))
        assert last == (Need.APART, "ot2", gap_m, 0.5, "ot1")


@pytest.mark.parametrize(
    ("mode", "age_s", "measured_s"),
    [("live", 0.06, None), ("live", 0.08, 0.06), ("lockstep", 0.08, None)],
)
def test_a_live_vut_must_be_young_enough_for_triggers(
    mode: str, age_s: float, measured_s: float | None
) -> None:
    spec = RUN.model_copy(update={"mode": mode})
    states = participants(spec, vut={"stamp_ns": NOW_NS - round(age_s * S)})
    named = [] if measured_s is None else [(Need.TRIGGERS, "vut", measured_s, 0.04, "")]
    assert obstacles_of(spec, READY, states) == named


def test_the_facts_of_one_process_are_those_of_a_sound_session() -> None:
    assert READY.ages_s == dict.fromkeys(
        (names.SIL_WORLD, names.MONITOR, names.FRONT_CAMERA, names.VUT_ID, "ot1", "ot2"), 0.0
    )
    assert READY.links == dict.fromkeys(("ot1", "ot2"), LinkEstimate(0.0, 0.0, 0.0))
    assert READY.rules == dict.fromkeys(("ot1", "ot2"), RulesCheck())
    assert READY.recorder_ready
