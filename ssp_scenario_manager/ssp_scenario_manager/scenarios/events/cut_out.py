"""The vehicle ahead leaves the VUT's lane and reveals one that stands there (relation following).

The initiator is the vehicle that stands: the conflict is with it, so that phases, order and labels
can be measured from recorded states. The vehicle that leaves is the occluder, and the only one that
moves when the trigger fires.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial

from ssp_core.run_file.participants import LaneChange
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block, BlockLane
from ssp_scenario_manager.scenarios.base import (
    BlockPoint,
    CannotPlace,
    Drive,
    Kind,
    Plan,
    Setting,
    Trigger,
    Wait,
)
from ssp_scenario_manager.scenarios.block_places import (
    ahead_of,
    end_of,
    entry_m,
    neighbour,
    vut_lane_indices,
    within_block,
)
from ssp_scenario_manager.scenarios.events.crossing import hidden_at_the_trigger
from ssp_scenario_manager.scenarios.motions import cruise_reached_s
from ssp_scenario_manager.scenarios.planning import Draft, plans_in_lane
from ssp_scenario_manager.scenarios.values import (
    approach_acceleration,
    choose,
    choose_headway,
    size_of,
    vehicle_speed_limit,
)

_VUT_BRAKING_MPS2 = 4.0
_HEADWAYS_S = (0.5, 0.8)


def _leaves_to_left(event: Event, leader: str) -> bool:
    cell = event.motion.get(leader, {}).get("trigger")
    return cell is None or cell.lateral == "left"


def _manoeuvres(event: Event) -> frozenset[str]:
    leader = event.interaction.occluder
    left = leader is None or _leaves_to_left(event, leader)
    return frozenset({"keep_lane", "lane_change_left" if left else "lane_change_right"})


def _leader(event: Event) -> str:
    leader = event.interaction.occluder
    if leader is None:
        raise CannotPlace("interaction.occluder names no vehicle that leaves the lane")
    return leader


def _lanes(event: Event, block: Block, leader: str) -> tuple[BlockLane, BlockLane]:
    """Return the VUT's lane, and the one that the leader goes to."""
    index = vut_lane_indices(event, block)[0]
    return block.forward_lanes[index], neighbour(block, index, _leaves_to_left(event, leader))


def _draft(setting: Setting, values: Mapping[str, float]) -> Draft:
    event, block, limits = setting.event, setting.block, setting.limits
    name, leader = event.interaction.initiator, _leader(event)
    lane, beside = _lanes(event, block, leader)
    vut, other, leading = (size_of(event, who) for who in (event.vut_id, name, leader))
    v, u = values["vut_speed"], values["leader_speed"]
    if values["gap"] <= values["below"]:
        raise CannotPlace(
            f"the gap at the start, {values['gap']:g} m, is under the trigger's "
            f"{values['below']:g} m"
        )
    a, b = (approach_acceleration(event, who, limits) for who in (event.vut_id, leader))
    start = BlockPoint(entry_m(block), lane.y_m)

    def ahead(gap_m: float, rear_m: float, who: str) -> BlockPoint:
        s = ahead_of(block, start.s_m, vut.front_m + gap_m + rear_m, lane.y_m)
        size = other if who == name else leading
        return BlockPoint(round(within_block(block, size, s, who), 3), lane.y_m)

    return Draft(
        vut=Drive(start, v, end_of(block, vut), a, _VUT_BRAKING_MPS2, values["headway"]),
        targets={
            name: Wait(ahead(values["gap"], other.rear_m, name)),
            leader: Drive(
                ahead(values["leader_gap"], leading.rear_m, leader), u, end_of(block, leading), b
            ),
        },
        trigger=Trigger(
            object_id=name,
            quantity="relative_distance",
            below=values["below"],
            anchor=None,
            act=LaneChange(
                kind="lane_change",
                lateral_shift_m=beside.y_m - lane.y_m,
                duration_s=values["duration"],
                cruise_mps=u,
            ),
            not_before_s=round(0.5 * cruise_reached_s(v, a), 1),
            actor_id=leader,
        ),
        extra=partial(hidden_at_the_trigger, name, leader),
    )


def _plans(setting: Setting) -> Iterator[Plan]:
    event = setting.event
    name, leader, vut = event.interaction.initiator, _leader(event), event.vut_id
    pick = partial(choose, event, preferred=setting.preferred)
    fastest = vehicle_speed_limit(event, setting.limits, setting.block)
    c = "constraints"
    choices = {
        "headway": choose_headway(setting.preferred, _HEADWAYS_S),
        "gap": pick(f"participants.{name}.region.gap", "m"),
        "leader_gap": pick(f"participants.{leader}.region.gap", "m"),
        "vut_speed": pick(f"{c}.speeds.{vut}.approach", "m/s", at_most=fastest),
        "leader_speed": pick(f"{c}.speeds.{leader}.approach", "m/s", at_most=fastest),
        "below": pick(f"{c}.trigger.below", "m"),
        "duration": pick(f"{c}.manoeuvre.duration", "s"),
    }
    return plans_in_lane(
        setting, CUT_OUT.observable, choices, partial(_draft, setting), lambda *_: 0.0
    )


CUT_OUT = Kind(
    name="cut_out",
    relation="following",
    zone="vut_lane",
    observable="closing",
    dominant_motions=frozenset({"stationary"}),
    initiator_classes=frozenset({"car", "truck", "bus", "motorcycle"}),
    initiator_places={"stationary": frozenset({"vut_lane"})},
    first="initiator",
    manoeuvre={"duration": "s"},
    trigger_quantities=frozenset({"relative_distance"}),
    needs_occluder=True,
    occluder_leaves=True,
    uses_arrival_gap=False,
    same_direction_lanes=2,
    manoeuvres=_manoeuvres,
    plans=_plans,
)
