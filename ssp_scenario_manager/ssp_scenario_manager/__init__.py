"""Event specification, triggers, session and supervisor of SSP.

Its public API is what ``PUBLIC`` names; docs/api.md describes it.
"""

from typing import Any

from ssp_core.public_names import public_name

# Loaded when they are asked for, so that a node or command pays for what it uses alone.
PUBLIC = {
    "load_event": "ssp_scenario_manager.event_spec.load",
    "load_library": "ssp_scenario_manager.maps.load",
    "load_site": "ssp_scenario_manager.maps.site",
    "load_task": "ssp_scenario_manager.compile.task",
    "run_in_process": "ssp_scenario_manager.run.in_process",
}


def __getattr__(name: str) -> Any:
    return public_name(__name__, PUBLIC, name)
