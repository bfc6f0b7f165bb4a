"""A pedestrian steps out from behind a vehicle parked at the right (relation crossing)."""

from __future__ import annotations

from ssp_scenario_manager.interactions.base import Kind
from ssp_scenario_manager.interactions.crossing import crossing_manoeuvres, plans_crossing

KIND = Kind(
    name="occluded_crossing",
    relation="crossing",
    zone="corridor_crossing",
    observable="lateral",
    dominant_motions=frozenset({"crossing_from_right"}),
    initiator_classes=frozenset({"pedestrian", "cyclist"}),
    initiator_places={"crossing_from_right": frozenset({"right_kerb"})},
    first="initiator",
    manoeuvre={
        "walking_speed": "m/s",
        "kerb_distance": "m",
        "acceleration": "m/s^2",
        "occluder_gap": "m",
    },
    trigger_quantities=frozenset({"time_to_arrival"}),
    needs_occluder=True,
    uses_arrival_gap=True,
    same_direction_lanes=1,
    manoeuvres=crossing_manoeuvres,
    plans=plans_crossing,
)
