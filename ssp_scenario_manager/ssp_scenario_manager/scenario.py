"""Scenario and site files; ``resolve`` makes a run file from one of each.

A scenario is written in the frame of a road block: x along the road, and lateral places as lanes
or distances from a kerb, so that the same scenario fits sites with other lane widths. A site puts
that block somewhere (METHOD 2.4: p = R p_local + t) and says what is allowed there.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from ssp_core.errors import InputError
from ssp_core.files import load_model, read_mapping
from ssp_core.hashing import sha256_json
from ssp_core.run_spec import (
    Camera,
    ConflictThresholds,
    Driver,
    EndCondition,
    Finite,
    Lane,
    Limits,
    LinkDisturbance,
    Look,
    NonNegative,
    ObjectId,
    ObjectWord,
    Positive,
    Strict,
)

LIBRARY = Path(__file__).resolve().parent / "library"


class Place(Strict):
    """A lateral place: the middle of a lane relative to the VUT's, or a distance from a kerb."""

    x_m: Finite
    lane: int | None = Field(None, description="0 the VUT's lane, 1 the next to its left")
    beyond_right_kerb_m: Finite | None = None
    beyond_left_kerb_m: Finite | None = None


class ApproachPlan(Strict):
    """Straight on along the own lane, until the trigger and, without one, to a standstill."""

    cruise_mps: Positive
    acceleration_mps2: Positive = 2.0
    deceleration_mps2: Positive = 2.0
    end_x_m: Finite


class LaneChangePlan(Strict):
    """To another lane while driving on."""

    kind: Literal["lane_change"]
    lanes: Annotated[int, Field(ge=-3, le=3)] = Field(description="+ is to the left")
    duration_s: Positive
    cruise_mps: Positive
    deceleration_mps2: Positive = 2.0


class CrossPlan(Strict):
    """Straight across to another place."""

    kind: Literal["cross"]
    to: Place
    speed_mps: Positive
    acceleration_mps2: Positive = 1.5


class GapBelow(Strict):
    type: Literal["relative_distance"]
    object_id: ObjectId
    below_m: Positive


class ArrivalBelow(Strict):
    type: Literal["time_to_arrival"]
    anchor_x_m: Finite
    below_s: Positive


class TriggerPlan(Strict):
    id: str
    condition: Annotated[GapBelow | ArrivalBelow, Field(discriminator="type")]
    held_for_s: NonNegative = 0.0
    not_before_s: NonNegative = 0.0
    manoeuvre: Annotated[LaneChangePlan | CrossPlan, Field(discriminator="kind")]
    lead_time_s: NonNegative = 0.1


class VutPlan(Strict):
    object_class: ObjectWord = "car"
    start_x_m: Finite
    end_x_m: Finite
    driver: Driver


class TargetPlan(Strict):
    id: ObjectId
    object_class: ObjectWord
    start: Place
    heading_deg: Finite = Field(0.0, description="relative to the road")
    approach: ApproachPlan | None = None
    trigger: TriggerPlan


class TrafficPlan(Strict):
    id: ObjectId
    object_class: ObjectWord = "car"
    direction: Literal["forward", "backward"]
    lane: Annotated[int, Field(ge=0)] = Field(description="counted from the road's middle")
    x_m: Finite
    speed_mps: NonNegative


class Scenario(Strict):
    """``ssp.scenario/1``: one event in the frame of a block."""

    schema_: Literal["ssp.scenario/1"] = Field(alias="schema")
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
    interaction: Literal["cut_in", "vru_crossing"]
    description: str
    vut: VutPlan
    targets: Annotated[list[TargetPlan], Field(min_length=1)]
    traffic: list[TrafficPlan] = []
    thresholds: ConflictThresholds = ConflictThresholds()
    end: EndCondition = EndCondition()


class Block(Strict):
    """A straight stretch of road and where it lies."""

    origin_x_m: Finite
    origin_y_m: Finite
    heading_deg: Finite
    length_m: Positive
    lanes: Annotated[list[Lane], Field(min_length=1)]
    vut_lane: Annotated[int, Field(ge=0)]
    sidewalk_left_m: NonNegative = 0.0
    sidewalk_right_m: NonNegative = 0.0
    crossing_x_m: Finite | None = None
    fence_margin_m: Positive = Field(description="geofence beyond the sidewalks")
    speed_limit_mps: Positive


class Site(Strict):
    """``ssp.site/1``: a place, what is allowed there, and what it looks like."""

    schema_: Literal["ssp.site/1"] = Field(alias="schema")
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
    description: str
    domain: Literal["simulation", "physical"]
    stand_in: bool
    block: Block
    limits: Limits
    camera: Camera = Camera()
    look: Look = Look()
    disturbance: LinkDisturbance = LinkDisturbance()


def _find(name_or_path: str, kind: str) -> Path:
    path = Path(name_or_path)
    if path.suffix in (".yaml", ".yml", ".json") or path.is_file():
        return path
    shipped = LIBRARY / f"{kind}s" / f"{name_or_path}.{kind}.yaml"
    if shipped.is_file():
        return shipped
    known = ", ".join(sorted(p.name.split(".")[0] for p in (LIBRARY / f"{kind}s").glob("*.yaml")))
    raise InputError(
        f"no such {kind}", value=name_or_path, remedy=f"name one of {known}, or give a file"
    )


def load_scenario(name_or_path: str) -> tuple[Scenario, str]:
    """A scenario by name or file, and its version: the hash of its content, not of its text."""
    path = _find(name_or_path, "scenario")
    return load_model(Scenario, path), sha256_json(read_mapping(path))


def load_site(name_or_path: str) -> tuple[Site, str]:
    """A site by name or file, and its version."""
    path = _find(name_or_path, "site")
    return load_model(Site, path), sha256_json(read_mapping(path))
