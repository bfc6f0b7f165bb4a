"""The VUT turns left across the way of an oncoming vehicle that has priority (crossing).

VUT and vehicle each follow a route over a connecting road of the map's junction. The vehicle drives
off on the opposite arm when the trigger fires, and goes straight on; the VUT gives way to it by gap
acceptance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ssp_core.motion.encounter import comes_against
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.legs import STRAIGHT_ON_RAD
from ssp_scenario_manager.scenarios.base import CannotPlace, Kind, Plan, Setting
from ssp_scenario_manager.scenarios.over_routes import (
    Crossing,
    RouteMotion,
    conflicting_routes,
    plans_with,
    turning_left,
)

# So long before a VUT that keeps its speed is there the vehicle comes into its corridor.
_ROUTE_MOTION = RouteMotion(ahead_s=0.9, has_priority=True)


def _manoeuvres(_event: Event) -> frozenset[str]:
    return frozenset({"keep_lane"})


def oncoming(block: Block, routes: Mapping[str, Block]) -> list[Crossing]:
    """Return the conflicts with routes that come the opposite way and go straight on, and those.

    Raises:
        CannotPlace: there is none.
    """
    crossings = []
    for conflict, other, passage in conflicting_routes(block, routes, turns=True):
        own = block.line.pose(turning_left(block).start_s_m).yaw_rad
        comes = other.line.pose(passage.start_s_m).yaw_rad
        opposite = comes_against(own, comes)
        if opposite and abs(passage.turn_rad) < STRAIGHT_ON_RAD:
            crossings.append((conflict, other, passage))
    if not crossings:
        raise CannotPlace(
            "0 routes of its junction come the opposite way and go straight on across it, needs 1"
        )
    return crossings


def _plans(setting: Setting) -> Iterator[Plan]:
    return plans_with(setting, oncoming(setting.block, setting.routes), _ROUTE_MOTION)


VUT_TURN = Kind(
    name="vut_turn",
    relation="crossing",
    zone="corridor_crossing",
    observable="lateral",
    dominant_motions=frozenset({"crossing_from_right"}),
    initiator_classes=frozenset({"car", "truck", "bus", "motorcycle"}),
    initiator_places={"crossing_from_right": frozenset({"right_road"})},
    first="initiator",
    manoeuvre={
        "crossing_speed": "m/s",
        "line_distance": "m",
        "acceleration": "m/s^2",
        "critical_gap": "s",
    },
    trigger_quantities=frozenset({"time_to_arrival"}),
    needs_occluder=False,
    uses_arrival_gap=True,
    same_direction_lanes=1,
    manoeuvres=_manoeuvres,
    plans=_plans,
    at_junction=True,
    vut_intents=frozenset({"turn_left"}),
    # Its way across is measured from what it drove.
    after_resolution_s=4.0,
)
