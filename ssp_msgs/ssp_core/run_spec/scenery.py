"""What stands beside the road, in the road's frame."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import (
    Field,
    model_validator,
)

from ssp_core.run_spec.values import Finite, Strict

# On one road; more would be felt in every frame.
MOST_SCENERY = 1000
SceneryExtent = Annotated[float, Field(ge=0.5, le=300)]


def without_empty_scenery(dumped: dict[str, Any]) -> dict[str, Any]:
    """A dumped block; one without scenery reads, and hashes, as if there were no such field."""
    if not dumped.get("scenery", True):
        del dumped["scenery"]
    return dumped


class Building(Strict):
    """A building: a rectangle of walls on the ground.

    Its length lies along the road turned to the left by ``yaw_rad``.
    """

    type: Literal["building"]
    s_m: Finite = Field(description="of its middle")
    l_m: Finite = Field(description="of its middle, + left")
    yaw_rad: Finite = 0.0
    length_m: SceneryExtent
    width_m: SceneryExtent
    height_m: SceneryExtent


class Sign(Strict):
    """A traffic sign on a post."""

    type: Literal["sign"]
    s_m: Finite
    l_m: Finite = Field(description="+ left")
    kind: Literal["speed_limit", "crossing", "stop", "yield", "other"] = Field(
        description="other: a plain plate"
    )
    value: Annotated[int, Field(ge=1, le=999)] | None = Field(
        None, description="number printed on it: a speed limit's, in the place's own unit"
    )
    direction: Literal["forward", "backward"] = Field(
        "forward", description="of the traffic that it faces"
    )

    @model_validator(mode="after")
    def _has_its_number(self) -> Sign:
        if (self.value is not None) != (self.kind == "speed_limit"):
            raise ValueError("a sign has a value if it is a speed_limit, and no other has one")
        return self


class Tree(Strict):
    """A broad-leaved tree."""

    type: Literal["tree"]
    s_m: Finite
    l_m: Finite = Field(description="+ left")
    height_m: Annotated[float, Field(ge=1, le=60)] = 7.0


class Pole(Strict):
    """A bare post; with a lamp, a street lamp whose arm reaches towards the road."""

    type: Literal["pole"]
    s_m: Finite
    l_m: Finite = Field(description="+ left")
    height_m: Annotated[float, Field(ge=0.5, le=60)] = 7.5
    lamp: bool = False


SceneryItem = Annotated[Building | Sign | Tree | Pole, Field(discriminator="type")]
Scenery = Annotated[list[SceneryItem], Field(max_length=MOST_SCENERY)]
