"""A plan on a block as the run of a session, every place in frame map (METHOD 2.4)."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice

import ssp_core
from ssp_core.motion.state import Size
from ssp_core.names import VUT_ID
from ssp_core.run_file.model import EndCondition, Limits, LinkDisturbance, RunSpec
from ssp_core.run_file.participants import FollowPath, Hold, LaneChange, TrafficSpec, TriggerSpec
from ssp_core.run_file.road import JunctionRoad, Lane, PartialCrossing, Road
from ssp_core.run_file.values import Point, Start
from ssp_core.world.reference_line import NotOneToOne
from ssp_scenario_manager.compile.area import (
    OperatingArea,
    check_in_fence,
    check_reachable,
    check_safe_stop,
    clear_traffic,
)
from ssp_scenario_manager.compile.task import (
    Anchors,
    EventLink,
    Place,
    Target,
    Task,
    TaskBlock,
    TriggerRegion,
    Tuning,
)
from ssp_scenario_manager.event_spec.fields import Span
from ssp_scenario_manager.event_spec.model import Event, Interval
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.run.feasibility import why_not
from ssp_scenario_manager.scenarios.base import (
    BlockPoint,
    CannotPlace,
    Cross,
    Drive,
    Kind,
    Plan,
    Setting,
    Wait,
)
from ssp_scenario_manager.scenarios.events.kinds import KINDS
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
    """Return a place of the block in both frames.

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
    anchors_by_id = {
        VUT_ID: Anchors(
            start=place(block, plan.vut.start),
            goal=place(block, BlockPoint(plan.vut.end_s_m, plan.vut.start.l_m)),
            conflict=conflict,
        )
    }
    for name, motion in plan.targets.items():
        goal = _goal(name, motion, plan)
        anchors_by_id[name] = Anchors(
            start=place(block, motion.start), goal=place(block, goal), conflict=conflict
        )
    return anchors_by_id


def _goal(name: str, motion: Drive | Wait, plan: Plan) -> BlockPoint:
    act = plan.trigger.act if plan.trigger.acting_id == name else None
    if isinstance(act, Cross):
        return act.goal
    if isinstance(motion, Wait):
        return motion.start
    shift = act.lateral_shift_m if isinstance(act, LaneChange) else 0.0
    return BlockPoint(motion.end_s_m, motion.start.l_m + shift)


def trigger_region(block: Block, plan: Plan) -> TriggerRegion:
    """Give the region and the quantity at which the trigger is expected to fire."""
    trigger = plan.trigger
    return TriggerRegion(
        quantity=trigger.quantity,
        object_id=trigger.object_id,
        below=trigger.below,
        unit="m" if trigger.quantity == "relative_distance" else "s",
        expected=place(block, plan.expected),
    )


def tunings(event: Event, plan: Plan) -> list[Tuning]:
    """Return the values that were chosen within part C, with what it allows."""
    entries = []
    for field, (value, unit, why) in sorted(plan.choices.items()):
        quantity = quantity_at(event, field)
        span = quantity.si if isinstance(quantity, Interval) else Span()
        at_most = plan.at_most.get(field, math.inf)
        entries.append(
            Tuning(
                field=field,
                value=value,
                unit=unit,
                min=finite(span.low),
                max=finite(span.high),
                at_most=at_most if at_most < span.high else None,
                reason=why,
            )
        )
    return entries


# Plans that are run before a block is given up.
MOST_RUN = 4
COMPILER = f"ssp compile {ssp_core.__version__}"
# A crossing is at a marking that lies within this of it.
_AT_MARKING_M = 1.0


@dataclass(frozen=True)
class Order:
    """An event that is to be placed.

    Args:
        event: K*.
        version: of the event.
        area: site or map.
        target: what is compiled for; only a track session is physical.
        seed: of the run.
        preferred: values to try first, by field path.
    """

    event: Event
    version: str
    area: OperatingArea
    target: Target
    seed: int
    preferred: Mapping[str, float]

    @property
    def kind(self) -> Kind:
        return KINDS[self.event.interaction.type]

    @property
    def limits(self) -> Limits:
        return self.area.limits(self.event)


@dataclass(frozen=True)
class Realisation:
    """An event on a block of a place.

    Args:
        block: the block.
        plan: the event in its frame.
        task: of it, but for how the block was chosen; not sealed.
        left_out: surroundings that would come into the event's way, with reasons.
    """

    block: Block
    plan: Plan
    task: Task
    left_out: tuple[str, ...]


def realise(order: Order, block: Block) -> Realisation:
    """Place an event on a block.

    Raises:
        CannotPlace: it doesn't fit, or leaves what the place allows; the message says where and by
            how much.
    """
    setting = Setting(
        order.event, block, order.limits, order.preferred, order.area.routes_with(block)
    )
    plans = order.kind.plans(setting)
    first: CannotPlace | None = None
    for plan in islice(plans, MOST_RUN):
        try:
            return _realised(order, block, plan)
        except CannotPlace as error:
            first = first or error
    raise first or CannotPlace("it has no plan")


def _realised(order: Order, block: Block, plan: Plan) -> Realisation:
    """Make a plan a task that holds what the place demands, and whose event would happen.

    Raises:
        CannotPlace: it doesn't.
    """
    event, area = order.event, order.area
    run_motions = motions(
        block.line, classes_of(event), event.vut_id, plan.vut, plan.targets, plan.trigger
    )
    traffic, left_out = _traffic(block, area, plan)
    run = _run(order, block, plan, run_motions).model_copy(update={"traffic": traffic})
    reachable, zones = area.regions("ot_reachable"), area.regions("safe_stop_zones")
    check_in_fence(run, block, plan)
    if area.site is not None and area.site.domain == "physical":
        check_reachable(run, block, plan, reachable)
    if area.site is not None:
        check_safe_stop(block, plan, zones)
    problems = cannot_fire(run) or why_not(run)
    if problems:
        raise CannotPlace("; ".join(problems))
    task = Task(
        target=order.target,
        event=EventLink(name=event.name, version=order.version),
        compiler=COMPILER,
        seed=order.seed,
        place=area.link,
        block=TaskBlock(
            id=block.block_id,
            origin=run.road.origin,
            pieces=list(block.line.pieces),
            length_m=block.length_m,
            lanes=run.road.lanes,
        ),
        chosen_by="",
        retrieval=[],
        anchors=anchors(block, plan),
        vut_route=run.vut.approach.path if run.vut.approach is not None else [],
        trigger=trigger_region(block, plan),
        conflict_zone=[place(block, corner) for corner in plan.zone],
        limits=run.limits,
        geofence=run.geofence,
        ot_reachable=reachable,
        safe_stop_zones=zones,
        tunings=tunings(event, plan),
        run=run,
    )
    return Realisation(block, plan, task, tuple(left_out))


def road_of(
    block: Block, event_at_m: float | None = None, junction: Sequence[JunctionRoad] = ()
) -> Road:
    """Return the block as the road of a run, with all its marked crossings.

    Args:
        block: in frame map.
        event_at_m: arc length of the crossing that the event takes place on; None: on none.
        junction: roads of the junction that it leads through.
    """
    origin = block.line.pose(0.0)
    marked = sorted(block.crossings_s_m, key=lambda s: s != event_at_m)
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
        crossing_x_m=marked[0] if marked else None,
        further_crossings_x_m=sorted(marked[1:]),
        partial_crossings=[
            PartialCrossing(x_m=x_m, right_m=right_m, left_m=left_m)
            for x_m, right_m, left_m in block.zebras_m
            if x_m not in marked
        ],
        speed_limit_mps=block.speed_limit_mps or Road.model_fields["speed_limit_mps"].default,
        scenery=list(block.scenery),
        junction=list(junction),
    )


def _run(order: Order, block: Block, plan: Plan, run_motions: Motions) -> RunSpec:
    """Return the run of a session, without surroundings."""
    event, area, limits = order.event, order.area, order.limits
    physical = order.target == "track" and area.site is not None
    tracked = area.site is not None and area.site.domain == "physical"
    return RunSpec(
        schema_="ssp.run/1",
        run_id=event.name,
        scenario=event.name,
        interaction=event.interaction.type,
        observable=order.kind.observable,
        initiator=event.interaction.initiator,
        domain=area.site.domain if physical and area.site is not None else "simulation",
        stand_in=physical and area.site is not None and area.site.stand_in,
        event_version=order.version,
        compiler=COMPILER,
        site=area.name,
        site_version=area.link.sha256,
        seed=order.seed,
        mode="lockstep",
        road=road_of(block, _marked_crossing(block, plan), area.junction_roads(block)),
        geofence=area.geofence(block, _ways_of_act(run_motions) if block.passage else []),
        vut=run_motions.vut,
        driver=run_motions.driver,
        targets=list(run_motions.targets),
        triggers=_triggers(event, block, plan, run_motions, limits),
        thresholds=thresholds_of(event),
        passing=wanted_passing(event),
        end=EndCondition(after_resolution_s=order.kind.after_resolution_s),
        limits=limits,
        # A simulation of a track is one without what its stand-in session brings.
        disturbance=area.disturbance if physical or not tracked else LinkDisturbance(),
        camera=area.camera(event),
        look=area.look,
        datum=None if area.site is None else area.site.datum,
    )


def _triggers(
    event: Event, block: Block, plan: Plan, run_motions: Motions, limits: Limits
) -> list[TriggerSpec]:
    """Return the initiator's trigger and, where another object acts, that one's too."""
    trigger, initiator = _trigger(event, block, plan, run_motions, limits), plan.trigger.object_id
    if trigger.object_id == initiator:
        return [trigger]
    begins = {"id": f"{initiator}_begins", "object_id": initiator, "manoeuvre": Hold(kind="hold")}
    return [trigger.model_copy(update=begins), trigger]


def _ways_of_act(run_motions: Motions) -> list[tuple[list[Point], Size]]:
    """Return the way that the initiator's act leads over; none of an act on its present path."""
    act = run_motions.trigger.manoeuvre
    sizes = {target.id: target.size for target in run_motions.targets}
    if not isinstance(act, FollowPath):
        return []
    return [(list(act.motion.path), sizes[run_motions.trigger.object_id])]


def _trigger(
    event: Event, block: Block, plan: Plan, run_motions: Motions, limits: Limits
) -> TriggerSpec:
    """Return the plan's trigger, with the time gap that is to be kept after it."""
    anchor = None
    if isinstance(plan.trigger.act, Cross):
        # Who crosses does so at one place; another meets the VUT where the trigger fires.
        conflict = place(block, plan.conflict)
        anchor = (conflict.x_m, conflict.y_m)
    adaptation = adaptation_of(
        run_motions,
        plan.gap_s,
        initiator_first=initiator_first(event),
        anchor=anchor,
        most_mps2=limits.acceleration_mps2,
    )
    return run_motions.trigger.model_copy(update={"adaptation": adaptation})


def _marked_crossing(block: Block, plan: Plan) -> float | None:
    """Return the arc length of the zebra crossing of the event, None where it is on none."""
    act = plan.trigger.act
    if not isinstance(act, Cross):
        return None
    at = act.goal.s_m
    return next((s for s in block.crossings_s_m if abs(at - s) <= _AT_MARKING_M), None)


def _traffic(block: Block, area: OperatingArea, plan: Plan) -> tuple[list[TrafficSpec], list[str]]:
    """Return a site's surroundings in the block's lanes, and why some of them are left out."""
    if block.passage is not None and area.site is not None:
        along = {*block.entrances, *block.passage.via, *block.exits}
        passed = [one for one in area.site.blocks if one.id in along]
        why = "and surroundings don't follow a route over a junction"
        return [], [f"{v.id}: it drives on {one.id}, {why}" for one in passed for v in one.traffic]
    site_block, lanes, moved = area.site_block(block), [], []
    if site_block is None:
        return [], []
    for vehicle in site_block.traffic:
        y_m = site_block.lanes[vehicle.lane].y_m
        index = min(range(len(block.lanes)), key=lambda i: abs(block.lanes[i].y_m - y_m))
        lanes.append(block.lanes[index])
        moved.append(vehicle.model_copy(update={"lane": index}))
    return clear_traffic(moved, lanes, plan)
