"""The records of a CARLA server that drew pictures or moved vehicles, as a bag holds them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, fields
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field

from ssp_core.carla.blueprints import ChosenBody
from ssp_core.carla.frame import BodyBox
from ssp_core.cdr.codec import ENCAPSULATION, text_bytes
from ssp_core.hashing import canonical_json
from ssp_core.motion.state import Size
from ssp_core.run_file.values import Finite, Strict

SCENE_SCHEMA: Literal["ssp.carla_scene/1"] = "ssp.carla_scene/1"
PLANT_SCHEMA: Literal["ssp.carla_plant/1"] = "ssp.carla_plant/1"
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
    def box_text(self) -> str:
        """Describe blueprint, box and offset, for people."""
        box = self.measured
        return (
            f"{self.blueprint}, box {_product(_sides(box))} m, middle {box.forward_m:+.2f} m ahead "
            f"and {box.right_m:+.2f} m right of its origin"
        )

    @property
    def text(self) -> str:
        """Describe the body and by how much the run's size differs in pictures, for people."""
        size, box_text = self.size, self.box_text
        own = (size["front_m"] + size["rear_m"], size["width_m"], size["height_m"])
        sides = _sides(self.measured)
        apart = [theirs - ours for theirs, ours in zip(sides, own, strict=True)]
        if max(map(abs, apart)) < _TOLD_M:
            return f"{box_text}; as the run has it"
        return (
            f"{box_text}; the run has {_product(own)} m, so that in the pictures it is "
            + ", ".join(
                f"{abs(by):.2f} m {more if by > 0 else less}"
                for by, more, less in zip(
                    apart,
                    ("longer", "wider", "higher"),
                    ("shorter", "narrower", "lower"),
                    strict=True,
                )
                if abs(by) >= _TOLD_M
            )
        )


def body_record(body: ChosenBody, size: Size) -> dict[str, Any]:
    """Return the fields of a ``BodyRecord``."""
    return {"blueprint": body.blueprint, "box": asdict(body.box), "size": asdict(size)}


class _ServerRecord(Strict):
    """A server and its settings.

    Args:
        address: as it was given; empty in bags from before it was recorded.
        first_frame: CARLA's number of the frame before the first that counts.
        settings: as read back.
        bodies: by object.
        counterpart: it is a stand-in for tests, and no CARLA.
    """

    version: str
    client_version: str
    address: str = ""
    map_name: str
    map_sha256: str
    synchronous: bool
    step_s: Finite
    first_frame: Annotated[int, Field(ge=0)]
    seed: Annotated[int, Field(ge=0)]
    settings: dict[str, Any]
    bodies: dict[str, BodyRecord]
    counterpart: bool = False

    model_config = ConfigDict(extra="forbid", frozen=True, populate_by_name=True)


class CarlaPlantRecord(_ServerRecord):
    """A server whose physics moves vehicles (``ssp.carla_plant/1``).

    Args:
        responses: of each vehicle to its pedals and its wheel, as measured before the run, by the
            names of ``Response``; a body without one is moved by our own model and only placed.
    """

    schema_: Literal["ssp.carla_plant/1"] = Field(PLANT_SCHEMA, alias="schema")
    responses: dict[str, dict[str, Finite]]

    @property
    def texts(self) -> dict[str, str]:
        """Describe the bodies and how they answer, by object, for people."""
        descriptions = {}
        for name, body in sorted(self.bodies.items()):
            r = self.responses.get(name)
            descriptions[name] = f"{body.box_text}; " + (
                "moved by our own body, and placed"
                if r is None
                else f"full throttle {r['throttle_mps2']:.2f} m/s^2 (lag {r['throttle_lag_s']:.2f} "
                f"s), full brake {r['brake_mps2']:.2f} m/s^2 (lag {r['brake_lag_s']:.2f} s), whole "
                f"turn of the wheel {r['steer_1pm']:.3f} 1/m (lag {r['steer_lag_s']:.2f} s)"
            )
        return descriptions


class CarlaScene(_ServerRecord):
    """A server that drew pictures, for their readers (``ssp.carla_scene/1``).

    Args:
        weather: as read back.
    """

    schema_: Literal["ssp.carla_scene/1"] = Field(SCENE_SCHEMA, alias="schema")
    rate_hz: Finite
    camera: dict[str, str]
    weather: dict[str, Finite]
    triggers: list[dict[str, Any]]

    @property
    def texts(self) -> dict[str, str]:
        """Describe the bodies, by object, for people."""
        return {name: body.text for name, body in sorted(self.bodies.items())}

    @property
    def trigger_text(self) -> str:
        """Describe conditions and times of the triggers, for people."""
        return "; ".join(map(_trigger_text, self.triggers)) or "none"

    def differences(self, other: CarlaScene) -> list[str]:
        """Name the fields that differ.

        The address, the frame's number and bodies of other objects don't count.
        """
        field_names = [
            name
            for name in type(self).model_fields
            if name not in ("address", "first_frame", "bodies")
            and getattr(self, name) != getattr(other, name)
        ]
        both = self.bodies.keys() & other.bodies.keys()
        return field_names + [
            f"bodies.{k}" for k in sorted(both) if self.bodies[k] != other.bodies[k]
        ]


def encode_server(record: Mapping[str, Any]) -> bytes:
    """Return a record as the latched message of its topic, std_msgs/String with JSON."""
    return ENCAPSULATION + text_bytes(canonical_json(record).decode())


def with_bodies(scene: CarlaScene, bodies: Mapping[str, BodyRecord]) -> CarlaScene:
    """Return the record with further bodies."""
    return scene.model_copy(update={"bodies": {**bodies, **scene.bodies}})


def _trigger_text(trigger: Mapping[str, Any]) -> str:
    condition = trigger.get("condition")
    values = {**(condition if isinstance(condition, dict) else {}), **trigger}
    values_text = ", ".join(
        f"{name} {value:g}" if isinstance(value, float) else f"{name} {value}"
        for name, value in sorted(values.items())
        if name not in ("id", "object_id") and not isinstance(value, dict | None)
    )
    return f"{trigger.get('id')} of {trigger.get('object_id')}: {values_text}"


def _sides(box: BodyBox) -> tuple[float, float, float]:
    return box.length_m, box.width_m, box.height_m


def _product(sides: tuple[float, float, float]) -> str:
    return " × ".join(f"{side:.2f}" for side in sides)
