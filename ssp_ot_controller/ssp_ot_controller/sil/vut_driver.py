"""The driver of the simulated VUT: car following, emergency braking, external commands, faults."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import replace

from ssp_core import names
from ssp_core.clock import ns_to_seconds, seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.model import FaultKind, RunSpec
from ssp_core.run_file.participants import Driver
from ssp_core.world.car_following import following_acceleration, free_acceleration
from ssp_core.world.gap_acceptance import PriorityWatch, Word
from ssp_core.world.obstacles import Obstacle, find_obstacles, places_on
from ssp_ot_controller.bodies.dynamics import LIMITS, Command, brake_command
from ssp_ot_controller.sil.disturbance import FaultChange, FaultSchedule

_LOOKAHEAD_S = 0.6
_MIN_LOOKAHEAD_M = 4.0


def lookahead_m(speed_mps: float) -> float:
    """Return how far ahead the point of the path lies that pure pursuit steers to."""
    return max(_MIN_LOOKAHEAD_M, _LOOKAHEAD_S * speed_mps)


def steer(vut: ObjectState, path: Polyline, station: float) -> float:
    """Return the curvature of pure pursuit, 1/m: 2 y / L^2 to a point of the path ahead."""
    target = path.pose(station + lookahead_m(vut.speed_mps))
    x, y = vut.pose.to_local(target.x_m, target.y_m)
    return 2.0 * y / max(x * x + y * y, 1e-6)


def drive(
    vut: ObjectState,
    others: Sequence[ObjectState],
    path: Polyline,
    driver: Driver,
    dt_s: float,
    most_mps2: float = math.inf,
) -> Command:
    """Return the driver's command for the next step.

    The VUT accelerates to cruise speed, keeps its gap to obstacles if the driver reacts, and
    stands with its reference point at the path's end.

    Args:
        vut: state of the VUT.
        others: all other objects; their order doesn't matter.
        path: to be driven, frame map.
        driver: how the VUT is driven.
        dt_s: time for which the command is held.
        most_mps2: acceleration that it keeps below for those that it gives way to.
    """
    limits = LIMITS[vut.object_class]
    v = max(vut.speed_mps, 0.0)
    b = driver.comfortable_deceleration_mps2
    # A little above cruise speed the driver only eases off.
    target_mps2 = max(min(free_acceleration(v, driver), (driver.cruise_mps - v) / dt_s), -b)
    target_mps2 = min(target_mps2, most_mps2)
    places = places_on(vut, others if driver.reacts else (), path)
    station = places[0][0]
    left = path.length_m - station
    if v * v / (2.0 * b) >= left - v * limits.acceleration_lag_s:
        target_mps2 = min(target_mps2, -v * v / (2.0 * left) if left > 0.05 else -b)
    if driver.reacts:
        for obstacle in find_obstacles(vut, others, path, driver, places):
            gap, speed, gain = obstacle.gap_m, obstacle.speed_mps, obstacle.acceleration_mps2
            target_mps2 = min(target_mps2, following_acceleration(v, gap, speed, gain, driver))
    acceleration = min(max(target_mps2, -limits.deceleration_mps2), limits.acceleration_mps2)
    bound = limits.curvature_1pm
    return Command(acceleration, min(max(steer(vut, path, station), -bound), bound), vut.yaw_rad)


# What is left between two bumpers when the braking was just enough.
MARGIN_M = 0.5
# Brakes need this long to build up; the gap closes meanwhile.
BUILD_UP_S = 0.2


def needed_deceleration(speed_mps: float, obstacle: Obstacle) -> float:
    """Return the constant deceleration that just avoids an obstacle, m/s^2; inf where none does.

    The obstacle keeps braking until it stands; that it may speed up doesn't count. Where the two
    come closest while it moves, (v - v_o)^2 / (2 s) + |a_o| is needed; where it stands first,
    v^2 / (2 (s + v_o^2 / (2 |a_o|))). s is the gap less the margin and less what closes while the
    brakes build up.

    Args:
        speed_mps: of the VUT, >= 0.
        obstacle: ahead on the VUT's path.
    """
    ahead, braking = max(obstacle.speed_mps, 0.0), max(-obstacle.acceleration_mps2, 0.0)
    closing = speed_mps - ahead
    if closing <= 0.0 and braking == 0.0:
        return 0.0
    room = obstacle.gap_m - MARGIN_M - max(closing, 0.0) * BUILD_UP_S
    if closing > 0.0:
        if room <= 0.0:
            return math.inf
        meets_after_s = 2.0 * room / closing
        if braking == 0.0 or meets_after_s < ahead / braking:
            return braking + closing * closing / (2.0 * room)
    to_standstill = room + ahead * ahead / (2.0 * braking)
    return speed_mps**2 / (2.0 * to_standstill) if to_standstill > 0.0 else math.inf


def brakes_in_emergency(
    active: bool, speed_mps: float, obstacles: Iterable[Obstacle], driver: Driver
) -> bool:
    """Tell whether the emergency brake is on in the next step.

    Args:
        active: it is on.
        speed_mps: of the VUT, >= 0.
        obstacles: everything ahead of it, as ``driver.find_obstacles`` gives them.
        driver: its ``aeb_deceleration_mps2`` is None where there is no such brake.
    """
    if driver.aeb_deceleration_mps2 is None:
        return False
    if active:
        return any(o.speed_mps < speed_mps or o.speed_mps <= 0.0 for o in obstacles)
    limit = driver.comfortable_deceleration_mps2
    return any(needed_deceleration(speed_mps, o) > limit for o in obstacles)


# An external driver that is silent this long is taken for gone.
DRIVER_TIMEOUT_S = 0.2
VUT_FAULTS: tuple[FaultKind, ...] = ("vut_stop",)


class VutDriver:
    """The VUT's driver: the built-in one or an external one, and the fault that stops it.

    ``vut_stop`` brakes with the fault's value, or comfortably without one, for as long as it
    lasts.
    """

    def __init__(self, run: RunSpec) -> None:
        self._run = run
        motion = run.vut.approach
        self._path = Polyline(motion.path) if motion is not None else None
        self._faults = FaultSchedule(run.faults, (names.VUT_ID,), VUT_FAULTS)
        self._drivers = _drivers(run.driver)
        self._priority = PriorityWatch(run.driver)
        self._emergency = False
        self._external_ns = 0
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
        """Compute the VUT's command until the next step.

        Args:
            vut: its true state; the stamp is session time.
            others: true states of everybody else.
            external: age in s and command of an external driver, None before its first one.
            drives: False: the run is over or no manager leads it; it brakes to a standstill.
        """
        self.fault_changes += self._faults.begin(vut.stamp_ns, running=True, armed=True)
        driver, wants_to_drive = self._driver(vut.stamp_ns)
        # A driven run has commands in each step that the built-in driver doesn't lead.
        if self._run.driver.external or external is not None:
            command = self._external(vut, external)
        else:
            command = self._built_in_command(vut, others, driver)
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

    def _built_in_command(
        self, vut: ObjectState, others: Sequence[ObjectState], driver: Driver
    ) -> Command:
        if self._path is None:
            return brake_command(vut, driver.comfortable_deceleration_mps2)
        most = math.inf
        if self._priority:
            front = self._path.project_beyond(vut.x_m, vut.y_m)[0] + vut.size.front_m
            decision = self._priority.decide(front, max(vut.speed_mps, 0.0), others, driver)
            others, most = (
                [o for o in others if o.object_id not in decision.heeded],
                decision.most_mps2,
            )
        command = drive(vut, others, self._path, driver, self._run.step_s, most)
        if driver.aeb_deceleration_mps2 is None:
            return command
        obstacles = find_obstacles(vut, others, self._path, driver)
        speed = max(vut.speed_mps, 0.0)
        self._emergency = brakes_in_emergency(self._emergency, speed, obstacles, driver)
        if not self._emergency:
            return command
        hardest = min(command.acceleration_mps2, -driver.aeb_deceleration_mps2)
        return replace(command, acceleration_mps2=hardest)

    @property
    def priority_words(self) -> tuple[Word, ...]:
        """The newest decision at each place at which it gives way."""
        return tuple(self._priority.words)

    @property
    def external_is_silent(self) -> bool:
        return self.external_silence_s > DRIVER_TIMEOUT_S

    def _external(self, vut: ObjectState, external: tuple[float, Command] | None) -> Command:
        """Return an external driver's command; with a silent one, brake to a standstill.

        The state before the start isn't answered. A command that isn't finite is no command.
        """
        if external is not None and external[1].is_finite:
            self._external_ns = vut.stamp_ns - seconds_to_ns(external[0])
        self.external_silence_s = ns_to_seconds(vut.stamp_ns - self._external_ns)
        if external is None or not external[1].is_finite or self.external_is_silent:
            return brake_command(vut, self._run.limits.stop_deceleration_mps2)
        return external[1]


def _drivers(driver: Driver) -> list[tuple[int, Driver, bool]]:
    """Return in time order from when on, ns, which driver, and whether it wants to drive."""
    drivers = [(0, driver, True)]
    for change in sorted(driver.later, key=lambda c: c.at_s):
        wants = change.cruise_mps > 0.0
        changed = driver.model_copy(update={"cruise_mps": change.cruise_mps}) if wants else driver
        drivers.append((seconds_to_ns(change.at_s), changed, wants))
    return drivers
