"""What the cells of several rows share: times, verdicts, and cells for several stages.

Bounds on reaction times are a limit of the site plus ``SEEN_S``: one step until the fault is in a
state, one until it is judged, one until the answer is published. Watches of processes use the
wall's clock in lockstep, where session time stands still while the world waits.
"""

from __future__ import annotations

from ssp_scenario_manager.faults.model import Cell, Expected, Stage

SEEN_S = 0.06
# Polling periods and scheduling of processes, on the wall's clock.
TOLD_S = 0.75
# Lockstep: the world drops whom it waits for in vain (sil/node.py), and how long its own
# standstill may last (core/vigil.py, objects/pool.py).
HANG_S = 1.5
WORLD_S = 4.0
# Without ticks outside a run an object takes the world for dead (objects/pool.py).
TICKS_S = 1.0
# The recorder's flush and report, and how long the manager waits for its status (core/vigil.py).
DISK_S = 1.0
RECORDER_S = 2.0
# A reference that begins to move is that much ahead of what shows as motion.
STARTS_S = 0.4
# An error of 2 m by an acceleration of 1 m/s^2 that nobody asked for.
ERROR_S = 3.0

VALID = frozenset({"valid"})
HARNESS = frozenset({"invalid_harness"})
OFF_SPEC = frozenset({"off_spec"})
ABORTED = frozenset({"aborted"})
FAILED = frozenset({"failed_safety"})
# What the runner says of a session whose end nobody could confirm.
UNCONFIRMED = "the recording ends while the session is"
RUN = (Stage.BEFORE, Stage.AFTER, Stage.CONFLICT)


def valid(why: str) -> Expected:
    """A cell in which nobody stops and the run is valid."""
    return Expected(VALID, why, stops=False)


def stages(armed: Cell, running: Cell) -> dict[Stage, Cell]:
    """One cell for the armed session, the same for all stages of the run."""
    return {Stage.ARMED: armed, **dict.fromkeys(RUN, running)}


def same(cell: Cell) -> dict[Stage, Cell]:
    """One cell for all stages."""
    return dict.fromkeys(Stage, cell)
