"""The shipped sites on which each shipped event can take place."""

from __future__ import annotations

from typing import Literal

from ssp_scenario_manager.scenarios.events.kinds import KINDS

_OPEN_ROAD = {"simulation": "boulevard", "physical": "north_track"}
_CROSSROADS = {"simulation": "crossroads", "physical": "cross_track"}
_TEE = {"simulation": "tee", "physical": "tee_track"}
_RING = {"simulation": "ring", "physical": "ring_track"}
_ENTRY = {"simulation": "entry", "physical": "entry_track"}


def site_of(event: str, domain: Literal["simulation", "physical"] = "simulation") -> str:
    """Return the name of a site of a domain that has the road of a shipped event."""
    if event == "merge":
        return _ENTRY[domain]
    if event == "vut_turn":
        return _TEE[domain]
    if event == "roundabout":
        return _RING[domain]
    return (_CROSSROADS if KINDS[event].at_junction else _OPEN_ROAD)[domain]
