"""Which of a place's surroundings may drive during an event without coming into its way."""

from __future__ import annotations

from collections.abc import Sequence

from ssp_core.run_file.participants import TrafficSpec
from ssp_scenario_manager.interactions.base import Cross, Drive, Plan
from ssp_scenario_manager.topology.block import Block, BlockLane

# Room to whoever starts in the same lane, and time around a crossing in it.
_ROOM_M = 25.0
_AROUND_S = 4.0
# Between a trigger's not_before and its firing (Plan: the half of the foreseen time).
_FIRES_SHARE = 2.0


def clear_traffic(
    wanted: Sequence[TrafficSpec], lanes: Sequence[BlockLane], block: Block, plan: Plan
) -> tuple[list[TrafficSpec], list[str]]:
    """The vehicles that keep clear of the event, and why the others were left out.

    They drive straight on at constant speed, as SUMO has them do.

    Args:
        wanted: surroundings of the block.
        lanes: lane of each of them.
        block: that the event is on.
        plan: the event.
    """
    kept, left_out = [], []
    for vehicle, lane in zip(wanted, lanes, strict=True):
        reason = _in_the_way(vehicle, lane, block, plan)
        if reason is None:
            kept.append(vehicle)
        else:
            left_out.append(f"{vehicle.id}: {reason}")
    return kept, left_out


def _in_the_way(vehicle: TrafficSpec, lane: BlockLane, block: Block, plan: Plan) -> str | None:
    act = plan.trigger.act
    if vehicle.id in {"vut", *plan.targets}:
        return "its id is a participant's"
    if isinstance(act, Cross):
        return _at_crossing(vehicle, lane, plan, act)
    if not lane.forward:
        return None
    for drive in (plan.vut, *plan.targets.values()):
        if not isinstance(drive, Drive) or abs(drive.start.l_m - lane.y_m) > lane.width_m / 2:
            continue
        ahead = vehicle.x_m - drive.start.s_m
        if ahead < 0.0 and ahead > -_ROOM_M - 20.0:
            return "it starts too close behind a participant"
        if ahead < 0.0 and vehicle.speed_mps > 0.0:
            return "it would catch up with a participant"
        if 0.0 <= ahead < _ROOM_M or (ahead >= 0.0 and vehicle.speed_mps < drive.cruise_mps):
            return "a participant would catch up with it"
    return None


def _at_crossing(vehicle: TrafficSpec, lane: BlockLane, plan: Plan, act: Cross) -> str | None:
    """Two who would be at the same place of the crossing at about the same time."""
    s = act.goal.s_m
    walker = plan.targets[plan.trigger.object_id].start
    speed = vehicle.speed_mps if lane.forward else -vehicle.speed_mps
    away = s - vehicle.x_m
    same_lane = abs(plan.vut.start.l_m - lane.y_m) <= lane.width_m / 2
    if same_lane and lane.forward:
        if away > -_ROOM_M or vehicle.speed_mps < plan.vut.cruise_mps:
            return "it drives in the VUT's lane up to the crossing or too slowly beyond it"
        return None
    if abs(vehicle.x_m - s) < 15.0 and vehicle.speed_mps == 0.0:
        return "it stands at the crossing"
    if speed == 0.0 or away / speed < 0.0:
        return None
    fires_s = _FIRES_SHARE * plan.trigger.not_before_s
    there_s = fires_s + abs(lane.y_m - walker.l_m) / act.speed_mps
    if abs(away / speed - there_s) < _AROUND_S:
        return f"it would pass the crossing with {plan.trigger.object_id} in its lane"
    return None
