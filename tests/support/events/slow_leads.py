"""The shipped slow lead as other road users: of another class, slower, or standing."""

from __future__ import annotations

from typing import Any

from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.event_spec.load import load_event
from ssp_scenario_manager.event_spec.model import Event

# What each class drives or walks along a lane, m/s.
SPEEDS_MPS = {
    "bus": (3.0, 4.0),
    "car": (3.0, 4.0),
    "cyclist": (3.0, 4.0),
    "motorcycle": (3.0, 4.0),
    "pedestrian": (1.2, 1.6),
    "truck": (3.0, 4.0),
}


def slow_lead(object_class: str = "car", standing: bool = False, **changes: Any) -> Event:
    """Return the shipped slow lead with another object ahead.

    Args:
        object_class: of the object.
        standing: it stands.
        changes: of ``constraints.manoeuvre``.
    """
    value = load_event("slow_lead")[0].model_dump(mode="json", by_alias=True)
    value["uncertainty"] = {}
    value["participants"]["ot1"]["class"] = object_class
    low, high = (0.0, 0.0) if standing else SPEEDS_MPS[object_class]
    for phase in PHASES:
        value["constraints"]["speeds"]["ot1"][phase] = {"min": low, "max": high, "unit": "m/s"}
        if standing:
            cell = value["motion"]["ot1"][phase]
            value["motion"]["ot1"][phase] = cell | {
                "motion": "stationary",
                "speed_trend": "standing",
            }
    if standing:
        value["interaction"]["dominant_motion"] = "stationary"
        gap = {"min": 105.0, "max": 125.0, "unit": "m"}
        value["participants"]["ot1"]["region"]["gap"] = gap
        # Nothing that stands is passed.
        value["constraints"]["time_gap"] = "unresolved"
    if high < 3.0:
        value["constraints"]["trigger"]["below"] = {"min": 48.0, "max": 52.0, "unit": "m"}
    value["constraints"]["manoeuvre"] |= changes
    return Event.model_validate(value)
