"""The record of a CARLA server that drew pictures (``ssp.carla_scene/1``), as a bag holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from ssp_core.carla.frame import BodyBox
from ssp_core.run_file.values import Finite, Strict

SCENE_SCHEMA: Literal["ssp.carla_scene/1"] = "ssp.carla_scene/1"
# A blueprint that a server offers which isn't CARLA, but stands in for one in tests.
COUNTERPART_BLUEPRINT = "static.prop.counterpart"
# Smaller differences between a body and what the run takes it for aren't told.
_TOLD_M = 0.005


class BodyRecord(Strict):
    """The body of an object in CARLA.

    Args:
        box: as measured when it was spawned, by the names of ``BodyBox``.
        size: that the run takes it for, by the names of ``Size``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    blueprint: str
    box: dict[str, Finite]
    size: dict[str, Finite]

    @property
    def measured(self) -> BodyBox:
        """The box. Raises KeyError where a side is missing."""
        return BodyBox(**{field.name: self.box[field.name] for field in fields(BodyBox)})

    @property
    def text(self) -> str:
        """Describe blueprint, box and offset, and the difference to the run's size, for people."""
        box, size = self.measured, self.size
        own = (size["front_m"] + size["rear_m"], size["width_m"], size["height_m"])
        sides = (box.length_m, box.width_m, box.height_m)
        told = (
            f"{self.blueprint}, box {_product(sides)} m, middle {box.forward_m:+.2f} m ahead and "
            f"{box.right_m:+.2f} m right of its origin"
        )
        apart = [theirs - ours for theirs, ours in zip(sides, own, strict=True)]
        if max(map(abs, apart)) < _TOLD_M:
            return f"{told}; as the run has it"
        return f"{told}; the run has {_product(own)} m, so that in the pictures it is " + ", ".join(
            f"{abs(by):.2f} m {more if by > 0 else less}"
            for by, more, less in zip(
                apart,
                ("longer", "wider", "higher"),
                ("shorter", "narrower", "lower"),
                strict=True,
            )
            if abs(by) >= _TOLD_M
        )


class CarlaScene(Strict):
    """A server and what it was told, for the readers of its pictures.

    Args:
        first_frame: CARLA's number of the frame before the first picture.
        settings, weather: as read back.
        bodies: by object.
        counterpart: it is a stand-in for tests, and no CARLA.
    """

    schema_: Literal["ssp.carla_scene/1"] = Field(SCENE_SCHEMA, alias="schema")
    version: str
    client_version: str
    map_name: str
    map_sha256: str
    synchronous: bool
    step_s: Finite
    first_frame: Annotated[int, Field(ge=0)]
    seed: Annotated[int, Field(ge=0)]
    rate_hz: Finite
    camera: dict[str, str]
    settings: dict[str, Any]
    weather: dict[str, Finite]
    triggers: list[dict[str, Any]]
    bodies: dict[str, BodyRecord]
    counterpart: bool = False

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)

    def differences(self, other: CarlaScene) -> list[str]:
        """Name the fields that differ, but for the frame's number and bodies of other objects."""
        named = [
            name
            for name in type(self).model_fields
            if name not in ("first_frame", "bodies") and getattr(self, name) != getattr(other, name)
        ]
        both = self.bodies.keys() & other.bodies.keys()
        return named + [f"bodies.{k}" for k in sorted(both) if self.bodies[k] != other.bodies[k]]


def with_bodies(scene: CarlaScene, bodies: Mapping[str, BodyRecord]) -> CarlaScene:
    """The record with further bodies."""
    return scene.model_copy(update={"bodies": {**bodies, **scene.bodies}})


def _product(sides: tuple[float, float, float]) -> str:
    return " × ".join(f"{side:.2f}" for side in sides)
