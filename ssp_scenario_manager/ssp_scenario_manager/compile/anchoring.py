"""What a task says of a plan: its places in both frames, its trigger, and what was chosen."""

from __future__ import annotations

from ssp_core.names import VUT_ID
from ssp_core.world.reference_line import NotOneToOne
from ssp_scenario_manager.compile.task import Anchors, Place, TriggerRegion, Tuning
from ssp_scenario_manager.interactions.base import (
    BlockPoint,
    CannotPlace,
    Cross,
    Drive,
    Plan,
    ShiftLane,
    Wait,
)
from ssp_scenario_manager.interactions.choosing import quantity_at
from ssp_scenario_manager.spec.model import Event, Interval
from ssp_scenario_manager.topology.block import Block


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
    shift = act.shift_m if isinstance(act, ShiftLane) else 0.0
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
        interval = wanted if isinstance(wanted, Interval) else None
        found.append(
            Tuning(
                field=field,
                value=value,
                unit=unit,
                min=interval.min if interval is not None else None,
                max=interval.max if interval is not None else None,
                reason=why,
            )
        )
    return found
