"""The prediction of a session, held against formulas and against the pieces it is made of."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

from ssp_core.geometry import Pose2
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import ConflictThresholds
from ssp_core.run_file.participants import (
    Brake,
    Driver,
    FollowPath,
    LaneChange,
    Motion,
    ParticipantSpec,
    RelativeDistance,
    TimeToArrival,
    TriggerSpec,
)
from ssp_core.run_file.road import CurvePiece
from ssp_core.run_file.values import Start
from ssp_core.vocabulary import ObjectClass
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.scenarios.base import BlockPoint, CannotPlace, Cross, Drive, Trigger, Wait
from ssp_scenario_manager.scenarios.events.crossing import is_hidden
from ssp_scenario_manager.scenarios.motions import (
    CRUISE_SHARE,
    STEP_S,
    Motions,
    cruise_reached_s,
    driver_travel,
    motions,
    reference_travel,
)
from ssp_scenario_manager.scenarios.prediction import predict
from tests.support.states import object_state

THRESHOLDS = ConflictThresholds(ttc_s=3.0, arrival_gap_s=None)


def car(name: str, x_m: float, y_m: float, cruise_mps: float) -> ParticipantSpec:
    return ParticipantSpec(
        id=name,
        object_class="car",
        start=Start(x_m=x_m, y_m=y_m, yaw_rad=0.0),
        approach=Motion(path=[(x_m, y_m), (600.0, y_m)], cruise_mps=cruise_mps),
    )


def cutting_in(below_m: float = 18.0, **changes: float) -> Motions:
    manoeuvre = {"duration_s": 2.5, "cruise_mps": 5.5, "lateral_shift_m": -3.5, **changes}
    return Motions(
        vut=car("vut", 15.0, 0.0, 13.0),
        driver=Driver(cruise_mps=13.0),
        targets=(car("ot1", 58.0, 3.5, 8.5),),
        trigger=TriggerSpec(
            id="t",
            condition=RelativeDistance(type="relative_distance", object_id="ot1", below_m=below_m),
            not_before_s=4.0,
            object_id="ot1",
            manoeuvre=LaneChange(kind="lane_change", **manoeuvre),
        ),
        initiator_id="ot1",
    )


def crossing(speed_mps: float = 1.5, below_s: float = 3.2) -> Motions:
    return Motions(
        vut=car("vut", 15.0, 0.0, 10.0),
        driver=Driver(cruise_mps=10.0, comfortable_deceleration_mps2=3.0),
        targets=(
            ParticipantSpec(
                id="ot1",
                object_class="pedestrian",
                start=Start(x_m=110.0, y_m=-2.5, yaw_rad=math.pi / 2),
            ),
        ),
        trigger=TriggerSpec(
            id="t",
            condition=TimeToArrival(type="time_to_arrival", anchor=(110.0, 0.0), below_s=below_s),
            object_id="ot1",
            manoeuvre=FollowPath(
                kind="follow_path",
                motion=Motion(path=[(110.0, -2.5), (110.0, 13.0)], cruise_mps=speed_mps),
            ),
        ),
        initiator_id="ot1",
    )


def test_a_conflict_that_is_over_before_the_trigger_shows_is_none() -> None:
    """The walker picks up speed, and its predicted arrival passes the VUT's meanwhile."""
    seen = predict(crossing(0.4, 8.0), "lateral", ConflictThresholds(ttc_s=2.5, arrival_gap_s=1.5))
    assert seen.trigger_s is not None
    assert seen.conflict_s is not None
    # The session has it 6.8 s after its trigger, not with it.
    assert seen.conflict_s > seen.trigger_s + 2.0


def test_a_free_driver_follows_its_closed_form() -> None:
    """dx/dt = a (1 - x^4) / v0 has t = v0/2a (atanh x + atan x), s = v0^2/2a atanh x^2."""
    for cruise, rate in ((13.0, 2.0), (8.0, 1.2)):
        t = cruise_reached_s(cruise, rate)
        distance, speed = driver_travel(cruise, rate, t)
        x = CRUISE_SHARE
        assert speed == pytest.approx(x * cruise, rel=5e-3)
        assert distance == pytest.approx(cruise**2 / (2 * rate) * math.atanh(x * x), rel=2e-2)
        assert driver_travel(cruise, rate, 0.0) == (0.0, 0.0)


def test_an_approach_covers_what_its_reference_says() -> None:
    """v^2/2a while it gets there, then v t; it starts 0.5 s after the VUT, and 0.2 s softly."""
    assert reference_travel(8.0, 2.0, 10.7) == pytest.approx(16.0 + 8.0 * 6.0)


def test_a_cut_in_is_foreseen_phase_by_phase() -> None:
    seen = predict(cutting_in(), "lateral", THRESHOLDS)
    assert seen.trigger_s is not None
    assert seen.conflict_s is not None
    assert seen.resolution_s is not None
    # The gap at the firing is just under the threshold: front of the VUT to rear of the OT.
    vut, (other,) = seen.vut_fired, seen.targets_fired
    gap = other.x_m - 0.9 - vut.x_m - 3.6
    assert 18.0 - 13.0 * STEP_S < gap < 18.0
    assert seen.fired_s < seen.trigger_s < seen.conflict_s < seen.resolution_s
    # First overlap: with half of 1.8 m and 0.3 m around the VUT, 0.9 m of itself, turned a little.
    assert seen.trigger_s < seen.overlap_s < seen.fired_s + 0.1 + 2.5
    assert seen.initiator_first
    assert 0.2 < seen.time_gap_s < 6.0
    assert seen.vut_end_mps < seen.fired_speed_mps


def test_the_drivers_reaction_keeps_the_distance() -> None:
    hard = predict(cutting_in(cruise_mps=3.0), "lateral", THRESHOLDS)
    assert hard.separation_m > 0.5
    slow = replace(cutting_in(cruise_mps=3.0), driver=Driver(cruise_mps=13.0, headway_s=0.2))
    assert predict(slow, "lateral", THRESHOLDS).separation_m < hard.separation_m


def test_a_crossing_is_yielded_to() -> None:
    both = ConflictThresholds(ttc_s=2.5, arrival_gap_s=1.5)
    seen = predict(crossing(), "lateral", both)
    assert seen.initiator_first
    # From -2.25 m to the corridor's edge at -1.2 m.
    walked = seen.overlap_s - seen.fired_s
    assert 0.9 < walked < 2.0
    assert seen.left_s - seen.overlap_s == pytest.approx((2.4 + 0.5) / 1.5, abs=0.3)
    assert seen.vut_arrival_s > seen.left_s
    # Half of its width and 0.3 m before its middle.
    assert seen.conflict_station_m == pytest.approx(110.0 - 0.25 - 0.3 - 15.0, abs=0.01)


def test_who_comes_too_early_for_a_conflict_leaves_none() -> None:
    both = ConflictThresholds(ttc_s=2.5, arrival_gap_s=1.5)
    seen = predict(crossing(speed_mps=3.0, below_s=9.0), "lateral", both)
    assert seen.conflict_s is None
    assert seen.resolution_s is None


def test_braking_is_observable_by_its_deceleration() -> None:
    lead = replace(
        cutting_in(24.0),
        targets=(car("ot1", 65.0, 0.0, 10.0),),
        driver=Driver(cruise_mps=13.0, headway_s=0.8),
    )
    trigger = lead.trigger.model_copy(
        update={"manoeuvre": Brake(kind="brake", to_mps=2.0, deceleration_mps2=4.25)}
    )
    seen = predict(replace(lead, trigger=trigger), "braking", THRESHOLDS)
    assert seen.trigger_s is not None
    assert seen.conflict_s is not None
    assert seen.conflict_s > seen.trigger_s + 0.5
    # It is in the corridor all the while, so that the conflict point is its rear when it brakes.
    assert seen.overlap_s == pytest.approx(seen.fired_s, abs=2 * STEP_S)
    never = predict(replace(lead, trigger=trigger), "lateral", THRESHOLDS)
    assert never.trigger_s is None


def test_what_never_fires_or_can_not_be_driven_is_said() -> None:
    behind = replace(cutting_in(), vut=car("vut", 15.0, 0.0, 8.0))
    slower = replace(behind, driver=Driver(cruise_mps=8.0))
    with pytest.raises(CannotPlace, match="never fires"):
        predict(slower, "lateral", THRESHOLDS)
    plan = cutting_in()
    short = plan.targets[0].model_copy(
        update={"approach": Motion(path=[(58.0, 3.5), (110.0, 3.5)], cruise_mps=8.5)}
    )
    with pytest.raises(CannotPlace, match=r"ot1: .*(too short|stands)"):
        predict(replace(plan, targets=(short,)), "lateral", THRESHOLDS)
    still = plan.vut.model_copy(update={"approach": None})
    with pytest.raises(CannotPlace, match="has no path"):
        predict(replace(plan, vut=still), "lateral", THRESHOLDS)


def state(name: str, object_class: ObjectClass, x_m: float, y_m: float) -> ObjectState:
    return object_state(name, object_class, x_m, y_m)


def test_hidden_means_every_corner() -> None:
    vut = state("vut", ObjectClass.CAR, 0.0, 0.0)
    truck = state("truck", ObjectClass.TRUCK, 30.0, -3.2)  # 28 to 37 m, -4.45 to -1.95 m
    assert is_hidden(vut, state("p", ObjectClass.PEDESTRIAN, 38.5, -2.6), truck, 1.8)
    # Half a step further in, its shoulder shows.
    seen = state("p", ObjectClass.PEDESTRIAN, 38.5, -2.1)
    assert not is_hidden(vut, seen, truck, 1.8)
    nearer = state("p", ObjectClass.PEDESTRIAN, 25.0, -2.6)
    assert not is_hidden(vut, nearer, truck, 1.8)


def test_motions_follow_a_bend() -> None:
    line = ReferenceLine(
        Pose2(5.0, -3.0, 0.4),
        [
            CurvePiece(length_m=50.0),
            CurvePiece(length_m=150.0, start_curvature_1pm=0.005, end_curvature_1pm=0.005),
        ],
    )
    told = motions(
        line,
        {"ego": "car", "ot1": "pedestrian", "ot2": "truck"},
        "ego",
        Drive(BlockPoint(10.0, 0.0), 10.0, 190.0),
        {"ot1": Wait(BlockPoint(120.0, -2.5), math.pi / 2), "ot2": Wait(BlockPoint(100.0, -3.2))},
        Trigger(
            "ot1",
            "time_to_arrival",
            3.0,
            BlockPoint(120.0, 0.0),
            Cross(BlockPoint(120.0, 8.0), 1.5, 1.0),
        ),
    )
    assert told.vut.id == "vut"
    assert told.vut.approach is not None
    for x, y in told.vut.approach.path:
        assert line.to_local(x, y)[1] == pytest.approx(0.0, abs=1e-6)
    walker = told.target("ot1")
    across = line.pose(120.0).yaw_rad + math.pi / 2
    assert math.cos(walker.start.yaw_rad - across) == pytest.approx(1.0)
    assert told.target("ot2").start.yaw_rad == pytest.approx(line.pose(100.0).yaw_rad)
    assert isinstance(told.trigger.manoeuvre, FollowPath)
    (x0, y0), (x1, y1) = told.trigger.manoeuvre.motion.path
    assert line.to_local(x1, y1) == pytest.approx((120.0, 8.0), abs=1e-6)
    assert math.atan2(y1 - y0, x1 - x0) == pytest.approx(across)
    with pytest.raises(KeyError):
        told.target("ot3")
