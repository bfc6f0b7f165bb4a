"""Parameters of this package's nodes."""

from __future__ import annotations

from dataclasses import replace

from ssp_core.node_interface import RUN_FILE, Parameter

SCENARIO_MANAGER = (
    replace(
        RUN_FILE,
        description="run of the session, whose mode and token the manager holds every goal and "
        "command against; empty: those of the first run that it loads",
        required=False,
    ),
)
NODES: dict[str, tuple[Parameter, ...]] = {"scenario_manager": SCENARIO_MANAGER}
