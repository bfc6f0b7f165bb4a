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
from ssp_scenario_manager.maps.block import Block
from ssp_scenario_manager.scenarios.base import CannotPlace, Kind, Plan, Setting
from ssp_scenario_manager.scenarios.over_routes import (
    Course,
    Crossing,
    met_by,
    plans_with,
    side_of,
)

# So long before a VUT that keeps its speed the vehicle is in its corridor, and slower; a VUT that
# brakes has room for it. The vehicle's way ends so far beyond the junction.
_COURSE = Course(ahead_s=0.9, speed="merging_speed", beyond_m=100.0)


def _manoeuvres(_event: Event) -> frozenset[str]:
    return frozenset({"keep_lane"})


def ramps(event: Event, block: Block, routes: Mapping[str, Block]) -> list[Crossing]:
    """Return where routes that come beside a route from K*'s side join it, and those, in order.

    Raises:
        CannotPlace: there is none.
    """
    side, found, angles = side_of(event), [], []
    for conflict, other, passage in met_by(block, routes, "merge"):
        if conflict.comes_from != side:
            continue
        x_m, y_m = other.line.to_map(passage.start_s_m, 0.0)
        beside_s_m = block.line.to_local(x_m, y_m)[0]
        own_rad = block.line.pose(beside_s_m).yaw_rad
        turns_rad = wrap_angle(other.line.pose(passage.start_s_m).yaw_rad - own_rad)
        angles.append(f"{abs(math.degrees(turns_rad)):.0f} deg")
        if abs(turns_rad) < math.pi / 2 and not is_crossing(turns_rad):
            found.append((conflict, other, passage))
    if not found:
        at = f" ({', '.join(angles)})" if angles else ""
        raise CannotPlace(
            f"0 of {len(angles)} routes that join it from the {side} come at less than 45 deg, "
            f"needs 1{at}"
        )
    return found


def _plans(setting: Setting) -> Iterator[Plan]:
    found = ramps(setting.event, setting.block, setting.routes)
    return plans_with(setting, found, _COURSE)


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
