"""Kinds of values that file models are made of, and the base of these models."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, GetCoreSchemaHandler
from pydantic_core import CoreSchema, PydanticCustomError, core_schema

from ssp_core.geodesy import Datum, Place
from ssp_core.geometry import Pose2, outline_problem


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be a finite number")
    return value


Finite = Annotated[float, AfterValidator(_finite)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_finite)]
NonNegative = Annotated[float, Field(ge=0), AfterValidator(_finite)]
Point = tuple[Finite, Finite]


def _legal(points: list[Point]) -> list[Point]:
    problem = outline_problem(points)
    if problem is not None:
        raise ValueError(f"{problem[0]}; {problem[1]}")
    return points


Outline = Annotated[list[Point], Field(min_length=3), AfterValidator(_legal)]
Path2 = Annotated[list[Point], Field(min_length=2)]
ObjectId = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


def _whole(value: Any) -> Any:
    """A value that may become a whole number: no text, no boolean."""
    if isinstance(value, bool | str):
        raise PydanticCustomError("int_type", "Input should be a valid integer")
    return value


def _numbers_as_such(schema: Any) -> Any:
    """A core schema in which neither a text nor a boolean is a number."""
    if isinstance(schema, list | tuple):
        return type(schema)(_numbers_as_such(item) for item in schema)
    if not isinstance(schema, dict) or schema.get("type") == "model":
        return schema  # a model within has its own
    found = {
        # Keys of JSON and YAML are texts.
        key: value if key in ("keys_schema", "metadata") else _numbers_as_such(value)
        for key, value in schema.items()
    }
    if found.get("type") == "float":
        found.setdefault("strict", True)
    if found.get("type") == "int" and not found.get("strict"):
        return core_schema.no_info_before_validator_function(_whole, found)
    return found


class Strict(BaseModel):
    """Base of all file models: unknown keys are errors, values can't be changed.

    Neither a text nor a boolean stands for a number: ``on`` is no second, ``"0150"`` no metre.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        schema = handler(source)
        model: Any = handler.resolve_ref_schema(schema)
        while model["type"] != "model":  # validators of the whole stand around it
            model = model["schema"]
        model["schema"] = _numbers_as_such(model["schema"])
        return schema


def without_defaults(dumped: dict[str, Any], **defaults: object) -> dict[str, Any]:
    """A dumped model; fields with these values read, and hash, as if there were no such fields."""
    for name, default in defaults.items():
        if name in dumped and dumped[name] == default:
            del dumped[name]
    return dumped


class Start(Strict):
    """Initial pose of the reference point, frame map."""

    x_m: Finite
    y_m: Finite
    yaw_rad: Finite

    @property
    def pose(self) -> Pose2:
        return Pose2(self.x_m, self.y_m, self.yaw_rad)


class SiteDatum(Strict):
    """Where the origin of frame map lies on the Earth (WGS 84), and how its axes are turned."""

    latitude_deg: Annotated[float, Field(ge=-90, le=90)]
    longitude_deg: Annotated[float, Field(ge=-180, le=180)]
    altitude_m: Finite = Field(0.0, description="above the ellipsoid, not above the sea")
    yaw_rad: Finite = Field(0.0, description="of the x axis, counter-clockwise from east")

    @property
    def datum(self) -> Datum:
        return Datum(Place(self.latitude_deg, self.longitude_deg, self.altitude_m), self.yaw_rad)
