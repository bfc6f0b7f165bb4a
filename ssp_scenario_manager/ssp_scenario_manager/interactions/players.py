"""VUT and targets as they will move, in steps: the VUT reacts to what it meets."""

from __future__ import annotations

import math

from ssp_core.clock import seconds_to_ns
from ssp_core.geometry import Polyline
from ssp_core.motion.encounter import Encounter
from ssp_core.motion.reference import Reference, sample
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import ObjectClass, Role
from ssp_core.world.car_following import following_acceleration, free_acceleration
from ssp_scenario_manager.core.dispatch import (
    APPROACH_LEAD_S,
    Address,
    approach_reference,
    manoeuvre_reference,
)
from ssp_scenario_manager.interactions.base import CannotPlace
from ssp_scenario_manager.interactions.motions import Motions

_VULNERABLE = frozenset({ObjectClass.PEDESTRIAN, ObjectClass.CYCLIST})


class Players:
    """VUT and targets, moved on in steps; the VUT reacts to what it meets."""

    def __init__(self, plan: Motions) -> None:
        if plan.vut.approach is None:
            raise CannotPlace("the VUT has no path")
        self.plan = plan
        self.path = Polyline(plan.vut.approach.path)
        self.station_m = 0.0
        self.speed_mps = 0.0
        self.references: dict[str, Reference] = {}
        self.act: Reference | None = None
        for target in plan.targets:
            if target.approach is not None:
                address = self._address(target.id, APPROACH_LEAD_S)
                try:
                    self.references[target.id] = approach_reference(address, target.approach)
                except ValueError as error:
                    raise CannotPlace(f"{target.id}: {error}") from error

    @staticmethod
    def _address(object_id: str, execute_s: float) -> Address:
        return Address(object_id, object_id, "", "foreseen", 0, seconds_to_ns(execute_s))

    def vut(self, t_s: float) -> ObjectState:
        """The VUT's state now, which is at a session time."""
        pose = self.path.pose(self.station_m)
        return _state(self.plan.vut, Role.VUT, t_s, (pose.x_m, pose.y_m, pose.yaw_rad),
                      self.speed_mps, 0.0)  # fmt: skip

    def target(self, spec: ParticipantSpec, t_s: float) -> ObjectState:
        """A target's state at a session time."""
        reference = self.references.get(spec.id)
        act = self.act
        if act is not None and act.object_id == spec.id and seconds_to_ns(t_s) >= act.execute_at_ns:
            reference = act
        if reference is None or seconds_to_ns(t_s) <= reference.execute_at_ns:
            s = spec.start
            return _state(spec, Role.OT, t_s, (s.x_m, s.y_m, s.yaw_rad), 0.0, 0.0)
        p = sample(reference, seconds_to_ns(t_s))
        pose = (p.x_m, p.y_m, p.yaw_rad)
        return _state(spec, Role.OT, t_s, pose, p.speed_mps, p.acceleration_mps2)

    def fire(self, t_s: float) -> None:
        """Dispatches the manoeuvre, as the session does."""
        trigger = self.plan.trigger
        spec = self.plan.target(trigger.object_id)
        current = self.references.get(spec.id)
        address = self._address(spec.id, t_s + trigger.lead_time_s)
        try:
            self.act = manoeuvre_reference(
                address, trigger.manoeuvre, self.target(spec, t_s), current, spec.approach
            )
        except ValueError as error:
            raise CannotPlace(f"{spec.id}: {error}") from error

    def advance(self, meetings: list[tuple[ObjectState, Encounter]], dt_s: float) -> None:
        """Moves the VUT on, by its driver's law and, if the driver reacts, for what it meets."""
        driver, v = self.plan.driver, self.speed_mps
        wanted = free_acceleration(v, driver)
        for other, meeting in meetings if driver.reacts else ():
            if meeting.gap_m <= 0.1:
                continue
            if other.object_class in _VULNERABLE:
                if not (meeting.in_corridor or math.isfinite(meeting.object_arrival_s)):
                    continue
                ahead, rate = 0.0, 0.0
            elif meeting.in_corridor:
                ahead = meeting.along_mps
                rate = other.acceleration_mps2 if ahead > 0.0 else 0.0
            else:
                continue
            wanted = min(wanted, following_acceleration(v, meeting.gap_m, ahead, rate, driver))
        faster = max(v + wanted * dt_s, 0.0)
        self.station_m += 0.5 * (v + faster) * dt_s
        self.speed_mps = faster


def _state(
    spec: ParticipantSpec,
    role: Role,
    t_s: float,
    pose: tuple[float, float, float],
    speed_mps: float,
    acceleration_mps2: float,
) -> ObjectState:
    return ObjectState(
        spec.id, spec.cls, role, seconds_to_ns(t_s), *pose, speed_mps, acceleration_mps2, 0.0,
        spec.size,
    )  # fmt: skip
