"""The driver's place in a session of several processes: what arrives, and the answer to each step.

A tick is answered when the states of the VUT that precede it are there, as the objects do it, so
that the pilot sees what it sees in one process.
"""

from __future__ import annotations

from dataclasses import dataclass

from ssp_core.cdr.steps import WorldTick
from ssp_core.motion.state import ObjectState
from ssp_core.world.driver import DriveReport
from ssp_ot_controller.bodies.dynamics import Command
from ssp_ot_controller.driving.pilot import Pilot


@dataclass(frozen=True, slots=True)
class DriverStep:
    """The answer to one tick.

    Args:
        step: of the world.
        now_ns: session time.
        command: until the next step; None: the VUT has said nothing yet.
        report: of the driver; None: as command.
    """

    step: int
    now_ns: int
    command: Command | None
    report: DriveReport | None


class DriverSeat:
    """Takes states and ticks as they arrive, and has a pilot answer each step once.

    Args:
        pilot: of the run.
    """

    def __init__(self, pilot: Pilot) -> None:
        self._pilot = pilot
        self._vut: ObjectState | None = None
        self._states = 0
        self._tick: WorldTick | None = None
        self._answered_step = -1

    def take_state(self, state: ObjectState) -> None:
        """Take a state of the VUT; those before the start are of no number."""
        self._vut = state
        self._states += state.sequence > 1

    def take_tick(self, tick: WorldTick) -> None:
        """Take the world's tick."""
        self._tick = tick

    def step(self) -> DriverStep | None:
        """Answer the tick that is open; None where there is none, or a state before it is missing.

        The first step is repeated while the world holds, and answered each time.
        """
        tick = self._tick
        if tick is None or self._states < tick.vut_states_sent:
            return None
        self._tick = None
        if tick.step <= self._answered_step and tick.step > 0:
            return None
        self._answered_step = tick.step
        if self._vut is None:
            return DriverStep(tick.step, tick.stamp_ns, None, None)
        command, report = self._pilot.step(tick.step, tick.stamp_ns, self._vut, tick.objects)
        return DriverStep(tick.step, tick.stamp_ns, command, report)
