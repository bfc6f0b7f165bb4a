"""Vehicle physics of the CARLA counterpart: other than SSP's bodies in gain, lag and steering.

Nothing here is SSP's. A vehicle rolls on two axles, turns about its rear one and slips on neither;
its engine weakens with speed, air and tyres hold it back, and it falls until it stands on the
ground.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from tests.support.carla.picture import Pose

_GRAVITY_MPS2 = 9.81


@dataclass(frozen=True)
class Physics:
    """The capabilities of a vehicle.

    Args:
        engine: m/s^2 at full throttle, standing.
        fades_at: m/s at which the engine gives nothing more.
        brakes: m/s^2 at full brake.
        lag, steer_lag: time constants in s.
        most_deg: of the front wheels, at a full turn of the wheel.
        wheelbase: m.
        drag: 1/s, of the speed.
        drifts: m/s^2 to the front without a command, as on a slope.
    """

    engine: float = 5.0
    fades_at: float = 60.0
    brakes: float = 9.0
    lag: float = 0.15
    steer_lag: float = 0.05
    most_deg: float = 70.0
    wheelbase: float = 2.8
    drag: float = 0.02
    drifts: float = 0.0


@dataclass
class Drive:
    """One vehicle in motion; ``control`` is throttle, wheel to the right, brake."""

    control: tuple[float, float, float] = (0.0, 0.0, 0.0)
    speed: float = 0.0
    acceleration: float = 0.0
    wheels_deg: float = 0.0
    velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def told(self, fields: Sequence[float | bool]) -> str:
        """Take carla.VehicleControl; what a real client wouldn't send, in words."""
        throttle, steer, brake, *rest = fields
        if len(fields) != 7 or rest != [False, False, False, 0]:
            return f"control {fields}"
        if not (0 <= throttle <= 1 and -1 <= steer <= 1 and 0 <= brake <= 1):
            return f"pedals {fields}"
        self.control = (float(throttle), float(steer), float(brake))
        return ""

    def stop(self) -> None:
        """Stand, as what was put somewhere does."""
        self.speed = self.acceleration = self.wheels_deg = 0.0
        self.velocity = (0.0, 0.0, 0.0)

    def step(self, pose: Pose, physics: Physics, dt: float) -> Pose:
        """The pose one step later."""
        throttle, steer, brake = self.control
        pushed = throttle * physics.engine * max(0.0, 1.0 - self.speed / physics.fades_at)
        wanted = pushed + physics.drifts - brake * physics.brakes - physics.drag * self.speed
        self.acceleration += _share(physics.lag, dt) * (wanted - self.acceleration)
        turned = steer * physics.most_deg - self.wheels_deg
        self.wheels_deg += _share(physics.steer_lag, dt) * turned
        before, after = self.speed, self.speed + self.acceleration * dt
        if after <= 0.0:
            # Brakes hold, and never push backwards.
            after, self.acceleration = 0.0, min(self.acceleration, 0.0) if throttle else 0.0
        self.speed = after
        curvature = math.tan(math.radians(self.wheels_deg)) / physics.wheelbase
        way = 0.5 * (before + after) * dt
        yaw = math.radians(pose.yaw)
        middle, turn = yaw + 0.5 * way * curvature, way * curvature
        half = 0.5 * physics.wheelbase
        # The rear axle rolls; the origin is half a wheelbase ahead of it.
        x = pose.x - half * math.cos(yaw) + way * math.cos(middle) + half * math.cos(yaw + turn)
        y = pose.y - half * math.sin(yaw) + way * math.sin(middle) + half * math.sin(yaw + turn)
        sideways = self.speed * curvature * half
        c, s = math.cos(yaw + turn), math.sin(yaw + turn)
        self.velocity = (self.speed * c - sideways * s, self.speed * s + sideways * c, 0.0)
        fallen = max(0.0, pose.z - _GRAVITY_MPS2 * dt)
        return replace(pose, x=x, y=y, z=fallen, yaw=math.degrees(yaw + turn))


def _share(lag: float, dt: float) -> float:
    return 1.0 if lag <= 0.0 else 1.0 - math.exp(-dt / lag)
