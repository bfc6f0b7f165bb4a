"""``ssp.site/1``: a proving ground or a simulated place, what is allowed there, how it looks."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import (
    Discriminator,
    Field,
    SerializerFunctionWrapHandler,
    Tag,
    model_serializer,
)

from ssp_core.errors import InputError
from ssp_core.files import parse_whole_model, read_mapping
from ssp_core.hashing import sha256_json
from ssp_core.run_file.model import Camera, Limits, LinkDisturbance, Look
from ssp_core.run_file.participants import TrafficSpec
from ssp_core.run_file.road import CurvePiece, Lane, Scenery, without_empty_scenery
from ssp_core.run_file.values import Finite, NonNegative, ObjectId, Point, Positive, Start, Strict

LIBRARY = Path(__file__).resolve().parent / "library"


class Strip(Strict):
    """A region in a block's frame: between two arc lengths and two offsets (+ left)."""

    block: ObjectId
    from_s_m: Finite
    to_s_m: Finite
    from_l_m: Finite
    to_l_m: Finite


class Polygon(Strict):
    """A region in frame map, as it was surveyed."""

    points: Annotated[list[Point], Field(min_length=3)]


def _kind_of_region(value: Any) -> str | None:
    """Which of both is meant, so that errors name what is wrong with that one."""
    if isinstance(value, Strip | Polygon):
        return type(value).__name__
    if not isinstance(value, dict):
        return None
    if "points" in value:
        return "Polygon"
    return "Strip" if value.keys() & Strip.model_fields.keys() else None


Region = Annotated[
    Annotated[Strip, Tag("Strip")] | Annotated[Polygon, Tag("Polygon")],
    Discriminator(
        _kind_of_region,
        custom_error_type="region",
        custom_error_message="is no region: a polygon has points (at least 3, frame map), a strip "
        "has block, from_s_m, to_s_m, from_l_m and to_l_m",
    ),
]


class SiteBlock(Strict):
    """One stretch of road of the site."""

    id: ObjectId
    origin: Start = Field(description="pose of the reference line's start, frame map")
    pieces: Annotated[list[CurvePiece], Field(min_length=1)]
    lanes: Annotated[list[Lane], Field(min_length=1)]
    road_type: Literal["urban", "rural", "motorway", "proving_ground"]
    left_boundary: Literal["kerb", "sidewalk", "shoulder", "verge"]
    right_boundary: Literal["kerb", "sidewalk", "shoulder", "verge"]
    sidewalk_left_m: NonNegative = 0.0
    sidewalk_right_m: NonNegative = 0.0
    permitted: Annotated[
        list[Literal["keep_lane", "lane_change_left", "lane_change_right", "crossing", "stop"]],
        Field(min_length=1),
    ]
    leads_to: list[ObjectId] = []
    crossing_x_m: Finite | None = None
    speed_limit_mps: Positive
    traffic: list[TrafficSpec] = Field([], description="surroundings, for any event")
    scenery: Scenery = Field([], description="what stands beside the road, block frame")

    @model_serializer(mode="wrap")
    def _without_empty_scenery(self, dump: SerializerFunctionWrapHandler) -> dict[str, Any]:
        return without_empty_scenery(dump(self))


class Site(Strict):
    """A place: its blocks and the Physical library's regions (METHOD 2.1)."""

    schema_: Literal["ssp.site/1"] = Field(alias="schema")
    name: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,31}$")]
    description: str
    domain: Literal["simulation", "physical"]
    stand_in: bool
    blocks: Annotated[list[SiteBlock], Field(min_length=1)]
    ot_reachable: Annotated[list[Region], Field(min_length=1)]
    safe_stop_zones: Annotated[list[Region], Field(min_length=1)]
    geofence: Region
    limits: Limits
    camera: Camera = Camera()
    look: Look = Look()
    disturbance: LinkDisturbance = LinkDisturbance()


def load_site(name_or_path: str) -> tuple[Site, str]:
    """A site by name or file, and its version: the hash of its content, not of its text.

    Raises:
        InputError: there is no such site, or the file is not valid; all that is wrong with it.
    """
    path = find_shipped(name_or_path, "site")
    site = parse_whole_model(Site, read_mapping(path), path)
    return site, site_version(site)


def site_version(site: Site) -> str:
    """Content hash of a site."""
    return sha256_json(site.model_dump(mode="json", by_alias=True))


def find_shipped(name_or_path: str, kind: Literal["site", "event"]) -> Path:
    """The file itself, or the one of that name that comes with the project.

    Raises:
        InputError: it is neither.
    """
    path = Path(name_or_path)
    shipped = LIBRARY / f"{kind}s" / f"{name_or_path}.{kind}.yaml"
    with suppress(OSError):  # a name that is longer than any file's
        if path.suffix in (".yaml", ".yml", ".json") or path.is_file():
            return path
        if shipped.is_file():
            return shipped
    known = ", ".join(sorted(p.name.split(".")[0] for p in (LIBRARY / f"{kind}s").glob("*.yaml")))
    raise InputError(
        f"no such {kind}", value=name_or_path, remedy=f"name one of {known}, or give a file"
    )
