"""The choice of a body for each object, by its class, then by the nearest size."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ssp_core.carla.frame import BodyBox
from ssp_core.errors import PeerError
from ssp_core.motion.state import Size
from ssp_core.vocabulary import ObjectClass

PEDESTRIAN_PREFIX = "walker.pedestrian."
VEHICLE_PREFIX = "vehicle."
# The values of a blueprint's base_type that stand for a class.
_BASE_TYPES: dict[ObjectClass, frozenset[str]] = {
    ObjectClass.CAR: frozenset({"car"}),
    ObjectClass.TRUCK: frozenset({"truck"}),
    ObjectClass.BUS: frozenset({"bus"}),
    ObjectClass.MOTORCYCLE: frozenset({"motorcycle"}),
    ObjectClass.CYCLIST: frozenset({"bicycle"}),
}
_TWO_WHEELED = frozenset({ObjectClass.MOTORCYCLE, ObjectClass.CYCLIST})
# A box with a side under this is none: those of some two-wheelers are flat or empty.
_LEAST_SIDE_M = 0.1


@dataclass(frozen=True, slots=True)
class Blueprint:
    """A kind of actor that a server offers.

    Args:
        base_type: of a vehicle, such as ``car``; empty for others.
        wheels: of a vehicle; 0 for others.
    """

    id: str
    base_type: str = ""
    wheels: int = 0


@dataclass(frozen=True, slots=True)
class ChosenBody:
    """The blueprint of an object, and the box that its actors have."""

    blueprint: str
    box: BodyBox


def is_candidate(blueprint: Blueprint, object_class: ObjectClass) -> bool:
    """Tell whether a blueprint is of a class."""
    if object_class is ObjectClass.PEDESTRIAN:
        return blueprint.id.startswith(PEDESTRIAN_PREFIX)
    return (
        blueprint.id.startswith(VEHICLE_PREFIX)
        and blueprint.base_type in _BASE_TYPES.get(object_class, frozenset())
        and (blueprint.wheels == 2) == (object_class in _TWO_WHEELED)
    )


def box_problem(box: BodyBox) -> str:
    """Name the fault of a measured box; empty where there is none."""
    sides = (box.length_m, box.width_m, box.height_m)
    if min(sides) >= _LEAST_SIDE_M:
        return ""
    return "its box is empty: " + " × ".join(f"{side:.2f}" for side in sides) + " m"


def mismatch_m(size: Size, box: BodyBox) -> float:
    """Return the sum of the differences in length, width and height."""
    return (
        abs(size.length_m - box.length_m)
        + abs(size.width_m - box.width_m)
        + abs(size.height_m - box.height_m)
    )


def choose_body(
    object_class: ObjectClass,
    size: Size,
    blueprints: Sequence[Blueprint],
    boxes: Mapping[str, BodyBox],
) -> ChosenBody:
    """Choose the body of the class whose measured box is nearest in size; of equals, by its id.

    Args:
        object_class: of the object.
        size: of the object.
        blueprints: those that the server offers.
        boxes: as measured, by blueprint; one without a box isn't chosen, nor one with an empty one.

    Raises:
        PeerError: the server has none.
    """
    word = object_class.name.lower()
    offered = [b.id for b in blueprints if is_candidate(b, object_class)]
    if not offered:
        raise PeerError(f"the CARLA server has no blueprint for a {word}")
    fitting = [name for name in offered if name in boxes and not box_problem(boxes[name])]
    if not fitting:
        faults = [
            f"{name} ({box_problem(boxes[name]) if name in boxes else 'not spawned'})"
            for name in offered
        ]
        raise PeerError(f"the CARLA server has no body for a {word}: {', '.join(faults)}")
    best = min(fitting, key=lambda name: (round(mismatch_m(size, boxes[name]), 6), name))
    return ChosenBody(best, boxes[best])
