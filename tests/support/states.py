"""States and references of objects."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, Protocol

from ssp_core.motion.reference import Reference, ReferencePoint
from ssp_core.motion.state import DEFAULT_SIZES, ObjectState
from ssp_core.names import VUT_ID
from ssp_core.vocabulary import ObjectClass, Role


class Moving(Protocol):
    """The motion that a state takes from a simulated body."""

    x_m: float
    y_m: float
    yaw_rad: float
    speed_mps: float
    acceleration_mps2: float

    @property
    def yaw_rate_radps(self) -> float: ...


def object_state(
    object_id: str = "ot1",
    object_class: ObjectClass = ObjectClass.CAR,
    x_m: float = 0.0,
    y_m: float = 0.0,
    yaw_rad: float = 0.0,
    speed_mps: float = 0.0,
    **changes: Any,
) -> ObjectState:
    """A state at time 0; an object target's, or the VUT's if the id is. Keywords replace fields."""
    role = Role.VUT if object_id == VUT_ID else Role.OT
    size = DEFAULT_SIZES[object_class]
    base = ObjectState(
        object_id, object_class, role, 0, x_m, y_m, yaw_rad, speed_mps, 0.0, 0.0, size
    )
    return replace(base, **changes)


def state_of_body(
    body: Moving,
    stamp_ns: int = 0,
    object_id: str = "ot1",
    object_class: ObjectClass = ObjectClass.CAR,
) -> ObjectState:
    """The true state of a simulated body."""
    return object_state(
        object_id,
        object_class,
        body.x_m,
        body.y_m,
        body.yaw_rad,
        body.speed_mps,
        acceleration_mps2=body.acceleration_mps2,
        yaw_rate_radps=body.yaw_rate_radps,
        stamp_ns=stamp_ns,
    )


def make_reference(points: Iterable[ReferencePoint] = (), **changes: Any) -> Reference:
    """A reference of ot1 that is executed from time 0 on; keywords replace its fields."""
    base = Reference("r", "ot1", "v", "approach", 0, 0, 10**12, tuple(points))
    return replace(base, **changes)
