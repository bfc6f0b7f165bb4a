"""The played VUT: a simulated car whose driver drives while the session runs, and brakes else."""

from __future__ import annotations

from collections.abc import Sequence

from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import RunSpec
from ssp_core.vocabulary import Role, SessionPhase
from ssp_ot_controller.core.bodies import BodyState, step_body
from ssp_ot_controller.sil.vut import VutDriver

# The plant is stepped at least this finely, also where a busy machine comes late.
_PLANT_STEP_S = 0.01
# However late: what wasn't stepped by then stays out, as for a vehicle that stood meanwhile.
_LONGEST_S = 1.0


class PlayedVehicle:
    """Drives by the heartbeats that it hears, as a driver does by the radio. Reads no clock.

    Args:
        run: its VUT and driver.
        now_ns: system clock.
    """

    def __init__(self, run: RunSpec, now_ns: int) -> None:
        self._run = run
        self._driver = VutDriver(run)
        self._now_ns = now_ns
        self._began_ns: int | None = None
        self._silent_ns = seconds_to_ns(run.limits.heartbeat_s)
        self._heard_ns: int | None = None
        self._phase = SessionPhase.IDLE
        self.body = BodyState.at_rest(run.vut.start.pose)

    def hear(self, phase: SessionPhase, now_ns: int) -> None:
        """A heartbeat."""
        if phase is SessionPhase.RUNNING and self._phase is not SessionPhase.RUNNING:
            self._began_ns = now_ns
        self._phase, self._heard_ns = phase, now_ns

    def drives(self, now_ns: int) -> bool:
        """The session runs, and somebody still says so."""
        heard = self._heard_ns is not None and now_ns - self._heard_ns <= self._silent_ns
        return heard and self._phase is SessionPhase.RUNNING

    def advance(self, others: Sequence[ObjectState], now_ns: int) -> BodyState:
        """Moves the vehicle up to a time.

        Args:
            others: what its driver sees.
            now_ns: system clock.
        """
        left_ns = min(now_ns - self._now_ns, seconds_to_ns(_LONGEST_S))
        self._now_ns = now_ns - left_ns
        longest_ns = seconds_to_ns(_PLANT_STEP_S)
        while self._now_ns < now_ns:
            step_ns = min(longest_ns, now_ns - self._now_ns)
            self._now_ns += step_ns
            command = self._driver.command(
                self._state(), others, None, drives=self.drives(self._now_ns)
            )
            self.body = step_body(self._run.vut.cls, self.body, command, ns_to_seconds(step_ns))
        return self.body

    @property
    def now_ns(self) -> int:
        """Up to when it was moved."""
        return self._now_ns

    def _state(self) -> ObjectState:
        vut, b = self._run.vut, self.body
        began_ns = self._began_ns if self._began_ns is not None else self._now_ns
        return ObjectState(
            vut.id, vut.cls, Role.VUT, max(self._now_ns - began_ns, 0), b.x_m, b.y_m, b.yaw_rad,
            b.speed_mps, b.acceleration_mps2, b.yaw_rate_radps, vut.size,
        )  # fmt: skip
