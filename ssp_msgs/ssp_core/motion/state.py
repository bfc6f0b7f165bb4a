"""State of an object (ObjectState.msg without ROS), and the typical extent of each class."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ssp_core.clock import ns_to_seconds
from ssp_core.geometry import Box, Pose2, reach_m, wrap_angle
from ssp_core.value_class import value_class
from ssp_core.vocabulary import ControlState, ObjectClass, Role

# No coordinate, speed, angle or extent of a vehicle comes near this, in SI units.
_UNBELIEVABLE = 1e9


@dataclass(frozen=True, slots=True)
class Size:
    """Extent from the reference point (see ObjectState.msg), m."""

    front_m: float
    rear_m: float
    width_m: float
    height_m: float

    @property
    def length_m(self) -> float:
        return self.front_m + self.rear_m

    @property
    def reach_m(self) -> float:
        """Reach from its reference point, m."""
        return reach_m(self.front_m, self.rear_m, self.width_m)


# Typical extents; a run file may give others.
DEFAULT_SIZES: dict[ObjectClass, Size] = {
    ObjectClass.CAR: Size(3.6, 0.9, 1.8, 1.5),
    ObjectClass.TRUCK: Size(7.0, 2.0, 2.5, 3.4),
    ObjectClass.BUS: Size(9.0, 3.0, 2.5, 3.1),
    ObjectClass.MOTORCYCLE: Size(1.2, 0.9, 0.8, 1.6),
    ObjectClass.CYCLIST: Size(1.1, 0.7, 0.6, 1.75),
    ObjectClass.PEDESTRIAN: Size(0.25, 0.25, 0.5, 1.75),
}


@value_class(frozen=True, slots=True)
class ObjectState:
    """State of the reference point in frame map; fields mean what they do in ObjectState.msg."""

    object_id: str
    object_class: ObjectClass
    role: Role
    stamp_ns: int
    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float
    yaw_rate_radps: float
    size: Size
    sequence: int = 0
    control_state: ControlState = ControlState.OFF
    position_std_m: float = 0.0
    reference_id: str = ""
    error_longitudinal_m: float = 0.0
    error_lateral_m: float = 0.0
    error_yaw_rad: float = 0.0

    @property
    def pose(self) -> Pose2:
        return Pose2(self.x_m, self.y_m, self.yaw_rad)

    @property
    def box(self) -> Box:
        return Box(self.pose, self.size.front_m, self.size.rear_m, self.size.width_m)

    @property
    def is_finite(self) -> bool:
        """Each number is one, and none is so large that it can't be reckoned with."""
        # One sum instead of ten questions: it is asked dozens of times a step.
        size = self.size
        return (
            abs(self.x_m)
            + abs(self.y_m)
            + abs(self.yaw_rad)
            + abs(self.speed_mps)
            + abs(self.acceleration_mps2)
            + abs(self.yaw_rate_radps)
            + abs(size.front_m)
            + abs(size.rear_m)
            + abs(size.width_m)
            + abs(size.height_m)
        ) < _UNBELIEVABLE

    def point_at(self, stamp_ns: int) -> tuple[float, float]:
        """Return x and y at another time; see ``extrapolated``."""
        dt = ns_to_seconds(stamp_ns - self.stamp_ns)
        half = 0.5 * (self.yaw_rate_radps * dt)
        # The chord of the arc: no difference of nearly equal numbers for a slight turn.
        chord = self.speed_mps * dt * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
        middle = self.yaw_rad + half
        return self.x_m + chord * math.cos(middle), self.y_m + chord * math.sin(middle)

    def extrapolated(self, stamp_ns: int) -> ObjectState:
        """Return the state at another time, speed and yaw rate held: straight or on a circle."""
        if stamp_ns == self.stamp_ns:
            return self
        x, y = self.point_at(stamp_ns)
        yaw = wrap_angle(
            self.yaw_rad + self.yaw_rate_radps * ns_to_seconds(stamp_ns - self.stamp_ns)
        )
        # Spelt out: dataclasses.replace takes four times as long, and this is asked all the time.
        return ObjectState(
            self.object_id,
            self.object_class,
            self.role,
            stamp_ns,
            x,
            y,
            yaw,
            self.speed_mps,
            self.acceleration_mps2,
            self.yaw_rate_radps,
            self.size,
            self.sequence,
            self.control_state,
            self.position_std_m,
            self.reference_id,
            self.error_longitudinal_m,
            self.error_lateral_m,
            self.error_yaw_rad,
        )

    def reported(
        self,
        control_state: ControlState,
        reference_id: str,
        errors: tuple[float, float, float],
    ) -> ObjectState:
        """Return the state as its object reports it.

        Args:
            control_state: of the object.
            reference_id: of the reference that it tracks; empty for none.
            errors: longitudinal and lateral ones in m, and that of the yaw in rad.
        """
        return ObjectState(
            self.object_id,
            self.object_class,
            self.role,
            self.stamp_ns,
            self.x_m,
            self.y_m,
            self.yaw_rad,
            self.speed_mps,
            self.acceleration_mps2,
            self.yaw_rate_radps,
            self.size,
            self.sequence,
            control_state,
            self.position_std_m,
            reference_id,
            *errors,
        )
