"""Parameters of this package's nodes."""

from __future__ import annotations

from dataclasses import replace

from ssp_core.node_interface import RUN_FILE, Parameter

SCENARIO_MANAGER = (
    replace(
        RUN_FILE,
        description="run of the session, whose mode and token every goal and command must have; "
        "empty: those of the first run that is loaded",
        required=False,
    ),
)
NODES: dict[str, tuple[Parameter, ...]] = {"scenario_manager": SCENARIO_MANAGER}
