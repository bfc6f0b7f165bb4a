"""Who drives the VUT in the simulated world, and what keeps it from driving."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ssp_core import names
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import FaultKind, RunSpec
from ssp_core.run_file.participants import Driver
from ssp_ot_controller.core import emergency_brake
from ssp_ot_controller.core.bodies import Command, brake_command
from ssp_ot_controller.core.driver import drive, find_obstacles
from ssp_ot_controller.sil.fault_schedule import FaultChange, FaultSchedule

# An external driver that is silent this long is taken for gone.
DRIVER_TIMEOUT_S = 0.2
VUT_FAULTS: tuple[FaultKind, ...] = ("vut_stop",)


class VutDriver:
    """The VUT's driver: the built-in one or an external one, and the fault that stops it.

    ``vut_stop`` brakes with the fault's value, or comfortably without one, for as long as it
    lasts.

    Args:
        run: the run.
    """

    def __init__(self, run: RunSpec) -> None:
        self._run = run
        motion = run.vut.approach
        self._path = Polyline(motion.path) if motion is not None else None
        self._faults = FaultSchedule(run.faults, (names.VUT_ID,), VUT_FAULTS)
        self._drivers = _drivers(run.driver)
        self._emergency = False
        self._heard_ns = 0
        self.external_silence_s = 0.0
        self.fault_changes: list[FaultChange] = []

    def command(
        self,
        vut: ObjectState,
        others: Sequence[ObjectState],
        external: tuple[float, Command] | None,
        *,
        drives: bool,
    ) -> Command:
        """What the VUT does until the next step.

        Args:
            vut: its true state; the stamp is session time.
            others: true states of everybody else.
            external: age in s and command of an external driver, None before its first one.
            drives: False: the run is over or nobody leads it; it brakes to a standstill.
        """
        self.fault_changes += self._faults.begin(vut.stamp_ns, running=True, armed=True)
        driver, wants_to_drive = self._driver(vut.stamp_ns)
        if self._run.driver.external:
            command = self._external(vut, external)
        else:
            command = self._built_in(vut, others, driver)
        comfortable = driver.comfortable_deceleration_mps2
        stops = [fault.value or comfortable for fault in self._faults.active("vut_stop")]
        if not (drives and wants_to_drive):
            stops.append(comfortable)
        if not stops:
            return command
        # While it stops it keeps its lane, and brakes harder for what stops ahead of it.
        return replace(command, acceleration_mps2=min(command.acceleration_mps2, -max(stops)))

    def _driver(self, now_ns: int) -> tuple[Driver, bool]:
        at_ns, driver, drives = self._drivers[0]
        for at_ns, changed, wants in self._drivers[1:]:
            if now_ns >= at_ns:
                driver, drives = changed, wants
        return driver, drives

    def _built_in(self, vut: ObjectState, others: Sequence[ObjectState], driver: Driver) -> Command:
        if self._path is None:
            return brake_command(vut, driver.comfortable_deceleration_mps2)
        command = drive(vut, others, self._path, driver, self._run.step_s)
        if driver.aeb_deceleration_mps2 is None:
            return command
        obstacles = find_obstacles(vut, others, self._path, driver)
        speed = max(vut.speed_mps, 0.0)
        self._emergency = emergency_brake.brakes(self._emergency, speed, obstacles, driver)
        if not self._emergency:
            return command
        hardest = min(command.acceleration_mps2, -driver.aeb_deceleration_mps2)
        return replace(command, acceleration_mps2=hardest)

    @property
    def external_is_silent(self) -> bool:
        return self.external_silence_s > DRIVER_TIMEOUT_S

    def _external(self, vut: ObjectState, external: tuple[float, Command] | None) -> Command:
        """The command of an external driver; a silent one's vehicle brakes to a standstill.

        Nobody answers the state before the start. A command that isn't finite is no command.
        """
        if external is not None and external[1].is_finite:
            self._heard_ns = vut.stamp_ns - seconds_to_ns(external[0])
        self.external_silence_s = ns_to_seconds(vut.stamp_ns - self._heard_ns)
        if external is None or not external[1].is_finite or self.external_is_silent:
            return brake_command(vut, self._run.limits.stop_deceleration_mps2)
        return external[1]


def _drivers(driver: Driver) -> list[tuple[int, Driver, bool]]:
    """The driver from which time on, ns, and whether it wants to drive at all."""
    found = [(0, driver, True)]
    for change in sorted(driver.later, key=lambda c: c.at_s):
        wants = change.cruise_mps > 0.0
        changed = driver.model_copy(update={"cruise_mps": change.cruise_mps}) if wants else driver
        found.append((seconds_to_ns(change.at_s), changed, wants))
    return found
