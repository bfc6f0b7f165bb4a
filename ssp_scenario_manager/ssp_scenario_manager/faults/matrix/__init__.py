"""The fault matrix itself: every row and cell, with the reason for what is expected."""

from __future__ import annotations

from ssp_scenario_manager.faults.matrix.commands import ACTUATOR_STUCK, REFERENCES
from ssp_scenario_manager.faults.matrix.event import OPERATOR_ABORT, TRIGGER_NEVER, VUT_STOPS
from ssp_scenario_manager.faults.matrix.links import DELAYS, LOSSES, REORDERED
from ssp_scenario_manager.faults.matrix.own_state import CLOCKS, FROZEN, JUMP, NAN
from ssp_scenario_manager.faults.matrix.processes import (
    DISK_FULL,
    MANAGER_KILLED,
    MANAGER_STOPPED,
    OBJECT_KILLED,
    RECORDER_KILLED,
    WORLD_PAUSED,
)
from ssp_scenario_manager.faults.model import Row

MATRIX: tuple[Row, ...] = (
    MANAGER_KILLED,
    MANAGER_STOPPED,
    OBJECT_KILLED,
    WORLD_PAUSED,
    RECORDER_KILLED,
    DISK_FULL,
    *DELAYS,
    *LOSSES,
    REORDERED,
    *CLOCKS,
    JUMP,
    NAN,
    FROZEN,
    *REFERENCES,
    ACTUATOR_STUCK,
    VUT_STOPS,
    TRIGGER_NEVER,
    OPERATOR_ABORT,
)

__all__ = ["MATRIX"]
