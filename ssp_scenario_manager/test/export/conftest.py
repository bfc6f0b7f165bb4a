"""Tasks of the four events on blocks made here, as the compiler would write them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest

from ssp_core.geometry import Pose2
from ssp_core.run_file.model import EndCondition, Limits, RunSpec
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
from ssp_core.run_file.road import CurvePiece, Lane, Road
from ssp_core.run_file.values import Start
from ssp_core.world.reference_line import ReferenceLine
from ssp_scenario_manager.compile.area import strip_polygon
from ssp_scenario_manager.compile.task import (
    Anchors,
    BlockScore,
    EventLink,
    Place,
    PlaceLink,
    Target,
    Task,
    TaskBlock,
    TriggerRegion,
    sealed,
)
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block, BlockLane
from ssp_scenario_manager.scenarios.base import (
    Act,
    BlockPoint,
    BrakeTo,
    Cross,
    Drive,
    Plan,
    ShiftLane,
    Trigger,
    Wait,
)

EVENTS = ("cut_in", "vru_crossing", "lead_braking", "occluded_crossing")


@dataclass(frozen=True)
class Case:
    """What an exporter is given."""

    task: Task
    event: Event
    block: Block
    plan: Plan


def make_block(
    pieces: list[CurvePiece] | None = None,
    origin: Pose2 = Pose2(0.0, 0.0, 0.0),  # noqa: B008 -- frozen
    lanes: tuple[tuple[float, bool], ...] = ((0.0, True), (3.5, True), (7.0, False), (10.5, False)),
    width_m: float = 3.5,
    **fields: Any,
) -> Block:
    """A road of 400 m with sidewalks, straight along x unless told otherwise."""
    line = ReferenceLine(origin, pieces or [CurvePiece(length_m=400.0)])
    block = Block(
        block_id="main",
        line=line,
        lanes=tuple(
            BlockLane(y, width_m, forward, f"lane {i}") for i, (y, forward) in enumerate(lanes)
        ),
        road_type="urban",
        segment="straight" if line.is_straight else "curve",
        left_boundary="kerb",
        right_boundary="kerb",
        sidewalk_left_m=3.0,
        sidewalk_right_m=3.0,
        permitted=frozenset({"keep_lane", "lane_change_left", "lane_change_right", "crossing"}),
        crossing_s_m=110.0,
        speed_limit_mps=13.9,
    )
    return replace(block, **fields)


CURVED = [
    CurvePiece(length_m=120.0),
    CurvePiece(length_m=60.0, end_curvature_1pm=0.004),
    CurvePiece(length_m=160.0, start_curvature_1pm=0.004, end_curvature_1pm=0.004),
    CurvePiece(length_m=60.0, start_curvature_1pm=0.004),
]


def _plan(name: str, block: Block) -> Plan:
    lane = block.forward_lanes[0].y_m
    beside = block.forward_lanes[1].y_m if len(block.forward_lanes) > 1 else lane
    kerb, far = block.right_edge_m, block.left_edge_m
    targets: dict[str, Drive | Wait]
    act: Act
    if name == "cut_in":
        vut = Drive(BlockPoint(15.0, lane), 13.0, 385.0)
        targets = {"ot1": Drive(BlockPoint(52.0, beside), 8.5, 380.0)}
        act = ShiftLane(lane - beside, 2.4, 5.5, 2.0)
        trigger = Trigger("ot1", "relative_distance", 18.0, None, act, not_before_s=4.0)
        conflict = BlockPoint(140.0, lane)
    elif name == "lead_braking":
        vut = Drive(BlockPoint(15.0, lane), 12.0, 385.0)
        targets = {"ot1": Drive(BlockPoint(60.0, lane), 9.0, 380.0)}
        act = BrakeTo(2.0, 4.0)
        trigger = Trigger("ot1", "relative_distance", 20.0, None, act, not_before_s=4.0)
        conflict = BlockPoint(180.0, lane)
    else:
        vut = Drive(BlockPoint(15.0, lane), 10.0, 300.0)
        walker = BlockPoint(110.0, kerb - 0.8)
        targets = {"ot1": Wait(walker, math.pi / 2)}
        if name == "occluded_crossing":
            targets["ot2"] = Wait(BlockPoint(100.0, kerb - 1.5))
        act = Cross(BlockPoint(110.0, far + 1.0), 1.5, 1.5)
        trigger = Trigger(
            "ot1", "time_to_arrival", 3.2, BlockPoint(110.0, lane), act, not_before_s=2.0
        )
        conflict = BlockPoint(110.0, lane)
    zone = tuple(
        BlockPoint(conflict.s_m + s, lane + side)
        for s, side in ((0, -1.2), (5, -1.2), (5, 1.2), (0, 1.2))
    )
    return Plan(vut, targets, trigger, conflict, zone, BlockPoint(conflict.s_m - 25.0, lane), {})


def _start(line: ReferenceLine, place: BlockPoint, heading_rad: float = 0.0) -> Start:
    x, y = line.to_map(place.s_m, place.l_m)
    return Start(x_m=x, y_m=y, yaw_rad=line.pose(place.s_m).yaw_rad + heading_rad)


def _motion(line: ReferenceLine, drive: Drive) -> Motion:
    return Motion(
        path=line.path(drive.start.s_m, drive.end_s_m, drive.start.l_m),
        cruise_mps=drive.cruise_mps,
        acceleration_mps2=drive.acceleration_mps2,
        deceleration_mps2=drive.deceleration_mps2,
    )


def _trigger_spec(plan: Plan, line: ReferenceLine) -> TriggerSpec:
    trigger, act = plan.trigger, plan.trigger.act
    condition: RelativeDistance | TimeToArrival
    manoeuvre: LaneChange | FollowPath | Brake
    if trigger.anchor is None:
        condition = RelativeDistance(
            type="relative_distance", object_id=trigger.object_id, below_m=trigger.below
        )
    else:
        condition = TimeToArrival(
            type="time_to_arrival",
            anchor=line.to_map(trigger.anchor.s_m, trigger.anchor.l_m),
            below_s=trigger.below,
        )
    if isinstance(act, ShiftLane):
        manoeuvre = LaneChange(
            kind="lane_change",
            lateral_shift_m=act.shift_m,
            duration_s=act.duration_s,
            cruise_mps=act.cruise_mps,
            deceleration_mps2=act.deceleration_mps2,
        )
    elif isinstance(act, BrakeTo):
        manoeuvre = Brake(kind="brake", to_mps=act.to_mps, deceleration_mps2=act.deceleration_mps2)
    else:
        start = plan.targets[trigger.object_id].start
        manoeuvre = FollowPath(
            kind="follow_path",
            motion=Motion(
                path=[line.to_map(start.s_m, start.l_m), line.to_map(act.goal.s_m, act.goal.l_m)],
                cruise_mps=act.speed_mps,
                acceleration_mps2=act.acceleration_mps2,
                deceleration_mps2=act.acceleration_mps2,
            ),
        )
    return TriggerSpec(
        id="manoeuvre",
        condition=condition,
        not_before_s=trigger.not_before_s,
        object_id=trigger.object_id,
        manoeuvre=manoeuvre,
        lead_time_s=trigger.lead_time_s,
    )


def _participant(
    line: ReferenceLine, name: str, kind: str, motion: Drive | Wait
) -> ParticipantSpec:
    heading = motion.heading_rad if isinstance(motion, Wait) else 0.0
    return ParticipantSpec(
        id=name,
        object_class=kind,
        start=_start(line, motion.start, heading),
        approach=_motion(line, motion) if isinstance(motion, Drive) else None,
    )


def make_case(
    name: str,
    block: Block | None = None,
    target: Target = "openscenario",
    place: PlaceLink | None = None,
) -> Case:
    """One event on one block."""
    block = block or make_block()
    event, version = load_event(name)
    line = block.line
    plan = _plan(name, block)
    pose = line.pose(0.0)
    origin = Start(x_m=pose.x_m, y_m=pose.y_m, yaw_rad=pose.yaw_rad)
    lanes = [
        Lane(
            y_m=lane.y_m,
            width_m=lane.width_m,
            direction="forward" if lane.forward else "backward",
        )
        for lane in block.lanes
    ]
    fence = strip_polygon(line, 0.0, block.length_m, -8.0, 17.0)
    limits = Limits(speed_mps=16.0, acceleration_mps2=5.0)
    run = RunSpec(
        schema_="ssp.run/1",
        run_id="run",
        scenario=name,
        interaction=event.interaction.type,
        observable="braking" if name == "lead_braking" else "lateral",
        initiator="ot1",
        domain="simulation",
        stand_in=False,
        event_version=version,
        site="made_here",
        site_version="sha256:site",
        seed=7,
        mode="lockstep",
        road=Road(origin=origin, length_m=block.length_m, pieces=[*line.pieces], lanes=lanes),
        geofence=fence,
        vut=_participant(line, "vut", "car", plan.vut),
        # Behind a lead that brakes, the usual headway leaves no conflict.
        driver=Driver(
            cruise_mps=plan.vut.cruise_mps, headway_s=0.8 if name == "lead_braking" else 1.4
        ),
        targets=[
            _participant(line, who, event.participants[who].class_, motion)
            for who, motion in plan.targets.items()
        ],
        triggers=[_trigger_spec(plan, line)],
        limits=limits,
        end=EndCondition(at_latest_s=40.0),
    )

    def at(point: BlockPoint) -> Place:
        x, y = line.to_map(point.s_m, point.l_m)
        return Place(s_m=point.s_m, l_m=point.l_m, x_m=x, y_m=y)

    expected = at(plan.expected)
    task = Task(
        schema_="ssp.task/1",
        target=target,
        event=EventLink(name=name, version=version),
        compiler="ssp 0.1.0",
        seed=7,
        place=place or PlaceLink(kind="site", name="made_here", sha256="sha256:site"),
        block=TaskBlock(
            id=block.block_id,
            origin=origin,
            pieces=[*line.pieces],
            length_m=block.length_m,
            lanes=lanes,
        ),
        chosen_by="highest score",
        retrieval=[
            BlockScore(
                block="main", topology=1, interaction=1, constraints=1, total=1, eligible=True
            )
        ],
        anchors={
            "vut": Anchors(
                start=at(plan.vut.start),
                goal=at(BlockPoint(plan.vut.end_s_m, plan.vut.start.l_m)),
                conflict=at(plan.conflict),
            )
        },
        vut_route=run.vut.approach.path if run.vut.approach else [],
        trigger=TriggerRegion(
            quantity=plan.trigger.quantity,
            object_id=plan.trigger.object_id,
            below=plan.trigger.below,
            unit="m" if plan.trigger.anchor is None else "s",
            expected=expected,
        ),
        conflict_zone=[at(corner) for corner in plan.zone],
        limits=limits,
        geofence=fence,
        tunings=[],
        run=run,
    )
    return Case(sealed(task), event, block, plan)


@pytest.fixture(scope="session")
def block_of() -> Callable[..., Block]:
    """Makes blocks: ``block_of(pieces, origin, lanes, width_m, **fields)``."""
    return make_block


@pytest.fixture(scope="session")
def case_of() -> Callable[..., Case]:
    """Makes cases: ``case_of(name, block, target, place)``."""
    return make_case


@pytest.fixture(scope="session")
def curved_block() -> Block:
    """Straight, clothoid, arc, clothoid; turned and moved in the map."""
    return make_block(CURVED, Pose2(512.0, -240.0, math.radians(37.0)))
