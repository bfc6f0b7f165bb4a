"""Tasks of the four events on blocks made here, as the compiler would write them."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest

from ssp_core.geometry import Pose2
from ssp_core.run_file.model import EndCondition, Limits, RunSpec
from ssp_core.run_file.participants import Brake, Driver, Hold, LaneChange
from ssp_core.run_file.road import CurvePiece, Road
from ssp_scenario_manager.compile.area import strip_polygon
from ssp_scenario_manager.compile.place import anchors, road_of, trigger_region
from ssp_scenario_manager.compile.place import place as on_block
from ssp_scenario_manager.compile.task import (
    BlockScore,
    EventLink,
    PlaceLink,
    Target,
    Task,
    TaskBlock,
    sealed,
)
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.crossings import Crossing
from ssp_scenario_manager.scenarios.base import (
    Act,
    BlockPoint,
    Cross,
    Drive,
    Plan,
    Trigger,
    Wait,
)
from ssp_scenario_manager.scenarios.events.kinds import KINDS
from ssp_scenario_manager.scenarios.motions import motions
from ssp_scenario_manager.scenarios.values import classes_of
from tests.support.events.blocks import block_of as made_block

# Where roads cross: test_maps_crossing_car.py.
EVENTS = tuple(sorted(name for name, kind in KINDS.items() if not kind.at_junction))
# The usual driver is so careful behind a lead that no conflict comes.
BEHIND_A_LEAD = {
    "lead_braking": {"headway_s": 0.8},
    "slow_lead": {"headway_s": 0.5, "comfortable_deceleration_mps2": 4.0},
    "cut_out": {"headway_s": 0.5, "comfortable_deceleration_mps2": 4.0},
}


@dataclass(frozen=True)
class Case:
    """The input of an exporter."""

    task: Task
    event: Event
    block: Block
    plan: Plan


def make_block(pieces: list[CurvePiece] | None = None, *given: Any, **changes: Any) -> Block:
    """A road with kerbs and a marked crossing."""
    usual = {"left_boundary": "kerb", "right_boundary": "kerb", "crossings": (Crossing(110.0),)}
    return made_block(pieces or [CurvePiece(length_m=400.0)], *given, **{**usual, **changes})


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
        act = LaneChange(
            kind="lane_change",
            lateral_shift_m=lane - beside,
            duration_s=2.4,
            cruise_mps=5.5,
            deceleration_mps2=2.0,
        )
        trigger = Trigger("ot1", "relative_distance", 18.0, None, act, not_before_s=4.0)
        conflict = BlockPoint(140.0, lane)
    elif name == "lead_braking":
        vut = Drive(BlockPoint(15.0, lane), 12.0, 385.0)
        targets = {"ot1": Drive(BlockPoint(60.0, lane), 9.0, 380.0)}
        act = Brake(kind="brake", to_mps=2.0, deceleration_mps2=4.0)
        trigger = Trigger("ot1", "relative_distance", 20.0, None, act, not_before_s=4.0)
        conflict = BlockPoint(180.0, lane)
    elif name == "slow_lead":
        vut = Drive(BlockPoint(15.0, lane), 11.0, 385.0)
        targets = {"ot1": Drive(BlockPoint(125.0, lane - 0.4), 3.5, 380.0)}
        trigger = Trigger(
            "ot1", "relative_distance", 42.0, None, Hold(kind="hold"), not_before_s=4.0
        )
        conflict = BlockPoint(180.0, lane)
    elif name == "cut_out":
        vut = Drive(BlockPoint(15.0, lane), 11.0, 385.0)
        targets = {
            "ot1": Wait(BlockPoint(160.0, lane)),
            "ot2": Drive(BlockPoint(43.5, lane), 9.5, 380.0),
        }
        act = LaneChange(
            kind="lane_change", lateral_shift_m=beside - lane, duration_s=2.5, cruise_mps=9.5
        )
        trigger = Trigger(
            "ot1", "relative_distance", 54.0, None, act, not_before_s=4.0, actor_id="ot2"
        )
        conflict = BlockPoint(160.0, lane)
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


def make_case(
    name: str,
    block: Block | None = None,
    target: Target = "openscenario",
    place: PlaceLink | None = None,
) -> Case:
    """One event on one block."""
    block = block or make_block()
    event, version = load_event(name)
    plan = _plan(name, block)
    told = motions(block.line, classes_of(event), "vut", plan.vut, plan.targets, plan.trigger)
    fence = strip_polygon(block.line, 0.0, block.length_m, -8.0, 17.0)
    limits = Limits(speed_mps=16.0, acceleration_mps2=5.0)
    road = road_of(block).model_copy(update={"pieces": [*block.line.pieces]})
    triggers = [told.trigger.model_copy(update={"id": "manoeuvre"})]
    if told.trigger.object_id != "ot1":
        begins = {"id": "begins", "object_id": "ot1", "manoeuvre": Hold(kind="hold")}
        triggers.insert(0, told.trigger.model_copy(update=begins))
    run = RunSpec(
        schema_="ssp.run/1",
        run_id="run",
        scenario=name,
        interaction=event.interaction.type,
        observable=KINDS[event.interaction.type].observable,
        initiator="ot1",
        domain="simulation",
        stand_in=False,
        event_version=version,
        site="made_here",
        site_version="sha256:site",
        seed=7,
        mode="lockstep",
        road=Road(origin=road.origin, length_m=road.length_m, pieces=road.pieces, lanes=road.lanes),
        geofence=fence,
        vut=told.vut,
        driver=Driver(cruise_mps=plan.vut.cruise_mps, **BEHIND_A_LEAD.get(name, {})),
        targets=[told.target(who) for who in plan.targets],
        triggers=triggers,
        limits=limits,
        end=EndCondition(at_latest_s=40.0),
    )
    task = Task(
        schema_="ssp.task/1",
        target=target,
        event=EventLink(name=name, version=version),
        compiler="ssp 0.1.0",
        seed=7,
        place=place or PlaceLink(kind="site", name="made_here", sha256="sha256:site"),
        block=TaskBlock(
            id=block.block_id,
            origin=road.origin,
            pieces=road.pieces,
            length_m=block.length_m,
            lanes=road.lanes,
        ),
        chosen_by="highest score",
        retrieval=[
            BlockScore(
                block="main", topology=1, interaction=1, constraints=1, total=1, eligible=True
            )
        ],
        anchors={"vut": anchors(block, plan)["vut"]},
        vut_route=run.vut.approach.path if run.vut.approach else [],
        trigger=trigger_region(block, plan),
        conflict_zone=[on_block(block, corner) for corner in plan.zone],
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
