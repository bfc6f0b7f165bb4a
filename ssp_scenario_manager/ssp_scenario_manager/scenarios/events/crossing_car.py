"""A vehicle crosses the VUT's straight way over a junction, from left or right (relation crossing).

VUT and vehicle each follow a route over a connecting road of the map's junction. The vehicle waits
at the junction's edge on its arm, and drives off when the trigger fires.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ssp_core.geometry import wrap_angle
from ssp_core.motion.encounter import is_crossing
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.maps.legs import STRAIGHT_ON_RAD
from ssp_scenario_manager.scenarios.base import CannotPlace, Kind, Plan, Setting
from ssp_scenario_manager.scenarios.over_routes import (
    Crossing,
    RouteMotion,
    conflicting_routes,
    plans_with,
    side_of,
)

# So long before the VUT would the vehicle be in the VUT's corridor.
_AHEAD_S = 0.3


def _manoeuvres(_event: Event) -> frozenset[str]:
    return frozenset({"keep_lane"})


def crossings(event: Event, block: Block, routes: Mapping[str, Block]) -> list[Crossing]:
    """Return conflicts with routes that cross straight on from K*'s side, and those, in order.

    Raises:
        CannotPlace: there is none.
    """
    side, candidates = side_of(event), []
    for conflict, other, passage in conflicting_routes(block, routes):
        straight = abs(passage.turn_rad) < STRAIGHT_ON_RAD
        across = is_crossing(wrap_angle(conflict.angle_rad))
        if straight and across and conflict.comes_from == side:
            candidates.append((conflict, other, passage))
    if not candidates:
        raise CannotPlace(f"0 routes of its junction cross it straight on from the {side}, needs 1")
    return candidates


def _plans(setting: Setting) -> Iterator[Plan]:
    candidates = crossings(setting.event, setting.block, setting.routes)
    return plans_with(setting, candidates, RouteMotion(_AHEAD_S))


CROSSING_CAR = Kind(
    name="crossing_car",
    relation="crossing",
    zone="corridor_crossing",
    observable="lateral",
    dominant_motions=frozenset({"crossing_from_left", "crossing_from_right"}),
    initiator_classes=frozenset({"car", "truck", "bus", "motorcycle"}),
    initiator_places={
        "crossing_from_left": frozenset({"left_road"}),
        "crossing_from_right": frozenset({"right_road"}),
    },
    first="initiator",
    manoeuvre={"crossing_speed": "m/s", "line_distance": "m", "acceleration": "m/s^2"},
    trigger_quantities=frozenset({"time_to_arrival"}),
    needs_occluder=False,
    uses_arrival_gap=True,
    same_direction_lanes=1,
    manoeuvres=_manoeuvres,
    plans=_plans,
    at_junction=True,
)
