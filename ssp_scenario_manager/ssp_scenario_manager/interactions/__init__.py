"""Kinds of interaction by their names, which are the words of ``interaction.type``."""

from __future__ import annotations

from ssp_scenario_manager.interactions import cut_in, lead_braking, occluded_crossing, vru_crossing
from ssp_scenario_manager.interactions.base import Kind

KINDS: dict[str, Kind] = {
    module.KIND.name: module.KIND
    for module in (cut_in, lead_braking, occluded_crossing, vru_crossing)
}
