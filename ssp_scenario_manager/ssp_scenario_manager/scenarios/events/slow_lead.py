"""Somebody stands or moves slowly ahead in the VUT's lane and does nothing (relation following)."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import partial

from ssp_core.motion.encounter import corridor_half_m
from ssp_core.motion.state import Size
from ssp_core.run_file.participants import Hold
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import BlockLane
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
    vut_lane_indices,
    within_block,
)
from ssp_scenario_manager.scenarios.motions import cruise_reached_s
from ssp_scenario_manager.scenarios.planning import Draft, plans_in_lane
from ssp_scenario_manager.scenarios.values import (
    approach_acceleration,
    choose,
    choose_headway,
    fixed,
    size_of,
    vehicle_speed_limit,
)

# A driver who brakes gently, or keeps more distance, does so early, and no conflict comes. At the
# shortest headway the VUT loses less than 0.5 m/s in a second before the conflict, and its past
# doesn't show what it is going to do.
_VUT_BRAKING_MPS2 = 4.0
_HEADWAYS_S = (0.2, 0.5, 0.8)
# An object ahead reaches at least so far into the VUT's corridor, however it sways.
_OVERLAP_M = 0.3


def _manoeuvres(_event: Event) -> frozenset[str]:
    return frozenset({"keep_lane"})


def stands(event: Event) -> bool:
    """Tell whether the object ahead stands in K*."""
    return event.interaction.dominant_motion == "stationary"


def _check_offset(name: str, offset_m: float, lane: BlockLane, vut: Size, other: Size) -> None:
    """Refuse an offset beside the lane or the VUT's corridor.

    Raises:
        CannotPlace: the object would be there.
    """
    most = (lane.width_m - other.width_m) / 2.0
    if abs(offset_m) > most:
        raise CannotPlace(
            f"{name} {abs(offset_m):.2f} m beside the middle of its lane of {lane.width_m:.2f} m "
            f"would leave it, at most {most:.2f} m fits"
        )
    most = corridor_half_m(vut.width_m) + other.width_m / 2.0 - _OVERLAP_M
    if abs(offset_m) > most:
        raise CannotPlace(
            f"{name} {abs(offset_m):.2f} m beside the middle of the VUT's lane would leave the "
            f"VUT's way free, at most {most:.2f} m doesn't"
        )


def _draft(setting: Setting, values: Mapping[str, float]) -> Draft:
    event, block, limits = setting.event, setting.block, setting.limits
    name = event.interaction.initiator
    lane = block.forward_lanes[vut_lane_indices(event, block)[0]]
    vut, other = size_of(event, event.vut_id), size_of(event, name)
    v, u = values["vut_speed"], values["speed"]
    if u >= v:
        raise CannotPlace(f"at {u:g} m/s {name} isn't slower than the VUT at {v:g} m/s")
    if values["gap"] <= values["below"]:
        raise CannotPlace(
            f"the gap at the start, {values['gap']:g} m, is under the trigger's "
            f"{values['below']:g} m"
        )
    _check_offset(name, values["offset"], lane, vut, other)
    a, b = (approach_acceleration(event, who, limits) for who in (event.vut_id, name))
    start = BlockPoint(entry_m(block), lane.y_m)
    ahead = vut.front_m + values["gap"] + other.rear_m
    s = within_block(block, other, ahead_of(block, start.s_m, ahead, lane.y_m), name)
    place = BlockPoint(round(s, 3), round(lane.y_m + values["offset"], 3))
    lead = Wait(place) if stands(event) else Drive(place, u, end_of(block, other), b)
    return Draft(
        vut=Drive(start, v, end_of(block, vut), a, _VUT_BRAKING_MPS2, values["headway"]),
        targets={name: lead},
        trigger=Trigger(
            object_id=name,
            quantity="relative_distance",
            below=values["below"],
            anchor=None,
            act=Hold(kind="hold"),
            not_before_s=round(0.5 * cruise_reached_s(v, a), 1),
        ),
    )


def _plans(setting: Setting) -> Iterator[Plan]:
    event = setting.event
    name, vut = event.interaction.initiator, event.vut_id
    pick = partial(choose, event, preferred=setting.preferred)
    fastest = vehicle_speed_limit(event, setting.limits, setting.block)
    c, own = "constraints", f"constraints.speeds.{name}.approach"
    choices = {
        "headway": choose_headway(setting.preferred, _HEADWAYS_S),
        "gap": pick(f"participants.{name}.region.gap", "m"),
        "vut_speed": pick(f"{c}.speeds.{vut}.approach", "m/s", at_most=fastest),
        "speed": fixed(event, own, "m/s", 0.0, "it stands")
        if stands(event)
        else pick(own, "m/s", at_most=fastest),
        "below": pick(f"{c}.trigger.below", "m"),
        "offset": pick(f"{c}.manoeuvre.offset", "m", at_least=-math.inf),
    }
    return plans_in_lane(
        setting, SLOW_LEAD.observable, choices, partial(_draft, setting), lambda *_: 0.0
    )


SLOW_LEAD = Kind(
    name="slow_lead",
    relation="following",
    zone="vut_lane",
    observable="closing",
    dominant_motions=frozenset({"same_direction", "stationary"}),
    initiator_classes=frozenset({"car", "truck", "bus", "motorcycle", "cyclist", "pedestrian"}),
    initiator_places={
        motion: frozenset({"vut_lane"}) for motion in ("same_direction", "stationary")
    },
    first="initiator",
    manoeuvre={"offset": "m"},
    trigger_quantities=frozenset({"relative_distance"}),
    needs_occluder=False,
    uses_arrival_gap=False,
    same_direction_lanes=1,
    manoeuvres=_manoeuvres,
    plans=_plans,
)
