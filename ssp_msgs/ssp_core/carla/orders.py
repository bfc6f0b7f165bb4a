"""Orders to actors for the next frame, and CARLA's commands for them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from ssp_core.carla.frame import CarlaPose


@dataclass(frozen=True, slots=True)
class Placement:
    """A place for an actor in the next frame.

    Args:
        walking_mps: of a pedestrian, whose pose is that of its feet; None for other actors.
        lights: of a vehicle, as bits of carla.VehicleLightState; None leaves them.
    """

    actor: int
    pose: CarlaPose
    walking_mps: float | None = None
    lights: int | None = None

    def commands(self, carla: Any) -> Iterator[Any]:
        """Yield the placement as CARLA's commands, by its client's module."""
        transform = transform_of(carla, self.pose)
        if self.walking_mps is None:
            yield carla.command.ApplyTransform(self.actor, transform)
        else:
            yield carla.command.ApplyWalkerState(self.actor, transform, self.walking_mps)
        if self.lights is not None:
            state = carla.VehicleLightState(self.lights)
            yield carla.command.SetVehicleLightState(self.actor, state)


@dataclass(frozen=True, slots=True)
class PedalOrder:
    """Pedals and steering wheel of a vehicle in the next frame.

    Args:
        throttle, brake: 0 to 1.
        steer: -1 to 1, to the right.
    """

    actor: int
    throttle: float
    brake: float
    steer: float

    def commands(self, carla: Any) -> Iterator[Any]:
        """Yield the order as CARLA's commands, by its client's module."""
        control = carla.VehicleControl(throttle=self.throttle, brake=self.brake, steer=self.steer)
        yield carla.command.ApplyVehicleControl(self.actor, control)


@dataclass(frozen=True, slots=True)
class CarlaMotion:
    """Pose of an actor's origin, and its velocity in m/s along CARLA's axes."""

    pose: CarlaPose
    velocity: tuple[float, float, float]


def transform_of(carla: Any, pose: CarlaPose) -> Any:
    """Return a pose as carla.Transform."""
    location = carla.Location(pose.x_m, pose.y_m, pose.z_m)
    return carla.Transform(location, carla.Rotation(pose.pitch_deg, pose.yaw_deg, pose.roll_deg))
