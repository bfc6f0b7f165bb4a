"""The VUT enters a roundabout, and a vehicle that circulates on it has priority (crossing).

VUT and vehicle each follow a route over connecting roads of the map's ring. The vehicle waits on
the arm before the VUT's, enters the ring when the trigger fires, passes the VUT's entry, and leaves
the ring by an exit before the VUT's; the VUT gives way to it by gap acceptance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from ssp_core.motion.encounter import is_crossing
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block, Conflict
from ssp_scenario_manager.scenarios.base import CannotPlace, Kind, Plan, Setting
from ssp_scenario_manager.scenarios.over_routes import (
    Crossing,
    RouteMotion,
    conflicting_routes,
    plans_with,
    side_of,
)

# So long before a VUT that keeps its speed is there the vehicle comes into its corridor.
# The VUT waits before the place that the vehicle's rear sweeps while it comes around the bend.
_ROUTE_MOTION = RouteMotion(
    ahead_s=0.9, speed="circulating_speed", has_priority=True, before_zone_m=3.0
)
# In a ring both routes are one lane, this near to each other, for at least so long.
_ONE_LANE_M, _TOGETHER_M = 0.5, 3.0


def _manoeuvres(_event: Event) -> frozenset[str]:
    return frozenset({"keep_lane"})


def _run_together(block: Block, other: Block, conflict: Conflict) -> bool:
    """Tell whether another route goes on in a route's lane from where it comes into it."""
    stations = conflict.other_s_m + np.linspace(1.0, 1.0 + _TOGETHER_M, 6)
    beside = block.line.to_local_many(other.line.to_map_many(stations, 0.0))[:, 1]
    return bool((np.abs(beside) < _ONE_LANE_M).all())


def circulating(event: Event, block: Block, routes: Mapping[str, Block]) -> list[Crossing]:
    """Return where routes that a route joins in a ring, and that leave it first, meet it.

    That of the nearest arm before the VUT's is the first.

    Raises:
        CannotPlace: there is none.
    """
    side, crossings = side_of(event), []
    for conflict, other, passage in conflicting_routes(block, routes, turns=True):
        beside = not is_crossing(conflict.angle_rad) and conflict.comes_from == side
        if beside and _run_together(block, other, conflict):
            crossings.append((conflict, other, passage))
    if not crossings:
        raise CannotPlace(
            f"0 routes of its junction come from the {side}, share a ring with it, and leave it "
            "before it does; needs 1"
        )
    return sorted(crossings, key=lambda crossing: len(crossing[2].via))


def _plans(setting: Setting) -> Iterator[Plan]:
    crossings = circulating(setting.event, setting.block, setting.routes)
    return plans_with(setting, crossings, _ROUTE_MOTION)


ROUNDABOUT = Kind(
    name="roundabout",
    relation="crossing",
    zone="corridor_crossing",
    observable="lateral",
    dominant_motions=frozenset({"crossing_from_left"}),
    initiator_classes=frozenset({"car"}),
    initiator_places={"crossing_from_left": frozenset({"left_road"})},
    first="initiator",
    manoeuvre={
        "circulating_speed": "m/s",
        "line_distance": "m",
        "acceleration": "m/s^2",
        "critical_gap": "s",
    },
    trigger_quantities=frozenset({"time_to_arrival"}),
    needs_occluder=False,
    uses_arrival_gap=False,
    same_direction_lanes=1,
    manoeuvres=_manoeuvres,
    plans=_plans,
    at_junction=True,
    turns_left=True,
    # The VUT's way into the ring is measured from what it drove.
    after_resolution_s=6.0,
)
