"""Bodies of object targets: what drives, brakes and steers, simulated or of metal.

An object_target is the same over all of them. ``Body`` is all that it needs of one.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from ssp_core.motion.state import ObjectState
from ssp_core.run_file.participants import ParticipantSpec
from ssp_core.vocabulary import Role
from ssp_ot_controller.core.bodies import Command


@dataclass(frozen=True, slots=True)
class BodyReading:
    """What a body knows of itself at one instant; its reference point in frame map.

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


class Body(Protocol):
    """One body. Neither method waits for anything."""

    def read(self) -> BodyReading | None:
        """The newest reading since the last call, None when there is no new one."""

    def command(self, command: Command, now_ns: int) -> None:
        """What to do until the next command; a body that hears none for long brakes by itself.

        Args:
            command: finite.
            now_ns: session time, ns.
        """

    def close(self) -> None:
        """Gives back what it holds; the body is left to its own watchdog."""


def state_of(reading: BodyReading, spec: ParticipantSpec, sequence: int) -> ObjectState:
    """An object's own state as its body reads it.

    Args:
        reading: of the body.
        spec: of the object.
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
