"""The interface of a body for an object_target.

And a mirror, which does exactly what it is commanded.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.motion.reference import Reference
from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.safety.limits import LimitViolation
from ssp_core.vocabulary import ControlState, ObjectClass, Role, SessionPhase
from ssp_ot_controller.bodies.dynamics import LIMITS, Command


@dataclass(frozen=True, slots=True)
class BodyReading:
    """A body's reading of itself at one instant; its reference point in frame map.

    Args:
        stamp_ns: when it was measured, on the body's clock, which is that of the session.
        x_m: m, east.
        y_m: m, north.
        yaw_rad: rad, counter-clockwise from east.
        speed_mps: m/s along the heading, backwards is negative.
        acceleration_mps2: m/s^2 along the heading.
        yaw_rate_radps: rad/s, counter-clockwise positive.
        position_std_m: one sigma of x and of y, as its localisation states it; NaN: it has none.
        brakes_by_itself: it heard no command for too long.
    """

    stamp_ns: int
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float = 0.0
    yaw_rate_radps: float = 0.0
    position_std_m: float = 0.0
    brakes_by_itself: bool = False


@dataclass(frozen=True, slots=True)
class BodyCheck:
    """The judgement of a body with a control state of its own, for the object target.

    Args:
        armed: it reports that it is armed.
        cannot_arm: all that keeps it from being armed, as sentences; empty when nothing does.
        lasting: one of these stays as long as this process runs.
        violation: what it does that it must not; the object stops and latches.
        missed_start: its start time is over, and it doesn't report to run; the reason for what
            else is wrong with an object that stands where it should drive.
        slows_s: measured from an abort to its slowing, s; 0: stops as the bodies of its class.
    """

    armed: bool = True
    cannot_arm: tuple[str, ...] = ()
    lasting: bool = False
    violation: LimitViolation | None = None
    missed_start: LimitViolation | None = None
    slows_s: float = 0.0


@dataclass(frozen=True, slots=True)
class TrajectoryDecision:
    """The object target's decision, for a body that follows trajectories by itself.

    Args:
        session: as the manager's last heartbeat said.
        state: the object target's.
        references: the one that is driven, and those that wait, by their time.
    """

    session: SessionPhase
    state: ControlState
    references: tuple[Reference, ...] = ()


class Body(Protocol):
    """One body. No method waits for anything."""

    def read(self) -> BodyReading | None:
        """Return the newest reading since the last call, None when there is no new one."""

    def command(self, command: Command, now_ns: int) -> None:
        """Take the command that holds until the next.

        A body that hears none for long brakes by itself.

        Args:
            command: finite.
            now_ns: session time, ns.
        """

    def problems(self) -> tuple[str, ...]:
        """List why none of its messages becomes a reading, as sentences.

        Empty where nothing is known.

        Asked for while no reading comes.
        """

    def close(self) -> None:
        """Give back what it holds; the body is left to its own watchdog."""


def state_of(reading: BodyReading, spec: ParticipantSpec, sequence: int) -> ObjectState:
    """Return an object's own state as its body reads it.

    Args:
        reading: newest one of the body.
        spec: gives id, class and size of the object.
        sequence: number of the state, from 1.
    """
    return ObjectState(
        object_id=spec.id,
        object_class=spec.cls,
        role=Role.OT,
        stamp_ns=reading.stamp_ns,
        x_m=reading.x_m,
        y_m=reading.y_m,
        yaw_rad=reading.yaw_rad,
        speed_mps=reading.speed_mps,
        acceleration_mps2=reading.acceleration_mps2,
        yaw_rate_radps=reading.yaw_rate_radps,
        size=spec.size,
        sequence=sequence,
        position_std_m=reading.position_std_m,
    )


class MirrorBody:
    """Accelerates and steers as commanded, at once and exactly; it has no watchdog.

    Args:
        object_class: a walker turns to the commanded heading, others follow the curvature.
    """

    def __init__(self, object_class: ObjectClass, pose: Pose2, now_ns: int = 0) -> None:
        self._walks = object_class is ObjectClass.PEDESTRIAN
        self._hardest_mps2 = LIMITS[object_class].emergency_deceleration_mps2
        self._newest = BodyReading(now_ns, pose.x_m, pose.y_m, wrap_angle(pose.yaw_rad), 0.0)
        self._reading: BodyReading | None = self._newest
        self.commands: list[Command] = []

    def read(self) -> BodyReading | None:
        reading, self._reading = self._reading, None
        return reading

    def command(self, command: Command, now_ns: int) -> None:
        """Move as commanded from the last command's time to this one's."""
        last = self._newest
        previous_command = self.commands[-1] if self.commands else Command(0.0, 0.0, last.yaw_rad)
        self.commands.append(command)
        dt_s = ns_to_seconds(now_ns - last.stamp_ns)
        acceleration_mps2 = (
            -self._hardest_mps2
            if previous_command.emergency_stop
            else previous_command.acceleration_mps2
        )
        speed = max(last.speed_mps + acceleration_mps2 * dt_s, 0.0)
        way_m = 0.5 * (last.speed_mps + speed) * dt_s
        turn = way_m * previous_command.curvature_1pm
        yaw = last.yaw_rad
        if self._walks and not previous_command.emergency_stop:
            yaw, turn = previous_command.heading_rad, 0.0
        self._newest = self._reading = BodyReading(
            stamp_ns=now_ns,
            x_m=last.x_m + way_m * math.cos(yaw + 0.5 * turn),
            y_m=last.y_m + way_m * math.sin(yaw + 0.5 * turn),
            yaw_rad=wrap_angle(yaw + turn),
            speed_mps=speed,
            acceleration_mps2=(speed - last.speed_mps) / dt_s if dt_s > 0.0 else 0.0,
            yaw_rate_radps=turn / dt_s if dt_s > 0.0 else 0.0,
        )

    def problems(self) -> tuple[str, ...]:
        return ()

    def close(self) -> None:
        pass
