"""A perfect body without a plant, for tests and for a first look: it does what it is told."""

from __future__ import annotations

import math

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Pose2, wrap_angle
from ssp_core.vocabulary import ObjectClass
from ssp_ot_controller.core.bodies import LIMITS, Command
from ssp_ot_controller.target.bodies import BodyReading


class MirrorBody:
    """Accelerates and steers as commanded, at once and exactly; it has no watchdog.

    Args:
        object_class: a walker turns to the commanded heading, others follow the curvature.
        pose: where it stands.
        now_ns: session time.
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
        """Moves as commanded from the last command's time to this one's."""
        last = self._newest
        done = self.commands[-1] if self.commands else Command(0.0, 0.0, last.yaw_rad)
        self.commands.append(command)
        dt_s = ns_to_seconds(now_ns - last.stamp_ns)
        wanted = -self._hardest_mps2 if done.emergency_stop else done.acceleration_mps2
        speed = max(last.speed_mps + wanted * dt_s, 0.0)
        way_m = 0.5 * (last.speed_mps + speed) * dt_s
        turn = way_m * done.curvature_1pm
        yaw = last.yaw_rad
        if self._walks and not done.emergency_stop:
            yaw, turn = done.heading_rad, 0.0
        self._newest = self._reading = BodyReading(
            stamp_ns=now_ns,
            x_m=last.x_m + way_m * math.cos(yaw + 0.5 * turn),
            y_m=last.y_m + way_m * math.sin(yaw + 0.5 * turn),
            yaw_rad=wrap_angle(yaw + turn),
            speed_mps=speed,
            acceleration_mps2=(speed - last.speed_mps) / dt_s if dt_s > 0.0 else 0.0,
            yaw_rate_radps=turn / dt_s if dt_s > 0.0 else 0.0,
        )

    def close(self) -> None:
        pass
