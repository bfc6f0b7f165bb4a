"""A vehicle from the opposite road turns across the VUT's straight way at a junction (crossing).

VUT and vehicle each follow a route over a connecting road of the map's junction. The vehicle waits
on the opposite arm, in the oncoming lane, and turns when the trigger fires.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from ssp_core.motion.encounter import comes_against
from ssp_core.motion.state import DEFAULT_SIZES
from ssp_core.vocabulary import ObjectClass
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.legs import STRAIGHT_ON_RAD
from ssp_scenario_manager.scenarios.base import CannotPlace, Kind, Plan, Setting
from ssp_scenario_manager.scenarios.over_routes import (
    Crossing,
    RouteMotion,
    conflicting_routes,
    plans_with,
)
from ssp_scenario_manager.scenarios.values import size_of

# So long before a VUT that keeps its speed is where the vehicle comes into its corridor does the
# vehicle do so: it is seen turning before the conflict, and is still there when the VUT comes.
_AHEAD_S = 2.1
# That is of a car. Of one that reaches further ahead of its rear axle the front is in the corridor
# as soon as the turn shows.
_AHEAD_SPM = 0.15


def _manoeuvres(_event: Event) -> frozenset[str]:
    return frozenset({"keep_lane"})


def turns(block: Block, routes: Mapping[str, Block]) -> list[Crossing]:
    """Return the conflicts with routes of oncoming vehicles that turn across a route, and those.

    Raises:
        CannotPlace: there is none.
    """
    crossings = []
    for conflict, other, passage in conflicting_routes(block, routes):
        own = block.line.pose(conflict.s_m).yaw_rad
        comes = other.line.pose(passage.start_s_m).yaw_rad
        opposite = comes_against(own, comes)
        if opposite and passage.turn_rad >= STRAIGHT_ON_RAD and conflict.comes_from == "left":
            crossings.append((conflict, other, passage))
    if not crossings:
        raise CannotPlace(
            "0 routes of its junction come the opposite way and turn across it by at least "
            f"{math.degrees(STRAIGHT_ON_RAD):.0f} deg, needs 1"
        )
    return crossings


def _plans(setting: Setting) -> Iterator[Plan]:
    front_m = size_of(setting.event, setting.event.interaction.initiator).front_m
    longer_m = max(0.0, front_m - DEFAULT_SIZES[ObjectClass.CAR].front_m)
    ahead_s = _AHEAD_S + _AHEAD_SPM * longer_m
    return plans_with(setting, turns(setting.block, setting.routes), RouteMotion(ahead_s))


ONCOMING_TURN = Kind(
    name="oncoming_turn",
    relation="crossing",
    zone="corridor_crossing",
    observable="lateral",
    dominant_motions=frozenset({"oncoming"}),
    initiator_classes=frozenset({"car", "truck", "bus", "motorcycle"}),
    initiator_places={"oncoming": frozenset({"oncoming_lane"})},
    first="initiator",
    manoeuvre={"crossing_speed": "m/s", "line_distance": "m", "acceleration": "m/s^2"},
    trigger_quantities=frozenset({"time_to_arrival"}),
    needs_occluder=False,
    uses_arrival_gap=False,
    same_direction_lanes=1,
    manoeuvres=_manoeuvres,
    plans=_plans,
    at_junction=True,
    turn=("opposite", "rightwards"),
)
