"""Kinds of interaction by their names, which are the words of ``interaction.type``."""

from __future__ import annotations

from ssp_scenario_manager.scenarios.base import Kind
from ssp_scenario_manager.scenarios.events.crossing import OCCLUDED_CROSSING, VRU_CROSSING
from ssp_scenario_manager.scenarios.events.crossing_car import CROSSING_CAR
from ssp_scenario_manager.scenarios.events.cut_in import CUT_IN
from ssp_scenario_manager.scenarios.events.cut_out import CUT_OUT
from ssp_scenario_manager.scenarios.events.lead_braking import LEAD_BRAKING
from ssp_scenario_manager.scenarios.events.merge import MERGE
from ssp_scenario_manager.scenarios.events.oncoming_turn import ONCOMING_TURN
from ssp_scenario_manager.scenarios.events.roundabout import ROUNDABOUT
from ssp_scenario_manager.scenarios.events.slow_lead import SLOW_LEAD
from ssp_scenario_manager.scenarios.events.vut_turn import VUT_TURN

KINDS: dict[str, Kind] = {
    kind.name: kind
    for kind in (
        CROSSING_CAR,
        CUT_IN,
        CUT_OUT,
        LEAD_BRAKING,
        MERGE,
        OCCLUDED_CROSSING,
        ONCOMING_TURN,
        ROUNDABOUT,
        SLOW_LEAD,
        VRU_CROSSING,
        VUT_TURN,
    )
}
