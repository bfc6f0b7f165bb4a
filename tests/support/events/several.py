"""Shipped events with further participants: a lead, an oncoming car, a second pedestrian."""

from __future__ import annotations

from typing import Any

from ssp_core.vocabulary import PHASES
from ssp_scenario_manager.event_spec.load import load_event, seal_event, uncovered
from ssp_scenario_manager.event_spec.model import Doubt, Event


def _cell(
    position: str, motion: str, heading: str, trend: str, longitudinal: str
) -> dict[str, Any]:
    return {
        "position": position,
        "motion": motion,
        "heading": heading,
        "speed_trend": trend,
        "longitudinal": longitudinal,
        "lateral": "none",
    }


# By the example's name: the shipped event, and its further participants: class, place, gap in m,
# speed in m/s, and their motion.
LEAD = (
    "car",
    ("vut_lane", "ahead"),
    (95.0, 125.0),
    (12.0, 14.0),
    _cell("front", "same_direction", "same", "constant", "any"),
)
ONCOMING = (
    "car",
    ("oncoming_lane", "ahead"),
    (120.0, 170.0),
    (8.0, 9.0),
    _cell("front_left", "oncoming", "opposite", "constant", "any"),
)
WAITING = (
    "pedestrian",
    ("right_kerb", "ahead"),
    (36.0, 46.0),
    (0.0, 0.0),
    _cell("front_right", "stationary", "leftwards", "standing", "any"),
)
# At the right kerb before a junction, where it hides what waits on the arm from the right.
PARKED = (
    "truck",
    ("right_kerb", "ahead"),
    (30.0, 70.0),
    (0.0, 0.0),
    _cell("front_right", "stationary", "same", "standing", "any"),
)
EXAMPLES = {
    "lead_ahead_of_a_cut_in": ("cut_in", {"ot2": LEAD}),
    "oncoming_while_a_pedestrian_crosses": ("vru_crossing", {"ot2": ONCOMING}),
    "two_pedestrians_one_hidden": ("occluded_crossing", {"ot3": WAITING}),
}


def several(example: str) -> Event:
    """Return a named example."""
    kind, further = EXAMPLES[example]
    return with_further(kind, further)


def behind_a_parked_truck() -> Event:
    """Return a car that crosses at a junction, hidden at first by a truck on the VUT's own road."""
    return with_further("crossing_car", {"ot2": PARKED}, seen_share=0.5)


def with_further(
    kind: str, further: dict[str, tuple[Any, ...]], seen_share: float | None = None
) -> Event:
    """Return a shipped event with further participants, which a person has decided on.

    Args:
        kind: of the event.
        further: the participants by id, as above.
        seen_share: of the time that the camera must see the initiator; None: as shipped.
    """
    shipped = load_event(kind)[0]
    value = shipped.model_dump(mode="json", by_alias=True)
    for name, (object_class, (place, along), gap, speed, cell) in further.items():
        value["participants"][name] = {
            "role": "OT",
            "class": object_class,
            "region": {
                "place": place,
                "along": along,
                "gap": {"min": gap[0], "max": gap[1], "unit": "m"},
            },
        }
        value["motion"][name] = dict.fromkeys(PHASES, cell)
        value["constraints"]["speeds"][name] = {
            phase: {"min": speed[0], "max": speed[1], "unit": "m/s"} for phase in PHASES
        }
    if seen_share is not None:
        value["constraints"]["camera"]["visible_fraction"]["min"] = seen_share
    event = Event.model_validate(value)
    decided = Doubt(
        confidence=1.0, provenance="person", source="chosen", review="accepted", seal=None
    )
    doubts = dict(event.uncertainty) | dict.fromkeys(uncovered(event), decided)
    return seal_event(event.model_copy(update={"uncertainty": doubts}))
