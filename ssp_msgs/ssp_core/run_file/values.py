"""Kinds of values that file models are made of, and the base of these models."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import Pose2, outline_problem
from ssp_core.run_file.quantities import LENGTH, NUMBER, Quantity, quantity_of


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be a finite number")
    return value


Finite = Annotated[float, AfterValidator(_finite)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_finite)]
NonNegative = Annotated[float, Field(ge=0), AfterValidator(_finite)]


# Angles that people round: 6.2832 is a whole turn.
_ROUNDED_RAD = 1e-3


def _in_radians(value: float, most_rad: float, bound_text: str) -> float:
    """Take an angle that is in radians.

    Args:
        value: of the angle, rad.
        most_rad: largest angle either way that the field can mean.
        bound_text: that bound for people, such as 2π.

    Raises:
        ValueError: it isn't finite, or beyond the bound, as most angles in degrees are.
    """
    if abs(_finite(value)) > most_rad + _ROUNDED_RAD:
        raise ValueError(
            f"must be from -{bound_text} to {bound_text}; give radians: {value:g} degrees are "
            f"{math.radians(value):.4g}"
        )
    return value


def _yaw_in_radians(value: float) -> float:
    """Take a heading of at most one turn either way, as `_in_radians` does."""
    return _in_radians(value, 2.0 * math.pi, "2π")


def _pitch_in_radians(value: float) -> float:
    return _in_radians(value, math.pi / 2.0, "π/2")


def _roll_in_radians(value: float) -> float:
    return _in_radians(value, math.pi, "π")


Yaw = Annotated[float, AfterValidator(_yaw_in_radians)]
Pitch = Annotated[float, AfterValidator(_pitch_in_radians)]
Roll = Annotated[float, AfterValidator(_roll_in_radians)]
_Coordinate = Annotated[Finite, AfterValidator(LENGTH.within)]
Point = tuple[_Coordinate, _Coordinate]


def _legal(points: list[Point]) -> list[Point]:
    problem = outline_problem(points)
    if problem is not None:
        raise ValueError(f"{problem[0]}; {problem[1]}")
    return points


Outline = Annotated[list[Point], Field(min_length=3), AfterValidator(_legal)]
Path2 = Annotated[list[Point], Field(min_length=2)]
ObjectId = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


def _whole(value: Any) -> Any:
    """Return a value that may become a whole number: no text, no boolean."""
    if isinstance(value, bool | str):
        raise PydanticCustomError("int_type", "Input should be a valid integer")
    return value


def _finite_within(value: Any) -> Any:
    """Return a value of any form that holds no NaN and no infinity, which can't be hashed."""
    left = [value]
    while left:
        item = left.pop()
        if isinstance(item, dict):
            left += item.values()
        elif isinstance(item, list):
            left += item
        elif isinstance(item, float) and not math.isfinite(item):
            raise ValueError("must hold finite numbers alone")
    return value


def _of_files(schema: Any, quantity: Quantity = NUMBER) -> Any:
    """Return a core schema in which a number is one, and within the range of its quantity.

    Neither a text nor a boolean is a number. The quantity of a field is that of its name's unit.

    Args:
        schema: of a model, or of a part of one.
        quantity: of its numbers.
    """
    if isinstance(schema, list | tuple):
        return type(schema)(_of_files(item, quantity) for item in schema)
    if not isinstance(schema, dict) or schema.get("type") == "model":
        return schema  # a model within has its own
    if schema.get("type") == "model-fields":
        fields = {
            name: _of_files(field, quantity_of(name)) for name, field in schema["fields"].items()
        }
        return {**schema, "fields": fields}
    if schema.get("type") == "any":
        return core_schema.no_info_after_validator_function(_finite_within, schema)
    number = schema
    while number.get("type") == "function-after":
        number = number["schema"]
    if number.get("type") == "float":
        number.setdefault("strict", True)
        check = quantity.within_positive if number.get("gt") == 0 else quantity.within
        is_bounded = number.keys() & {"ge", "gt"} and number.keys() & {"le", "lt"}
        if is_bounded and number.get("gt") != 0:
            return schema
        return core_schema.no_info_after_validator_function(check, schema)
    new_schema = {
        # Keys of JSON and YAML are texts.
        key: value if key in ("keys_schema", "metadata") else _of_files(value, quantity)
        for key, value in schema.items()
    }
    if new_schema.get("type") == "int" and not new_schema.get("strict"):
        return core_schema.no_info_before_validator_function(_whole, new_schema)
    return new_schema


class Strict(BaseModel):
    """Base of all file models: unknown keys are errors, values can't be changed.

    Neither a text nor a boolean stands for a number: ``on`` is no second, ``"0150"`` no metre.
    A number is within the range of the unit that its field's name ends with.
    The validator of a model is made when it is first used: a node reads few of the files whose
    models it imports.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, defer_build=True)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema = handler(source)
        model: Any = handler.resolve_ref_schema(schema)
        while model["type"] != "model":  # validators of the whole stand around it
            model = model["schema"]
        model["schema"] = _of_files(model["schema"])
        return schema


def without_defaults(dumped: dict[str, Any], **defaults: object) -> dict[str, Any]:
    """Return a dumped model without the fields that have these values.

    It reads, and hashes, as if there were no such fields.
    """
    for name, default in defaults.items():
        if name in dumped and dumped[name] == default:
            del dumped[name]
    return dumped


class Start(Strict):
    """Initial pose of the reference point, frame map."""

    x_m: Finite
    y_m: Finite
    yaw_rad: Yaw

    @property
    def pose(self) -> Pose2:
        return Pose2(self.x_m, self.y_m, self.yaw_rad)


def _on_earth(place: Place) -> None:
    if place.problem is not None:
        raise ValueError(place.problem)


def _latitude(value: float) -> float:
    _on_earth(Place(value, 0.0))
    return value


def _longitude(value: float) -> float:
    _on_earth(Place(0.0, value))
    return value


class SiteDatum(Strict):
    """The place on the Earth of frame map's origin (WGS 84), and the orientation of its axes."""

    latitude_deg: Annotated[float, AfterValidator(_latitude)]
    longitude_deg: Annotated[float, AfterValidator(_longitude)]
    altitude_m: Finite = Field(0.0, description="above the ellipsoid, not above the sea")
    yaw_rad: Yaw = Field(0.0, description="of the x axis, counter-clockwise from east")

    @property
    def datum(self) -> Datum:
        return Datum(Place(self.latitude_deg, self.longitude_deg, self.altitude_m), self.yaw_rad)
