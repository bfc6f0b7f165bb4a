"""A vehicle comes over a ramp and merges into the VUT's lane at a junction (relation merge).

VUT and vehicle each follow a route, and both go on in one lane. The vehicle waits at the end of its
ramp, and drives off into the VUT's lane when the trigger fires.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

from ssp_core.geometry import wrap_angle
from ssp_core.motion.encounter import is_crossing
from ssp_scenario_manager.event_spec.model import Event
from ssp_scenario_manager.maps.block import Block, Passage, bend_1pm
from ssp_scenario_manager.scenarios.base import CannotPlace, Kind, Plan, Setting
from ssp_scenario_manager.scenarios.over_routes import (
    Crossing,
    RouteMotion,
    conflicting_routes,
    plans_with,
    side_of,
    straight_on,
)

# So long before a VUT that keeps its speed the vehicle is in its corridor, and slower; a VUT that
# brakes has room for it. The vehicle's way ends so far beyond the junction.
_ROUTE_MOTION = RouteMotion(ahead_s=0.9, speed="merging_speed", beyond_m=100.0)


def _manoeuvres(_event: Event) -> frozenset[str]:
    return frozenset({"keep_lane"})


def _bend_1pm(route: Block, passage: Passage) -> float:
    return bend_1pm(route.line.section(passage.start_s_m, passage.end_s_m))


def ramps(event: Event, block: Block, routes: Mapping[str, Block]) -> list[Crossing]:
    """Return where routes that come beside a route from K*'s side join it, and those, in order.

    Raises:
        CannotPlace: there is none.
    """
    side, crossings, refused = side_of(event), [], []
    for conflict, other, passage in conflicting_routes(block, routes, "merge"):
        if conflict.comes_from != side:
            continue
        start = other.line.pose(passage.start_s_m)
        beside = block.line.pose(block.line.to_local(start.x_m, start.y_m)[0])
        comes_rad = wrap_angle(start.yaw_rad - beside.yaw_rad)
        goes_on_rad = block.line.pose(straight_on(block).end_s_m).yaw_rad
        own_rad, its_rad = (abs(wrap_angle(goes_on_rad - p.yaw_rad)) for p in (beside, start))
        if abs(comes_rad) > math.pi / 2 or is_crossing(comes_rad):
            refused.append(f"one comes at {abs(math.degrees(comes_rad)):.0f} deg, limit 45 deg")
        elif other.entrances == block.entrances:
            # Two lanes of one road: that which ends is left along an S.
            own_1pm, its_1pm = _bend_1pm(block, straight_on(block)), _bend_1pm(other, passage)
            if own_1pm >= its_1pm:
                refused.append(
                    f"the lane of one bends by {its_1pm:.3f} 1/m, and the VUT's by {own_1pm:.3f} "
                    "1/m: the VUT would come from the lane that ends"
                )
            else:
                crossings.append((conflict, other, passage))
        elif own_rad >= its_rad:
            refused.append(
                f"one turns by {math.degrees(its_rad):.0f} deg, and the VUT by "
                f"{math.degrees(own_rad):.0f} deg: the VUT would come over the ramp"
            )
        else:
            crossings.append((conflict, other, passage))
    if not crossings:
        raise CannotPlace(
            f"0 of {len(refused)} routes that join it from the {side} come over a ramp, at less "
            "than 45 deg; needs 1" + "".join(f"; {one}" for one in refused)
        )
    return crossings


def _plans(setting: Setting) -> Iterator[Plan]:
    crossings = ramps(setting.event, setting.block, setting.routes)
    return plans_with(setting, crossings, _ROUTE_MOTION)


MERGE = Kind(
    name="merge",
    relation="merge",
    zone="vut_lane",
    observable="lateral",
    dominant_motions=frozenset({"cutting_in_from_left", "cutting_in_from_right"}),
    initiator_classes=frozenset({"car", "truck", "bus", "motorcycle"}),
    initiator_places={
        "cutting_in_from_left": frozenset({"left_road"}),
        "cutting_in_from_right": frozenset({"right_road"}),
    },
    first="initiator",
    manoeuvre={"merging_speed": "m/s", "line_distance": "m", "acceleration": "m/s^2"},
    trigger_quantities=frozenset({"time_to_arrival"}),
    needs_occluder=False,
    uses_arrival_gap=False,
    same_direction_lanes=1,
    manoeuvres=_manoeuvres,
    plans=_plans,
    at_junction=True,
)
