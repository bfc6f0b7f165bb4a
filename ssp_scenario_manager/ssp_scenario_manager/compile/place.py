"""A plan on a block as the run of a session, every place in frame map (METHOD 2.4)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice

import ssp_core
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import Limits, LinkDisturbance, RunSpec
from ssp_core.run_file.participants import LaneChange, TrafficSpec, TriggerSpec
from ssp_core.run_file.road import Lane, Road
from ssp_core.run_file.values import Point, Start
from ssp_core.world.reference_line import NotOneToOne
from ssp_scenario_manager.compile.area import (
    OperatingArea,
    check_fence,
    check_reachable,
    check_safe_stop,
    clear_traffic,
)
from ssp_scenario_manager.compile.task import (
    Anchors,
    Place,
    Target,
    TaskBlock,
    TriggerRegion,
    Tuning,
)
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.event_spec.units import Span
from ssp_scenario_manager.maps.block import Block, BlockLane
from ssp_scenario_manager.run.in_process import why_not
from ssp_scenario_manager.scenarios.base import (
    BlockPoint,
    CannotPlace,
    Cross,
    Drive,
    Kind,
    PlaceLimits,
    Plan,
    Wait,
)
from ssp_scenario_manager.scenarios.kinds import KINDS
from ssp_scenario_manager.scenarios.motions import Motions, motions
from ssp_scenario_manager.scenarios.planning import adaptation_of
from ssp_scenario_manager.scenarios.values import (
    classes_of,
    finite,
    initiator_first,
    quantity_at,
    thresholds_of,
    wanted_passing,
)
from ssp_scenario_manager.triggers.fireability import cannot_fire


def place(block: Block, point: BlockPoint) -> Place:
    """A place of the block in both frames.

    Raises:
        CannotPlace: the block's frame has no such place.
    """
    try:
        x, y = block.line.to_map(point.s_m, point.l_m)
    except NotOneToOne as error:
        raise CannotPlace(f"the block is too tightly curved: {error}") from error
    return Place(s_m=point.s_m, l_m=point.l_m, x_m=x, y_m=y)


def anchors(block: Block, plan: Plan) -> dict[str, Anchors]:
    """Start, goal and conflict point of every participant, by its id in the run."""
    conflict = place(block, plan.conflict)
    found = {
        VUT_ID: Anchors(
            start=place(block, plan.vut.start),
            goal=place(block, BlockPoint(plan.vut.end_s_m, plan.vut.start.l_m)),
            conflict=conflict,
        )
    }
    for name, motion in plan.targets.items():
        goal = _goal(name, motion, plan)
        found[name] = Anchors(
            start=place(block, motion.start), goal=place(block, goal), conflict=conflict
        )
    return found


def _goal(name: str, motion: Drive | Wait, plan: Plan) -> BlockPoint:
    act = plan.trigger.act if plan.trigger.object_id == name else None
    if isinstance(act, Cross):
        return act.goal
    if isinstance(motion, Wait):
        return motion.start
    shift = act.lateral_shift_m if isinstance(act, LaneChange) else 0.0
    return BlockPoint(motion.end_s_m, motion.start.l_m + shift)


def trigger_region(block: Block, plan: Plan) -> TriggerRegion:
    """Where and by which quantity the trigger is expected to fire."""
    trigger = plan.trigger
    return TriggerRegion(
        quantity=trigger.quantity,
        object_id=trigger.object_id,
        below=trigger.below,
        unit="m" if trigger.quantity == "relative_distance" else "s",
        expected=place(block, plan.expected),
    )


def tunings(event: Event, plan: Plan) -> list[Tuning]:
    """The values that were chosen within part C, with what it allows."""
    found = []
    for field, (value, unit, why) in sorted(plan.chosen.items()):
        wanted = quantity_at(event, field)
        span = wanted.si if isinstance(wanted, Interval) else Span()
        low, high = finite(span.low), finite(span.high)
        found.append(Tuning(field=field, value=value, unit=unit, min=low, max=high, reason=why))
    return found


# Plans that are run before a block is given up.
MOST_RUN = 4
COMPILER = f"ssp compile {ssp_core.__version__}"
# A crossing is at a marking that lies within this of it.
_AT_MARKING_M = 1.0


@dataclass(frozen=True)
class Realisation:
    """An event on a block of a place.

    Args:
        run: what a session runs; its id, seed and mode are set by whoever runs it.
        vut_route: frame map.
        ot_reachable: polygons, empty where the place has none.
        safe_stop_zones: polygons, as ot_reachable.
        tunings: values that were chosen within part C.
        left_out: surroundings that would come into the event's way, with reasons.
    """

    block: Block
    plan: Plan
    run: RunSpec
    anchors: dict[str, Anchors]
    vut_route: list[Point]
    trigger: TriggerRegion
    conflict_zone: list[Place]
    ot_reachable: list[list[Point]]
    safe_stop_zones: list[list[Point]]
    tunings: list[Tuning]
    left_out: tuple[str, ...]

    @property
    def task_block(self) -> TaskBlock:
        """The block as a task holds it."""
        road = self.run.road
        return TaskBlock(
            id=self.block.block_id,
            origin=road.origin,
            pieces=list(self.block.line.pieces),
            length_m=self.block.length_m,
            lanes=road.lanes,
        )


def realise(
    event: Event,
    event_version: str,
    block: Block,
    area: OperatingArea,
    target: Target,
    *,
    seed: int,
    preferred: Mapping[str, float],
) -> Realisation:
    """Places an event on a block.

    Args:
        target: what is compiled for; only a track session is physical.
        preferred: values to try first, by field path.

    Raises:
        CannotPlace: it doesn't fit, or leaves what the place allows; the message says where and by
            how much.
    """
    kind = KINDS[event.interaction.type]
    limits = area.limits(event)
    plans = kind.plans(
        event,
        block,
        PlaceLimits(
            speed_mps=limits.speed_mps,
            acceleration_mps2=limits.acceleration_mps2,
            separation_m=limits.separation_m,
            speed_limit_mps=block.speed_limit_mps or limits.speed_mps,
        ),
        preferred,
    )
    first: CannotPlace | None = None
    for plan in islice(plans, MOST_RUN):
        try:
            return _realised(event, event_version, kind, block, area, target, plan, limits, seed)
        except CannotPlace as error:
            first = first or error
    raise first or CannotPlace("it has no plan")


def _realised(
    event: Event,
    event_version: str,
    kind: Kind,
    block: Block,
    area: OperatingArea,
    target: Target,
    plan: Plan,
    limits: Limits,
    seed: int,
) -> Realisation:
    """One plan as a run that holds what the place demands, and whose event would happen.

    Raises:
        CannotPlace: it doesn't.
    """
    told = motions(
        block.line, classes_of(event), event.vut_id, plan.vut, plan.targets, plan.trigger
    )
    run, left_out = _run(event, event_version, kind, block, area, target, plan, told, limits)
    run = run.model_copy(update={"seed": seed})
    reachable, zones = area.ot_reachable(), area.safe_stop_zones()
    check_fence(run, block, plan)
    if area.site is not None and area.site.domain == "physical":
        check_reachable(run, block, plan, reachable)
    if area.site is not None:
        check_safe_stop(block, plan, zones)
    problems = cannot_fire(run) or why_not(run)
    if problems:
        raise CannotPlace("; ".join(problems))
    return Realisation(
        block=block,
        plan=plan,
        run=run,
        anchors=anchors(block, plan),
        vut_route=run.vut.approach.path if run.vut.approach is not None else [],
        trigger=trigger_region(block, plan),
        conflict_zone=[place(block, corner) for corner in plan.zone],
        ot_reachable=reachable,
        safe_stop_zones=zones,
        tunings=tunings(event, plan),
        left_out=tuple(left_out),
    )


def road_of(block: Block, crossing_s_m: float | None = None) -> Road:
    """The block as the road of a run."""
    origin = block.line.pose(0.0)
    return Road(
        origin=Start(x_m=origin.x_m, y_m=origin.y_m, yaw_rad=origin.yaw_rad),
        length_m=block.length_m,
        pieces=[] if block.line.is_straight else list(block.line.pieces),
        lanes=[
            Lane(
                y_m=lane.y_m,
                width_m=lane.width_m,
                direction="forward" if lane.forward else "backward",
            )
            for lane in block.lanes
        ],
        sidewalk_left_m=block.sidewalk_left_m,
        sidewalk_right_m=block.sidewalk_right_m,
        crossing_x_m=crossing_s_m,
        speed_limit_mps=block.speed_limit_mps or Road.model_fields["speed_limit_mps"].default,
        scenery=list(block.scenery),
    )


def _run(
    event: Event,
    event_version: str,
    kind: Kind,
    block: Block,
    area: OperatingArea,
    target: Target,
    plan: Plan,
    told: Motions,
    limits: Limits,
) -> tuple[RunSpec, list[str]]:
    physical = target == "track" and area.site is not None
    tracked = area.site is not None and area.site.domain == "physical"
    marked = _marked_crossing(event, block, plan)
    traffic, left_out = _traffic(block, area, plan)
    run = RunSpec(
        schema_="ssp.run/1",
        run_id=event.name,
        scenario=event.name,
        interaction=event.interaction.type,
        observable=kind.observable,
        initiator=event.interaction.initiator,
        domain=area.site.domain if physical and area.site is not None else "simulation",
        stand_in=physical and area.site is not None and area.site.stand_in,
        event_version=event_version,
        compiler=COMPILER,
        site=area.name,
        site_version=area.link.sha256,
        seed=0,
        mode="lockstep",
        road=road_of(block, marked),
        geofence=area.geofence(block),
        vut=told.vut,
        driver=told.driver,
        targets=list(told.targets),
        triggers=[_trigger(event, block, plan, told, limits)],
        thresholds=thresholds_of(event),
        passing=wanted_passing(event),
        limits=limits,
        # A simulation of a track is one without what its stand-in session brings.
        disturbance=area.disturbance if physical or not tracked else LinkDisturbance(),
        traffic=traffic,
        camera=area.camera(event),
        look=area.look,
    )
    return run, left_out


def _trigger(event: Event, block: Block, plan: Plan, told: Motions, limits: Limits) -> TriggerSpec:
    """The plan's trigger, with the time gap that is to be kept after it."""
    anchor = None
    if isinstance(plan.trigger.act, Cross):
        # Who crosses does so at one place; another meets the VUT where the trigger fires.
        conflict = place(block, plan.conflict)
        anchor = (conflict.x_m, conflict.y_m)
    adaptation = adaptation_of(
        told,
        plan.gap_s,
        initiator_first=initiator_first(event),
        anchor=anchor,
        most_mps2=limits.acceleration_mps2,
    )
    return told.trigger.model_copy(update={"adaptation": adaptation})


def _marked_crossing(event: Event, block: Block, plan: Plan) -> float | None:
    """The zebra crossing, where the event takes place on it."""
    act = plan.trigger.act
    if block.crossing_s_m is None or not isinstance(act, Cross):
        return None
    at_it = abs(act.goal.s_m - block.crossing_s_m) <= _AT_MARKING_M
    return block.crossing_s_m if at_it and event.interaction.occluder is None else None


def _traffic(block: Block, area: OperatingArea, plan: Plan) -> tuple[list[TrafficSpec], list[str]]:
    wanted, lanes, moved = area.traffic(block), [], []
    site_block = next(
        (b for b in area.site.blocks if b.id == block.block_id) if area.site else iter(()),
        None,
    )
    for vehicle in wanted:
        if site_block is None or vehicle.lane >= len(site_block.lanes):
            raise CannotPlace(f"{vehicle.id} drives in lane {vehicle.lane}, which isn't there")
        index, lane = _lane_at(block, site_block.lanes[vehicle.lane].y_m)
        lanes.append(lane)
        moved.append(vehicle.model_copy(update={"lane": index}))
    return clear_traffic(moved, lanes, block, plan)


def _lane_at(block: Block, y_m: float) -> tuple[int, BlockLane]:
    index = min(range(len(block.lanes)), key=lambda i: abs(block.lanes[i].y_m - y_m))
    return index, block.lanes[index]
