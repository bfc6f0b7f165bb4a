"""Kinds of values that file models are made of, and the base of these models."""

from __future__ import annotations

import math
from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from ssp_core.geometry import Pose2


def _finite(value: float) -> float:
    if not math.isfinite(value):
        raise ValueError("must be a finite number")
    return value


Finite = Annotated[float, AfterValidator(_finite)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_finite)]
NonNegative = Annotated[float, Field(ge=0), AfterValidator(_finite)]
Point = tuple[Finite, Finite]
Path2 = Annotated[list[Point], Field(min_length=2)]
ObjectId = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]


class Strict(BaseModel):
    """Base of all file models: unknown keys are errors, values can't be changed."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class Start(Strict):
    """Initial pose of the reference point, frame map."""

    x_m: Finite
    y_m: Finite
    yaw_rad: Finite

    @property
    def pose(self) -> Pose2:
        return Pose2(self.x_m, self.y_m, self.yaw_rad)
