"""Kinds of values that file models are made of, and the base of these models."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

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


class Strict(BaseModel):
    """Base of all file models: unknown keys are errors, values can't be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


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
