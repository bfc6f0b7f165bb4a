"""Plans of every kind, on straight and bent blocks, from both sides: what K* says comes true."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ssp_core.geometry import Pose2
from ssp_core.run_file.model import Limits
from ssp_core.run_file.participants import Brake, Hold, LaneChange
from ssp_core.run_file.road import CurvePiece
from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.event_spec.fields import UNITS, units_of
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.maps.block import Block, BlockLane
from ssp_scenario_manager.maps.crossings import Crossing
from ssp_scenario_manager.scenarios.base import (
    CannotPlace,
    Cross,
    Drive,
    Plan,
    Setting,
    Wait,
)
from ssp_scenario_manager.scenarios.block_places import ahead_of
from ssp_scenario_manager.scenarios.events.crossing import is_hidden
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from ssp_scenario_manager.scenarios.motions import motions
from ssp_scenario_manager.scenarios.prediction import Prediction, predict
from ssp_scenario_manager.scenarios.values import classes_of, quantity_at, size_of, thresholds_of
from tests.support.events.blocks import block_of

# Where roads cross: test_maps_crossing_car.py.
SHIPPED = sorted(name for name, kind in KINDS.items() if not kind.at_junction)
LIMITS = Limits(speed_mps=15.0, acceleration_mps2=4.5, separation_m=0.5)
SPEED_LIMIT_MPS = 13.9


@cache
def shipped(name: str) -> Event:
    """A shipped event; reading one takes a while."""
    return load_event(name)[0]


def changed(name: str, changes: dict[str, Any]) -> Event:
    """A shipped event with other values at some dotted paths."""
    value = shipped(name).model_dump(mode="json", by_alias=True, exclude={"uncertainty"})
    for path, new in changes.items():
        *way, last = path.split(".")
        node = value
        for key in way:
            node = node[key]
        node[last] = new
    return Event.model_validate(value)


VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    **{name: (name, {}) for name in SHIPPED},
    "cut_in from the right": (
        "cut_in",
        {
            "interaction.dominant_motion": "cutting_in_from_right",
            "participants.ot1.region.place": "right_lane",
            "topology.vut_lane.value": "leftmost",
        },
    ),
    "cut_in of a truck": (
        "cut_in",
        {
            "participants.ot1.class": "truck",
            # It takes longer to get to its speed.
            "participants.ot1.region.gap": {"min": 24, "max": 60, "unit": "m"},
        },
    ),
    "crossing from the left": (
        "vru_crossing",
        {
            "interaction.dominant_motion": "crossing_from_left",
            "participants.ot1.region.place": "left_kerb",
            # Four lanes are crossed before the VUT's.
            "constraints.trigger.below": {"min": 9.5, "max": 12.0, "unit": "s"},
            "participants.ot1.region.gap": {"min": 40, "max": 200, "unit": "m"},
        },
    ),
    "crossing of a cyclist": (
        "vru_crossing",
        {
            "participants.ot1.class": "cyclist",
            "constraints.manoeuvre.walking_speed": {"min": 2.0, "max": 4.0, "unit": "m/s"},
            "constraints.manoeuvre.kerb_distance": {"min": 1.5, "max": 4.0, "unit": "m"},
            **{
                f"constraints.speeds.ot1.{phase}": {"min": 0.0, "max": 5.0, "unit": "m/s"}
                for phase in ("trigger", "conflict", "resolution")
            },
        },
    ),
    "slow cyclist": ("slow_lead", {"participants.ot1.class": "cyclist"}),
    "standing lead": (
        "slow_lead",
        {
            "interaction.dominant_motion": "stationary",
            **{
                f"constraints.speeds.ot1.{phase}": {"min": 0.0, "max": 0.0, "unit": "m/s"}
                for phase in PHASES
            },
        },
    ),
    "crossing in other units": (
        "vru_crossing",
        {
            "constraints.speeds.vut.approach": {"min": 32.4, "max": 39.6, "unit": "km/h"},
            "constraints.trigger.below": {"min": 3000, "max": 3400, "unit": "ms"},
        },
    ),
}


def block(
    width_m: float = 3.5,
    length_m: float = 400.0,
    curvature_1pm: float = 0.0,
    crossings_s_m: tuple[float, ...] = (),
    pose: Pose2 | None = None,
) -> Block:
    """Two lanes a direction with sidewalks; bent by a constant curvature in its middle half."""
    quarter = length_m / 4
    pieces = [
        CurvePiece(length_m=quarter),
        CurvePiece(
            length_m=2 * quarter, start_curvature_1pm=curvature_1pm, end_curvature_1pm=curvature_1pm
        ),
        CurvePiece(length_m=quarter),
    ]
    return block_of(
        pieces,
        pose or Pose2(0.0, 0.0, 0.0),
        [(i * width_m, i < 2) for i in range(4)],
        width_m,
        segment="curve" if curvature_1pm else "straight",
        crossings=tuple(map(Crossing, crossings_s_m)),
    )


def plan_of(event: Event, place: Block, preferred: dict[str, float] | None = None) -> Plan:
    setting = Setting(event, place, LIMITS, preferred or {})
    return next(KINDS[event.interaction.type].plans(setting))


def foresight(event: Event, place: Block, plan: Plan) -> Prediction:
    told = motions(
        place.line, classes_of(event), event.vut_id, plan.vut, plan.targets, plan.trigger
    )
    return predict(told, KINDS[event.interaction.type].observable, thresholds_of(event))


def check(event: Event, place: Block, plan: Plan) -> None:
    """Assert the conditions that every plan must meet (METHOD 2.3)."""
    seen = foresight(event, place, plan)
    # Phases in order, nothing before the trigger can be seen.
    assert not seen.early_conflict
    assert seen.trigger_s is not None
    assert seen.conflict_s is not None
    assert seen.resolution_s is not None
    assert seen.fired_s <= seen.trigger_s <= seen.conflict_s < seen.resolution_s
    # Passing order and time gap.
    assert seen.initiator_first == (event.interaction.passing_order[0] == "ot1")
    gap = event.constraints.time_gap
    if math.isfinite(seen.vut_arrival_s):
        assert isinstance(gap, Interval)
        assert (gap.min or 0.0) - 1e-9 <= seen.time_gap_s <= (gap.max or math.inf) + 1e-9
    assert seen.separation_m > LIMITS.separation_m
    # Every chosen value lies in its interval.
    for field, (value, unit, _) in plan.choices.items():
        found = quantity_at(event, field)
        if isinstance(found, Interval):
            assert unit in units_of(UNITS[found.unit].dimension)[:1]
            assert found.si.low - 1e-6 <= value <= found.si.high + 1e-6, field
    # Everybody is on the block, the conflict in the zone, the zone in the VUT's corridor.
    for motion in (plan.vut, *plan.targets.values()):
        assert 0.0 <= motion.start.s_m <= place.length_m
    low, high = plan.zone[0], plan.zone[2]
    assert low.s_m - 1e-6 <= plan.conflict.s_m <= high.s_m
    assert low.l_m < plan.vut.start.l_m < high.l_m
    foreseen_s = ahead_of(place, plan.vut.start.s_m, seen.conflict_station_m, plan.vut.start.l_m)
    assert plan.conflict.s_m == pytest.approx(foreseen_s, abs=0.02)
    assert plan.vut.start.s_m < plan.expected.s_m < plan.conflict.s_m
    assert plan.vut.cruise_mps <= SPEED_LIMIT_MPS
    # Who was where stays so: a cut-in ends in the VUT's lane, a crossing on the other side.
    act = plan.trigger.act
    initiator = plan.targets[event.interaction.initiator]
    motion_word = event.interaction.dominant_motion
    if plan.trigger.acting_id != event.interaction.initiator:
        # Who leaves was in the lane in which the initiator stands, and goes to the next one.
        leaving = plan.targets[plan.trigger.acting_id]
        assert isinstance(initiator, Wait)
        assert isinstance(act, LaneChange)
        assert initiator.start.l_m == leaving.start.l_m == plan.vut.start.l_m
        assert leaving.start.s_m < initiator.start.s_m
        lanes_m = [lane.y_m for lane in place.forward_lanes]
        assert any(leaving.start.l_m + act.lateral_shift_m == pytest.approx(y_m) for y_m in lanes_m)
        assert act.lateral_shift_m > 2.9
    elif isinstance(act, LaneChange):
        assert initiator.start.l_m + act.lateral_shift_m == pytest.approx(plan.vut.start.l_m)
        assert (act.lateral_shift_m < 0.0) == (motion_word == "cutting_in_from_left")
    elif isinstance(act, Cross):
        assert isinstance(initiator, Wait)
        goes_left = act.goal.l_m > initiator.start.l_m
        assert goes_left == (motion_word == "crossing_from_right")
        assert min(act.goal.l_m, initiator.start.l_m) < place.right_edge_m
        assert max(act.goal.l_m, initiator.start.l_m) > place.left_edge_m
    elif isinstance(act, Hold):
        assert isinstance(initiator, Wait) == (motion_word == "stationary")
        assert -0.5 <= initiator.start.l_m - plan.vut.start.l_m <= -0.2
    else:
        assert isinstance(act, Brake)
        assert isinstance(initiator, Drive)
        assert initiator.start.l_m == plan.vut.start.l_m


@pytest.mark.parametrize(
    ("variant", "curvature_1pm"),
    [
        *((variant, 0.0) for variant in VARIANTS),
        # Each in a bend to one side; those of a kind in bends to both.
        *((variant, (0.004, -0.004)[number % 2]) for number, variant in enumerate(VARIANTS)),
    ],
)
def test_every_variant_goes_as_it_says(variant: str, curvature_1pm: float) -> None:
    name, changes = VARIANTS[variant]
    event, place = changed(name, changes), block(curvature_1pm=curvature_1pm)
    check(event, place, plan_of(event, place))


@settings(max_examples=12, deadline=None)
@given(
    name=st.sampled_from(sorted(VARIANTS)),
    width_m=st.floats(3.0, 4.2),
    length_m=st.floats(300.0, 600.0),
    curvature_1pm=st.sampled_from([0.0, 0.0, 0.002, -0.003, 0.005]),
    yaw_rad=st.floats(-3.1, 3.1),
    vut_mps=st.floats(8.0, 14.0),
    share=st.floats(0.0, 1.0),
)
def test_whatever_is_preferred_a_plan_keeps_to_k_star(
    name: str,
    width_m: float,
    length_m: float,
    curvature_1pm: float,
    yaw_rad: float,
    vut_mps: float,
    share: float,
) -> None:
    event = changed(*VARIANTS[name])
    place = block(width_m, length_m, curvature_1pm, pose=Pose2(40.0, -7.0, yaw_rad))
    preferred = {"constraints.speeds.vut.approach": vut_mps}
    for key in event.constraints.manoeuvre:
        found = quantity_at(event, f"constraints.manoeuvre.{key}")
        if isinstance(found, Interval) and found.min is not None and found.max is not None:
            value = found.si.low + share * (found.si.high - found.si.low)
            preferred[f"constraints.manoeuvre.{key}"] = value
    try:
        plan = plan_of(event, place, preferred)
    except CannotPlace:
        return  # a block that is too short, or a bend that is too tight, is refused
    check(event, place, plan)


def test_a_crossing_takes_place_at_the_marking_where_there_is_one() -> None:
    event = shipped("vru_crossing")
    for s in (95.0, 110.0, 200.0, 330.0):
        place = block(crossings_s_m=(s,))
        plan = plan_of(event, place)
        assert isinstance(plan.trigger.act, Cross)
        assert plan.trigger.act.goal.s_m == s
        check(event, place, plan)
    # One that the VUT reaches before it drives at cruise speed is passed by.
    plan = plan_of(event, block(crossings_s_m=(40.0,)))
    assert isinstance(plan.trigger.act, Cross)
    assert plan.trigger.act.goal.s_m > 80.0


def test_of_several_markings_the_most_central_one_that_has_room_is_crossed() -> None:
    event = shipped("vru_crossing")
    for marks, crossed in (
        ((110.0, 330.0), 110.0),
        ((40.0, 150.0, 380.0), 150.0),
        ((210.0, 390.0), 210.0),
        ((30.0, 350.0), 350.0),
    ):
        plan = plan_of(event, block(crossings_s_m=marks))
        assert isinstance(plan.trigger.act, Cross)
        assert plan.trigger.act.goal.s_m == crossed


@pytest.mark.parametrize(
    "marks", [(102.0,), (98.5,), (106.3,), (99.0, 111.0), (102.0, 118.0, 134.0)]
)
@pytest.mark.parametrize("half_m", [2.0, 5.0])
def test_an_occluded_crossing_keeps_off_every_marking(
    marks: tuple[float, ...], half_m: float
) -> None:
    event = shipped("occluded_crossing")
    unmarked = plan_of(event, block())
    for whole in (True, False):
        zebras = tuple(Crossing(s, half_m, whole) for s in marks)
        place = replace(block(), crossings=zebras)
        plan = plan_of(event, place)
        check(event, place, plan)
        assert isinstance(plan.trigger.act, Cross)
        walker, occluder = plan.targets["ot1"].start.s_m, plan.targets["ot2"].start.s_m
        size = size_of(event, "ot2")
        for zebra in zebras:
            assert abs(walker - zebra.s_m) > max(4.0, zebra.half_m + 2.0)
            # Nobody parks on it either.
            apart = abs(occluder + (size.front_m - size.rear_m) / 2.0 - zebra.s_m)
            assert apart > zebra.half_m + (size.front_m + size.rear_m) / 2.0
        assert walker >= unmarked.targets["ot1"].start.s_m
    far = plan_of(event, block(crossings_s_m=(110.0,)))
    assert far.targets["ot1"].start == unmarked.targets["ot1"].start


def test_an_occluder_hides_whoever_crosses_until_the_trigger() -> None:
    event, place = shipped("occluded_crossing"), block()
    plan = plan_of(event, place)
    seen = foresight(event, place, plan)
    states = {state.object_id: state for state in seen.targets_fired}
    assert is_hidden(seen.vut_fired, states["ot1"], states["ot2"], 1.8)
    assert isinstance(plan.targets["ot2"], Wait)
    far = replace(states["ot2"], y_m=states["ot2"].y_m - 20.0)
    assert not is_hidden(seen.vut_fired, states["ot1"], far, 1.8)


REFUSED: dict[str, tuple[str, dict[str, Any], Block, str]] = {
    "one lane a direction": (
        "cut_in",
        {},
        replace(block(), lanes=block().lanes[1:3]),
        r"no driving lane to the left of the VUT's in its direction \(1 driving lane\(s\)",
    ),
    "lanes apart": (
        "cut_in",
        {},
        replace(
            block(),
            lanes=(BlockLane(0.0, 3.5, True, "a"), BlockLane(6.0, 3.5, True, "b")),
        ),
        r"lies 2\.5 m apart",
    ),
    "no middle lane": (
        "vru_crossing",
        {"topology.vut_lane.value": "middle"},
        block(),
        "none is the middle one",
    ),
    "too short": ("vru_crossing", {}, block(length_m=70.0), "long and 20 m are needed beyond"),
    "too short to close in": ("cut_in", {}, block(length_m=120.0), "too short|needs"),
    "too slow a place": (
        "cut_in",
        {"constraints.speeds.vut.approach": {"min": 14.5, "max": 15.0, "unit": "m/s"}},
        block(),
        r"must be within 14\.5 and 15 m/s; the place allows 0 to 13\.9 m/s",
    ),
    "unresolved": (
        "cut_in",
        {"constraints.speeds.vut.approach": "unresolved"},
        block(),
        r"speeds\.vut\.approach is unresolved; it needs an interval in m/s",
    ),
    "doesn't close in": (
        "cut_in",
        {"constraints.speeds.ot1.approach": {"min": 13.8, "max": 13.9, "unit": "m/s"}},
        block(),
        "doesn't close in on",
    ),
    "no conflict": (
        "vru_crossing",
        {
            "constraints.thresholds.ttc": {"min": 0.01, "max": 0.01, "unit": "s"},
            "constraints.thresholds.arrival_gap": None,
        },
        block(),
        "no conflict comes",
    ),
    "other order": (
        "vru_crossing",
        {"interaction.passing_order": ["vut", "ot1"]},
        block(),
        r"vut wouldn't reach the conflict point first: after the trigger ot1 takes \d\.\d s to",
    ),
    "time gap": (
        "cut_in",
        {"constraints.time_gap": {"min": 5.0, "max": 6.0, "unit": "s"}},
        block(),
        r"time gap at the conflict point would be 1\.\d+ s, K\* wants 5 to 6 s",
    ),
    "gap at the start": (
        "cut_in",
        {"participants.ot1.region.gap": {"min": 5.0, "max": 10.0, "unit": "m"}},
        block(),
        "closes before both are at cruise speed",
    ),
    "too long": (
        "vru_crossing",
        {"constraints.safety.duration": {"min": None, "max": 10.0, "unit": "s"}},
        block(),
        "limit is 10 s",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_does_not_fit_is_refused_with_reason_and_numbers(case: str) -> None:
    name, changes, place, reason = REFUSED[case]
    with pytest.raises(CannotPlace, match=reason):
        plan_of(changed(name, changes), place)
